# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the query language needs of the rows that it is asked about, and of their tables."""

from __future__ import annotations

from typing import FrozenSet, Iterator, Mapping, NamedTuple, Optional, Protocol, Sequence, Tuple

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.keys import Position, RowName
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.index_field import IndexField
from cassandra_ros.messages.stamps import Stamp


class Runs(Protocol):
    """The recordings, imports and clients that stored the messages, by their writer ids."""

    def called(self, text: str) -> FrozenSet[int]:
        """Return those whose RUN is this text."""


class Disk(NamedTuple):
    """A spot on the ground, and whose place is asked for."""

    x: float
    y: float
    radius: float
    """All three in metres, the rim included."""
    frame: str = "map"
    """The frame of x and y."""
    robot: str = ""
    """Its frame, or a topic of its poses; '' = to be found out."""


class Stays(Protocol):
    """When robots were where a question asks for."""

    def holds(self, node: str, run: str, t: int) -> Optional[bool]:
        """Say whether the robot of a message was there; None where nobody knows.

        Args:
            node: nodeID of the message.
            run: What RUN says of it.
            t: The time under which it lies, ns.
        """

    def spans(self, low: int, high: int, reverse: bool = False) -> Iterator[Tuple[int, int]]:
        """Yield time ranges outside of which ``holds`` is never true.

        In order, or the newest first, apart from one another, both ends included, ns, all of them
        in [low, high]. They are found while they are taken.
        """


class Places(Protocol):
    """Where the robots of a keyspace were."""

    def stays(
        self, disk: Disk, node: Optional[str] = None, writers: Optional[FrozenSet[int]] = None
    ) -> Stays:
        """Say when robots were on a disk; of one node, None = of all.

        Args:
            writers: The runs about whose messages it is asked: their own poses count, where they
                recorded any. None = all runs.

        Raises:
            InvalidOption: No pose in its frame is stored, or several robots may be meant.
        """


class Group(Protocol):
    """Messages of a block that have the same size."""

    @property
    def members(self) -> NDArray[np.int64]:
        """Their positions in the block, ascending."""

    @property
    def planes(self) -> NDArray[np.uint8]:
        """(size, members): row k holds byte k of every message."""


class Block(Protocol):
    """Consecutive messages of one table, unpacked together."""

    def __len__(self) -> int: ...

    @property
    def groups(self) -> Sequence[Group]:
        """All of its messages."""


class Table(Protocol):
    """A table of a topic: messages of one definition, in one format."""

    name: str
    """Unique in its keyspace."""
    definition: Optional[Definition]
    """None where there is no usable one."""
    named: bool
    """Its rows are found by a name, not by their time."""
    packed: bool
    """Its messages lie in blocks, with zones that bound their fields."""
    columns: tuple[str, ...]
    """Those of its format, in their order."""
    longest_text: int
    """A longer text of a large message is in no column; bytes of UTF-8."""

    @property
    def msg_type(self) -> str:
        """Type of its messages, 'pkg/Name'."""

    @property
    def runs(self) -> Runs:
        """Those of its keyspace."""

    @property
    def places(self) -> Places:
        """Where its keyspace's robots were."""

    @property
    def by_field(self) -> bool:
        """Whether each field has a column of its own (format ``ros``)."""

    @property
    def index_fields(self) -> Mapping[str, IndexField]:
        """The indexes that conditions can use, by their field."""


class Row(Protocol):
    """A stored message: its place, and its bytes when they are asked for."""

    t: int
    """Key time, ns since 1970."""
    node: str
    """'' when nobody said."""
    name: str
    """The name under which it is kept; '' where it is found by time."""
    columns: tuple[Optional[bytes], ...]
    """Columns of the format, undecoded: all of them, or those that were asked for."""
    size: int
    """Serialised bytes."""

    @property
    def run(self) -> str:
        """Name of the run that stored it, or its writer id where that has none."""

    @property
    def topic(self) -> str:
        """The topic under which it is stored."""

    @property
    def key(self) -> Stamp | RowName:
        """The row key."""

    @property
    def position(self) -> Position:
        """Its place in the order of all reads."""

    @property
    def table(self) -> Table:
        """The table in which it lies."""

    @property
    def wire(self) -> bytes:
        """The serialised message."""
