# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a read asks for: one record, made in the public method and handed down to the store."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, FrozenSet, NamedTuple, Optional, Protocol, Sequence, Tuple, Union

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.keys import Position, writer_of

LAST_NS = 2**63 - 1
"""The largest time of a time range, ns."""
Nodes = Optional[Sequence[str]]
"""nodeIDs whose messages are read; None = all."""
Writers = Optional[FrozenSet[int]]
"""Writer ids whose messages are read; None = all."""
Columns = Callable[..., Optional[Sequence[str]]]
"""Returns for a table the columns of its format to read, in their order; None = all."""
Terms = Tuple[Tuple[str, str, bytes], ...]
"""Comparisons for the server: column, operator of CQL, encoded value."""
Query = Tuple[Terms, bool]
"""What the server checks, and whether it finds the rows by an index."""
Sift = Callable[..., Optional[NDArray[np.bool_]]]
"""Returns for an unpacked block a mask of the messages to keep; None = all."""


class Place(Protocol):
    """A row, its position, or a key that the store gave."""

    @property
    def node(self) -> Optional[str]:
        """The nodeID."""

    @property
    def seq(self) -> Optional[int]:
        """Writer id << 32 | counter."""


class Whose(NamedTuple):
    """Whose messages are meant."""

    nodes: Nodes = None
    writers: Writers = None
    """Writer ids of the recordings, imports and clients that stored them; None = all."""

    @classmethod
    def of(cls, node: Optional[str], writers: Writers = None) -> Whose:
        """Return the messages of one node, None = of all, and of some writers."""
        return cls(None if node is None else (node,), writers)

    @property
    def node(self) -> Optional[str]:
        """The nodeID, where the messages of one node are meant; else None."""
        return self.nodes[0] if self.nodes is not None and len(self.nodes) == 1 else None

    def both(self, other: Whose) -> Whose:
        """Return the messages that are theirs and also those of others."""
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
        """Whether no node or no writer is left."""
        return self.nodes == () or self.writers == frozenset()

    def has(self, place: Place) -> bool:
        """Say whether a row, or what tells of one, is of theirs."""
        return self.wrote(place.seq or 0) and (self.nodes is None or place.node in self.nodes)

    def wrote(self, seq: int) -> bool:
        """Say whether one of the writers gave this ``_seq``."""
        return self.writers is None or writer_of(seq) in self.writers


EVERYBODY = Whose()
"""The messages of all nodes and writers."""


class TimeRange(NamedTuple):
    """A time range, ns, both ends included."""

    low: int = 0
    high: int = LAST_NS

    def wider(self, by_ns: int) -> TimeRange:
        """Return the time range that begins earlier and ends later by this time, ns."""
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
    """Decides, bucket by bucket, what the server checks of a condition.

    A table is the object that the reader was given; a bucket is the list of its rows in the
    directory. (A signature with ``...`` leaves the type of the table to each room.)
    """

    @property
    def checks(self) -> bool:
        """Whether there is anything to check."""

    @property
    def choose(self) -> Callable[..., Optional[Sequence[Query]]]:
        """From table and bucket to the queries that give the rows that may pass; None = all."""

    @property
    def few(self) -> Callable[..., bool]:
        """Says of a table whether the server probably lets few rows of a bucket through."""

    @property
    def learn(self) -> Callable[..., None]:
        """Takes table, bucket and how many messages its queries found."""

    @property
    def sift(self) -> Callable[..., Optional[Sift]]:
        """From a table to what leaves out messages of its unpacked blocks; None = all stay."""

    @property
    def opened(self) -> Callable[..., None]:
        """Takes a table, the messages of a block that was unpacked, and how many became rows."""


@dataclass(frozen=True)
class Read:
    """Which stored messages to read, in which order, and how much of each.

    The tables to read are given beside it: they may be replaced while a read goes on.
    """

    time_range: TimeRange = ALWAYS
    """Key times, or times of reception where these are asked for."""
    whose: Whose = EVERYBODY
    only: Union[Named, Valued, None] = None
    """Only the messages under this name, or with this value of the key field; None = all."""
    after: Optional[Position] = None
    """Only rows that come after this place in the order of reading (a cursor)."""
    reverse: bool = False
    """Newest first."""
    columns: Optional[Columns] = None
    """None = all columns. A row fetches the others when its bytes are asked for."""
    chooser: Optional[Chooser] = None
    """What the server may leave out; None = nothing."""
    wanted: Optional[int] = None
    """Number of rows that are probably taken; None = all. More come all the same."""


EVERYTHING = Read()
"""The read of all messages in the order of their place."""
