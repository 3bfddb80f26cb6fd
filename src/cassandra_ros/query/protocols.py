# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the query language needs of whoever has the rows: tables, their rows, a topic of both."""

from __future__ import annotations

from typing import (
    Callable,
    FrozenSet,
    Iterator,
    Mapping,
    Optional,
    Protocol,
    Sequence,
    Tuple,
    TypeVar,
    Union,
)

from cassandra_ros.keys import Position, RowName
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.index_field import IndexField
from cassandra_ros.messages.stamps import Stamp


class Table(Protocol):
    """A table of a topic: messages of one definition, in one format."""

    @property
    def name(self) -> str:
        """Its name, unique in its keyspace."""

    @property
    def msg_type(self) -> str:
        """Type of its messages, 'pkg/Name'."""

    @property
    def definition(self) -> Optional[Definition]:
        """Of its messages; None where there is no usable one."""

    @property
    def named(self) -> bool:
        """Whether its rows are found by a name, not by their time."""

    @property
    def columns(self) -> Sequence[str]:
        """The columns of its format, in their order."""

    @property
    def by_field(self) -> bool:
        """Whether each field has a column of its own (format ``ros``)."""

    @property
    def index_fields(self) -> Mapping[str, IndexField]:
        """The indexes that conditions can use, by their field."""

    @property
    def longest_text(self) -> int:
        """A longer text of a large message is in no column; bytes of UTF-8."""


class Row(Protocol):
    """A stored message: its place, and its bytes when they are asked for."""

    @property
    def t(self) -> int:
        """Key time, ns since 1970."""

    @property
    def node(self) -> str:
        """NodeID of the message; '' when nobody said."""

    @property
    def name(self) -> str:
        """The name under which it is kept; '' where it is found by time."""

    @property
    def topic(self) -> str:
        """The topic under which it is stored."""

    @property
    def key(self) -> Union[Stamp, RowName]:
        """The row key."""

    @property
    def position(self) -> Position:
        """Its place in the order of all reads."""

    @property
    def table(self) -> Table:
        """The table in which it lies."""

    @property
    def columns(self) -> Sequence[Optional[bytes]]:
        """Columns of the format, undecoded: all of them, or those that were asked for."""

    @property
    def size(self) -> int:
        """Serialised bytes."""

    @property
    def wire(self) -> bytes:
        """The serialised message."""


class Bucket(Protocol):
    """What one writer notes of a partition in the directory."""

    @property
    def rows(self) -> int:
        """How many messages it wrote there."""

    @property
    def odd(self) -> int:
        """How many of them have a field that is not held exactly in its column."""

    @property
    def closed(self) -> bool:
        """Whether these numbers are final."""

    @property
    def filled(self) -> FrozenSet[str]:
        """The shadow columns that it filled in each of its rows."""


Columns = Callable[[Table], Optional[Sequence[str]]]
"""Gives for a table those of its columns that are to be read, in their order; None = all."""
Term = Tuple[str, str, bytes]
"""Column, operator and encoded value."""
Query = Tuple[Tuple[Term, ...], bool]
"""What the server is to check, all of it, and whether it finds the rows by an index."""


class TopicChooser(Protocol):
    """Decides, bucket by bucket, what the server is to check."""

    def choose(self, table: Table, bucket: Sequence[Bucket]) -> Optional[Sequence[Query]]:
        """Return the queries whose rows together are those of the bucket that may be wanted.

        None = all rows of the bucket; empty = none of them.
        """

    def few(self, table: Table) -> bool:
        """Say whether the server is expected to let few rows of a bucket through."""

    def learn(self, table: Table, bucket: Sequence[Bucket], found: int) -> None:
        """Take note of how many rows the queries of a bucket found."""


RowT = TypeVar("RowT", bound=Row)
RowT_co = TypeVar("RowT_co", bound=Row, covariant=True)


class Source(Protocol[RowT_co]):
    """The stored messages of one topic."""

    @property
    def name(self) -> str:
        """The topic's name."""

    @property
    def tables(self) -> Sequence[Table]:
        """Its tables, one for each definition and format; none before the first message."""

    def rows(
        self,
        key: Optional[int] = None,
        to_key: Optional[int] = None,
        *,
        nodeID: Optional[str] = None,
        limit: Optional[int] = None,
        after: Optional[Position] = None,
        reverse: bool = False,
        columns: Optional[Columns] = None,
        chooser: Optional[TopicChooser] = None,
    ) -> Iterator[RowT_co]:
        """Walk through the rows with a time in [key, to_key], ns, in its order; None = open."""

    def versions(
        self, name: str, *, nodeID: Optional[str] = None, reverse: bool = False
    ) -> Iterator[RowT_co]:
        """Walk through the rows under one name, by time.

        Raises:
            InvalidKey: No message can have such a name.
        """

    def countTopicData(
        self,
        key: Optional[Stamp] = None,
        to_key: Optional[Stamp] = None,
        nodeID: Optional[str] = None,
    ) -> int:
        """Count the rows with a time in [key, to_key]."""

    def countBuckets(self) -> int:
        """Count its partitions: stretches of time of a node in a table."""
