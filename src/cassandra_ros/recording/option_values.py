# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Values of a recorder's options and settings: their defaults, and how their texts are read.

Help and usage errors of the recorder need no more than this module, which imports little.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from cassandra_ros.arguments import check_labels, check_ttl
from cassandra_ros.errors import InvalidOption

DEFAULT_BUFFER_BYTES = 256 * 1024 * 1024
"""Default maximum memory of the messages that wait for the store, bytes."""
BLOCK_SEC = 0.5
"""Default maximum time that a message waits for others in a block of format packed, s."""
_UNITS = {"": 1, "s": 1, "m": 60, "h": 3600, "d": 86400}
"""Units of durations, s."""
MAX_RATE_HZ = 1e6
"""Maximum value of a rate limit, Hz."""


def read_duration(value: object) -> float:
    """Read a duration: a number of seconds above 0, or a number followed by s, m, h or d."""
    text = str(value) if isinstance(value, (int, float, str)) else ""
    match = re.fullmatch(r"([0-9]{1,15}(?:\.[0-9]*)?|\.[0-9]+)([smhd]?)", text)
    if match is None or not float(match[1]):
        raise InvalidOption(f"{str(value)!r:.80} is not a duration, like 30, 5m or 2h")
    return float(match[1]) * _UNITS[match[2]]


def read_rate(value: object) -> float:
    """Read a rate in messages per second, above 0 and at most MAX_RATE_HZ."""
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
    """Read KEY=VALUE; raises InvalidOption."""
    key, equals, value = text.partition("=")
    if not (key.strip() and equals):
        raise InvalidOption(f"{text!r:.80} is not a label: give KEY=VALUE, as site=lab")
    ((key, value),) = check_labels({key.strip(): value.strip()}).items()
    return key, value


def read_ttl(value: object) -> int:
    """Read a time to live: whole seconds, 0 = never, or a number followed by s, m, h or d."""
    if value == "0":
        return 0
    return check_ttl(int(read_duration(value)) if isinstance(value, str) else value)


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
