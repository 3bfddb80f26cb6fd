# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Times: the row key Stamp, and the conversion of every form in which a time may be given."""

from __future__ import annotations

import operator
import re
from datetime import datetime, timedelta
from decimal import Context, Decimal, InvalidOperation
from numbers import Integral, Real
from typing import Any, Callable, NamedTuple, Union

import genpy
import numpy as np

from cassandra_ros.errors import InvalidKey
from cassandra_ros.keys import MAX_NS, SECOND_NS

SECONDS_BELOW = 10**12
"""Limit below which an integer time was probably meant as seconds: as ns it would be less than
17 minutes after 1970."""
_MOST_UNITS = 10**16
"""Limit below which an integer can be meant as seconds, milliseconds or microseconds since 1970; as
ns it is before May 1970."""
LENGTHS_BELOW = 10**9
"""Limit below which a number is a length in seconds, where a time or a length may be given. It is
31 years; as a time it would be before 2001."""

Time = Union[genpy.Time, datetime, "np.datetime64", int, float, Decimal, str]
"""Any form of a time, see to_ns. genpy.Time includes Stamp and rospy.Time; datetime includes
pandas.Timestamp."""
Length = Union[genpy.Duration, timedelta, "np.timedelta64", int, float, Decimal]
"""Any form of a length of time; a number means seconds."""

# Statements can compute lengths with hundreds of digits; Python's default context rounds to 28.
_EXACT = Context(prec=1000)
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

    A float means its shortest decimal text: 0.1 is 100,000,000 ns. Raises InvalidKey if the value
    is not a finite number.
    """
    if isinstance(seconds, Integral):
        return int(seconds) * SECOND_NS
    try:
        exact = seconds if isinstance(seconds, Decimal) else Decimal(repr(float(seconds)))
        return int(_EXACT.multiply(exact, SECOND_NS).to_integral_value())
    except (InvalidOperation, ValueError, OverflowError, TypeError) as exc:
        raise InvalidKey(f"{seconds!r} is not a number of seconds") from exc


def check_ns(ns: int, original: object = None) -> int:
    """Return ns since 1970 if ROS can express it, else raise InvalidKey; it shows ``original``."""
    if 0 <= ns <= MAX_NS:
        return ns
    what = f"{ns} ns" if original is None else repr(original)
    raise InvalidKey(
        f"{what} is not a time of ROS 1, which reaches from 1970 to 2106-02-07 "
        f"({MAX_NS} ns); an int means nanoseconds, a float seconds"
    )


def _ordering(compare: Callable[[float, float], bool]) -> Callable[[Stamp, object], bool]:
    """Return the method of a Stamp that compares its ns with what _comparable returns."""

    def method(self: Stamp, other: object) -> bool:
        limit = _comparable(other)
        return NotImplemented if limit is None else compare(self.ns, limit)

    return method


class Stamp(genpy.Time):
    """Key of a stored message: a ROS time with exact nanosecond arithmetic.

    ``stamp + 5`` and ``stamp - 0.1`` mean seconds; a difference stops at 0. Durations, timedelta
    and the time lengths of numpy and pandas can be added and subtracted too. ``str(stamp)`` is the
    integer nanoseconds. ``==`` and ``hash`` are genpy.Time's. ``<``, ``<=``, ``>`` and ``>=`` also
    take every form that to_ns takes except text, on either side: an int means nanoseconds, a float
    seconds.

    Attributes:
        node: nodeID of the row, None when the stamp came from no row.
        seq: Writer id << 32 | counter of the row, or None.
        table: Table of the row, or None.
    """

    __slots__ = ["node", "seq", "table"]
    __array_ufunc__ = None
    """Tells numpy to leave sums and comparisons with its numbers to this class."""

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
        """Make a stamp from integer ns since 1970; InvalidKey: before 1970 or after 2106."""
        # Called for every message that is read; six times as fast as __init__.
        ns = int(ns)
        if not 0 <= ns <= MAX_NS:
            check_ns(ns)
        stamp = cls.__new__(cls)
        stamp.secs, stamp.nsecs = divmod(ns, SECOND_NS)
        stamp.node, stamp.seq, stamp.table = node, seq, table
        return stamp

    @classmethod
    def from_sec(cls, float_secs: float) -> Stamp:
        """Make a stamp from seconds; exact, while genpy's method truncates."""
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
        node = f" of {self.node}" if self.node else ""
        return f"Stamp[{self.ns}: {iso_time(self.ns)}{node}]"

    def __add__(self, other: object) -> Stamp:
        offset = _offset_ns(other)
        if offset is None:
            return NotImplemented
        return type(self)(0, max(0, self.ns + offset))

    __radd__ = __add__

    def __sub__(self, other: object) -> Stamp | genpy.Duration:
        time = _object_ns(other)
        if time is not None:
            return length_from_ns(self.ns - time)
        offset = _offset_ns(other)
        if offset is None:
            return NotImplemented
        return type(self)(0, max(0, self.ns - offset))

    __lt__ = _ordering(operator.lt)
    __le__ = _ordering(operator.le)
    __gt__ = _ordering(operator.gt)
    __ge__ = _ordering(operator.ge)


def _is_number(value: object) -> bool:
    # numpy.timedelta64 is registered as an Integral.
    return isinstance(value, (Real, Decimal)) and not isinstance(value, (bool, np.timedelta64))


def _object_ns(value: Any) -> int | None:
    """Return the ns since 1970 of an object whose type is a time; None for other types.

    A time without a zone is in UTC, like the times of numpy, pandas and the store. Raises
    InvalidKey for a missing time (NaT) and for one finer than nanoseconds.
    """
    if isinstance(value, genpy.Time):
        return int(value.to_nsec())
    if isinstance(value, datetime):
        if value != value:
            raise InvalidKey(f"{value!r} is not a time: the value is missing")
        zone = value.utcoffset()
        # A pandas.Timestamp has an extra attribute for ns; its difference would overflow at
        # 292 years.
        local = datetime(*value.timetuple()[:6], value.microsecond) - _EPOCH
        return _delta_ns(local - (zone or timedelta())) + int(getattr(value, "nanosecond", 0))
    if isinstance(value, np.datetime64):
        return _numpy_ns(value, "M8[ns]")
    return None


def _delta_ns(value: timedelta) -> int:
    """Return the exact ns of a timedelta."""
    # A pandas.Timedelta has an extra attribute for ns.
    us = (value.days * 86_400 + value.seconds) * 10**6 + value.microseconds
    return us * 1000 + int(getattr(value, "nanoseconds", 0))


def _numpy_ns(value: Any, unit: str) -> int:
    """Return the ns of a time or length of numpy; InvalidKey: NaT, or ns cannot express it.

    ``unit``: the type of the same kind with the unit ns.
    """
    ns = value.astype(unit)
    if np.isnat(value) or ns.astype(value.dtype) != value:
        why = "the value is missing" if np.isnat(value) else "nanoseconds cannot express it"
        raise InvalidKey(f"{value!r} is not a time: {why}")
    return int(ns.astype("i8"))


def length_from_ns(ns: int) -> genpy.Duration:
    """Return a length of time of so many ns, below 2**31 s, as ROS has it."""
    return genpy.Duration(0, ns)


def length_object_ns(value: Any) -> int | None:
    """Return the ns of an object whose type is a length of time; None for other types.

    Raises InvalidKey for a missing length (NaT) and for one finer than nanoseconds.
    """
    if isinstance(value, genpy.Duration):
        return int(value.to_nsec())
    if isinstance(value, timedelta):
        if value != value:
            raise InvalidKey(f"{value!r} is not a length of time: the value is missing")
        return _delta_ns(value)
    return _numpy_ns(value, "m8[ns]") if isinstance(value, np.timedelta64) else None


def _offset_ns(value: Any) -> int | None:
    """Return the ns of a value that can be added to a stamp: a length, or a number of seconds.

    None for other values; InvalidKey: as length_object_ns and seconds_to_ns.
    """
    ns = length_object_ns(value)
    return seconds_to_ns(value) if ns is None and _is_number(value) else ns


def duration_ns(value: object) -> int:
    """Return the ns of a Length; InvalidKey: not a Length, or negative."""
    ns = _offset_ns(value)
    if ns is None or ns < 0:
        forms = "seconds, at least 0, a genpy.Duration or a timedelta"
        raise InvalidKey(f"{value!r:.80} is not a length of time: give {forms}")
    return ns


def _comparable(value: Any) -> int | float | None:
    """Return the ns of a value that can be compared with a stamp; None for other values.

    A time, an int (ns) or another number (seconds), also an infinite one or NaN.
    """
    ns = _object_ns(value)
    if ns is not None or not _is_number(value):
        return ns
    if isinstance(value, Integral):
        return int(value)
    if value != value or value in (float("inf"), float("-inf")):
        return float(value)  # infinity and NaN compare as in IEEE 754
    return seconds_to_ns(value)


def to_ns(value: object) -> int:
    """Return the ns since 1970 of a time in any form. No other function decides what a form means.

    Args:
        value: genpy.Time (exact; includes Stamp and rospy.Time), datetime, pandas.Timestamp or
            numpy.datetime64 (without a zone: UTC), int (nanoseconds), float or Decimal (seconds),
            or text: ISO 8601 (without a zone: UTC; up to 9 digits), only digits (nanoseconds), or
            digits with a point (seconds).

    Raises:
        InvalidKey: The value has none of these forms, or is outside 1970 to 2106.
    """
    ns = _object_ns(value)
    if ns is not None:
        return check_ns(ns, value)
    if isinstance(value, str):
        return check_ns(_text_to_ns(value), value)
    if _is_number(value):
        whole = isinstance(value, Integral)
        return check_ns(int(value) if whole else seconds_to_ns(value), value)  # type: ignore[call-overload]
    forms = "a genpy.Time, a datetime, an int (nanoseconds), a float (seconds) or ISO 8601 text"
    raise InvalidKey(f"{value!r} is not a time: give {forms}")


class When(NamedTuple):
    """A time, or an offset from another time."""

    ns: int
    """Nanoseconds since 1970, or offset from the other time."""
    relative: bool


def time_or_length(value: object) -> When:
    """Return a value that may be a time or a length of time.

    A number below LENGTHS_BELOW is a length in seconds. Any other number is a time: an int in
    nanoseconds, a float in seconds.

    Raises:
        InvalidKey: The value is neither, negative, or after 2106; or it is an int from
            LENGTHS_BELOW to SECONDS_BELOW, which was probably meant as seconds since 1970.
    """
    if not _is_number(value):
        return When(to_ns(value), False) if is_time(value) else When(duration_ns(value), True)
    number: Any = value
    if number != number or number < LENGTHS_BELOW:
        return When(duration_ns(number), True)
    if isinstance(number, Integral) and number < SECONDS_BELOW:
        raise InvalidKey(
            f"{number} is an int, and as a time that is nanoseconds: write seconds since 1970 as "
            f"{number}.0"
        )
    return When(to_ns(number), False)


def _text_to_ns(text: str) -> int:
    """Return the ns since 1970 of a text, see to_ns; it may be outside ROS time."""
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
    """Return the ns since 1970 of a match of _ISO; ValueError: there is no such date or time."""
    day = datetime.strptime(match["date"], "%Y-%m-%d")
    hour, minute, second = (int(match[unit] or 0) for unit in ("hour", "minute", "second"))
    delta = day.replace(hour=hour, minute=minute, second=second) - _EPOCH
    seconds, zone = delta.days * 86_400 + delta.seconds, match["zone"] or "Z"
    if zone not in "Zz":
        digits = zone[1:].replace(":", "").ljust(4, "0")
        if int(digits[2:]) > 59 or int(digits[:2]) > 23:
            raise ValueError(f"{zone} is not a time zone")
        offset = int(digits[:2]) * 3600 + int(digits[2:]) * 60
        seconds += offset if zone[0] == "-" else -offset
    return seconds * SECOND_NS + int((match["fraction"] or "").ljust(9, "0"))


def written_time_ns(text: str) -> int:
    """Return the ns since 1970 of a time as typed in an option or a URL.

    Like to_ns, but a whole number of less than 13 digits means seconds, as in rosbag's options:
    a larger number of seconds is long after the end of ROS time.

    Raises:
        InvalidKey: The text is not a time, or outside 1970 to 2106. The error text lists the forms.
    """
    digits = re.fullmatch(r"\s*([0-9]{1,40})\s*", text)
    try:
        # to_ns takes a Decimal as seconds, a text of digits as ns.
        return to_ns(Decimal(digits[1]) if digits and int(digits[1]) < SECONDS_BELOW else text)
    except InvalidKey as exc:
        raise InvalidKey(
            f"{text[:80]!r} is not a time of ROS: write seconds since 1970 (1368021980 or "
            "1368021980.25), ISO 8601 (2013-05-08T14:06:20Z, no zone means UTC), or nanoseconds, "
            "which are taken for such from 13 digits on"
        ) from exc


def other_unit(value: object, first_ns: int) -> str:
    """Return how an integer of ns is written if it was meant in another unit; '' = it was not.

    Args:
        value: The time as it was given: an int, or its text.
        first_ns: Time of the first stored message, ns. In a simulation it is small, and so are the
            times that are meant in ns.

    Returns:
        The unit and the time in seconds, as 'seconds are written 1368021980.0'.
    """
    if isinstance(value, str):
        text = value.strip()
        value = int(text) if text.isascii() and text.isdigit() and len(text) < 20 else None
    if not isinstance(value, Integral) or not 0 < int(value) < _MOST_UNITS:
        return ""
    number = int(value)
    if first_ns < max(SECONDS_BELOW, 100 * number):
        return ""
    if number < SECONDS_BELOW:
        return f"seconds are written {number}.0"
    name, size = ("milliseconds", 3) if number < 10**14 else ("microseconds", 6)
    return f"{name} are written in seconds, {Decimal(number).scaleb(-size):f}"


def is_iso_text(text: str) -> bool:
    """Return whether a text is a time in ISO 8601."""
    return _ISO.fullmatch(text.strip()) is not None


def is_time(value: object) -> bool:
    """Return whether the type of a value is a time (not a number or text that means one)."""
    return isinstance(value, (genpy.Time, datetime, np.datetime64))


def iso_time(ns: int) -> str:
    """Return ns since 1970 as ISO 8601, like 2013-05-08T14:06:20.123456789Z."""
    seconds, rest = divmod(ns, SECOND_NS)
    return f"{_EPOCH + timedelta(seconds=seconds):%Y-%m-%dT%H:%M:%S}.{rest:09d}Z"
