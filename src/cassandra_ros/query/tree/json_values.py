# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Values of a result as JSON text, and parameters out of it: what services carry."""

from __future__ import annotations

import base64
import json
import math
from typing import Any

from cassandra_ros.errors import InvalidExpression
from cassandra_ros.query.tree.syntax import DecimalText


def to_json(value: object) -> str:
    """Write one value of a result.

    Times and durations are integer nanoseconds, uint8[] base64 text as in rosbridge, missing
    values null; NaN, Infinity and -Infinity stand as bare words.
    """
    return json.dumps(value, default=_simple)


def json_value(value: object) -> object:
    """Return a value of a result as other programs can read it in JSON.

    As to_json; but NaN, Infinity and -Infinity, which JSON lacks, are None, as in rosbridge.
    """
    if isinstance(value, list):
        return [json_value(element) for element in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value if value is None or isinstance(value, (str, int)) else _simple(value)


def from_json(text: str, name: str = "the value") -> Any:
    """Read a parameter from JSON: a number with all its digits, "text", true, false, or a list.

    Raises:
        InvalidExpression: The text, of what error texts call ``name``, is none of them.
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
