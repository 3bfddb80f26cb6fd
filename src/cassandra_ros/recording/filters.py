# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Filters that leave messages out on purpose: by a condition on fields, or by a maximum rate.

The events that begin and end by themselves (see event_marks.py) see each message before its filter.
"""

from __future__ import annotations

import logging
import threading
from typing import Callable, Mapping, Sequence

from cassandra_ros.arguments import spellings
from cassandra_ros.errors import InvalidOption, InvalidQuery
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.query.protocols import Row
from cassandra_ros.recording.event_marks import EventWatch, Put
from cassandra_ros.recording.live_row import LiveRow, LiveTable
from cassandra_ros.recording.topic_settings import RecordingSettings
from cassandra_ros.topics.query_result import Condition

_log = logging.getLogger(__name__)

MAX_HEADERS = 4096
"""Maximum number of connections whose header is remembered: publishers come and go for days."""


class Filters:
    """The filters of all topics. Thread-safe.

    Args:
        settings: Conditions and rates by topic.
        node: nodeID of the recorded robot, NODE in conditions.
        put: Stores an event without waiting; None = events are not watched.
        writer: Returns the writer id of the present run; 0 = no run.
    """

    def __init__(
        self,
        settings: RecordingSettings,
        node: str = "",
        put: Put | None = None,
        writer: Callable[[], int] = lambda: 0,
    ) -> None:
        self._settings = settings
        self._put, self._writer = put, writer
        self._node = node
        self._topics: dict[str, TopicFilter | None] = {}
        self._mutex = threading.Lock()
        """Guards changes of ``_topics``, which is read without it."""

    def passes(self, topic: str, header: Mapping[str, str], t: int, wire: bytes) -> bool:
        """Return whether a message is recorded; the condition is checked before the rate.

        Each message of a topic must be given once, in the order of reception: it counts for the
        rate, and may begin or end events.

        Args:
            header: Connection header; the same object for all messages of a connection.
            t: Time of reception, ns.
        """
        topic_filter = self.of(topic)
        return topic_filter is None or topic_filter.passes(header, t, wire)

    def of(self, topic: str) -> TopicFilter | None:
        """Return the filter of a topic; None where all of its messages are recorded."""
        try:
            return self._topics[topic]
        except KeyError:
            return self._make(topic)

    def _make(self, topic: str) -> TopicFilter | None:
        """Make and keep the filter of a topic; None where it needs none."""
        settings = self._settings.of(topic)
        watches = self._watches(topic)
        topic_filter = None
        if settings.where or settings.rate_limit or watches:
            condition = _TopicCondition(topic, settings.where, self._node)
            topic_filter = TopicFilter(
                condition if settings.where else None,
                _Throttle(settings.rate_limit) if settings.rate_limit else None,
                watches,
            )
        with self._mutex:  # of two that were made at the same time the first is used
            return self._topics.setdefault(topic, topic_filter)

    def _watches(self, topic: str) -> list[EventWatch]:
        """Return the watches of the events whose condition is one on this topic."""
        put, watches = self._put, []
        for rule in self._settings.events if put is not None else ():
            if topic in spellings(rule.topic) and put is not None:
                condition = _TopicCondition(topic, rule.where, self._node, event=rule.name)
                watches.append(EventWatch(rule, condition.holds, self._node, put, self._writer))
        return watches

    def end_events(self) -> None:
        """End the events that last, because no more messages come."""
        with self._mutex:
            filters = list(self._topics.values())
        for topic_filter in filters:
            if topic_filter is not None:
                topic_filter.end_events()


class _Throttle:
    """A maximum rate of messages.

    A message that passes less than a period late does not delay the ones after it, so that the
    mean rate stays.
    """

    def __init__(self, rate_hz: float) -> None:
        self._period = max(1, int(SECOND_NS / rate_hz))
        """Time between two messages, ns."""
        self._due: int | None = None
        """Time from which on the next message passes, ns; None = at any time."""

    def passes(self, t: int) -> bool:
        """Return whether a message passes that was received at ``t``, ns."""
        due = t if self._due is None else self._due
        if due - t > self._period:  # time went back
            due = t
        if t < due:
            self._due = due
            return False
        self._due = max(due, t - self._period) + self._period
        return True


class TopicFilter:
    """Says of each message of one topic whether it is recorded. Thread-safe.

    Args:
        condition: Condition that recorded messages satisfy; None = none.
        throttle: Maximum rate; None = none.
        watches: Events that begin and end by messages of the topic. They see also those that the
            condition or the rate leaves out.
    """

    def __init__(
        self,
        condition: _TopicCondition | None,
        throttle: _Throttle | None,
        watches: Sequence[EventWatch] = (),
    ) -> None:
        self._condition = condition
        self._throttle = throttle
        self._watches = watches
        self._mutex = threading.Lock()

    def passes(self, header: Mapping[str, str], t: int, wire: bytes) -> bool:
        """Return whether a message is recorded; see Filters.passes."""
        with self._mutex:
            for watch in self._watches:
                watch.see(header, t, wire)
            if self._condition is not None and not self._condition.holds(header, t, wire):
                return False
            return self._throttle is None or self._throttle.passes(t)

    def end_events(self) -> None:
        """End the events of the topic that last."""
        with self._mutex:
            for watch in self._watches:
                watch.end()


Test = Callable[[Row], bool]
"""Function that returns whether a row satisfies a condition."""


class _TopicCondition:
    """A condition on the messages of one topic, of one or several types. Not thread-safe.

    Args:
        event: Name of the event that lasts while it holds; '' = it decides what is recorded.
    """

    def __init__(self, topic: str, where: str, node: str, event: str = "") -> None:
        self._topic, self._where, self._node, self._event = topic, where, node, event
        self._by_header: dict[int, tuple[Mapping[str, str], LiveTable, Test | None]] = {}
        """By id of a connection header: the header, which keeps the id from reuse, the connection's
        table, and its test; None = the condition cannot be checked."""

    def holds(self, header: Mapping[str, str], t: int, wire: bytes) -> bool:
        """Return whether a message satisfies the condition.

        If it cannot be checked: True for a filter, so that all is recorded, False for an event.
        """
        entry = self._by_header.get(id(header))
        if entry is None:
            if len(self._by_header) >= MAX_HEADERS:
                self._by_header.pop(next(iter(self._by_header)))
            entry = self._by_header[id(header)] = (header, *self._compile(header))
        _, table, test = entry
        if test is None:  # then all is recorded, and no event begins
            return not self._event
        return test(LiveRow(table, self._topic, self._node, t, wire, len(wire)))

    def _compile(self, header: Mapping[str, str]) -> tuple[LiveTable, Test | None]:
        """Return table and test of a connection; log why its condition cannot be checked (None)."""
        connection = live_connection(self._topic, header)
        table = LiveTable(connection)
        if table.definition is not None:
            try:
                return table, Condition(self._where).test([table])
            except (InvalidQuery, InvalidOption) as exc:
                problem = str(exc)
        else:
            problem = "its definition cannot be used"
        what = f"topic {self._topic} is recorded whole"
        if self._event:
            what = f"event {self._event} does not begin by topic {self._topic}"
        _log.error("%s, because its condition %r cannot be checked: %s", what, self._where, problem)
        return table, None
