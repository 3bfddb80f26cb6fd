# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Time buckets: the pure function from a key time to the partition that holds it."""

from __future__ import annotations

from cassandra_ros.keys import SECOND_NS

BUCKET_LENGTHS = tuple(s * SECOND_NS for s in (1, 10, 60, 600, 3600, 6 * 3600, 86400))
MAX_BUCKET_BYTES = 64_000_000
MAX_BUCKET_ROWS = 100_000
SLOT_BUCKETS = 4096
"""Buckets per partition of the directory."""


def bucketFor(rate_hz: float, bytes_per_sec: float, longest_ns: int = BUCKET_LENGTHS[-1]) -> int:
    """Choose the length of a topic's buckets.

    Args:
        rate_hz: Messages a second, >= 0.
        bytes_per_sec: Serialised bytes a second, >= 0.
        longest_ns: Upper bound of the answer, ns; shorter where the rate may still grow.

    Returns:
        The longest of 1 s, 10 s, 1 min, 10 min, 1 h, 6 h, 1 day with at most 64 MB and
        100,000 rows a bucket, in ns; 1 s where none fits.
    """
    for length in reversed(BUCKET_LENGTHS):
        seconds = length / SECOND_NS
        fits = rate_hz * seconds <= MAX_BUCKET_ROWS and bytes_per_sec * seconds <= MAX_BUCKET_BYTES
        if length <= longest_ns and fits:
            return length
    return BUCKET_LENGTHS[0]


def limitForTtl(bucket_ns: int, ttl_sec: int) -> int:
    """Shorten a bucket so that at least 24 of them fit into a TTL (0 = none)."""
    if not ttl_sec:
        return bucket_ns
    fitting = [n for n in BUCKET_LENGTHS if n <= min(bucket_ns, ttl_sec * SECOND_NS // 24)]
    return fitting[-1] if fitting else BUCKET_LENGTHS[0]


def slotOf(bucket: int) -> int:
    """Return the directory partition in which a bucket is listed."""
    return bucket // SLOT_BUCKETS
