# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Functions that parse option values for argparse: durations, sizes, numbers, expressions."""

from __future__ import annotations

import argparse
import re
from decimal import Decimal
from typing import Callable, TypeVar

from cassandra_ros.errors import CassandraRosError

_UNITS = {"": 1, "s": 1, "m": 60, "h": 3600}
_LONG_UNITS = {"d": 86_400, "w": 7 * 86_400}
_MOST_DIGITS = 18
_SIZES = {"": 1, "k": 1 << 10, "m": 1 << 20, "g": 1 << 30, "t": 1 << 40}
_Read = TypeVar("_Read")


def checked(reader: Callable[[str], _Read]) -> Callable[[str], _Read]:
    """Turn a parser that raises CassandraRosError into one that raises argparse's error."""

    def read(text: str) -> _Read:
        try:
            return reader(text)
        except CassandraRosError as exc:
            raise argparse.ArgumentTypeError(str(exc)) from exc

    return read


def exact_duration(text: str) -> Decimal:
    """Parse a duration as rosbag writes it (30, 90s, 1.5m, 2h). Return seconds, exactly."""
    match = re.fullmatch(r"([0-9]+(?:\.[0-9]*)?|\.[0-9]+)([smh]?)", text)
    if match is None or not float(match[1]):
        raise argparse.ArgumentTypeError(f"{text!r} is not a duration, like 30, 5m or 2h")
    return Decimal(match[1]) * _UNITS[match[2]]


def duration(text: str) -> float:
    """Parse a duration like exact_duration. Return seconds."""
    return float(exact_duration(text))


def age(text: str) -> float:
    """Parse an age: a duration, or days and weeks (30d, 8w). Return seconds."""
    number, unit = text[:-1], text[-1:]
    try:
        return duration(number) * _LONG_UNITS[unit] if unit in _LONG_UNITS else duration(text)
    except argparse.ArgumentTypeError:
        reason = f"{text!r} is not an age, like 90m, 12h, 30d or 8w"
        raise argparse.ArgumentTypeError(reason) from None


def truth(text: str) -> bool:
    """Parse true or false as written in ROS parameters."""
    words = {"true": True, "1": True, "false": False, "0": False}
    if text.lower() not in words:
        raise argparse.ArgumentTypeError(f"{text!r:.40} is neither true nor false")
    return words[text.lower()]


def whole_number(text: str) -> int:
    """Parse a whole number, at least 0."""
    if not (text.isascii() and text.isdigit() and len(text) < 10):
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of 0 or more")
    return int(text)


def megabytes(text: str) -> int:
    """Parse a number of MB. Return bytes."""
    return whole_number(text) << 20


def byte_size(text: str) -> int:
    """Parse a size as in rosbag's --min-space: 1G, 512M, 100k or bytes. Return bytes."""
    digits, unit = (text, "") if text.isdigit() else (text[:-1], text[-1:].lower())
    if unit not in _SIZES:
        raise argparse.ArgumentTypeError(f"{text!r} is not a size: give one like 1G, 512M or 100k")
    if not (digits.isascii() and digits.isdigit() and len(digits) <= _MOST_DIGITS):
        raise argparse.ArgumentTypeError(f"{text!r} is not a size: give one like 1G, 512M or 100k")
    return int(digits) * _SIZES[unit]


def exact_seconds(text: str) -> Decimal:
    """Parse a duration as rosbag writes it, at least 0. Return seconds, exactly."""
    try:
        is_zero = text.strip("0") in ("", ".") and text != "."
        return Decimal(0) if is_zero else exact_duration(text)
    except argparse.ArgumentTypeError:
        reason = f"{text!r} is not a number of seconds: give 0 or more, like 0.2 or 5m"
        raise argparse.ArgumentTypeError(reason) from None


def seconds(text: str) -> float:
    """Parse a duration like exact_seconds. Return seconds."""
    return float(exact_seconds(text))


def factor(text: str) -> float:
    """Parse a number greater than 0."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number above 0")
    return value
