# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The events of a keyspace: added, found by name, robot, run and time, ended, removed."""

from __future__ import annotations

import difflib
from dataclasses import replace
from itertools import islice
from numbers import Integral
from typing import (
    TYPE_CHECKING,
    Any,
    Iterable,
    Iterator,
    Mapping,
    NamedTuple,
    Sequence,
    Tuple,
    TypeVar,
    Union,
)

from cassandra_ros.arguments import (
    check_event_name,
    check_event_values,
    check_labels,
    check_new_node,
    check_text,
)
from cassandra_ros.errors import EventNotFound, InvalidKey, InvalidName, InvalidOption
from cassandra_ros.messages.stamps import SECONDS_BELOW, Length, Time, duration_ns, iso_time, to_ns
from cassandra_ros.query import protocols
from cassandra_ros.query.plan.bounds import merge_ranges
from cassandra_ros.query.rows.name_resolution import like_test
from cassandra_ros.read import ALWAYS, EVERYBODY, LAST_NS, Read, TimeRange, Whose
from cassandra_ros.store.tables.event_table import ALL_NAMES, Event, EventTable, Names
from cassandra_ros.topics.event_times import EventTimes, merged_events
from cassandra_ros.topics.run_finder import RunName, Runs

if TYPE_CHECKING:
    from cassandra_ros.topics.row_finder import Where

_E = TypeVar("_E")

EventRule = Union[None, str, Tuple[str, Length, Length]]
"""Messages during the events of a name: the name, or (name, before, after) with the time before
and after each event, seconds or a Duration. None = messages of all time."""
AroundRule = Union[None, Tuple[Union[str, Tuple[str, Any]], Length, Length]]
"""Messages around those of a topic that satisfy a condition: ('TOPIC: condition', before, after),
the times in seconds or as Durations. None = messages of all time."""
MOST_EVENTS = 100_000
"""Maximum number of events whose time ranges are read together."""
_MOST_LOOKED_AT = 10_000
"""Maximum number of events among which similar names are searched."""


class EventChoice(NamedTuple):
    """A checked EventRule."""

    name: str
    before: int = 0
    after: int = 0
    """Time before and after each event, ns."""

    @classmethod
    def of(cls, rule: EventRule) -> EventChoice | None:
        """Check a rule; None if it is None.

        Raises:
            InvalidName, InvalidKey: The name or a length of time cannot be used.
        """
        if rule is None:
            return None
        if isinstance(rule, (tuple, list)) and len(rule) == 3:
            return cls(check_event_name(rule[0]), duration_ns(rule[1]), duration_ns(rule[2]))
        return cls(check_event_name(rule))


class WindowRule(NamedTuple):
    """The messages around which windows are read (hits), and the lengths of a window."""

    topic: str
    condition: Where
    before: int
    """Length of a window before a hit, ns."""
    after: int
    """Length of a window after a hit, ns."""

    @classmethod
    def of(cls, around: object, before: int, after: int) -> WindowRule | None:
        """Read 'TOPIC: condition', or a pair of both; None if it is None.

        Raises:
            InvalidOption: It cannot be read.
        """
        if around is None:
            return None
        pair = around.split(":", 1) if isinstance(around, str) else around
        if isinstance(pair, (tuple, list)) and len(pair) == 2 and isinstance(pair[0], str):
            topic, condition = pair[0].strip(), pair[1]
            if isinstance(condition, str):
                condition = condition.strip()
            if topic and condition:
                return cls(topic, condition, before, after)
        raise InvalidOption(
            f"around {around!r:.80} names no hits: write 'TOPIC: condition', for example "
            "'/battery: voltage < 11.0'"
        )


class Events:
    """Reads and writes the events of one keyspace. Thread-safe.

    Args:
        keyspace: Name of the keyspace.
    """

    def __init__(self, keyspace: str, table: EventTable, runs: Runs) -> None:
        self._keyspace = keyspace
        self._table = table
        self._runs = runs

    def add(
        self,
        name: str,
        start: Time,
        end: Time | None = None,
        node: str = "",
        run: RunName = None,
        labels: Mapping[str, str] | None = None,
        values: Mapping[str, Any] | None = None,
    ) -> Event:
        """Store an event and return it; see RosCassandra.addEvent."""
        first, last = _time(start), None if end is None else _time(end)
        event = Event(
            check_event_name(name),
            first,
            last,
            check_new_node(node),
            0 if run is None or isinstance(run, frozenset) else self._runs.find(run)[0].writer,
            check_labels(labels or {}),
            check_event_values(values or {}),
        )
        return self.put(event)

    def put(self, event: Event) -> Event:
        """Store an event as it is, after a check of its times.

        It replaces one with the same name, start, robot and id.

        Raises:
            InvalidKey: Its end is before its start.
        """
        if event.end_ns is not None and event.end_ns < event.start_ns:
            start, end = iso_time(event.start_ns), iso_time(event.end_ns)
            reason = f"its end, {end}, is before its start, {start}: exchange them"
            raise InvalidKey(f"event {event.name!r:.80} is not stored: {reason}")
        self._table.put(event)
        return event

    def end(self, event: Event | str, end: Time) -> Event:
        """Set the end of an event, and return it; raises like ``get`` and ``put``."""
        return self.put(replace(self.get(event), end_ns=_time(end)))

    def remove(self, event: Event | str) -> None:
        """Delete an event; raises like ``get``."""
        self._table.remove(self.get(event))

    def move(self, event: Event, node: str) -> None:
        """Give an event another robot than it has; its key stays.

        If the program dies between the two writes, both robots have it, and a repetition helps.
        """
        self._table.put(replace(event, node=node))
        self._table.remove(event)

    def get(self, event: Event | str) -> Event:
        """Return a stored event by itself or by its key.

        Raises:
            EventNotFound: It is not stored (any more), or the text is not a key.
            InvalidOption: It is neither an event nor a text.
        """
        key = event.key if isinstance(event, Event) else event
        stored_event = self._table.with_key(check_text("event", key, wanted="an event, or its key"))
        if stored_event is None:
            raise EventNotFound(
                f"{self._not_stored(key)} ('cassandra_bag event list' prints names and keys)"
            )
        return stored_event

    def find(
        self,
        name: str | None = None,
        like: str | None = None,
        within: TimeRange = ALWAYS,
        whose: Whose = EVERYBODY,
    ) -> Iterator[Event]:
        """Yield events in order of their starts, lazily.

        Args:
            name: Their name; None = all names.
            like: Pattern of LIKE for their names, instead of a name.
            within: Time range that they meet.
            whose: Their robots and runs; events of no robot, or of no run, count for all.
        """
        if name is not None and like is not None:
            raise InvalidName("an event is found by a name or by a pattern of LIKE: give one")
        names, test = ALL_NAMES, None
        if name is not None:
            names = Names(check_event_name(name), exact=True)
        elif like is not None:
            pattern = check_text("like", like, error=InvalidName, wanted="a pattern, as 'bump%'")
            # The table is read by the text before the first wildcard.
            names, test = Names(pattern.split("%")[0].split("_")[0]), like_test(pattern)
        events = self._table.read(names, within)
        events = (event for event in events if _concerns(event, whose))
        return events if test is None else (event for event in events if test(event.name))

    def called(self, name: str, like: bool, read: Read) -> Iterator[Event]:
        """Yield the events of a name that meet a read; see query.protocols.NamedTimes."""
        within = read.time_range
        return self.find(like=name, within=within) if like else self.find(name, within=within)

    def unknown(self, name: str, like: bool) -> str:
        """Say that no event has a name, or one like it, with similar names; '' = one has."""
        try:
            events = self.find(like=name) if like else self.find(name)
        except InvalidName:  # no event can be called so
            return self._not_stored(name)
        return "" if next(events, None) is not None else self._absent(name)

    def times(
        self, name: str, like: bool, read: Read, others: Sequence[protocols.NamedTimes] = ()
    ) -> EventTimes:
        """Return the times of the events of a name, for EVENT; see query.protocols.NamedTimes."""
        sources: list[protocols.NamedTimes] = [self, *others]
        events = merged_events([source.called(name, like, read) for source in sources])
        return EventTimes(_limit(events, repr(name)))

    def within(self, time_range: TimeRange) -> list[Event]:
        """Return all events that meet a time range, in order of their starts.

        Raises:
            InvalidOption: There are too many.
        """
        return list(_limit(self.find(within=time_range), "of all names"))

    def chosen(self, choice: EventChoice, read: Read) -> EventTimes:
        """Return the times of the events of a choice that meet a read.

        Raises:
            EventNotFound: There is no such event; the text has similar names.
            InvalidOption: There are too many.
        """
        name, before, after = choice
        low, high = read.time_range
        within = TimeRange(max(0, low - after), min(LAST_NS, high + before))
        events = self.find(name, within=within, whose=read.whose)
        times = EventTimes(_limit(events, repr(name)), before, after)
        if not times.ranges:
            raise EventNotFound(self._absent(name))
        return times

    def _absent(self, name: str) -> str:
        """Return the reason why a name has no event in a time range, of a robot or run."""
        if next(self.find(name), None) is not None:
            return (
                f"no event {name!r:.80} is of this time, robot and run; 'cassandra_bag event list' "
                "prints those that there are"
            )
        return self._not_stored(name)

    def _not_stored(self, name: str) -> str:
        names = sorted({event.name for event in islice(self.find(), _MOST_LOOKED_AT)} - {name})
        near = difflib.get_close_matches(name, names, n=3, cutoff=0.5)
        hint = f"did you mean {', '.join(near)}?" if near else "it holds none of a similar name"
        return f"there is no event {name!r:.80} in keyspace {self._keyspace}; {hint}"


def _limit(events: Iterator[_E], names: str) -> Iterator[_E]:
    """Yield events; raise InvalidOption if there are more than MOST_EVENTS."""
    yield from islice(events, MOST_EVENTS)
    if next(events, None) is not None:
        raise InvalidOption(
            f"there are more than {MOST_EVENTS} events {names:.80}: give a shorter time range"
        )


def _concerns(event: Event, whose: Whose) -> bool:
    """Return whether an event is of some robots and runs, or of all."""
    if whose.nodes is not None and event.node and event.node not in whose.nodes:
        return False
    return whose.writers is None or not event.writer or event.writer in whose.writers


def _time(value: Time) -> int:
    """Return the ns of a time of an event; refuse integers that were meant as seconds."""
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    if whole and 0 < int(value) < SECONDS_BELOW:  # type: ignore[arg-type]
        raise InvalidKey(
            f"{value} means nanoseconds, soon after 1970; seconds are written {value}.0, and a "
            "time of a simulation is a genpy.Time"
        )
    return to_ns(value)


def merge_windows(
    hits: Iterable[int], before: int, after: int, bounds: TimeRange
) -> Iterator[TimeRange]:
    """Yield windows around hits in order, lazily; they do not overlap or touch.

    Args:
        hits: Ascending times within the bounds, ns.
        before, after: Length of a window before and after its hit, ns, at least 0.
        bounds: Time range to which windows are cut.
    """
    around = ((max(bounds.low, hit - before), min(bounds.high, hit + after)) for hit in hits)
    return merge_ranges(around)
