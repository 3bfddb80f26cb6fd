# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The time range that Look opens, and the number of messages of each topic in it."""

from __future__ import annotations

from typing import Iterable, NamedTuple

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.overview.timeline.lanes import Lane
from cassandra_ros.read import LAST_NS, TimeRange

DAY_NS = 24 * 3600 * SECOND_NS


def default_window(
    start: int | None, end: int | None, time: int | None, newest: int | None
) -> TimeRange:
    """Return the time range to open; one day if start or end is missing.

    It is half a day on both sides of ``time``, else one day from the given end on, else the last
    day with messages.

    Args:
        start, end, time: Times of the request, ns; None = not given.
        newest: Time of reception of the last message, ns; None = no message is stored.
    """
    if start is not None and end is not None:
        return TimeRange(start, end)
    if time is not None:
        half = DAY_NS // 2
        return TimeRange(
            max(0, time - half) if start is None else start,
            min(LAST_NS, time + half) if end is None else end,
        )
    if start is not None:
        return TimeRange(start, min(LAST_NS, start + DAY_NS))
    end = newest or 0 if end is None else end
    return TimeRange(max(0, end - DAY_NS), end)


class WindowContent(NamedTuple):
    """The messages in a time range, as accurate as the directory."""

    messages: int = 0
    """Number of messages."""
    size: int = 0
    """Size of the messages, bytes."""
    first: int | None = None
    """Time of reception of the first message, ns; None = no message."""
    last: int | None = None
    """Time of reception of the last message, ns; None = no message."""

    @classmethod
    def of_lanes(cls, lanes: Iterable[Lane]) -> WindowContent:
        """Return the sum over some lanes."""
        lanes = list(lanes)
        firsts, lasts = ([lane.times[end] for lane in lanes] for end in (0, 1))
        return cls(
            sum(lane.messages for lane in lanes),
            sum(lane.bytes for lane in lanes),
            min((t for t in firsts if t is not None), default=None),
            max((t for t in lasts if t is not None), default=None),
        )
