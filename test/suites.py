# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What belongs to which suite, and how far the searches of each go.

CASSANDRA_ROS_SUITE names the suite; make sets it.

- test (also where it is unset): every promise once.
- all: that, and what kills, cuts, waits, or starts servers, browsers, other Pythons.
- campaign: the searches with many examples, each fault ten times, and all that test leaves out.

The examples of test and all are the same in each run, so that a failure comes from the change that
is tested; those of the campaign are new in each run.

A test without a mark is in test, and so in all. ``suite("all", reason)`` leaves it to make
test-all, ``suite("campaign", reason)`` to make campaign. ``suite("test", reason)`` says why a test
that takes more than SLOW_SEC is in make test all the same.
"""

from __future__ import annotations

import os
from importlib.metadata import version

import pytest
from hypothesis import HealthCheck, settings

SUITES = ("test", "all", "campaign")
SUITE = os.environ.get("CASSANDRA_ROS_SUITE") or "test"
FURTHER = SUITE != "test"
"""Whether this is more than make test."""
CAMPAIGN = SUITE == "campaign"
SHARE = 10 if CAMPAIGN else 0.1
"""Share of a search's number of examples that is used."""
ROUNDS = 10 if CAMPAIGN else 1
"""How often a test of a fault runs."""
SLOW_SEC = 3.0
"""A test of make test that takes longer without a reason is named at the end, s."""

if SUITE not in SUITES:
    raise pytest.UsageError(f"CASSANDRA_ROS_SUITE={SUITE}: it is one of {', '.join(SUITES)}")


OLD_DUCKDB = version("duckdb").startswith("1.")
"""Whether this Python has DuckDB 1: doc/sql.md says what that does otherwise than DuckDB 2."""

FEW_FORMATS = ("ros", "packed")
"""The formats that make test asks where all formats would take long: one with a column for each
field, one with many messages in a row. The others keep a message as one value."""


def suite_mark(item):
    """Return the mark that says where a test belongs; None = it has no such mark.

    That of one of its parameters counts if it names a larger suite than that of the test; both
    count before that of the module.
    """
    of_test = [mark for mark in item.own_markers if mark.name == "suite"]
    marks = of_test or list(item.iter_markers("suite"))[:1]
    return max(marks, key=lambda mark: SUITES.index(mark.args[0]), default=None)


def runs(item):
    """Return whether a test belongs to this run."""
    mark = suite_mark(item)
    place = "test" if mark is None else mark.args[0]
    if CAMPAIGN:
        return place != "test" or any(map(item.get_closest_marker, ("search", "fault")))
    return SUITES.index(place) <= SUITES.index(SUITE)


def sparing(values, kept, suite="all"):
    """Parametrise with values of which the smaller suites ask only those kept, ``suite`` all."""
    later = pytest.mark.suite(suite, "smaller suites ask others of its kind")
    parts = [(value if isinstance(value, tuple) else (value,), value in kept) for value in values]
    return [pytest.param(*part, marks=[later] * (not here)) for part, here in parts]


def examples(number, least=1):
    """Return the number of examples of a search; the campaign uses ten times ``number``."""
    return max(least, round(number * SHARE))


def random_statements(number, repeatable=True, least=1):
    """Return the settings of a search with this number of random statements.

    Args:
        repeatable: Whether they are the same in each run, in the campaign too.
    """
    return settings(
        max_examples=examples(number, least),
        derandomize=repeatable or not CAMPAIGN,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )


def search(number, **options):
    """Make a property test a search, which make campaign takes further; see examples."""
    # On a busy machine examples take long.
    checks = {HealthCheck.too_slow, *options.pop("suppress_health_check", ())}
    options.update(suppress_health_check=list(checks), deadline=None)

    def decorate(test):
        limited = settings(max_examples=examples(number), **options)
        return pytest.mark.search(limited(test))

    return decorate
