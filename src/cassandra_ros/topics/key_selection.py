# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Keys of messages as programs give them, and the time ranges between two of them."""

from __future__ import annotations

from typing import Any, Callable, Optional

from cassandra_ros.messages.stamps import Time, to_ns
from cassandra_ros.read import LAST_NS, TimeRange

Clock = Callable[[], Time]
AnyKey = Any
"""A Time, or another key of a topic: a name, or the value of a field."""


def range_between(key: Optional[Time], to_key: Optional[Time]) -> TimeRange:
    """Return the time range between two times; None = open."""
    low = 0 if key is None else to_ns(key)
    return TimeRange(low, LAST_NS if to_key is None else to_ns(to_key))


def spellings(topic: str) -> tuple[str, str]:
    """Return the names by which a topic is found: with and without slash, the given one first."""
    return topic, topic[1:] if topic.startswith("/") else "/" + topic
