# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where the live messages of a publisher begin among the stored ones: found by their bytes.

TCPROS numbers no messages. Two subscribers of one publisher, a recorder and we, hear the same
sequence, each from another point on; so the end of what the one stored is the beginning of what
the other heard. Messages that are equal leave several such places; the times of reception choose.
"""

from __future__ import annotations

import hashlib
from bisect import bisect_left
from collections import Counter
from statistics import median
from typing import Dict, List, NamedTuple, Optional, Sequence

from cassandra_ros.keys import SECOND_NS

TOLERANCE_NS = SECOND_NS // 2
"""How far apart two receivers may have received a message that has equals."""
CERTAIN = 4
"""So many different messages in the same order are no accident, whatever the times say."""
FEW = 8
"""Below so many pairs, equal messages must agree in time within half of the publisher's period."""
NEAREST = 512
PAIRS = 64
_INLINE = 32


class Mark(NamedTuple):
    """What is compared of a message: when it was received, ns, and its bytes or their digest."""

    t: int
    digest: bytes


def digest_of(wire: bytes) -> bytes:
    """Return what stands for the bytes of a message: themselves where they are few."""
    return wire if len(wire) <= _INLINE else hashlib.blake2b(wire, digest_size=_INLINE + 1).digest()


def first_live(stored: Sequence[Mark], live: Sequence[Mark], sure: bool = False) -> Optional[int]:
    """Find the first stored message of a publisher that is also among the live ones.

    Args:
        stored: What a recorder has stored of the publisher lately, in order. Some may be missing.
        live: What we heard of it, in order, nothing missing since the first.
        sure: Equal bytes are the same message: they hold a time or a number.

    Returns:
        Its index; None where nothing that was heard live is stored yet.
    """
    if not stored or not live:
        return None
    lengths = _matches(stored, live)
    valid = [k for k, length in enumerate(lengths) if length == min(len(stored) - k, len(live))]
    if valid:
        best = _best_in_time(stored, live, valid)
        count = lengths[best]
        if _agree(stored, live, best, count):
            return best
        longest = max(valid, key=lengths.__getitem__)
        if sure or (lengths[longest] >= CERTAIN and _all_differ(live[: lengths[longest]])):
            return longest
    return _scattered(stored, live, sure)


def _matches(stored: Sequence[Mark], live: Sequence[Mark]) -> List[int]:
    """Return for each stored message how many from it on equal the live ones from the first on."""
    numbers: Dict[bytes, int] = {}
    text = [numbers.setdefault(mark.digest, len(numbers)) for mark in live]
    text.append(-1)
    text.extend(numbers.get(mark.digest, -2) for mark in stored)
    return _z_function(text)[len(live) + 1 :]


def _z_function(text: Sequence[int]) -> List[int]:
    """Return for each place how long the text from there on equals its own beginning."""
    size = len(text)
    found = [0] * size
    left = right = 0
    for i in range(1, size):
        length = min(right - i, found[i - left]) if i < right else 0
        while i + length < size and text[length] == text[i + length]:
            length += 1
        found[i] = length
        if i + length > right:
            left, right = i, i + length
    return found


def _best_in_time(stored: Sequence[Mark], live: Sequence[Mark], valid: Sequence[int]) -> int:
    """Choose the place where the times of reception agree best."""
    if len(valid) > NEAREST:
        # By the last pair: at first a subscriber that is reading the past lags behind.
        valid = sorted(valid, key=lambda k: _distance(stored, live, k, -1))[:NEAREST]
    return min(valid, key=lambda k: _cost(stored, live, k))


def _distance(stored: Sequence[Mark], live: Sequence[Mark], k: int, pair: int) -> int:
    count = min(len(stored) - k, len(live))
    pair %= count
    return abs(stored[k + pair].t - live[pair].t)


def _cost(stored: Sequence[Mark], live: Sequence[Mark], k: int) -> float:
    """Return how far the last pairs are apart in time, ns."""
    count = min(len(stored) - k, len(live))
    pairs = range(max(0, count - PAIRS), count)
    return float(median(abs(stored[k + i].t - live[i].t) for i in pairs))


def _agree(stored: Sequence[Mark], live: Sequence[Mark], k: int, count: int) -> bool:
    """Say whether the times alone show that both are the same messages."""
    limit = float(TOLERANCE_NS)
    times = [mark.t for mark in live[: PAIRS + 1]] + [mark.t for mark in stored[-PAIRS:]]
    if count < FEW and len(times) > 2:
        steps = [b - a for a, b in zip(times, times[1:]) if b > a]
        limit = min(limit, median(steps) / 2) if steps else limit
    return _cost(stored, live, k) <= limit


def _all_differ(marks: Sequence[Mark]) -> bool:
    return len({mark.digest for mark in marks}) == len(marks)


def _scattered(stored: Sequence[Mark], live: Sequence[Mark], sure: bool) -> Optional[int]:
    """Find the place where one of the two lacks messages: a filter, a queue that was full."""
    times: Dict[bytes, List[int]] = {}
    for mark in live:
        times.setdefault(mark.digest, []).append(mark.t)
    counts = Counter(mark.digest for mark in stored)
    common = sum(digest in times for digest in counts)
    unique = len(times) == len(live) and len(counts) == len(stored)
    certain = sure or (unique and common >= CERTAIN)
    for i, mark in enumerate(stored):
        heard = times.get(mark.digest)
        if heard is not None and (certain or _nearest(heard, mark.t) <= TOLERANCE_NS):
            return i
    return None


def _nearest(times: Sequence[int], t: int) -> int:
    at = bisect_left(times, t)
    return min(abs(other - t) for other in times[max(0, at - 1) : at + 1])
