# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What keys stand for: a stretch of time, a name, or the value of a field."""

from __future__ import annotations

from typing import Any, NamedTuple, Optional, Sequence, Union

from cassandra_ros.messages.stamps import Stamp, to_ns

LAST_NS = 2**63 - 1

Time = Union[Stamp, int, float, str]
"""genpy.Time or Stamp, int (ns), float (s) or ISO 8601 text."""
AnyKey = Any
"""A Time, or what else is the topic's key: a name, or the value of a field."""
Nodes = Optional[Sequence[str]]
"""nodeIDs whose messages are meant; None = all."""


class Stretch(NamedTuple):
    """All messages of a stretch of time, ns, both ends included."""

    low: int = 0
    high: int = LAST_NS

    @classmethod
    def between(cls, key: Optional[Time], to_key: Optional[Time]) -> Stretch:
        """Return the stretch between two times; None = open."""
        low = 0 if key is None else to_ns(key)
        return cls(low, LAST_NS if to_key is None else to_ns(to_key))


class Named(NamedTuple):
    """All messages under one name."""

    name: str


class Valued(NamedTuple):
    """All messages whose key field has one value."""

    value: AnyKey


def spellings(topic: str) -> tuple[str, str]:
    """Return the names that a topic is looked for by: the given one first."""
    return topic, topic[1:] if topic.startswith("/") else "/" + topic


Selection = Union[Stretch, Named, Valued]
