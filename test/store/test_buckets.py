# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Lengths of time buckets at their borders."""

from __future__ import annotations

import pytest

from cassandra_ros.arguments import MAX_TTL_SEC, check_ttl
from cassandra_ros.errors import InvalidOption
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.store.tables.lengths import (
    BUCKET_LENGTHS,
    MAX_BUCKET_BYTES,
    MAX_BUCKET_ROWS,
    bucket_for,
    limit_for_ttl,
)

LONGEST = BUCKET_LENGTHS[-1]
PAIRS = list(zip(BUCKET_LENGTHS, BUCKET_LENGTHS[1:]))


@pytest.mark.parametrize(("shorter", "length"), PAIRS)
def test_a_bucket_may_be_filled_to_its_bounds(shorter, length):
    seconds = length // SECOND_NS
    assert bucket_for(MAX_BUCKET_ROWS / seconds, 0.0) == length
    assert bucket_for((MAX_BUCKET_ROWS + 1) / seconds, 0.0) == shorter
    assert bucket_for(0.0, (MAX_BUCKET_BYTES - 1) / seconds) == length
    assert bucket_for(0.0, (MAX_BUCKET_BYTES + 1) / seconds) == shorter
    assert bucket_for(0.0, 0.0, length) == length
    assert bucket_for(0.0, 0.0, length - 1) == shorter


def test_what_fits_no_bucket_has_the_shortest():
    assert bucket_for(1e9, 1e12) == BUCKET_LENGTHS[0]
    assert bucket_for(0.0, 0.0) == LONGEST


@pytest.mark.parametrize(("shorter", "length"), PAIRS)
def test_24_buckets_fit_into_a_ttl(shorter, length):
    ttl_sec = 24 * length // SECOND_NS
    assert limit_for_ttl(LONGEST, ttl_sec) == length
    assert limit_for_ttl(LONGEST, ttl_sec - 1) == shorter
    assert limit_for_ttl(shorter, ttl_sec) == shorter
    assert limit_for_ttl(length, 0) == length


def test_the_shortest_ttl_has_the_shortest_buckets():
    assert limit_for_ttl(LONGEST, 1) == BUCKET_LENGTHS[0]


def test_ends_of_a_ttl():
    assert [check_ttl(ttl) for ttl in (0, 1, MAX_TTL_SEC)] == [0, 1, MAX_TTL_SEC]
    for ttl in (-1, MAX_TTL_SEC + 1, 0.5, True, "1", None):
        with pytest.raises(InvalidOption):
            check_ttl(ttl)
