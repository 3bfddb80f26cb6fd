# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What keys stand for: a time range, a name, or the value of a field."""

from __future__ import annotations

from typing import Any, Callable, FrozenSet, NamedTuple, Optional, Protocol, Sequence, Union

from cassandra_ros.keys import writer_of
from cassandra_ros.messages.stamps import Time, to_ns

LAST_NS = 2**63 - 1


class Place(Protocol):
    """A row, its position, or a key that the store gave."""

    @property
    def node(self) -> Optional[str]:
        """The nodeID."""

    @property
    def seq(self) -> Optional[int]:
        """Writer id << 32 | counter."""


Clock = Callable[[], Time]
AnyKey = Any
"""A Time, or what else is the topic's key: a name, or the value of a field."""


Nodes = Optional[Sequence[str]]
"""nodeIDs whose messages are meant; None = all."""


class Whose(NamedTuple):
    """Whose messages are meant."""

    nodes: Nodes = None
    """nodeIDs; None = all."""
    writers: Optional[FrozenSet[int]] = None
    """Writer ids, of the recordings, imports and clients that stored them; None = all."""

    def has(self, place: Place) -> bool:
        """Say whether a row, or what tells of one, is of theirs."""
        return self.wrote(place.seq or 0) and (self.nodes is None or place.node in self.nodes)

    def wrote(self, seq: int) -> bool:
        """Say whether one of the writers gave this ``_seq``."""
        return self.writers is None or writer_of(seq) in self.writers


EVERYBODY = Whose()


class TimeRange(NamedTuple):
    """All messages of a time range, ns, both ends included."""

    low: int = 0
    high: int = LAST_NS

    @classmethod
    def between(cls, key: Optional[Time], to_key: Optional[Time]) -> TimeRange:
        """Return the stretch between two times; None = open."""
        low = 0 if key is None else to_ns(key)
        return cls(low, LAST_NS if to_key is None else to_ns(to_key))

    def wider(self, by_ns: int) -> TimeRange:
        """Return the stretch that reaches so much further on both sides."""
        return TimeRange(max(0, self.low - by_ns), min(LAST_NS, self.high + by_ns))


class Named(NamedTuple):
    """All messages under one name."""

    name: str


class Valued(NamedTuple):
    """All messages whose key field has one value."""

    value: AnyKey


def spellings(topic: str) -> tuple[str, str]:
    """Return the names that a topic is looked for by: the given one first."""
    return topic, topic[1:] if topic.startswith("/") else "/" + topic


Selection = Union[TimeRange, Named, Valued]
