# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Values that are compared with a key field: encoded as in messages, in no message, or refused."""

from __future__ import annotations

import math
import struct
from decimal import Decimal

import genpy
import pytest

from cassandra_ros.errors import InvalidKey
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.messages.key_part import KeyPart

NO_MESSAGE = None


def part_of(field_type):
    return KeyPart(parse_definition("p/T", f"{field_type} x"), "x")


@pytest.mark.parametrize(
    ("field_type", "value", "wire"),
    [
        ("bool", True, b"\1"),
        ("int8", -3, b"\xfd"),
        ("uint8", 200, b"\xc8"),
        ("uint16", 65535, b"\xff\xff"),
        ("int32", 7.0, struct.pack("<i", 7)),
        ("uint32", 2**32 - 1, b"\xff" * 4),
        ("int64", -(2**63), struct.pack("<q", -(2**63))),
        ("uint64", 2**64 - 1, b"\xff" * 8),
        ("uint64", 128, struct.pack("<Q", 128)),
        ("float32", 0.1, struct.pack("<f", 0.1)),
        ("float64", Decimal("0.5"), struct.pack("<d", 0.5)),
        ("float64", 0, struct.pack("<d", -0.0)),
        ("string", "Zoë", struct.pack("<I", 4) + "Zoë".encode()),
        ("time", genpy.Time(3, 5), struct.pack("<II", 3, 5)),
        ("time", 1.25, struct.pack("<II", 1, 250_000_000)),
        ("duration", -1, struct.pack("<ii", -1, 999_999_999)),
        ("uint8[]", bytearray(b"ab"), struct.pack("<I", 2) + b"ab"),
        ("int16[2]", (1, -1), struct.pack("<hh", 1, -1)),
        ("string[]", ["a", ""], struct.pack("<IIsI", 2, 1, b"a", 0)),
    ],
)
def test_what_is_asked_for_is_what_the_message_has(field_type, value, wire):
    part = part_of(field_type)
    assert part.encode(value) is not None
    assert part.encode(value) == part.value(wire)


def test_the_text_of_a_time_keeps_its_nanoseconds():
    for field_type in ("time", "duration"):
        part = part_of(field_type)
        wire = struct.pack("<II", 1368021980, 238582676)
        for text in ("1368021980.238582676", "1368021980238582676"):
            assert part.encode(part.from_text(text)) == part.value(wire), text


@pytest.mark.parametrize(
    ("field_type", "value"),
    [
        ("int8", 128),
        ("uint32", 2**63),
        ("int64", 2**63),
        ("uint64", -1),
        ("float32", 1e39),
        ("float64", 10**400),
        ("float64", math.nan),
        ("int16[2]", [1]),
    ],
)
def test_what_no_message_can_have(field_type, value):
    assert part_of(field_type).encode(value) is NO_MESSAGE


@pytest.mark.parametrize(
    ("field_type", "value"),
    [
        *(("bool", value) for value in (1, "true", None)),
        *(("int32", value) for value in (True, 1.5, "1", b"1", None, math.nan, math.inf)),
        *(("float64", value) for value in (False, "0", None, [0.0])),
        *(("string", value) for value in (1, b"a", None, "\ud800")),
        *(("time", value) for value in (True, "1", None, 2**63)),
        *(("int16[]", value) for value in ("ab", b"ab", 1, ["a"], [2**15])),
        *(("string[]", value) for value in ("ab", [1], None)),
    ],
)
def test_what_makes_no_sense(field_type, value):
    with pytest.raises(InvalidKey, match="the key of these messages is their field x"):
        part_of(field_type).encode(value)
