# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Start and end of what is played: seconds from the first message, as in rosbag, or dates."""

from __future__ import annotations

import re
from decimal import Decimal, InvalidOperation
from typing import Union

from cassandra_ros.errors import InvalidKey, InvalidOption
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.stamps import (
    LENGTHS_BELOW,
    SECONDS_BELOW,
    Length,
    Time,
    When,
    duration_ns,
    iso_time,
    other_unit,
    time_or_length,
    to_ns,
)
from cassandra_ros.read import TimeRange

PlayTime = Union[None, Time, Length]
"""A date, or a length from the first message: a text or number below 10**9 is seconds. None =
not limited."""

_NUMBER = re.compile(r"\s*([0-9]{1,40}(?:\.[0-9]*)?|\.[0-9]+)\s*")


def read_when(name: str, value: PlayTime) -> When | None:
    """Read the time of an option; None = the option is not given.

    Args:
        name: Name of the option, for errors.
        value: Seconds from the first message as a number below 10**9; a genpy.Duration or
            timedelta from the first message; any other value is a time as for a key. As text, as
            for rosbag: below 10**9 seconds from the first message; below 10**12 or with a decimal
            point seconds since 1970; above nanoseconds since 1970; or ISO 8601.

    Raises:
        InvalidOption: The value cannot be read, is negative, or is after 2106.
    """
    if value is None:
        return None
    try:
        if not isinstance(value, str):
            return time_or_length(value)
        number = _number(value)
        if number is None:
            return When(to_ns(value), False)
        if number < LENGTHS_BELOW:
            return When(duration_ns(number), True)
        whole = number == int(number) and number >= SECONDS_BELOW
        return When(to_ns(int(number) if whole else number), False)
    except (InvalidKey, InvalidOperation, ValueError, OverflowError) as exc:
        raise InvalidOption(
            f"{name} {value!r:.80} is not a time to play: write seconds from the first message "
            "(12.5), seconds since 1970 (1368021980.25), nanoseconds since 1970 (from 13 digits "
            "on) or ISO 8601 (2013-05-08T14:06:20Z, no zone means UTC)"
        ) from exc


def check_length(name: str, seconds: object) -> int | None:
    """Return an option given in seconds as ns, None if it is not given, or raise InvalidOption."""
    if seconds is None:
        return None
    try:
        return duration_ns(_number(seconds) if isinstance(seconds, str) else seconds)
    except InvalidKey as exc:
        raise InvalidOption(f"{name} {seconds!r:.80} is not a number of seconds from 0 on") from exc


def _number(text: str) -> Decimal | None:
    """Return the number in a text; None if the text is not a number but, say, an ISO 8601 time."""
    match = _NUMBER.fullmatch(text)
    return None if match is None else Decimal(match[1])


def resolve_times(
    received: TimeRange, start: When | None, end: When | None, duration_ns: int | None
) -> TimeRange:
    """Return the time range that is played of the messages in the time range ``received``.

    Returns:
        It begins at the start, or at the first message if no start is given. It ends at the end,
        after the duration, or at the last message.

    Raises:
        InvalidOption: The start lies before the first message or after the last one, or the end
            before the first message or before the start.
    """
    low, high = received
    if start is not None:
        low = _time_of(received, start)
        if low < received.low:
            raise InvalidOption(f"the start, {_too_early(received, start)}")
        if low > received.high:
            raise InvalidOption(
                f"the start, {_when_text(received, start)}, lies after {_reach(received)}"
            )
    if end is not None:
        high = _time_of(received, end)
        if high < received.low:
            raise InvalidOption(f"the end, {_too_early(received, end)}")
        if high < low:
            raise InvalidOption(
                f"the end, {iso_time(high)}, lies before the start, {iso_time(low)}: exchange them"
            )
    if duration_ns is not None:
        high = min(high, low + duration_ns)
    return TimeRange(low, min(high, received.high))


def _time_of(received: TimeRange, when: When) -> int:
    """Return a time, or one that is relative to the first message, ns."""
    return when.ns + received.low if when.relative else when.ns


def _when_text(received: TimeRange, when: When) -> str:
    return f"{when.ns / SECOND_NS:g} s" if when.relative else iso_time(when.ns)


def _too_early(received: TimeRange, when: When) -> str:
    """Return that a time lies before all messages, and what may have been meant, as text."""
    meant = other_unit(when.ns, received.low)
    text = f"{iso_time(_time_of(received, when))}, lies before {_reach(received)}"
    return f"{text}; {meant}" if meant else text


def _reach(received: TimeRange) -> str:
    seconds = (received.high - received.low) / SECOND_NS
    return (
        f"all selected messages, which were received from {iso_time(received.low)} to "
        f"{iso_time(received.high)} ({seconds:g} s)"
    )
