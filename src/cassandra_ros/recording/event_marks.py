# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Events that one call begins and the next call ends, and the conditions that do so by themselves.

A watched event lasts while a condition holds for the messages of a topic: from the first message
that satisfies it to the last one before it has not held for the hold time.

The store may not answer for a while: ``EventWriter`` stores the events in the background.
"""

from __future__ import annotations

import logging
import threading
from concurrent.futures import Future
from dataclasses import dataclass, replace
from typing import Any, Callable, Mapping

from cassandra_ros.arguments import check_event_name, check_event_values, check_labels
from cassandra_ros.errors import CassandraRosError, InvalidKey, StoreUnavailable
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.stamps import iso_time
from cassandra_ros.recording.store_future import is_there
from cassandra_ros.store.tables.event_table import Event
from cassandra_ros.topics.catalog import Catalog

Put = Callable[[Event], object]
"""Function that stores an event, which may have been stored without its end before."""


class EventMarks:
    """The events that this process has begun and not ended. Thread-safe.

    ``put`` is called under its lock, so that the states of an event are stored in their order.

    Args:
        put: Stores an event.
    """

    def __init__(self, put: Put) -> None:
        self._put = put
        self._lasting: dict[tuple[str, str], Event] = {}
        """The events, by name and nodeID."""
        self._mutex = threading.Lock()

    def mark(
        self,
        name: str,
        t: int,
        node: str = "",
        labels: Mapping[str, str] | None = None,
        values: Mapping[str, Any] | None = None,
        writer: int = 0,
    ) -> Event:
        """Begin an event at a time, ns, or end the one of this name and robot; return it.

        Labels and values of the call that ends it are added to those of the first.

        Raises:
            InvalidName: The name, a label or a value cannot be stored.
            InvalidKey: The end is before the start: the clock went back.
            CassandraRosError: It cannot be stored, and is as before.
        """
        key = check_event_name(name), node
        new_labels, new_values = check_labels(labels or {}), check_event_values(values or {})
        with self._mutex:
            begun = self._lasting.get(key)
            if begun is not None and t < begun.start_ns:
                raise InvalidKey(
                    f"event {name!r:.80} is not ended: it began at {iso_time(begun.start_ns)}, and "
                    f"the clock was set back to {iso_time(t)}; end it later, or end the recorder"
                )
            if begun is None:
                event = Event(name, t, None, node, writer, new_labels, new_values)
            else:
                all_labels = {**begun.labels, **new_labels}
                all_values = {**begun.values, **new_values}
                event = replace(begun, end_ns=t, labels=all_labels, values=all_values)
            self._put(event)
            if begun is None:
                self._lasting[key] = event
            else:
                del self._lasting[key]
            return event

    def end_all(self, t: int) -> None:
        """End all events at a time, ns, or at their starts if these are later.

        Raises:
            CassandraRosError: ``put`` raised it: this event and the later ones are not ended.
        """
        with self._mutex:
            for event in self._lasting.values():
                self._put(replace(event, end_ns=max(t, event.start_ns)))
            self._lasting.clear()


@dataclass(frozen=True)
class WatchedEvent:
    """An event that lasts while a condition holds for the messages of a topic."""

    name: str
    topic: str
    where: str
    """Condition, as after WHERE in CQL."""
    hold_ns: int = 0
    """How long the condition must not hold until the event ends, ns."""
    labels: Mapping[str, str] | None = None


class EventWatch:
    """Begins and ends one event by the messages of its topic. Not thread-safe.

    Args:
        rule: The event.
        holds: Returns whether a message satisfies the condition: header, time of reception, bytes.
        node: nodeID of the robot.
        put: Stores an event without waiting.
        writer: Returns the writer id of the present run; 0 = no run.
    """

    def __init__(
        self,
        rule: WatchedEvent,
        holds: Callable[[Mapping[str, str], int, bytes], bool],
        node: str,
        put: Put,
        writer: Callable[[], int],
    ) -> None:
        self._rule, self._holds, self._node = rule, holds, node
        self._put, self._writer = put, writer
        self._event: Event | None = None
        self._last = 0
        """Time of the last message that satisfied the condition, ns."""

    def see(self, header: Mapping[str, str], t: int, wire: bytes) -> None:
        """Begin or end the event by a message that was received at a time, ns."""
        if t < self._last - max(self._rule.hold_ns, SECOND_NS):
            self.end()  # the clock was set back
        if self._holds(header, t, wire):
            if self._event is None:
                rule = self._rule
                self._event = Event(
                    rule.name, t, None, self._node, self._writer(), dict(rule.labels or {})
                )
                self._put(self._event)
                self._last = t
            self._last = max(self._last, t)
        elif self._event is not None and t >= self._last + self._rule.hold_ns:
            self.end()

    def end(self) -> None:
        """End the event, if it lasts, at the last message that satisfied the condition."""
        if self._event is not None:
            self._put(replace(self._event, end_ns=self._last))
            self._event = None


_log = logging.getLogger(__name__)

RETRY_SEC = 1.0
"""Interval between two attempts to store events while the store does not answer, s."""
END_SEC = 10.0
"""Maximum time that the end of a recorder waits for its last events, s."""
MAX_WAITING = 10_000
"""Maximum number of events that wait for the store."""


class EventWriter:
    """Stores events in the background, the latest state of each. Thread-safe.

    Args:
        store: Future of the catalog of the connected keyspace.
    """

    def __init__(self, store: Future[Catalog]) -> None:
        self._store = store
        self._waiting: dict[str, Event] = {}
        """The events to be stored, by key."""
        self._lost = 0
        """Number of events that were not taken because MAX_WAITING waited."""
        self._ending = False
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None

    def put(self, event: Event) -> None:
        """Take an event, or its later state, without waiting for the store."""
        with self._changed:
            if event.key not in self._waiting and len(self._waiting) >= MAX_WAITING:
                self._lost += 1
                return
            self._waiting[event.key] = event
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="events", daemon=True)
                self._thread.start()
            self._changed.notify()

    def close(self) -> None:
        """Store the remaining events, for at most END_SEC, and say which are lost."""
        with self._changed:
            self._ending = True
            self._changed.notify()
        if self._thread is not None:
            self._thread.join(END_SEC)
        with self._changed:
            events, self._waiting = self._waiting, {}  # so that the thread ends
        if events or self._lost:
            names = ", ".join(sorted({event.name for event in events.values()}))
            _log.error(
                "%d events are not stored, for the store did not take them: %s",
                len(events) + self._lost,
                names or "more than wait in memory",
            )

    def _run(self) -> None:
        """Store the waiting events one by one, until none waits after ``close``."""
        while True:
            with self._changed:
                while not (self._waiting or self._ending):
                    self._changed.wait()
                if not self._waiting:
                    return
                event = next(iter(self._waiting.values()))
            if not self._store_event(event):
                with self._changed:
                    self._changed.wait(RETRY_SEC)
                continue
            with self._changed:
                if self._waiting.get(event.key) is event:  # else its end has come meanwhile
                    del self._waiting[event.key]

    def _store_event(self, event: Event) -> bool:
        """Store an event; return False if it is to be tried again.

        One that the store refuses is logged and not tried again.
        """
        if not is_there(self._store):
            return False
        try:
            self._store.result().keyspace.events.put(event)
        except StoreUnavailable as exc:
            _log.debug("event %s is stored later: %s", event.name, exc)
            return False
        except CassandraRosError as exc:
            _log.error("event %s is not stored: %s", event.name, exc)
        return True
