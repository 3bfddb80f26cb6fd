# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Values of a recorder's options and settings, and how their texts are read.

Help and usage errors of the recorder need no more than this module, which imports little.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Mapping, NamedTuple, Sequence, Tuple

from cassandra_ros.arguments import check_labels, check_pattern, check_ttl
from cassandra_ros.errors import InvalidOption
from cassandra_ros.quantities import duration

if TYPE_CHECKING:
    from cassandra_ros.recording.event_marks import WatchedEvent

DEFAULT_BUFFER_BYTES = 256 * 1024 * 1024
"""Default maximum memory of the messages that wait for the store, bytes."""
DEFAULT_SPACE_BYTES = 1 << 30
"""Default minimum free space where the local Cassandra keeps its data, bytes."""
BLOCK_SEC = 0.5
"""Default maximum time that a message waits for others in a block of format packed, s."""
MAX_RATE_HZ = 1e6
"""Maximum value of a rate limit, Hz."""

Rule = Tuple[str, Mapping[str, Any]]
"""A regular expression that must match whole topic names, and values of TopicSettings by name."""


class SettingsFile(NamedTuple):
    """What a settings file says."""

    rules: Sequence[Rule] = ()
    events: Sequence[WatchedEvent] = ()
    """Events that last while a condition holds."""


def read_config(name: str) -> SettingsFile:
    """Read a settings file. An empty name, which a launch file may pass, means no file.

    Raises:
        InvalidOption: The file cannot be read, or its text cannot be used.
    """
    if not name:
        return SettingsFile()
    from cassandra_ros.recording.topic_settings import read_settings

    try:
        text = Path(name).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as exc:
        raise InvalidOption(f"the settings {name!r} cannot be read: {exc}") from exc
    return read_settings(text, name)


def read_where(text: str) -> tuple[str, str]:
    """Read 'TOPIC: CONDITION'. Return a pattern of topics and the condition.

    Raises:
        InvalidOption, InvalidQuery: The text is not of this form, or the condition is not valid.
    """
    from cassandra_ros.recording.topic_settings import check_condition

    topic, colon, condition = (word.strip() for word in text.partition(":"))
    if not (topic and colon and condition):
        raise InvalidOption(f"{text!r} is not of the form 'TOPIC: CONDITION'")
    return check_pattern(topic), check_condition(condition)


def read_rate_limit(text: str) -> tuple[str, float]:
    """Read '[TOPIC:]HZ'. Return a pattern of topics and the rate, Hz, or raise InvalidOption."""
    topic, _, rate = text.rpartition(":")
    return check_pattern(topic.strip() or ".*"), read_rate(rate.strip())


def read_duration(value: object) -> float:
    """Read a duration above 0 of a settings file: seconds, or a text with s, m, h, d or w."""
    return duration(str(value) if isinstance(value, (int, float, str)) else "")


def read_rate(value: object) -> float:
    """Read messages per second, above 0 and at most MAX_RATE_HZ, or raise InvalidOption."""
    try:
        rate = float(value) if isinstance(value, (int, float, str)) else 0.0
    except ValueError:
        rate = 0.0
    if isinstance(value, bool) or not 0 < rate <= MAX_RATE_HZ:
        raise InvalidOption(
            f"{str(value)!r:.80} is not a rate: give messages a second, like 5 or 0.1"
        )
    return rate


def read_label(text: str) -> tuple[str, str]:
    """Read KEY=VALUE; raises InvalidOption, or InvalidName if a label cannot be stored."""
    key, equals, value = text.partition("=")
    if not (key.strip() and equals):
        raise InvalidOption(f"{text!r:.80} is not a label: give KEY=VALUE, as site=lab")
    ((key, value),) = check_labels({key.strip(): value.strip()}).items()
    return key, value


def read_ttl(value: object) -> int:
    """Read a time to live and return it in s; 0 = messages stay for ever.

    A number is seconds, whole ones only. A text is seconds, or has s, m, h, d or w; it is rounded
    up to seconds. Other values raise InvalidOption.
    """
    if value == "0":
        return 0
    return check_ttl(math.ceil(read_duration(value)) if isinstance(value, str) else value)


@dataclass(frozen=True)
class SnapshotBound:
    """The maximum of messages kept in memory, by time or by size. One of the two is 0."""

    seconds: float = 0.0
    nbytes: int = 0


def read_bound(text: str) -> SnapshotBound:
    """Read a maximum like 30s, 5m or 200MB, or raise InvalidOption."""
    size = re.fullmatch(r"([0-9]{1,9})\s*MB", text.strip(), re.IGNORECASE)
    if size and int(size[1]):
        return SnapshotBound(nbytes=int(size[1]) << 20)
    try:
        return SnapshotBound(seconds=read_duration(text.strip()))
    except InvalidOption:
        raise InvalidOption(
            f"{text!r:.80} is neither seconds nor megabytes: give one like 30s or 200MB"
        ) from None
