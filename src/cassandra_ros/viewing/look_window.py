# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The window of time that Look opens, and how much of each topic lies in it."""

from __future__ import annotations

from typing import Iterable, NamedTuple

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.overview.timeline.lanes import Lane
from cassandra_ros.read import LAST_NS, TimeRange

DAY_NS = 24 * 3600 * SECOND_NS


def default_window(
    start: int | None, end: int | None, time: int | None, newest: int | None
) -> TimeRange:
    """Return the window that is meant where an end of it is missing: a day.

    Half a day on both sides of the moment that is looked at, else a day from its one end on, else
    the last day that there is.

    Args:
        start, end, time: As they were asked for, ns; None = not given.
        newest: When the last message came, ns; None = there is none.
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


class Held(NamedTuple):
    """What lies in a window, to the accuracy of the directory."""

    messages: int = 0
    size: int = 0
    """Bytes of the messages."""
    first: int | None = None
    last: int | None = None
    """When the first and the last of them came, ns; None: there is none."""

    @classmethod
    def of_lanes(cls, lanes: Iterable[Lane]) -> Held:
        """Return what some lanes hold together."""
        lanes = list(lanes)
        firsts, lasts = ([lane.times[end] for lane in lanes] for end in (0, 1))
        return cls(
            sum(lane.messages for lane in lanes),
            sum(lane.bytes for lane in lanes),
            min((t for t in firsts if t is not None), default=None),
            max((t for t in lasts if t is not None), default=None),
        )
