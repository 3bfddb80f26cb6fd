# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Whatever the plan and the format: the rows are those that plain Python finds.

Thousands of random statements, over messages at the edges of their types and real ones.
"""

from __future__ import annotations

import contextlib
import inspect
from collections import Counter

import pytest
from conftest import ROOT
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from query.brute_force import Writer, canonical
from query.kinds import KINDS, Stored
from query.random_statements import Asker

from cassandra_ros.query import execute

FORMATS = ("ros", "binary", "json")
PLANS = ("client", "filter", "index")
STATEMENTS = int(__import__("os").environ.get("N", 200))
"""Of each kind; with a condition are nine of ten."""


def ask(store, plan, statement, params):
    """Run a statement in one way, and return its rows."""
    chosen = {"plan": plan} if "plan" in inspect.signature(execute).parameters else {}
    return [tuple(map(canonical, row)) for row in execute(store, statement, params, **chosen)]


@pytest.fixture(params=sorted(KINDS))
def stored(request, rosCas):
    """Messages of one kind, in every format."""
    made = Stored(request.param, ROOT / "examples/data/husky_gps_data.bag")
    with contextlib.ExitStack() as open_ones:
        for format in FORMATS:
            open_ones.enter_context(made.store(rosCas, format))
        made.store = rosCas
        yield made


def test_every_plan_finds_what_python_finds(stored):
    asker = Asker(stored.kind.types, stored.messages, stored.kind.indexes)
    seen = Counter()

    @settings(
        max_examples=STATEMENTS,
        derandomize=True,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(asker.statements(), st.integers(0, 2**32))
    def check(statement, seed):
        expected = statement.answer(stored.messages)
        seen["conditions"] += statement.condition is not None
        seen["rows"] += bool(expected) and expected[0][0] not in (0, None)
        for format in FORMATS:
            for plan in PLANS:
                writer = Writer(seed)
                text = writer.statement(statement, stored.topic(format))
                found = ask(stored.store, plan, text, writer.params)
                assert found == expected, (plan, text, writer.params)

    check()
    if STATEMENTS < 200: return
    assert seen["conditions"] * len(KINDS) >= 2000, seen
    # Neither nothing nor everything is found most of the time.
    assert seen["rows"] * 4 > seen["conditions"], seen
