# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What recorder and player read from their command lines: durations, numbers, expressions."""

from __future__ import annotations

import argparse
import re
from typing import Callable, TypeVar

from cassandra_ros.errors import CassandraRosError

_UNITS = {"": 1, "s": 1, "m": 60, "h": 3600}
_LONG_UNITS = {"d": 86_400, "w": 7 * 86_400}
_SIZES = {"": 1, "k": 1 << 10, "m": 1 << 20, "g": 1 << 30, "t": 1 << 40}
_Read = TypeVar("_Read")


def checked(reader: Callable[[str], _Read]) -> Callable[[str], _Read]:
    """Make a reader of the library, which raises errors of ours, one for argparse."""

    def read(text: str) -> _Read:
        try:
            return reader(text)
        except CassandraRosError as exc:
            raise argparse.ArgumentTypeError(str(exc)) from exc

    return read


def regular_expression(text: str) -> str:
    """Check a regular expression, for argparse."""
    try:
        re.compile(text)
    except re.error as exc:
        raise argparse.ArgumentTypeError(f"{text!r} is not a regular expression: {exc}") from exc
    return text


def duration(text: str) -> float:
    """Read a duration as rosbag does, in seconds: 30, 90s, 1.5m, 2h."""
    match = re.fullmatch(r"([0-9]+(?:\.[0-9]*)?|\.[0-9]+)([smh]?)", text)
    if match is None or not float(match[1]):
        raise argparse.ArgumentTypeError(f"{text!r} is not a duration, like 30, 5m or 2h")
    return float(match[1]) * _UNITS[match[2]]


def age(text: str) -> float:
    """Read how old something may be, in seconds: as duration does, or in days and weeks."""
    number, unit = text[:-1], text[-1:]
    try:
        return duration(number) * _LONG_UNITS[unit] if unit in _LONG_UNITS else duration(text)
    except argparse.ArgumentTypeError:
        known = f"{text!r} is no age, like 90m, 12h, 30d or 8w"
        raise argparse.ArgumentTypeError(known) from None


def whole_number(text: str) -> int:
    """Read a number of 0 or more, for argparse."""
    if not (text.isascii() and text.isdigit() and len(text) < 10):
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of 0 or more")
    return int(text)


def megabytes(text: str) -> int:
    """Read a number of MB as bytes, for argparse."""
    return whole_number(text) << 20


def byte_size(text: str) -> int:
    """Read a size as rosbag does for --min-space: 1G, 512M, 100k or bytes."""
    digits, unit = (text, "") if text.isdigit() else (text[:-1], text[-1:].lower())
    if unit not in _SIZES:
        raise argparse.ArgumentTypeError(f"{text!r} is no size: give one like 1G, 512M or 100k")
    return whole_number(digits) * _SIZES[unit]


def seconds(text: str) -> float:
    """Read seconds of 0 or more, for argparse; as rosbag does, or with m or h."""
    try:
        return 0.0 if text.strip("0") in ("", ".") and text != "." else duration(text)
    except argparse.ArgumentTypeError:
        known = f"{text!r} is no number of seconds: give 0 or more, like 0.2 or 5m"
        raise argparse.ArgumentTypeError(known) from None


def factor(text: str) -> float:
    """Read a number above 0, for argparse."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number above 0")
    return value
