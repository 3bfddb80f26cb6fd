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
from typing import Dict, List, NamedTuple, Optional, Sequence, Tuple

from cassandra_ros.keys import SECOND_NS

TOLERANCE_NS = SECOND_NS // 2
"""How far apart two receivers may have received a message that has equals."""
CERTAIN = 4
"""So many different messages in the same order are no accident, whatever the times say."""
FEW = 8
"""Below so many pairs, equal messages must agree in time within half of the publisher's period."""
NEAREST = 512
"""Maximum number of overlaps that are compared by time."""
PAIRS = 64
"""Number of pairs at the end of an overlap whose median time difference is its cost. One pair alone
chooses a wrong overlap of equal messages when they are received half a period late."""
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
    valid = _overlaps(stored, live)
    if valid:
        best = _best_in_time(valid)
        if _agree(best, stored, live):
            return best.place
        longest = max(valid, key=lambda overlap: overlap.pairs)
        matched = live[longest.other : longest.other + longest.pairs]
        if sure or (longest.pairs >= CERTAIN and _all_differ(matched)):
            return longest.place
    return _scattered(stored, live, sure)


class Live:
    """Messages of a publisher that came live, to tell whether a stored one is among them.

    Args:
        marks: What was heard of it, in order.
        sure: Equal bytes are the same message.
    """

    def __init__(self, marks: Sequence[Mark], sure: bool) -> None:
        self._times: Dict[bytes, List[int]] = {}
        for mark in marks:
            self._times.setdefault(mark.digest, []).append(mark.t)
        self._sure = sure or len(marks) == len(self._times) >= CERTAIN
        self._limit = _limit((), marks)

    def has(self, mark: Mark) -> bool:
        """Say whether a stored message is one of them."""
        times = self._times.get(mark.digest)
        return times is not None and (self._sure or _nearest(times, mark.t) <= self._limit)


class _Overlap(NamedTuple):
    """One way in which both may be the same messages: pairs of equals up to the end of one."""

    place: int
    """Among the stored ones."""
    other: int
    """Among the live ones; one of the two is 0."""
    pairs: int
    cost: float
    """How far the last pairs are apart in time, ns."""


def _overlaps(stored: Sequence[Mark], live: Sequence[Mark]) -> List[_Overlap]:
    """List the possible overlaps; of very many those that agree best in time at their ends."""
    numbers: Dict[bytes, int] = {}
    ours = [numbers.setdefault(mark.digest, len(numbers)) for mark in live]
    theirs = [numbers.setdefault(mark.digest, len(numbers)) for mark in stored]
    # Where the live ones begin among the stored ones, or, with a recorder that came later, the
    # stored ones among the live ones.
    places = [(k, 0) for k in _beginnings(theirs, ours)]
    places += [(0, j) for j in _beginnings(ours, theirs) if j]

    def last_apart(place: Tuple[int, int]) -> int:
        k, j = place
        count = min(len(stored) - k, len(live) - j)
        return abs(stored[k + count - 1].t - live[j + count - 1].t)

    if len(places) > NEAREST:
        # By the last pair: at first a subscriber that is reading the past lags behind.
        places = sorted(places, key=last_apart)[:NEAREST]
    return [_overlap(stored, live, k, j) for k, j in places]


def _overlap(stored: Sequence[Mark], live: Sequence[Mark], k: int, j: int) -> _Overlap:
    count = min(len(stored) - k, len(live) - j)
    last = range(max(0, count - PAIRS), count)
    return _Overlap(k, j, count, median(abs(stored[k + i].t - live[j + i].t) for i in last))


def _beginnings(text: Sequence[int], other: Sequence[int]) -> List[int]:
    """List the places in a text from which on it equals another one, to the end of one of both."""
    lengths = _z_function([*other, -1, *text])[len(other) + 1 :]
    return [k for k, n in enumerate(lengths) if n == min(len(text) - k, len(other))]


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


def _best_in_time(overlaps: Sequence[_Overlap]) -> _Overlap:
    """Choose the one in which the times of reception agree best."""
    return min(overlaps, key=lambda overlap: overlap.cost)


def _agree(overlap: _Overlap, stored: Sequence[Mark], live: Sequence[Mark]) -> bool:
    """Say whether the times alone show that both are the same messages."""
    limit = _limit(stored, live) if overlap.pairs < FEW else TOLERANCE_NS
    return overlap.cost <= limit


def _limit(stored: Sequence[Mark], live: Sequence[Mark]) -> float:
    """Return half the period of a publisher, ns, where it is known and short."""
    steps = [
        after.t - mark.t
        for part in (stored[-PAIRS:], live[:PAIRS])
        for mark, after in zip(part, part[1:])
        if after.t > mark.t
    ]
    return min(TOLERANCE_NS, median(steps) / 2) if steps else TOLERANCE_NS


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
    limit = _limit(stored, live)
    for i, mark in enumerate(stored):
        heard = times.get(mark.digest)
        if heard is not None and (certain or _nearest(heard, mark.t) <= limit):
            return i
    return None


def _nearest(times: Sequence[int], t: int) -> int:
    at = bisect_left(times, t)
    return min(abs(other - t) for other in times[max(0, at - 1) : at + 1])
