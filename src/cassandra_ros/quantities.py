# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Durations, lengths, sizes and numbers as people write them in options, files and parameters.

Each function reads a text and raises InvalidOption, which says what to give instead.
"""

from __future__ import annotations

import re
from decimal import Decimal

from cassandra_ros.errors import InvalidOption

_UNITS_SEC = {"": 1, "s": 1, "m": 60, "h": 3600, "d": 86_400, "w": 7 * 86_400}
_MS = Decimal("0.001")
_MOST_DIGITS = 18
_SIZES = {"": 1, "k": 1 << 10, "m": 1 << 20, "g": 1 << 30, "t": 1 << 40}


def exact_duration(text: str) -> Decimal:
    """Read a duration above 0: a number of seconds, or with ms, s, m, h, d or w. Return seconds.

    m are minutes.
    """
    match = re.fullmatch(r"([0-9]{1,15}(?:\.[0-9]*)?|\.[0-9]+)(ms|[smhdw]?)", text)
    if match is None or not float(match[1]):
        raise InvalidOption(f"{text!r:.80} is not a duration, like 30, 5m, 2h or 7d")
    return Decimal(match[1]) * (_MS if match[2] == "ms" else _UNITS_SEC[match[2]])


def duration(text: str) -> float:
    """Read a duration like exact_duration. Return seconds."""
    return float(exact_duration(text))


def exact_seconds(text: str) -> Decimal:
    """Read a duration like exact_duration, or 0. Return seconds, exactly."""
    if re.fullmatch(r"(0+\.?0*|\.0+)(ms|[smhdw]?)", text):
        return Decimal(0)
    try:
        return exact_duration(text)
    except InvalidOption:
        reason = f"{text!r:.80} is not a number of seconds: give 0 or more, like 0.2 or 5m"
        raise InvalidOption(reason) from None


def seconds(text: str) -> float:
    """Read a duration like exact_seconds. Return seconds."""
    return float(exact_seconds(text))


def metres(text: str) -> float:
    """Read a length of 0 or more, with its unit: m or km. Return metres."""
    match = re.fullmatch(r"([0-9]{1,15}(?:\.[0-9]*)?|\.[0-9]+) ?(k?)m", text)
    if match is None:
        raise InvalidOption(f"{text!r:.80} is not a length of 0 or more, like 20m or 1.5km")
    return float(match[1]) * (1000 if match[2] else 1)


def truth(text: str) -> bool:
    """Read true or false, or 1 or 0."""
    words = {"true": True, "1": True, "false": False, "0": False}
    if text.lower() not in words:
        raise InvalidOption(f"{text!r:.40} is neither true nor false")
    return words[text.lower()]


def whole_number(text: str) -> int:
    """Read a whole number of 0 to 999,999,999."""
    if not (text.isascii() and text.isdigit() and len(text) < 10):
        raise InvalidOption(f"{text!r:.80} is not a whole number of 0 or more")
    return int(text)


def megabytes(text: str) -> int:
    """Read a number of MB, each of 1024 * 1024 bytes, as in rosbag. Return bytes."""
    return whole_number(text) << 20


def byte_size(text: str) -> int:
    """Read a size as in rosbag's --min-space: 1G, 512M, 100k or bytes. Return bytes.

    k is 1024. The number is whole.
    """
    digits, unit = (text, "") if text.isdigit() else (text[:-1], text[-1:].lower())
    is_number = digits.isascii() and digits.isdigit() and len(digits) <= _MOST_DIGITS
    if unit not in _SIZES or not is_number:
        raise InvalidOption(f"{text!r:.80} is not a size: give one like 1G, 512M or 100k")
    return int(digits) * _SIZES[unit]


def factor(text: str) -> float:
    """Read a finite number greater than 0."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise InvalidOption(f"{text!r:.80} is not a number above 0")
    return value
