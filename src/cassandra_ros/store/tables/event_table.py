# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""cr_event and cr_event_slot: named time ranges of robots, and where those of a name lie.

An event lies in the slot of its start, in the order of names. So a slot has the events of all
robots in some days. A row of cr_event_slot says that events of a name (or, in the partition of all
names, any events) begin in a slot, and in which slot the last of them may end. It is written before
the event and stays when the event is deleted: it may lead to a slot in vain, but misses none.
"""

from __future__ import annotations

import json
import uuid
from dataclasses import dataclass, field
from typing import Any, Iterator, Mapping, NamedTuple

from cassandra_ros.printable import shown
from cassandra_ros.read import ALWAYS, LAST_NS, TimeRange
from cassandra_ros.store.connection.cassandra import CqlRow
from cassandra_ros.store.tables.side_tables import SideTables

SLOT_NS = 1 << 48
"""Length of a slot, ns: about 3.3 days."""
_AT_ONCE = 4
"""Number of slots that are read together. Their events are in memory at the same time."""
_EVENT, _SLOT = "cr_event", "cr_event_slot"
_COLUMNS = ("slot", "name", "t_start", "node", "id", "t_end", "writer", "labels", "vals")
"""Columns of cr_event; the first five are the key."""
_NAMES = ", ".join(_COLUMNS[1:])
"""Columns that are read, as CQL."""


@dataclass(frozen=True, repr=False)
class Event:
    """A named time range of a robot."""

    name: str
    start_ns: int
    """First time, ns since 1970, included."""
    end_ns: int | None = None
    """Last time, ns, included; None = the event lasts."""
    node: str = ""
    """nodeID of the robot; '' = of all robots."""
    writer: int = 0
    """Writer id of the run to which the event belongs; 0 = it belongs to no run."""
    labels: Mapping[str, str] = field(default_factory=dict)
    values: Mapping[str, Any] = field(default_factory=dict)
    """Values that JSON can hold, by name."""
    id: str = field(default_factory=lambda: uuid.uuid4().hex[:12])
    """Text that tells apart events of one name, start and robot."""

    @property
    def key(self) -> str:
        """Text by which the event is found."""
        return f"{self.start_ns}-{self.id}"

    def order(self) -> tuple[int, str, str, str]:
        """Return what events are sorted by: start, name, robot and id."""
        return self.start_ns, self.name, self.node, self.id

    @property
    def time_range(self) -> TimeRange:
        """The time range; an event that lasts reaches to the end of all time."""
        return TimeRange(self.start_ns, LAST_NS if self.end_ns is None else self.end_ns)

    def __repr__(self) -> str:
        end = "it lasts" if self.end_ns is None else f"to {self.end_ns}"
        whose = f" of {shown(self.node)}" if self.node else ""
        return f"<Event {self.name!r}{whose}: {self.start_ns} {end}>"


class Names(NamedTuple):
    """The names with a beginning, or one name."""

    text: str = ""
    exact: bool = False
    """Whether ``text`` is the whole name."""


ALL_NAMES = Names()


class EventTable:
    """Reads and writes the events of one keyspace."""

    def __init__(self, side_tables: SideTables) -> None:
        self._tables = side_tables

    def put(self, event: Event) -> None:
        """Write an event; it replaces one with the same name, start, robot and id."""
        self._tables.make(_EVENT, _SLOT)
        slot, what = event.start_ns // SLOT_NS, f"storing event {event.name}"
        reach = event.time_range.high // SLOT_NS
        rows = [(False, "", slot, reach), (True, event.name, slot, reach)]
        self._tables.insert_many(_SLOT, ("named", "name", "slot", "reach"), rows, what)
        row = (slot, event.name, event.start_ns, event.node, event.id)
        # No column is null: each null is a tombstone, and reads that meet many of them fail.
        rest = (event.time_range.high, event.writer, dict(event.labels), _json(event.values))
        self._tables.insert_many(_EVENT, _COLUMNS, [(*row, *rest)], what)

    def remove(self, event: Event) -> None:
        """Delete an event."""
        row = (event.start_ns // SLOT_NS, event.name, event.start_ns, event.node, event.id)
        self._tables.delete(_EVENT, _COLUMNS[:5], [row], f"removing event {event.name}")

    def with_key(self, key: str) -> Event | None:
        """Return the event with a key; None = no event has it, or the text is not a key."""
        start, _, name = key.partition("-")
        if not (start.isascii() and start.isdigit() and len(start) < 20 and int(start) <= LAST_NS):
            return None
        t, where = int(start), "slot = ? AND t_start = ? ALLOW FILTERING"
        params = (t // SLOT_NS, t)
        rows = self._tables.select(_EVENT, _NAMES, where, params, what="reading an event")
        return next((event for event in map(_event, rows) if event.id == name), None)

    def read(self, names: Names = ALL_NAMES, within: TimeRange = ALWAYS) -> Iterator[Event]:
        """Yield the events that meet a time range, in order of their starts, a few slots at once.

        Args:
            names: Names of the events. For a beginning of nothing but U+10FFFF, events with later
                names may be yielded, too.
            within: Time range, ns.
        """
        where, values = _condition(names)
        slots = self._slots(names, within)
        for first in range(0, len(slots), _AT_ONCE):
            params = [(slot, *values) for slot in slots[first : first + _AT_ONCE]]
            answers = self._tables.select_many(_EVENT, _NAMES, where, params, "reading events")
            for rows in answers:
                events = (event for event in map(_event, rows) if _meets(event, within))
                yield from sorted(events, key=Event.order)

    def _slots(self, names: Names, within: TimeRange) -> list[int]:
        """Return the slots, ascending, in which events of some names may meet a time range.

        If not the whole name is given, these are the slots with events of any name.
        """
        low, high = (end // SLOT_NS for end in within)
        key = (True, names.text) if names.exact else (False, "")
        where, what = "named = ? AND name = ? AND slot <= ?", "reading where events lie"
        rows = self._tables.select(_SLOT, "slot, reach", where, (*key, high), what=what)
        return sorted({slot for slot, reach in rows if reach >= low})


def _condition(names: Names) -> tuple[str, tuple[str, ...]]:
    """Return the condition on the rows of a slot, and its parameters after the slot."""
    if names.exact:
        return "slot = ? AND name = ?", (names.text,)
    if not names.text:
        return "slot = ?", ()
    end = _after(names.text)
    if end is None:
        return "slot = ? AND name >= ?", (names.text,)
    return "slot = ? AND name >= ? AND name < ?", (names.text, end)


def _after(beginning: str) -> str | None:
    """Return the first text after all texts with a beginning; None = there is no such text."""
    for n in reversed(range(len(beginning))):
        code = ord(beginning[n]) + 1
        code = 0xE000 if code == 0xD800 else code  # surrogates are not characters
        if code <= 0x10FFFF:
            return beginning[:n] + chr(code)
    return None


def _meets(event: Event, within: TimeRange) -> bool:
    low, high = event.time_range
    return low <= within.high and high >= within.low


def _json(values: Mapping[str, Any]) -> str:
    return json.dumps(dict(values), ensure_ascii=False)


def _event(row: CqlRow) -> Event:
    name, start, node, number, high, writer, labels, values = row
    end = None if high == LAST_NS else high
    return Event(name, start, end, node, writer, dict(labels or {}), json.loads(values), number)
