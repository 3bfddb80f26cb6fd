# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What keys stand for: a stretch of time, a name, or the value of a field."""

from __future__ import annotations

from typing import Any, NamedTuple, Optional, Sequence, Union

from cassandra_ros.arguments import check_message_name
from cassandra_ros.errors import InvalidKey
from cassandra_ros.keys import NAMED_FORMATS
from cassandra_ros.messages.stamps import Stamp, is_iso_text, is_time, to_ns
from cassandra_ros.topics.topic_table import TopicTable

LAST_NS = 2**63 - 1


Time = Union[Stamp, int, float, str]
"""genpy.Time or Stamp, int (ns), float (s) or ISO 8601 text."""
AnyKey = Any
"""A Time, or what else is the topic's key: a name, or the value of a field."""


class Stretch(NamedTuple):
    """All messages of a stretch of time, ns, both ends included."""

    low: int = 0
    high: int = LAST_NS


class Named(NamedTuple):
    """All messages under one name."""

    name: str


class Valued(NamedTuple):
    """All messages whose key field has one value."""

    value: AnyKey


Selection = Union[Stretch, Named, Valued]


def stretch_of(key: Optional[Time], to_key: Optional[Time]) -> Stretch:
    """Return the stretch between two times, both included; None = open."""
    low = 0 if key is None else to_ns(key)
    return Stretch(low, LAST_NS if to_key is None else to_ns(to_key))


class TopicKeys:
    """Says what the keys of one topic mean.

    Args:
        topic: Its name, for error texts.
        key_format: The topic's.
        tables: Of the topic.
    """

    def __init__(self, topic: str, key_format: str, tables: Sequence[TopicTable]) -> None:
        self._topic = topic
        self._format = key_format
        self._tables = tables
        self._named = key_format in NAMED_FORMATS
        self._parts = [t.value_part for t in tables if t.value_part is not None]

    def several(self, key: AnyKey, to_key: AnyKey) -> Selection:
        """Say what key and to_key mean as the ends of a stretch, or what key alone means.

        Args:
            key, to_key: As the user gave them; None = open.

        Raises:
            InvalidKey: The keys of the topic have no order, or a key cannot be one.
        """
        if key is None and to_key is None:
            return Stretch()
        if self._named and to_key is not None:
            raise InvalidKey(
                f"messages of topic {self._topic} are kept under names (key_format "
                f"{self._format}), and names have no order: there is no stretch between two of "
                "them; give one key, or none for all"
            )
        if to_key is None and (self._named or self._is_value(key)):
            return self.one(key)
        if self._is_value(key) or self._is_value(to_key):
            raise InvalidKey(
                f"the key of topic {self._topic} is its field {self._parts[0].field}, and its "
                "messages lie in the order of time: a stretch goes from one genpy.Time to "
                "another; ask for a range of values with executeCQL"
            )
        return stretch_of(key, to_key)

    def one(self, key: AnyKey) -> Selection:
        """Say what a single key means: one time, one name, or one value.

        Raises:
            InvalidKey: It cannot be a key of the topic.
        """
        if self._named:
            return Named(check_message_name(self._topic, key))
        if self._is_value(key):
            return Valued(key)
        t = to_ns(key)
        return Stretch(t, t)

    def _is_value(self, key: AnyKey) -> bool:
        return bool(self._parts) and key is not None and not is_time(key)

    def of_text(self, text: str) -> AnyKey:
        """Read a key that a person typed; see CassandraTopic.keyOfText."""
        if self._named or any(table.named for table in self._tables):
            return text
        if self._parts:
            return Stamp.from_ns(to_ns(text)) if is_iso_text(text) else self._value(text)
        text = text.strip()
        return int(text) if text.isascii() and text.isdigit() and len(text) < 40 else text

    def _value(self, text: str) -> AnyKey:
        """Read a value as the first table that can takes it: texts last, they take anything."""
        problem: Optional[InvalidKey] = None
        for part in sorted(self._parts, key=lambda part: part.is_text):
            try:
                return part.from_text(text)
            except InvalidKey as exc:
                problem = problem or exc
        raise problem or InvalidKey(f"{text!r:.80} is no key")
