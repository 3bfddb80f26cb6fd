# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is pushed to the store: never stronger than the condition."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st
from query.rows import row_of
from std_msgs.msg import Int64
from suites import search

from cassandra_ros.keys import MAX_NS
from cassandra_ros.query.plan.bounds import _unite
from cassandra_ros.read import Read, Whose
from cassandra_ros.topics.query_result import Condition


def bounds(text, params=(), node=None):
    found = Condition(text, params).bounds(read=Read(whose=Whose.of(node)))
    nodes = found.read.whose.nodes
    return *found.read.time_range, nodes and nodes[-1], found.empty, found.whole


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("KEY = 5", (5, 5, None, False, True)),
        ("KEY > 5 and KEY <= 9", (6, 9, None, False, True)),
        ("KEY between 5 and 9 and NODE = 'a'", (5, 9, "a", False, True)),
        ("KEY > 5 and x = 1", (6, MAX_NS, None, False, False)),
        ("KEY > 5 or x = 1", (0, MAX_NS, None, False, False)),
        ("not KEY > 5", (0, MAX_NS, None, False, False)),
        ("KEY != 5", (0, MAX_NS, None, False, False)),
        ("KEY > 9 and KEY < 5", (10, 4, None, True, True)),
        ("KEY < 0", (0, -1, None, True, True)),
        ("KEY > -7 and KEY < infinity", (0, MAX_NS, None, False, True)),
        ("NODE = 'a' and NODE = 'b'", (0, MAX_NS, (), True, True)),
        ("NODE != 'a'", (0, MAX_NS, None, False, False)),
        ("KEY >= 1.5", (1_500_000_000, MAX_NS, None, False, True)),
    ],
)
def test_bounds(text, expected):
    assert bounds(text) == expected


def test_the_node_that_is_asked_for_besides():
    assert bounds("KEY = 5", node="a") == (5, 5, "a", False, True)
    assert bounds("NODE = 'a'", node="a")[2:] == ("a", False, True)
    assert bounds("NODE = 'b'", node="a")[3]


ATOMS = st.one_of(
    st.tuples(
        st.just("KEY"), st.sampled_from(["=", "!=", "<", "<=", ">", ">="]), st.integers(0, 6)
    ).map(lambda parts: "{} {} {}".format(*parts)),
    st.sampled_from(["NODE = 'a'", "NODE = 'b'", "NODE != 'a'", "data = 1", "data != 1"]),
)
CONDITIONS = st.recursive(
    ATOMS,
    lambda inner: st.one_of(
        st.lists(inner, min_size=2, max_size=3).map(lambda c: "(" + " and ".join(c) + ")"),
        st.lists(inner, min_size=2, max_size=3).map(lambda c: "(" + " or ".join(c) + ")"),
        inner.map(lambda c: f"not {c}"),
    ),
    max_leaves=6,
)


@search(300)
@given(CONDITIONS, st.integers(0, 6), st.sampled_from(["", "a", "b"]), st.integers(0, 2))
def test_no_row_that_matches_lies_outside(text, t, node, data):
    row = row_of(Int64(data), t=t, node=node)
    condition = Condition(text)
    found = condition.bounds()
    (low, high), whose = found.read.time_range, found.read.whose
    inside = low <= t <= high and whose.nodes in (None, (node,)) and not found.empty
    matched = condition.test([row.table])(row)
    assert inside or not matched
    if found.whole:
        assert inside == matched


@pytest.mark.parametrize("reverse", [False, True])
def test_time_ranges_of_several_conditions_are_united(reverse):
    numbers = random.Random(7)
    for _ in range(300):
        every = []
        for _ in range(numbers.randrange(2, 4)):
            ends = sorted(numbers.sample(range(30), 2 * numbers.randrange(4)))
            every.append(list(zip(ends[::2], ends[1::2])))
        asked = [lambda low, high, back, s=spans: iter(s[::-1] if back else s) for spans in every]
        found = list(_unite(asked)(0, 30, reverse))
        inside = {t for spans in every for low, high in spans for t in range(low, high + 1)}
        assert {t for low, high in found for t in range(low, high + 1)} == inside
        found = found[::-1] if reverse else found
        assert all(before[1] + 1 < after[0] for before, after in zip(found, found[1:]))
