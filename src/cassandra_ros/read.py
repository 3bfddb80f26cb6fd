# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The record that describes a read. The public method makes it and hands it down to the store."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, FrozenSet, NamedTuple, Optional, Protocol, Sequence, Tuple

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.keys import Position, writer_of

LAST_NS = 2**63 - 1
"""Maximum end of a time range, ns."""
Nodes = Optional[Sequence[str]]
"""nodeIDs whose messages are read; None = all."""
Writers = Optional[FrozenSet[int]]
"""Writer ids whose messages are read; None = all."""
Columns = Callable[..., Optional[Sequence[str]]]
"""Function of a table that returns the columns of its format to read, in order; None = all."""
Terms = Tuple[Tuple[str, str, bytes], ...]
"""Comparisons for the server, each a column, an operator of CQL and an encoded value."""
Query = Tuple[Terms, bool]
"""Comparisons that the server checks, and whether it finds the rows by an index."""


class Sifted(NamedTuple):
    """The messages of a block that may satisfy a condition."""

    mask: NDArray[np.bool_] | None
    """A bool for each message; None = all."""
    unsure: NDArray[np.bool_] | None
    """A bool for each message: if it is in the mask it has to be checked again; None = all."""


Sift = Callable[..., Sifted]
"""Function of an unpacked block that selects its messages to read."""

Skip = Callable[..., bool]
"""Function of a table, a node and a bucket that returns whether the bucket is left out."""


class MessageOrigin(Protocol):
    """Robot and writer of a message, as a row, a position or a stored key has them."""

    @property
    def node(self) -> str | None:
        """The nodeID."""

    @property
    def seq(self) -> int | None:
        """Writer id << 32 | counter."""


class Whose(NamedTuple):
    """The robots and writers whose messages are read."""

    nodes: Nodes = None
    writers: Writers = None
    """Writer ids of the recordings, imports and clients that stored them; None = all."""

    @classmethod
    def of(cls, node: str | None, writers: Writers = None) -> Whose:
        """Return an object for one robot (None = all robots) and some writers."""
        return cls(None if node is None else (node,), writers)

    @property
    def node(self) -> str | None:
        """The nodeID if there is exactly one robot, else None."""
        return self.nodes[0] if self.nodes is not None and len(self.nodes) == 1 else None

    def both(self, other: Whose) -> Whose:
        """Return the intersection with another object."""
        nodes, writers = self
        if nodes is None:
            nodes = other.nodes
        elif other.nodes is not None:
            nodes = tuple(node for node in nodes if node in other.nodes)
        if writers is None:
            writers = other.writers
        elif other.writers is not None:
            writers = writers & other.writers
        return Whose(nodes, writers)

    @property
    def empty(self) -> bool:
        """Whether no message can belong to it: it has no robot, or no writer."""
        return self.nodes == () or self.writers == frozenset()

    def has(self, origin: MessageOrigin) -> bool:
        """Return whether a row, position or key belongs to one of these robots and writers."""
        return self.wrote(origin.seq or 0) and (self.nodes is None or origin.node in self.nodes)

    def wrote(self, seq: int) -> bool:
        """Return whether a ``_seq`` was assigned by one of the writers."""
        return self.writers is None or writer_of(seq) in self.writers


EVERYBODY = Whose()
"""All robots and writers."""


class TimeRange(NamedTuple):
    """A time range, ns, both ends included."""

    low: int = 0
    high: int = LAST_NS

    def wider(self, by_ns: int) -> TimeRange:
        """Return the time range extended by ``by_ns`` at both ends, within 0 to LAST_NS."""
        return TimeRange(max(0, self.low - by_ns), min(LAST_NS, self.high + by_ns))


ALWAYS = TimeRange()
"""The time range of all messages."""


class Named(NamedTuple):
    """All messages under one name."""

    name: str


class Valued(NamedTuple):
    """All messages whose key field has one value."""

    value: object


class Chooser(Protocol):
    """Decides for each bucket which comparisons of a condition the server checks.

    A table is the object that the reader got; a bucket is the list of its rows in the directory.
    Signatures have ``...`` because the type of the table differs between rooms.
    """

    @property
    def checks(self) -> bool:
        """Whether there is a condition to check."""

    @property
    def choose(self) -> Callable[..., Sequence[Query] | None]:
        """Function of table and bucket that returns queries for rows that may match; None = all."""

    @property
    def few(self) -> Callable[..., bool]:
        """Function of a table: whether few rows of a bucket probably satisfy the comparisons."""

    @property
    def learn(self) -> Callable[..., None]:
        """Function that gets a table, a bucket, and the number of messages that were found."""

    @property
    def sift(self) -> Callable[..., Sift | None]:
        """Function of a table that returns its Sift; None = all messages of its blocks are read."""

    @property
    def opened(self) -> Callable[..., None]:
        """Function that gets a table, the messages of an unpacked block, and how many were kept."""


@dataclass(frozen=True)
class Read:
    """The messages to read, their order, and their columns.

    The tables are not part of it, because they may be replaced during the read.
    """

    time_range: TimeRange = ALWAYS
    """Time range of the keys, or of the receive times if the caller asks for these."""
    whose: Whose = EVERYBODY
    only: Named | Valued | None = None
    """Name of the messages, or value of their key field; None = all messages."""
    after: Position | None = None
    """Position (of a cursor) after which rows are read, in the order of reading; None = all."""
    reverse: bool = False
    """Whether the newest messages come first."""
    columns: Columns | None = None
    """Columns to read; None = all. A row fetches the other columns when they are needed."""
    chooser: Chooser | None = None
    """Object that decides which comparisons the server checks; None = it checks none."""
    wanted: int | None = None
    """Number of rows that the caller will probably take; None = all. More rows can be read."""
    skip: Skip | None = None
    """Function that tells which buckets are left out; None = none. Messages with names are not in
    buckets."""


EVERYTHING = Read()
"""The read of all messages in the order of their positions."""
