# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Lengths of buckets and blocks: chosen by the rate and the size of a topic's messages."""

from __future__ import annotations

from typing import NamedTuple

from cassandra_ros.keys import SECOND_NS

BUCKET_LENGTHS = tuple(s * SECOND_NS for s in (1, 10, 60, 600, 3600, 6 * 3600, 86400))
"""Lengths that a bucket may have, ns, ascending."""
MAX_BUCKET_BYTES = 64_000_000
MAX_BUCKET_ROWS = 100_000
"""Sizes that a bucket should not exceed, because it is a partition: Cassandra slows down with those
of more than 100 MB."""
MAX_BLOCK_MESSAGES = 1024
"""Maximum number of messages in a block."""
MAX_BLOCK_BYTES = 256 * 1024
"""Maximum number of serialised bytes in a block."""
MIN_SPAN_NS = 10_000_000
UNKNOWN_SPAN_NS = 10 * SECOND_NS
"""Minimum time range of a block, ns; and the time range of a block if the rate is unknown, ns."""
BLOCKS_IN_SPAN = 4
"""Number of full blocks in the maximum time range of a block: so blocks are full before it ends."""


class Lengths(NamedTuple):
    """Lengths of buckets and blocks, fixed when a table is made, in ns; 0 = the rate is unknown."""

    bucket_ns: int = 0
    """Length of a bucket, ns."""
    span_ns: int = 0
    """Maximum time range of a block, ns."""
    large: bool = False
    """Whether the messages seen so far are too large to be stored in their rows."""


def bucket_for(rate_hz: float, bytes_per_sec: float, longest_ns: int = BUCKET_LENGTHS[-1]) -> int:
    """Return the length of a topic's buckets.

    Args:
        rate_hz: Messages a second, >= 0.
        bytes_per_sec: Serialised bytes a second, >= 0.
        longest_ns: Maximum length, ns; give a short one if the rate may still grow.

    Returns:
        The longest of 1 s, 10 s, 1 min, 10 min, 1 h, 6 h and 1 day that has at most 64 MB and
        100,000 rows a bucket, in ns; 1 s if all have more.
    """
    for length in reversed(BUCKET_LENGTHS):
        seconds = length / SECOND_NS
        fits = rate_hz * seconds <= MAX_BUCKET_ROWS and bytes_per_sec * seconds <= MAX_BUCKET_BYTES
        if length <= longest_ns and fits:
            return length
    return BUCKET_LENGTHS[0]


def span_for(rate_hz: float, bytes_per_sec: float) -> int:
    """Return the maximum time range of a block of a connection, ns.

    It is the time of four full blocks at this rate of messages and of serialised bytes a second,
    from 10 ms to 1 day; 10 s if the rate is unknown (0).
    """
    if not rate_hz:
        return UNKNOWN_SPAN_NS
    seconds = BLOCKS_IN_SPAN * MAX_BLOCK_MESSAGES / rate_hz
    if bytes_per_sec:
        seconds = min(seconds, BLOCKS_IN_SPAN * MAX_BLOCK_BYTES / bytes_per_sec)
    return int(max(min(seconds * SECOND_NS, BUCKET_LENGTHS[-1]), MIN_SPAN_NS))


def limit_for_ttl(bucket_ns: int, ttl_sec: int) -> int:
    """Return the longest bucket length, at most ``bucket_ns``, of which 24 fit into a TTL.

    It is 1 s if no length is that short.

    Args:
        ttl_sec: 0 = rows do not expire, and the result is ``bucket_ns``.
    """
    if not ttl_sec:
        return bucket_ns
    longest = min(bucket_ns, ttl_sec * SECOND_NS // 24)
    return max((n for n in BUCKET_LENGTHS if n <= longest), default=BUCKET_LENGTHS[0])
