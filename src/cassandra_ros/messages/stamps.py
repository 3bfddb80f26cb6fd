# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Times: the row key Stamp, and every form in which a person may write a time."""

from __future__ import annotations

import operator
import re
from datetime import datetime, timedelta
from decimal import Decimal, InvalidOperation
from numbers import Integral, Real
from typing import Any, Callable

import genpy

from cassandra_ros.errors import InvalidKey
from cassandra_ros.keys import MAX_NS, SECOND_NS

SECONDS_BELOW = 10**12
"""An integer time below is 17 minutes after 1970, or was meant as seconds."""

_EPOCH = datetime(1970, 1, 1)
_DECIMAL = re.compile(r"[0-9]+\.?[0-9]*|\.[0-9]+")
_ISO = re.compile(
    r"(?P<date>[0-9]{4}-[0-9]{2}-[0-9]{2})"
    r"(?:[Tt ](?P<hour>[0-9]{2}):(?P<minute>[0-9]{2})"
    r"(?::(?P<second>[0-9]{2})(?:[.,](?P<fraction>[0-9]{1,9}))?)?"
    r"\s*(?P<zone>[Zz]|[+-][0-9]{2}(?::?[0-9]{2})?)?)?"
)


def seconds_to_ns(seconds: Any) -> int:
    """Convert seconds (int, float, Decimal) to nanoseconds, rounded half to even.

    The shortest decimal text of a float is what was meant: 0.1 is 100,000,000 ns. Raises InvalidKey
    where it is no finite number.
    """
    if isinstance(seconds, Integral):
        return int(seconds) * SECOND_NS
    try:
        exact = seconds if isinstance(seconds, Decimal) else Decimal(repr(float(seconds)))
        return int((exact * SECOND_NS).to_integral_value())
    except (InvalidOperation, ValueError, OverflowError, TypeError) as exc:
        raise InvalidKey(f"{seconds!r} is not a number of seconds") from exc


def check_ns(ns: int, shown: object = None) -> int:
    """Return ns if ROS can express it, else raise InvalidKey."""
    if 0 <= ns <= MAX_NS:
        return ns
    what = f"{ns} ns" if shown is None else repr(shown)
    raise InvalidKey(
        f"{what} is not a time of ROS 1, which reaches from 1970 to 2106-02-07 "
        f"({MAX_NS} ns); an int means nanoseconds, a float seconds"
    )


def _ordering(compare: Callable[[float, float], bool]) -> Callable[[Stamp, object], bool]:
    def method(self: Stamp, other: object) -> bool:
        limit = _comparable(other)
        return NotImplemented if limit is None else compare(self.ns, limit)

    return method


class Stamp(genpy.Time):
    """Key of a stored message: a ROS time with exact nanosecond arithmetic.

    ``stamp + 5`` and ``stamp - 0.1`` mean seconds; minus stops at 0. ``str(stamp)`` is the
    integer nanoseconds. ``==`` and ``hash`` are genpy.Time's; ``<`` and its kin also take int
    (nanoseconds) and float (seconds), from both sides.

    Attributes:
        node: nodeID of the row, None when the stamp came from no row.
        seq: Writer id << 32 | counter of the row, or None.
        table: Table of the row, or None.
    """

    __slots__ = ["node", "seq", "table"]

    def __init__(
        self,
        secs: Any = 0,
        nsecs: int = 0,
        node: str | None = None,
        seq: int | None = None,
        table: str | None = None,
    ) -> None:
        ns = check_ns(seconds_to_ns(secs) + int(nsecs))
        super().__init__(ns // SECOND_NS, ns % SECOND_NS)
        self.node = node
        self.seq = seq
        self.table = table

    @classmethod
    def from_ns(
        cls, ns: int, node: str | None = None, seq: int | None = None, table: str | None = None
    ) -> Stamp:
        """Make a stamp of integer nanoseconds since 1970; InvalidKey after 2106 or before 1970."""
        # As often as messages are read, and six times as quick as by __init__.
        stamp = cls.__new__(cls)
        stamp.secs, stamp.nsecs = divmod(check_ns(int(ns)), SECOND_NS)
        stamp.node, stamp.seq, stamp.table = node, seq, table
        return stamp

    @classmethod
    def from_sec(cls, float_secs: float) -> Stamp:
        """Make a stamp of seconds; exact, where genpy's own truncates."""
        return cls(float_secs)

    @property
    def ns(self) -> int:
        """Nanoseconds since 1970."""
        return int(self.secs) * SECOND_NS + int(self.nsecs)

    def __getstate__(self) -> list[object]:
        return [self.secs, self.nsecs, self.node, self.seq, self.table]

    def __setstate__(self, state: list[Any]) -> None:
        super().__setstate__(state[:2])
        self.node, self.seq, self.table = state[2:]

    def __repr__(self) -> str:
        return f"Stamp[{self.ns}]"

    def __add__(self, other: object) -> Stamp:
        offset = _offset_ns(other)
        if offset is None:
            return NotImplemented
        return type(self)(0, max(0, self.ns + offset))

    __radd__ = __add__

    def __sub__(self, other: object) -> Stamp | genpy.Duration:
        if isinstance(other, genpy.Time):
            return genpy.Duration(0, self.ns - other.to_nsec())
        offset = _offset_ns(other)
        if offset is None:
            return NotImplemented
        return type(self)(0, max(0, self.ns - offset))

    __lt__ = _ordering(operator.lt)
    __le__ = _ordering(operator.le)
    __gt__ = _ordering(operator.gt)
    __ge__ = _ordering(operator.ge)


def _is_number(value: object) -> bool:
    return isinstance(value, (Real, Decimal)) and not isinstance(value, bool)


def _offset_ns(value: object) -> int | None:
    """Return the nanoseconds of something that can be added to a stamp, or None."""
    if isinstance(value, genpy.Duration):
        return int(value.to_nsec())
    return seconds_to_ns(value) if _is_number(value) else None


def duration_ns(value: object) -> int:
    """Return the ns of a genpy.Duration or a number of seconds; InvalidKey below 0 or of others."""
    ns = _offset_ns(value)
    if ns is None or ns < 0:
        known = "seconds, at least 0, or a genpy.Duration"
        raise InvalidKey(f"{value!r:.80} is no length of time: give {known}")
    return ns


def _comparable(value: Any) -> int | float | None:
    """Nanoseconds of something that a stamp can be compared with, or None."""
    if isinstance(value, genpy.Time):
        return int(value.to_nsec())
    if not _is_number(value):
        return None
    if isinstance(value, Integral):
        return int(value)
    if value != value or value in (float("inf"), float("-inf")):
        return float(value)  # compares as IEEE says
    return seconds_to_ns(value)


def to_ns(value: object) -> int:
    """Return the nanoseconds since 1970 of any form of a time.

    Args:
        value: genpy.Time (exact), int (nanoseconds), float or Decimal (seconds), or text: ISO 8601
            (no zone means UTC, up to 9 digits), only digits (nanoseconds), or digits with a point
            (seconds).

    Raises:
        InvalidKey: It is none of these, or outside 1970 to 2106.
    """
    if isinstance(value, genpy.Time):
        return check_ns(int(value.to_nsec()), value)
    if isinstance(value, str):
        return check_ns(_text_to_ns(value), value)
    if isinstance(value, Integral) and not isinstance(value, bool):
        return check_ns(int(value), value)
    if _is_number(value):
        return check_ns(seconds_to_ns(value), value)
    known = "a genpy.Time, an int (nanoseconds), a float (seconds) or ISO 8601 text"
    raise InvalidKey(f"{value!r} is not a time: give {known}")


def _text_to_ns(text: str) -> int:
    stripped = text.strip()
    if len(stripped) <= 40 and _DECIMAL.fullmatch(stripped):
        return seconds_to_ns(Decimal(stripped)) if "." in stripped else int(stripped)
    match = _ISO.fullmatch(stripped)
    if match is None:
        raise InvalidKey(
            f"{text[:80]!r} is not a time: write it like 2013-05-08T14:06:20.123456789Z "
            f"(no zone means UTC), or as digits only for nanoseconds"
        )
    try:
        return _iso_to_ns(match)
    except ValueError as exc:
        raise InvalidKey(f"{text[:80]!r} is not a time: {exc}") from exc


def _iso_to_ns(match: re.Match[str]) -> int:
    day = datetime.strptime(match["date"], "%Y-%m-%d")
    hour, minute, second = (int(match[part] or 0) for part in ("hour", "minute", "second"))
    delta = day.replace(hour=hour, minute=minute, second=second) - _EPOCH
    seconds, zone = delta.days * 86_400 + delta.seconds, match["zone"] or "Z"
    if zone not in "Zz":
        digits = zone[1:].replace(":", "").ljust(4, "0")
        if int(digits[2:]) > 59 or int(digits[:2]) > 23:
            raise ValueError(f"{zone} is not a time zone")
        offset = int(digits[:2]) * 3600 + int(digits[2:]) * 60
        seconds += offset if zone[0] == "-" else -offset
    return seconds * SECOND_NS + int((match["fraction"] or "").ljust(9, "0"))


def is_iso_text(text: str) -> bool:
    """Say whether a text is a time in ISO 8601."""
    return _ISO.fullmatch(text.strip()) is not None


def is_time(value: object) -> bool:
    """Say whether a value is a genpy.Time or a Stamp (not a number or text that means one)."""
    return isinstance(value, genpy.Time)


def iso_time(ns: int) -> str:
    """Return nanoseconds since 1970 as ISO 8601, like 2013-05-08T14:06:20.123456789Z."""
    seconds, rest = divmod(ns, SECOND_NS)
    return f"{_EPOCH + timedelta(seconds=seconds):%Y-%m-%dT%H:%M:%S}.{rest:09d}Z"
