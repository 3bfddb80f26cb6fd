# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a key stands for: a stretch of time, a name, or the value of a field."""

from __future__ import annotations

from typing import Any, NamedTuple, Optional, Sequence, Union

from cassandra_ros.arguments import check_message_name
from cassandra_ros.errors import InvalidKey
from cassandra_ros.keys import NAMED_FORMATS
from cassandra_ros.messages.stamps import Stamp, isIsoText, isTime, toNs
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


def valueOfText(tables: Sequence[TopicTable], text: str) -> AnyKey:
    """Read the value of a key field that a person typed, as the first table that can takes it.

    Fields of text come last, for they take anything.

    Raises:
        InvalidKey: The text is a value in none of the tables.
    """
    problem: Optional[InvalidKey] = None
    for part in sorted((table.keyPart() for table in tables), key=lambda part: part.is_text):
        try:
            return part.fromText(text)
        except InvalidKey as exc:
            problem = problem or exc
    raise problem or InvalidKey(f"{text!r:.80} is no key")


def selectMany(
    topic: str, key_format: str, tables: Sequence[TopicTable], key: AnyKey, to_key: AnyKey
) -> Selection:
    """Say what key and to_key mean as the ends of a stretch, or what key alone means.

    Args:
        topic: Its name, for error texts.
        key_format: The topic's.
        tables: Of the topic.
        key, to_key: As the user gave them; None = open.

    Raises:
        InvalidKey: The keys of the topic have no order, or a key cannot be one.
    """
    if key is None and to_key is None:
        return Stretch()
    named = key_format in NAMED_FORMATS
    if named and to_key is not None:
        raise InvalidKey(
            f"messages of topic {topic} are kept under names (key_format {key_format}), and names "
            "have no order: there is no stretch between two of them; give one key, or none for all"
        )
    if named:
        return Named(check_message_name(topic, key))
    low_is_value, high_is_value = (_isValue(tables, end) for end in (key, to_key))
    if to_key is None and low_is_value:
        return Valued(key)
    if low_is_value or high_is_value:
        part = next(table.keyPart() for table in tables if table.valued)
        raise InvalidKey(
            f"the key of topic {topic} is its field {part.field}, and its messages lie in the "
            "order of time: a stretch goes from one genpy.Time to another; ask for a range of "
            "values with executeCQL"
        )
    return stretchOf(key, to_key)


def stretchOf(key: Optional[Time], to_key: Optional[Time]) -> Stretch:
    """Return the stretch between two times, both included; None = open."""
    low = 0 if key is None else toNs(key)
    return Stretch(low, LAST_NS if to_key is None else toNs(to_key))


def selectOne(topic: str, key_format: str, tables: Sequence[TopicTable], key: AnyKey) -> Selection:
    """Say what a single key means: one time, one name, or one value.

    Raises:
        InvalidKey: It cannot be a key of the topic.
    """
    if key_format in NAMED_FORMATS:
        return Named(check_message_name(topic, key))
    if _isValue(tables, key):
        return Valued(key)
    t = toNs(key)
    return Stretch(t, t)


def _isValue(tables: Sequence[TopicTable], key: AnyKey) -> bool:
    return key is not None and not isTime(key) and any(table.valued for table in tables)


def key_of_text(key_format: str, tables: Sequence[TopicTable], text: str) -> AnyKey:
    """Read a key that a person typed; see CassandraTopic.keyOfText."""
    if key_format in NAMED_FORMATS or any(table.named for table in tables):
        return text
    valued = [table for table in tables if table.valued]
    if valued and not isIsoText(text):
        return valueOfText(valued, text)
    if valued:
        return Stamp.fromNs(toNs(text))
    text = text.strip()
    return int(text) if text.isascii() and text.isdigit() and len(text) < 40 else text
