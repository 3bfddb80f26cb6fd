# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Values on the wire of the services."""

from __future__ import annotations

import json
import math

import genpy
import pytest

from cassandra_ros import Stamp
from cassandra_ros.errors import InvalidExpression
from cassandra_ros.query.tree.json_values import from_json, to_json


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (math.nan, "NaN"),
        (math.inf, "Infinity"),
        (-math.inf, "-Infinity"),
        (-0.0, "-0.0"),
        (0.1, "0.1"),
        (2**64 - 1, "18446744073709551615"),
        (True, "true"),
        (None, "null"),
        ('quote " and \n ä \ud800', '"quote \\" and \\n \\u00e4 \\ud800"'),
        (Stamp.from_ns(1_400_000_000_123_456_789), "1400000000123456789"),
        (genpy.Duration(-1, 500_000_000), "-500000000"),
        (b"\0\xff", '"AP8="'),
        ([b"a", [1.5, math.nan]], '["YQ==", [1.5, NaN]]'),
    ],
)
def test_written(value, text):
    assert to_json(value) == text


def test_read():
    assert from_json("5") == 5
    assert from_json('"base_link"') == "base_link"
    assert from_json('[1, "x", true]') == [1, "x", True]
    assert math.isnan(from_json("NaN"))
    assert from_json("-Infinity") == -math.inf
    number = from_json("1400000000.123456789")
    assert (number.text, number) == ("1400000000.123456789", 1400000000.123456789)


@pytest.mark.parametrize("text", ["", "base_link", "{", '{"a": 1}', "null", "[" * 5000, "9" * 9999])
def test_refused(text):
    with pytest.raises(InvalidExpression, match="params"):
        from_json(text, "params[0]")


def test_json_without_bare_words_is_plain_json():
    assert json.loads(to_json([1, "x", None, 0.5])) == [1, "x", None, 0.5]
