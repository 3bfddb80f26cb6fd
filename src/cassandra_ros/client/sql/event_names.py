# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The column EVENT: for each message the names of the events in whose time it lies.

An event of a robot counts for this robot's messages, one without a robot for all, as for EVENT in
our query language. The names are sorted, and each comes once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Iterable, NamedTuple

import numpy as np

from cassandra_ros.messages.definition import Definition
from cassandra_ros.query.arrays.array_types import AnyArray
from cassandra_ros.store.tables.event_table import Event
from cassandra_ros.topics.event_times import EventTimes

if TYPE_CHECKING:
    import pyarrow

EVENT = "EVENT"
"""Name of the column."""


def has_event_field(definitions: Iterable[Definition]) -> bool:
    """Return whether messages have a field of the column's name; it takes the column's place."""
    fields = (
        field for definition in definitions for field in definition.specs[definition.type].fields
    )
    return any(field.name.upper() == EVENT for field in fields)


class _Ranges(NamedTuple):
    """Time ranges; those of one name do not overlap."""

    lows: AnyArray
    """First times, ns."""
    highs: AnyArray
    """Last times, ns, included."""
    codes: AnyArray
    """Indexes of the names, in the sorted list of all names."""


class EventNames:
    """Finds the names of the events of messages.

    Args:
        arrow: The module pyarrow.
        events: All events at the time of the messages.
    """

    def __init__(self, arrow: Any, events: Iterable[Event]) -> None:
        self._arrow = arrow
        self._events: dict[str, list[Event]] = {}
        """Events by nodeID; '' = of all robots."""
        for event in events:
            self._events.setdefault(event.node, []).append(event)
        self._names = sorted(
            {event.name for robot_events in self._events.values() for event in robot_events}
        )
        self._ranges: dict[str, _Ranges] = {}
        """Time ranges by nodeID, as far as they were needed."""

    def column(self, batch: pyarrow.RecordBatch) -> pyarrow.Array:
        """Return the column EVENT for messages in any order, of which KEY and NODE are given."""
        arrow, count = self._arrow, batch.num_rows
        keys = batch.column("KEY").cast(arrow.int64()).to_numpy(zero_copy_only=False)
        nodes = batch.column("NODE").dictionary_encode()
        node_numbers = nodes.indices.to_numpy(zero_copy_only=False)
        # Pairs of a message (its index in the batch) and a name (its code).
        messages: list[AnyArray] = [np.empty(0, np.int64)]
        codes: list[AnyArray] = [np.empty(0, np.int64)]
        for n, node in enumerate(nodes.dictionary.to_pylist()):
            members = np.flatnonzero(node_numbers == n)
            members = members[np.argsort(keys[members], kind="stable")]
            lows, highs, range_codes = self._ranges_of(node)
            # The messages in a time range are ``counts`` consecutive members from ``first`` on.
            first = np.searchsorted(keys[members], lows, "left")
            counts = np.searchsorted(keys[members], highs, "right") - first
            within = np.arange(int(counts.sum())) - np.repeat(np.cumsum(counts) - counts, counts)
            messages.append(members[np.repeat(first, counts) + within])
            codes.append(np.repeat(range_codes, counts))
        owners, names = np.concatenate(messages), np.concatenate(codes)
        order = np.lexsort((names, owners))  # by message, then by name
        ends = np.cumsum(np.bincount(owners, minlength=count))
        offsets = arrow.array(np.concatenate([np.zeros(1, np.int64), ends]), arrow.int32())
        texts = arrow.array(self._names, arrow.string()).take(arrow.array(names[order]))
        return arrow.ListArray.from_arrays(offsets, texts)

    def _ranges_of(self, node: str) -> _Ranges:
        """Return the time ranges of the events that count for a robot."""
        if node not in self._ranges:
            by_name: dict[str, list[Event]] = {}
            for owner in {node, ""}:
                for event in self._events.get(owner, ()):
                    by_name.setdefault(event.name, []).append(event)
            ranges = [
                (low, high, code)
                for code, name in enumerate(self._names)
                for low, high in EventTimes(_in_order(by_name.get(name, ()))).ranges
            ]
            self._ranges[node] = _Ranges(*np.array(ranges, np.int64).reshape(-1, 3).T)
        return self._ranges[node]


def _in_order(events: Iterable[Event]) -> list[Event]:
    return sorted(events, key=Event.order)
