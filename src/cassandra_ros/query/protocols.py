# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Interfaces of the query language to stored rows and their tables."""

from __future__ import annotations

from typing import Iterator, Mapping, NamedTuple, Protocol, Sequence, TypeVar

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.keys import Position, RowName
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.index_field import IndexField
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.read import Read, TimeRange


class RunNames(Protocol):
    """Recordings, imports and clients that stored the messages, by their writer ids."""

    def called(self, text: str) -> frozenset[int]:
        """Return the writer ids of the runs with this value of RUN."""

    def unknown(self, text: str) -> str:
        """Say that no run has this value of RUN, with similar ones; '' = one has it."""

    def unknown_robot(self, node: str) -> str:
        """Say that no message is of a robot, with similar names; '' = one is."""

    def text(self, writer: int) -> str:
        """Return the value of RUN for the messages of a writer id."""


WGS84 = "WGS84"
"""Frame of the Earth, in which positions are latitude and longitude, degrees. All other frames are
of the ground."""


class Disk(NamedTuple):
    """A disk on the ground or on the Earth, and the robot whose position is compared with it."""

    x: float
    y: float
    """Metres in a frame of the ground; in WGS84 latitude and longitude, degrees."""
    radius: float
    """Metres; the rim is included."""
    frame: str = "map"
    """Frame of x and y."""
    robot: str = ""
    """Frame of the robot, or topic of its poses; '' = find it."""


class Stays(Protocol):
    """Times at which a NEAR is true (the robot was on the disk), or an EVENT."""

    def holds(self, node: str, run: str, t: int) -> bool | None:
        """Return whether it is true for the robot of a message at a time; None if unknown.

        Args:
            node: nodeID of the message.
            run: Value of RUN for the message.
            t: Row key of the message, ns.
        """

    def spans(self, low: int, high: int, reverse: bool = False) -> Iterator[tuple[int, int]]:
        """Yield time ranges outside of which ``holds`` is never true.

        The ranges lie in [low, high], ns, both ends included; they are disjoint, and ascending or
        (reverse) descending. They are computed when the iterator is advanced.
        """


class Places(Protocol):
    """Positions of the robots of a keyspace."""

    def stays(
        self, disk: Disk, node: str | None = None, writers: frozenset[int] | None = None
    ) -> Stays:
        """Return when robots were on a disk.

        Args:
            disk: The disk.
            node: nodeID of the robot; None = all robots.
            writers: Writer ids of the runs whose messages are checked. If they recorded poses, only
                these are used. None = all runs.

        Raises:
            InvalidOption: No pose in the disk's frame is stored, or several robots may be meant.
        """


class NamedTime(Protocol):
    """A named time range of a robot."""

    @property
    def end_ns(self) -> int | None:
        """Last time, ns, included; None = it lasts."""

    @property
    def node(self) -> str:
        """NodeID of the robot; '' = of all robots."""

    def order(self) -> tuple[int, str, str, str]:
        """Return the key by which events are sorted; copies of an event have the same."""

    @property
    def time_range(self) -> TimeRange:
        """The time range; one that lasts reaches to the end of all time."""


class NamedTimes(Protocol):
    """Events of a keyspace: named time ranges of robots."""

    def called(self, name: str, like: bool, read: Read) -> Iterator[NamedTime]:
        """Yield the events that ``times`` uses, sorted by ``order``. Its arguments are the same."""

    def unknown(self, name: str, like: bool) -> str:
        """Say that no event has a name, or one like it, with similar names; '' = one has."""

    def times(self, name: str, like: bool, read: Read, others: Sequence[NamedTimes] = ()) -> Stays:
        """Return when robots had events of a name.

        Args:
            name: The name, or (like) a pattern of LIKE.
            like: Whether the name is a pattern.
            read: The messages that are checked; other times and robots may be left out.
            others: Events of other keyspaces that count, too. Of copies of an event the one counts
                that has an end.

        Raises:
            InvalidName, InvalidOption: The name is empty, or there are too many events.
        """


class SizeGroup(Protocol):
    """Messages of a block that have the same size."""

    @property
    def members(self) -> NDArray[np.int64]:
        """Positions of the messages in the block, ascending."""

    @property
    def stored(self) -> NDArray[np.uint8]:
        """Bytes of the messages, (size, members): row k holds byte k of every message."""

    @property
    def rises(self) -> NDArray[np.bool_] | None:
        """Which rows are stored as differences; None = no row is."""


class UnpackedMessages(Protocol):
    """Consecutive messages of one table, unpacked together."""

    def __len__(self) -> int: ...

    @property
    def groups(self) -> Sequence[SizeGroup]:
        """All messages of the block, by size."""


class Table(Protocol):
    """A table of a topic: messages of one definition, in one format."""

    name: str
    """Name, unique in its keyspace."""
    definition: Definition | None
    """Definition of its messages; None if it is unusable."""
    named: bool
    """Whether rows are found by a name instead of their time."""
    packed: bool
    """Whether messages are stored in blocks, with zones that bound their fields."""
    columns: tuple[str, ...]
    """Columns of its format, in their order."""
    longest_text: int
    """Maximum size of a text in a column, UTF-8 bytes. A longer text of a large message has no
    column."""

    @property
    def msg_type(self) -> str:
        """Type of its messages, 'pkg/Name'."""

    @property
    def runs(self) -> RunNames:
        """Runs of its keyspace."""

    @property
    def places(self) -> Places:
        """Positions of the robots of its keyspace."""

    @property
    def events(self) -> NamedTimes:
        """Events of its keyspace."""

    @property
    def by_field(self) -> bool:
        """Whether each field has a column of its own (format ``ros``)."""

    @property
    def index_fields(self) -> Mapping[str, IndexField]:
        """Indexes that conditions can use, by field."""


class Row(Protocol):
    """A stored message: its row key, and its bytes, which may be read when they are requested."""

    t: int
    """Key time, ns since 1970."""
    node: str
    """nodeID of the robot; '' if none was given."""
    seq: int
    """Writer id << 32 | counter."""
    name: str
    """Name under which it is kept; '' if it is found by its time."""
    columns: tuple[bytes | None, ...]
    """Encoded columns of the format, in its order: all of them, those that were requested, or none;
    the number of columns tells which. None = unset."""
    size: int
    """Size of the serialised message, bytes."""

    @property
    def run(self) -> str:
        """Name of the run that stored it; its writer id if the run has no name."""

    @property
    def topic(self) -> str:
        """Topic under which it is stored."""

    @property
    def key(self) -> Stamp | RowName:
        """The row key."""

    @property
    def position(self) -> Position:
        """Position in the order of all reads."""

    @property
    def table(self) -> Table:
        """Table that contains it."""

    @property
    def wire(self) -> bytes:
        """The serialised message."""


RowT_co = TypeVar("RowT_co", bound=Row, covariant=True)


class Source(Protocol[RowT_co]):
    """The stored messages of one topic."""

    @property
    def name(self) -> str:
        """Name of the topic."""

    @property
    def tables(self) -> Sequence[Table]:
        """Tables of the topic, one for each definition and format.

        Empty before the first message.
        """

    def read(self, read: Read) -> Iterator[RowT_co]:
        """Yield the rows that a read asks for, in its order.

        Raises:
            InvalidKey: The read asks for an invalid name.
        """

    def count(self, read: Read) -> int:
        """Return the number of rows in the time range of a read, of its nodes and writers."""

    def countBuckets(self) -> int:
        """Return the number of buckets: time slices of a robot in a table."""
