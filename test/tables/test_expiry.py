# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The lifetimes that rows have left when they are copied into another table."""

from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from cassandra_ros.store.tables.expiry import STEPS, rounded

MAX_TTL = 20 * 365 * 86_400
"""Maximum TTL of Cassandra, s."""
TTLS = st.integers(1, MAX_TTL)


@given(ttl=TTLS, share=st.floats(0, 1))
@example(ttl=2000, share=0.0)
@example(ttl=2000, share=1.0)
@example(ttl=1, share=1.0)
def test_a_lifetime_is_rounded_up_by_less_than_a_hundredth_of_the_ttl(ttl, share):
    """Never down: a row would be gone too early, and with 0 it would stay for ever."""
    lifetime = max(1, round(share * ttl))
    assert lifetime <= rounded(lifetime, ttl) <= ttl
    assert rounded(lifetime, ttl) < lifetime + max(1, ttl // STEPS)


@pytest.mark.parametrize("ttl", [1, 99, 2000, MAX_TTL])
def test_a_row_that_is_about_to_expire_does_not_stay_for_ever(ttl):
    assert 1 <= rounded(0, ttl) == rounded(1, ttl) <= max(1, ttl // STEPS)


@given(ttl=TTLS, lifetimes=st.lists(st.integers(1, MAX_TTL), min_size=1, max_size=500))
def test_there_are_few_different_lifetimes(ttl, lifetimes):
    """Rows are copied in groups of one lifetime each."""
    assert len({rounded(min(lifetime, ttl), ttl) for lifetime in lifetimes}) <= 2 * STEPS
