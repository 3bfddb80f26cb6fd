# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""How far the searches go: a part of them in make test, all and more in make campaign.

CASSANDRA_ROS_CAMPAIGN says which: unset in make test; short, with all examples; long, with ten
times as many, and each fault ten times; ci, the tests of make test and of the short campaign in one
run, in which a search runs once, with half of the examples of the short one.
"""

from __future__ import annotations

import os

import pytest
from hypothesis import HealthCheck, settings

ASKED = os.environ.get("CASSANDRA_ROS_CAMPAIGN", "")
EVERYTHING = ASKED == "ci"
"""Whether the tests of make test run, too."""
LENGTH = "short" if EVERYTHING else ASKED
SHARES = {"": 0.25, "ci": 0.5, "short": 1, "long": 10}
"""Share of a search's number of examples that is used, by what is asked."""
FAULTS = {"": 1, "short": 0, "long": 10}
"""How often a test of a fault runs: make test has run it when the short campaign comes."""

if ASKED not in SHARES:
    raise pytest.UsageError(f"CASSANDRA_ROS_CAMPAIGN={ASKED}: it is short, long, ci or unset")


FEW_FORMATS = ("ros", "packed")
"""The formats that make test asks where all formats would take long: one with a column for each
field, one with many messages in a row. The others keep a message as one value."""


def sparing(values, kept):
    """Parametrise with values of which make test asks only those kept, the campaign all."""
    parts = [(value if isinstance(value, tuple) else (value,), value in kept) for value in values]
    return [pytest.param(*part, marks=[pytest.mark.long] * (not here)) for part, here in parts]


def examples(number, least=1):
    """Return the number of examples of a search; ``number`` is that in the short campaign."""
    return max(least, round(number * SHARES[ASKED]))


def random_statements(number, repeatable=True, least=1):
    """Return the settings of a search with this number of random statements."""
    return settings(
        max_examples=examples(number, least),
        derandomize=repeatable,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )


def campaign(number, **options):
    """Make a property test one of the campaign; ``number``: its examples in the short form."""

    def decorate(test):
        limited = settings(max_examples=examples(number), deadline=None, **options)
        return pytest.mark.campaign(limited(test))

    return decorate
