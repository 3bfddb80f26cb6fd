# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Values of results as JSON text, JSON text as parameters, and the limit on an answer's size.

A page ends after the row that reaches the page size. But one row may contain a field a thousand
times, and a message may be as large as the store accepts. Therefore each answer counts its bytes
while it is made, and fails before it takes more than MAX_ANSWER_BYTES.
"""

from __future__ import annotations

import base64
import json
import math
from typing import Any

from cassandra_ros.errors import AnswerTooLarge, InvalidExpression
from cassandra_ros.query.tree.syntax import DecimalText

MAX_ANSWER_BYTES = 64 * 2**20
"""Maximum size of an answer, or of one row of it, bytes."""
_LEAST_ELEMENT_BYTES = 2
"""Minimum size of a number in a row or list as JSON, with the comma after it, bytes."""


def to_json(value: object) -> str:
    """Return one value of a result as JSON text.

    Times and durations are integer nanoseconds, uint8[] base64 text as in rosbridge, missing
    values null. NaN, Infinity and -Infinity are written as bare words.
    """
    return json.dumps(value, default=_simple)


def json_value(value: object) -> object:
    """Return a value of a result as an object for strict JSON.

    Like to_json, but NaN, Infinity and -Infinity, which strict JSON lacks, are None as in
    rosbridge.
    """
    if isinstance(value, list):
        return [json_value(element) for element in value]
    if isinstance(value, dict):
        return {name: json_value(element) for name, element in value.items()}
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value if value is None or isinstance(value, (str, int)) else _simple(value)


def from_json(text: str, name: str = "the value") -> Any:
    """Return a parameter from JSON: an exact number, "text", true, false, or a list.

    Args:
        text: The JSON text.
        name: Name of the parameter in error texts.

    Raises:
        InvalidExpression: The text is not such a value.
    """
    try:
        value = json.loads(text, parse_float=DecimalText, parse_constant=DecimalText)
    except (ValueError, RecursionError) as exc:
        reason = f'is not JSON: {text[:80]!r} (text stands in double quotes: "base_link")'
        raise InvalidExpression(f"{name} {reason}") from exc
    if isinstance(value, dict) or value is None:
        raise InvalidExpression(f"{name} is {text[:80]}; nothing can be compared with that")
    return value


def _simple(value: object) -> object:
    """Return bytes as base64 text, a time or duration as ns; TypeError: another type."""
    if isinstance(value, (bytes, bytearray)):
        return base64.b64encode(value).decode("ascii")
    if hasattr(value, "to_nsec"):
        return int(value.to_nsec())
    raise TypeError(f"{type(value).__name__} cannot be written as JSON")


class AnswerBound:
    """Counter of the bytes of one answer, called before each part of it is made.

    Args:
        what: Name of what becomes too large, as the subject of the error's sentence.
        remedy: What to do instead, as the end of that sentence.

    Attributes:
        bytes: Size of the parts so far, bytes.
    """

    def __init__(self, what: str, remedy: str) -> None:
        self._what, self._remedy = what, remedy
        self.bytes = 0

    def count_part(self, size: int) -> None:
        """Count a part of ``size`` bytes that is about to be made.

        Raises:
            AnswerTooLarge: The answer would have more than MAX_ANSWER_BYTES. The part is not
                counted.
        """
        if self.bytes + size > MAX_ANSWER_BYTES:
            raise self.error()
        self.bytes += size

    def error(self) -> AnswerTooLarge:
        """Return the error for an answer that is too large."""
        limit = f"more than {MAX_ANSWER_BYTES // 2**20} MiB"
        return AnswerTooLarge(f"{self._what} would take {limit}; {self._remedy}")

    def json(self, value: object) -> str:
        """Count a value of a result and return it as JSON text, like to_json.

        Raises as ``count_part``.
        """
        least = least_bytes(value)
        self.count_part(least)
        text = to_json(value)
        self.count_part(max(0, len(text) - least))
        return text


def least_bytes(value: object) -> int:
    """Return the minimum size of a value of a result as text, bytes."""
    if isinstance(value, (str, bytes, bytearray)):
        return len(value)
    if not isinstance(value, list):
        return _LEAST_ELEMENT_BYTES
    # The elements of a list are of one kind, so the first one tells.
    if value and isinstance(value[0], (str, bytes, bytearray, list)):
        return sum(map(least_bytes, value))
    return _LEAST_ELEMENT_BYTES * len(value)
