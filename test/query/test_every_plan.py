# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Whatever the plan and the format: the rows are those that plain Python finds.

Thousands of random statements, over messages at the edges of their types and real ones.
"""

from __future__ import annotations

import contextlib
import math
from collections import Counter

import pytest
from conftest import ROOT
from hypothesis import given
from hypothesis import strategies as st
from query.brute_force import KEY, Leaf, Message, Path, Statement, Types, Value, Writer, canonical
from query.kinds import KINDS, T0, Stored, serialized
from query.random_statements import ORDERED, Asker, numbersBeside
from suites import CAMPAIGN, FURTHER, examples, random_statements

from cassandra_ros.messages.connection_header import live_connection

FORMATS = ("ros", "binary", "json", "packed")
PLANS = ("client", "filter", "index")
PLAIN = [(format, plan) for plan in PLANS for format in ("binary", "json")]
"""In the formats without columns for fields a filter has nothing to check but KEY and NODE: there
one way or another is taken."""
PACKED = [("packed", plan) for plan in ("client", "filter", "auto")]
"""In blocks a filter has their zones, and auto as much as any."""
LEAST = 46 if FURTHER else 1
STATEMENTS = examples(170, LEAST)
"""Number of statements of each kind; each has a condition. make test-all asks 506 of 11 kinds."""


def ask(store, statement, params, plan, used):
    """Run a statement in one way, return its rows, and count what the plan made of it."""
    result = store.statements.select(statement, params, plan=plan)
    rows = [tuple(map(canonical, row)) for row in result]
    used["indexed"] += bool(result.pushdown.indexed)
    used["filtered"] += bool(result.pushdown.filtered)
    return rows


def waysOf(seed):
    """List the formats and plans in which one statement is asked."""
    some = [ways[seed % len(ways)] for ways in (PLAIN, PACKED)]
    return [*(("ros", plan) for plan in PLANS), *some]


MARKS = {
    "mixed": [],
    "image": [pytest.mark.suite("campaign", "its statements take four times as long as others")],
}
"""Marks of kinds; without, make test-all asks them: they take longer to store than to ask."""
LATER = [pytest.mark.suite("all", "make test asks fewer kinds of messages")]


@pytest.fixture(params=[pytest.param(name, marks=MARKS.get(name, LATER)) for name in sorted(KINDS)])
def stored(request, rosCas):
    """Messages of one kind, in every format."""
    made = Stored(request.param, ROOT / "examples/data/husky_gps_data.bag")
    with contextlib.ExitStack() as open_ones:
        for format in FORMATS:
            open_ones.enter_context(made.store(rosCas, format))
        made.store = rosCas
        yield made


@pytest.mark.search
# The threads of the driver draw random numbers meanwhile.
@pytest.mark.suite("all", "a search; make test asks single plans")
@pytest.mark.filterwarnings("ignore:Do not use the `random` module inside strategies")
def test_every_plan_finds_what_python_finds(stored, record_property):
    asker = Asker(stored.kind.types, stored.messages, stored.kind.indexes)
    seen = Counter()

    @random_statements(170, repeatable=not CAMPAIGN, least=LEAST)
    @given(asker.statements(), st.integers(0, 2**32))
    def check(statement, seed):
        expected = statement.answer(stored.messages)
        seen["conditions"] += 1
        seen["found"] += bool(expected) and expected[0][0] not in (0, None)
        for format, plan in waysOf(seed):
            writer = Writer(seed)
            text = writer.statement(statement, stored.topic(format))
            found = ask(stored.store, text, writer.params, plan, seen)
            assert found == expected, (plan, text, writer.params)

    check()
    assert seen["conditions"] >= STATEMENTS, seen
    # Many of them find something, and some are the server's to check.
    assert seen["found"] * 6 > seen["conditions"], seen
    assert min(seen["indexed"], seen["filtered"]) * 50 > STATEMENTS, seen
    record_property("told", f"{stored.name}: {dict(seen)}")


EDGES = {
    "f": [0.1, 0.0, -0.0, 1.401298464324817e-45, 3.4028234663852886e38, *(math.inf, -math.inf)],
    "d": [0.1, 0.0, -0.0, 5e-324, 1.7976931348623157e308, math.inf, -math.inf, math.nan],
    "i": [-128, 127, 0, 1, -1],
    "l": [-(2**63), 2**63 - 1, 2**53 + 1, 0],
    "u": [2**64 - 1, 2**63, 2**53 + 1, 0],
}
TYPES = Types("edge_msgs/Edge", "float32 f\nfloat64 d\nint8 i\nint64 l\nuint64 u")


@pytest.mark.suite("all", "make test asks fewer kinds of messages")
def test_every_operator_at_every_edge(rosCas):
    """Few rows, and all pairs of value and operator."""
    header = {"type": TYPES.name, "md5sum": TYPES.md5sum, "message_definition": TYPES.text}
    messages = []
    with rosCas.messageWriter(format="ros") as writer:
        handle = writer.connect(live_connection("/edge", header))
        for n in range(max(map(len, EDGES.values())) + 1):
            wanted = {name: edges[n % len(edges)] for name, edges in EDGES.items()}
            wire = serialized(TYPES.root(**wanted))
            writer.write(handle, T0 + n, n, wire)
            messages.append(Message(T0 + n, "", (0, n), TYPES, TYPES.root().deserialize(wire)))
    for name in EDGES:
        rosCas.getTopic("edge").createIndex(name)
    for name, edges in EDGES.items():
        beside = {repr(v): v for edge in edges for v in (edge, *numbersBeside(edge))}
        for value in [*beside.values(), math.nan, 0.5, 3.4028235e38, 1e39, 2**64, -(10**310)]:
            for sign in ORDERED:
                leaf = Leaf(Path(((name, None),)), sign, (Value(value, "number", (), (value,)),))
                expected = Statement((KEY,), leaf).answer(messages)
                for plan in ("filter", "index"):
                    text = f"select KEY from edge where {name} {sign} ?"
                    assert ask(rosCas, text, [value], plan, Counter()) == expected, (
                        plan,
                        text,
                        value,
                    )
