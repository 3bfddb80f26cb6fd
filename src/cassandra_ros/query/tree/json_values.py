# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Conversion of result values to JSON text, and of JSON text to parameters, for services."""

from __future__ import annotations

import base64
import json
import math
from typing import Any

from cassandra_ros.errors import InvalidExpression
from cassandra_ros.query.tree.syntax import DecimalText


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
    if isinstance(value, (bytes, bytearray)):
        return base64.b64encode(value).decode("ascii")
    if hasattr(value, "to_nsec"):
        return int(value.to_nsec())
    raise TypeError(f"{type(value).__name__} cannot be written as JSON")
