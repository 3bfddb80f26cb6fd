# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is pushed to the server is never stronger than what was asked."""

from __future__ import annotations

import math
import operator
import struct

import numpy
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cassandra_ros.query.plan.pushdown import NEVER, ServerColumn, span_of, ways_of

OPERATORS = {
    "=": operator.eq,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
CODES = {"tinyint": ">b", "smallint": ">h", "int": ">i", "bigint": ">q"}
BITS = {"tinyint": 8, "smallint": 16, "int": 32, "bigint": 64}

numbers = st.one_of(
    st.integers(-(2**70), 2**70),
    st.integers(-300, 300),
    st.floats(),
    st.floats(width=32),
    st.sampled_from([0.0, -0.0, math.inf, -math.inf, math.nan, 10**400, -(10**400), 0.1, 1e39]),
)


def stored(cql_type):
    """Values that a column of this type can hold."""
    if cql_type == "float":
        return st.floats(width=32)
    if cql_type == "double":
        return st.floats()
    if cql_type == "varint":
        return st.one_of(st.integers(0, 2**64 - 1), st.integers(0, 5))
    bits = BITS[cql_type]
    return st.one_of(st.integers(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1), st.integers(-5, 5))


def decode(cql_type, raw):
    if cql_type == "varint":
        return int.from_bytes(raw, "big", signed=True)
    code = {"float": ">f", "double": ">d", **CODES}[cql_type]
    return struct.unpack(code, raw)[0]


def rank(value):
    """Order of Java's Double.compare: -0.0 below 0.0, NaN above all."""
    if isinstance(value, int):
        return (0, value, 0)
    if value != value:
        return (1, 0, 0)
    return (0, value, math.copysign(1, value) if value == 0 else 0)


def serverSays(cql_type, value, ways):
    """Whether Cassandra lets a row with this value through."""
    if ways is None:
        return True
    return any(
        all(
            OPERATORS["=" if sign == "CONTAINS" else sign](rank(value), rank(decode(cql_type, raw)))
            for _, sign, raw in terms
        )
        for terms in ways
    )


@st.composite
def comparisons(draw):
    cql_type = draw(st.sampled_from([*CODES, "varint", "float", "double"]))
    value = draw(stored(cql_type))
    near = [value, -value, numpy.nextafter(value, math.inf), numpy.nextafter(value, -math.inf)]
    if isinstance(value, float) and abs(value) < 3e38:
        near.append(float(numpy.nextafter(numpy.float32(value), numpy.float32(math.inf))))
    asked = draw(st.one_of(numbers, st.sampled_from([n if n == value else float(n) for n in near])))
    return cql_type, value, draw(st.sampled_from(list(OPERATORS))), asked


@given(comparisons())
def test_the_server_leaves_nothing_out_that_matches(case):
    cql_type, value, sign, asked = case
    ways = ways_of(ServerColumn("c", cql_type), sign, [asked])
    if OPERATORS[sign](value, asked):
        assert serverSays(cql_type, value, ways)


@given(comparisons(), st.lists(numbers, max_size=4))
def test_nor_what_is_one_of_many(case, others):
    cql_type, value, _, asked = case
    values = [*others, asked]
    if value in [v for v in values if v == v]:
        held = ServerColumn("c", cql_type)
        assert serverSays(cql_type, value, ways_of(held, "=", values))
        assert serverSays(cql_type, value, span_of(held, values))
        assert serverSays(
            cql_type, value, ways_of(ServerColumn("c", cql_type, True), "CONTAINS", values)
        )


@pytest.mark.parametrize(
    ("cql_type", "sign", "asked"),
    [
        ("tinyint", ">", 127),
        ("tinyint", "=", 128),
        ("int", "=", 5.5),
        ("bigint", "<", -(2**63) - 1),
        ("varint", "=", -1),
        ("double", "=", math.nan),
        ("float", "=", 0.1),
        ("double", "=", 2**53 + 1),
        ("boolean", "=", 2),
    ],
)
def test_what_no_column_can_hold_is_not_looked_for(cql_type, sign, asked):
    assert ways_of(ServerColumn("c", cql_type), sign, [asked]) == NEVER


def test_a_bound_is_pushed_as_narrow_as_the_column_allows():
    ((term,),) = ways_of(ServerColumn("c", "int"), ">", [5.5])
    assert term == ("c", ">=", struct.pack(">i", 6))
    ((term,),) = ways_of(ServerColumn("c", "float"), "<", [0.1])
    assert term == ("c", "<=", struct.pack(">f", 0.1))
    zeros = [struct.pack(">d", zero) for zero in (-0.0, 0.0)]
    assert ways_of(ServerColumn("c", "double"), "=", [0]) == (
        (("c", ">=", zeros[0]), ("c", "<=", zeros[1])),
    )
    for asked, raw in ((True, b"\1"), (False, b"\0"), (1, b"\1"), (0.0, b"\0")):
        assert ways_of(ServerColumn("c", "boolean"), "=", [asked]) == ((("c", "=", raw),),)
    assert ways_of(ServerColumn("c", "double", True), "CONTAINS", [0.0]) == tuple(
        (("c", "CONTAINS", zero),) for zero in zeros
    )


def test_a_text_that_may_be_missing_in_the_column_is_not_pushed():
    held = ServerColumn("c", "text", longest=4)
    assert ways_of(held, "=", ["äb"]) == ((("c", "=", "äb".encode()),),)
    assert ways_of(held, "=", ["äbcd"]) is None
    assert ways_of(held, "=", ["\ud800"]) is None
    assert ways_of(held, "<", ["b"]) is None


@pytest.mark.parametrize("cql_type", [*CODES, "varint"])
def test_integers_at_the_edges_of_their_type(cql_type):
    bits = BITS.get(cql_type)
    low, high = (0, 2**64 - 1) if bits is None else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    for asked in (low - 1, low, low + 1, low + 0.5, high - 1, high, high + 1):
        for sign, compare in OPERATORS.items():
            ways = ways_of(ServerColumn("c", cql_type), sign, [asked])
            for value in (low, low + 1, high - 1, high):
                if compare(value, asked):
                    assert serverSays(cql_type, value, ways), (sign, asked, value)
