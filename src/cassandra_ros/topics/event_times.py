# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The time ranges of events, with the time before and after them, by robot."""

from __future__ import annotations

import heapq
from dataclasses import replace
from itertools import chain, groupby
from typing import Iterable, Iterator, NamedTuple, Sequence, TypeVar

from cassandra_ros.query.plan.bounds import NsRange, has_overlap, merge_ranges
from cassandra_ros.query.protocols import NamedTime
from cassandra_ros.read import LAST_NS, Read, TimeRange, Whose

_E = TypeVar("_E", bound=NamedTime)


def merged_events(streams: Iterable[Iterator[_E]]) -> Iterator[_E]:
    """Yield the events of several stores, each once, in the order that each stream has.

    The order is that of ``NamedTime.order``, which copies of an event share.
    """
    events = heapq.merge(*streams, key=lambda event: event.order())
    copies = (list(group) for _, group in groupby(events, key=lambda event: event.order()))
    # An event may have ended in one store, and last in an older copy.
    return (max(group, key=lambda event: event.end_ns is not None) for group in copies)


class Reads(NamedTuple):
    """What a caller asks for, as one read or, with events, in parts."""

    whole: Read
    """The read without regard to events."""
    parts: Sequence[Read]
    """Reads in the order of time that do not overlap; without an event only ``whole``."""


class EventTimes:
    """The times of some events; see query.protocols.Stays.

    An event without a nodeID counts for every robot.

    Args:
        events: The events, in order of their starts.
        before, after: Time that is added before and after each event, ns.
    """

    def __init__(self, events: Iterable[NamedTime], before: int = 0, after: int = 0) -> None:
        by_node: dict[str, list[NsRange]] = {}
        for event in events:
            low, high = event.time_range
            wider = max(0, low - before), min(LAST_NS, high + after)
            by_node.setdefault(event.node, []).append(wider)
        self._by_node = {node: list(merge_ranges(ranges)) for node, ranges in by_node.items()}
        all_ranges = sorted(chain.from_iterable(self._by_node.values()))
        self.ranges: list[TimeRange] = list(merge_ranges(all_ranges))
        """The time ranges of all robots together, in order, not overlapping."""

    def holds(self, node: str, run: str, t: int) -> bool:
        """Return whether the robot of a message had an event at a time; ``run`` is not used."""
        return any(has_overlap(self._by_node.get(name, ()), t, t) for name in {node, ""})

    def spans(self, low: int, high: int, reverse: bool = False) -> Iterator[tuple[int, int]]:
        """Yield the time ranges in [low, high], ns, ascending or (reverse) descending."""
        ranges = [(max(low, a), min(high, b)) for a, b in self.ranges if a <= high and b >= low]
        return reversed(ranges) if reverse else iter(ranges)

    def reads(self, whole: Read) -> list[Read]:
        """Return the reads of the robots' messages during their events, inside of a read.

        They are in the order of time and do not overlap, so their rows can follow one another.
        """
        low, high = whole.time_range
        changes: list[tuple[int, str, bool]] = []
        for node, ranges in self._by_node.items():
            for first, last in ranges:
                if first <= high and last >= low:
                    changes += [(max(first, low), node, True), (min(last, high) + 1, node, False)]
        changes.sort()
        active: set[str] = set()  # the time ranges of one robot do not overlap
        reads: list[Read] = []
        for (t, node, begins), following in zip(changes, [*changes[1:], None]):
            if begins:
                active.add(node)
            else:
                active.discard(node)
            if active and following is not None and following[0] > t:
                nodes = None if "" in active else tuple(sorted(active))  # '' = of every robot
                whose = whole.whose.both(Whose(nodes))
                if not whose.empty:
                    time_range = TimeRange(t, following[0] - 1)
                    reads.append(replace(whole, time_range=time_range, whose=whose))
        return reads
