# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where messages, fields and lists end, to the byte."""

from __future__ import annotations

import struct

import pytest
from messages.random_wire import WireMaker

from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.messages.wire.cql_values import pack_equal, pack_list, split_equal, split_list
from cassandra_ros.messages.wire.field_ends import MAX_SURPLUS, compile_object_check, compile_skip

FIELDS = [
    "uint8[] x",
    "float64[] x",
    "time[] x",
    "bool[3] x",
    "string x",
    "string[] x",
    "string[2] x",
    "Point x",
    "Point[] x",
    "Point[2] x",
    "Named x",
    "Named[] x",
    "Named[2] x",
    "Empty[] x\nuint8 y",
    "string[0] x\nuint8 y",
]
REST = (
    f"\n{'=' * 80}\nMSG: a/Point\nfloat32 x\nfloat32 y\n{'=' * 80}\nMSG: a/Named\nstring name\n"
    f"int16[] values\n{'=' * 80}\nMSG: a/Empty\n"
)


@pytest.mark.parametrize("field", FIELDS)
def test_a_message_ends_where_its_last_byte_is(field):
    definition = parse_definition("a/Test", field + REST)
    skip = compile_skip(definition.type, definition.specs)
    for seed in range(6):
        wire = WireMaker(definition, seed, odd=True).make()
        assert skip(wire, 0) == len(wire)
        assert skip(b"..." + wire + b"...", 3) == 3 + len(wire)
        for end in range(len(wire)):
            with pytest.raises(struct.error):
                skip(wire[:end], 0)


@pytest.mark.parametrize("values", [[b""], [b"a"], [b"", b"bc", b""], [b"abc", b"d"] * 100])
def test_a_list_ends_where_its_last_byte_is(values):
    raw = pack_list(values)
    assert split_list(raw) == values
    for damaged in (*(raw[:end] for end in range(len(raw))), raw + b"\0", raw + raw):
        with pytest.raises(struct.error):
            split_list(damaged)


@pytest.mark.parametrize("count", [1, 2, 50])
def test_a_list_of_equal_sizes_ends_where_its_last_byte_is(count):
    values = [bytes([n, n, n]) for n in range(count)]
    raw = pack_equal(3)(values)
    assert raw == pack_list(values)
    split = split_equal(3)
    assert split(raw) == values
    for damaged in (*(raw[:end] for end in range(len(raw))), raw + b"\0", raw + raw[4:11]):
        with pytest.raises(struct.error):
            split(damaged)


def test_an_empty_list():
    assert split_list(pack_list([])) == split_equal(3)(pack_list([])) == []


def test_as_many_objects_as_a_message_may_have_and_one_more():
    definition = parse_definition("a/Test", "Empty[] x\nEmpty[] y" + REST)
    check = compile_object_check(definition.type, definition.specs)
    most = 8 + MAX_SURPLUS
    check(struct.pack("<II", most - 5, 5))
    for counts in ((most - 5, 6), (most + 1, 0), (0, 2**32 - 1)):
        with pytest.raises(struct.error):
            check(struct.pack("<II", *counts))
