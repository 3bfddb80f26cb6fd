# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Filters that leave messages out on purpose: by a condition on fields, or by a maximum rate."""

from __future__ import annotations

import logging
import threading
from typing import Callable, Mapping

from cassandra_ros.errors import InvalidQuery
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.query.protocols import Row
from cassandra_ros.recording.live_row import LiveRow, LiveTable
from cassandra_ros.recording.topic_settings import Settings
from cassandra_ros.topics.query_result import Condition

_log = logging.getLogger(__name__)

MAX_HEADERS = 4096
"""Maximum number of connections whose header is remembered: publishers come and go for days."""


class Filters:
    """The filters of all topics. Thread-safe.

    Args:
        settings: Conditions and rates by topic.
        node: nodeID of the recorded robot, NODE in conditions.
    """

    def __init__(self, settings: Settings, node: str = "") -> None:
        self._settings = settings
        self._node = node
        self._topics: dict[str, TopicFilter | None] = {}
        self._mutex = threading.Lock()

    def passes(self, topic: str, header: Mapping[str, str], t: int, wire: bytes) -> bool:
        """Return whether a message is recorded; the condition is checked before the rate.

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
        settings = self._settings.of(topic)
        topic_filter = None
        if settings.where or settings.rate_limit:
            condition = _TopicCondition(topic, settings.where, self._node)
            topic_filter = TopicFilter(
                condition if settings.where else None,
                _Throttle(settings.rate_limit) if settings.rate_limit else None,
            )
        with self._mutex:
            return self._topics.setdefault(topic, topic_filter)


class _Throttle:
    """A maximum rate of messages; messages that come late do not lower the rate."""

    def __init__(self, rate_hz: float) -> None:
        self._period = max(1, int(SECOND_NS / rate_hz))
        self._due: int | None = None

    def passes(self, t: int) -> bool:
        due = t if self._due is None else self._due
        if due - t > self._period:  # time went back
            due = t
        if t < due:
            self._due = due
            return False
        self._due = max(due, t - self._period) + self._period
        return True


class TopicFilter:
    """Says of each message of one topic whether it is recorded. Thread-safe."""

    def __init__(self, condition: _TopicCondition | None, throttle: _Throttle | None) -> None:
        self._condition = condition
        self._throttle = throttle
        self._mutex = threading.Lock()

    def passes(self, header: Mapping[str, str], t: int, wire: bytes) -> bool:
        """Say whether a message is recorded; see Filters.passes."""
        with self._mutex:
            if self._condition is not None and not self._condition.holds(header, t, wire):
                return False
            return self._throttle is None or self._throttle.passes(t)


Test = Callable[[Row], bool]
"""Function that returns whether a row satisfies a condition."""


class _TopicCondition:
    """A condition on the messages of one topic, of one or several types."""

    def __init__(self, topic: str, where: str, node: str) -> None:
        self._topic, self._where, self._node = topic, where, node
        self._by_header: dict[int, tuple[Mapping[str, str], LiveTable, Test | None]] = {}

    def holds(self, header: Mapping[str, str], t: int, wire: bytes) -> bool:
        entry = self._by_header.get(id(header))
        if entry is None:
            if len(self._by_header) >= MAX_HEADERS:
                self._by_header.pop(next(iter(self._by_header)))
            entry = self._by_header[id(header)] = (header, *self._compile(header))
        _, table, test = entry
        return test is None or test(LiveRow(table, self._topic, self._node, t, wire, len(wire)))

    def _compile(self, header: Mapping[str, str]) -> tuple[LiveTable, Test | None]:
        connection = live_connection(self._topic, header)
        table = LiveTable(connection)
        if table.definition is not None:
            try:
                return table, Condition(self._where).test([table])
            except InvalidQuery as exc:
                problem = str(exc)
        else:
            problem = "its definition cannot be used"
        _log.error(
            "topic %s is recorded whole, because its condition %r cannot be checked: %s",
            self._topic,
            self._where,
            problem,
        )
        return table, None
