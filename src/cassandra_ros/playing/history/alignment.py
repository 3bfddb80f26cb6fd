# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Finds, by their bytes, where the live messages of a publisher begin among its stored ones.

TCPROS does not number messages. A recorder and this subscriber receive the same sequence of one
publisher, each from another message on; so the end of the stored messages equals the beginning of
the live ones. Equal messages allow several overlaps; then the times of reception decide.
"""

from __future__ import annotations

import hashlib
from bisect import bisect_left
from collections import Counter
from statistics import median
from typing import NamedTuple, Sequence

from cassandra_ros.keys import SECOND_NS

TOLERANCE_NS = SECOND_NS // 2
"""Maximum difference of two times of reception of a message that is not unique, ns."""
CERTAIN = 4
"""Number of different messages in the same order that prove an overlap, whatever their times."""
FEW = 8
"""Number of pairs below which times must agree within half of the publisher's period."""
COMPARED_OVERLAPS = 512
"""Maximum number of overlaps that are compared by time."""
PAIRS = 64
"""Number of pairs at the end of an overlap whose median time difference is its cost. One pair alone
chooses a wrong overlap of equal messages when they are received half a period late."""
_INLINE = 32
"""Maximum length of a message that is compared by its bytes, bytes."""


class MessageFingerprint(NamedTuple):
    """The parts of a message that are compared."""

    t: int
    """Time of reception, ns."""
    digest: bytes
    """Bytes of the message, or their digest if there are more than 32."""


def digest_of(wire: bytes) -> bytes:
    """Return the digest of a message's bytes; the bytes themselves if they are few.

    A digest is one byte longer than these, so that it never equals them.
    """
    return wire if len(wire) <= _INLINE else hashlib.blake2b(wire, digest_size=_INLINE + 1).digest()


def first_live(
    stored: Sequence[MessageFingerprint], live: Sequence[MessageFingerprint], sure: bool = False
) -> int | None:
    """Find the first stored message of a publisher that is also among the live ones.

    Args:
        stored: The last stored messages of the publisher, in order; some may be missing.
        live: The received messages of the publisher, in order, complete since the first.
        sure: Whether equal bytes are the same message, because they contain a time or a number.

    Returns:
        Its index in ``stored``; None = no live message is stored yet.
    """
    if not stored or not live:
        return None
    valid = _overlaps(stored, live)
    if valid:
        best = _best_in_time(valid)
        if _agree(best, stored, live):
            return best.stored_at
        longest = max(valid, key=lambda overlap: overlap.pairs)
        matched = live[longest.live_at : longest.live_at + longest.pairs]
        if sure or (longest.pairs >= CERTAIN and _all_differ(matched)):
            return longest.stored_at
    return _first_common(stored, live, sure)


class Live:
    """The live messages of a publisher, with a test whether a stored message is among them.

    Args:
        marks: The received messages, in order.
        sure: Whether equal bytes are the same message.
    """

    def __init__(self, marks: Sequence[MessageFingerprint], sure: bool) -> None:
        self._times: dict[bytes, list[int]] = {}
        """Times of reception by digest, ns, in order."""
        for mark in marks:
            self._times.setdefault(mark.digest, []).append(mark.t)
        self._sure = sure or len(marks) == len(self._times) >= CERTAIN
        self._limit = _limit((), marks)
        """Maximum difference of the times of reception of one message, ns."""

    def has(self, mark: MessageFingerprint) -> bool:
        """Return whether a stored message is one of them."""
        times = self._times.get(mark.digest)
        return times is not None and (self._sure or _nearest(times, mark.t) <= self._limit)


class _Overlap(NamedTuple):
    """A possible overlap of stored and live messages: pairs of equal ones up to the end of one."""

    stored_at: int
    """Index of the first pair in the stored messages."""
    live_at: int
    """Index of the first pair in the live messages; one of the two indexes is 0."""
    pairs: int
    """Number of pairs."""
    cost: float
    """Median difference of the times of the last pairs, ns."""


def _overlaps(
    stored: Sequence[MessageFingerprint], live: Sequence[MessageFingerprint]
) -> list[_Overlap]:
    """Return the possible overlaps, of many the COMPARED_OVERLAPS with the best times."""
    numbers: dict[bytes, int] = {}
    ours = [numbers.setdefault(mark.digest, len(numbers)) for mark in live]
    theirs = [numbers.setdefault(mark.digest, len(numbers)) for mark in stored]
    # Positions of the first live message among the stored ones or, if the recorder started later,
    # of the first stored message among the live ones.
    places = [(k, 0) for k in _beginnings(theirs, ours)]
    places += [(0, j) for j in _beginnings(ours, theirs) if j]

    def last_apart(place: tuple[int, int]) -> int:
        k, j = place
        count = min(len(stored) - k, len(live) - j)
        return abs(stored[k + count - 1].t - live[j + count - 1].t)

    if len(places) > COMPARED_OVERLAPS:
        # By the last pair: a subscriber that reads the past gets its first messages late.
        places = sorted(places, key=last_apart)[:COMPARED_OVERLAPS]
    return [_overlap(stored, live, k, j) for k, j in places]


def _overlap(
    stored: Sequence[MessageFingerprint], live: Sequence[MessageFingerprint], k: int, j: int
) -> _Overlap:
    """Return the overlap that begins with stored message k and live message j."""
    count = min(len(stored) - k, len(live) - j)
    last = range(max(0, count - PAIRS), count)
    return _Overlap(k, j, count, median(abs(stored[k + i].t - live[j + i].t) for i in last))


def _beginnings(text: Sequence[int], other: Sequence[int]) -> list[int]:
    """Return the positions of ``text`` from which it equals ``other``, until one of both ends."""
    lengths = _z_function([*other, -1, *text])[len(other) + 1 :]
    return [k for k, n in enumerate(lengths) if n == min(len(text) - k, len(other))]


def _z_function(text: Sequence[int]) -> list[int]:
    """Return for each position the length of the text from there that equals its beginning.

    For position 0 it is 0. The time is linear in the size (the Z algorithm).
    """
    size = len(text)
    lengths = [0] * size
    left = right = 0
    for i in range(1, size):
        length = min(right - i, lengths[i - left]) if i < right else 0
        while i + length < size and text[length] == text[i + length]:
            length += 1
        lengths[i] = length
        if i + length > right:
            left, right = i, i + length
    return lengths


def _best_in_time(overlaps: Sequence[_Overlap]) -> _Overlap:
    """Return the overlap in which the times of reception agree best."""
    return min(overlaps, key=lambda overlap: overlap.cost)


def _agree(
    overlap: _Overlap, stored: Sequence[MessageFingerprint], live: Sequence[MessageFingerprint]
) -> bool:
    """Return whether the times alone show that both are the same messages."""
    limit = _limit(stored, live) if overlap.pairs < FEW else TOLERANCE_NS
    return overlap.cost <= limit


def _limit(stored: Sequence[MessageFingerprint], live: Sequence[MessageFingerprint]) -> float:
    """Return half the period of a publisher, ns, at most TOLERANCE_NS."""
    steps = [
        after.t - mark.t
        for marks in (stored[-PAIRS:], live[:PAIRS])
        for mark, after in zip(marks, marks[1:])
        if after.t > mark.t
    ]
    return min(TOLERANCE_NS, median(steps) / 2) if steps else TOLERANCE_NS


def _all_differ(marks: Sequence[MessageFingerprint]) -> bool:
    return len({mark.digest for mark in marks}) == len(marks)


def _first_common(
    stored: Sequence[MessageFingerprint], live: Sequence[MessageFingerprint], sure: bool
) -> int | None:
    """Return the index of the first stored message that is live, though some may be missing.

    A filter of the recorder or a full queue may have left messages out. None = no common message.
    """
    times: dict[bytes, list[int]] = {}
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
    """Return the smallest difference of a time to some times, at least one, in order; ns."""
    at = bisect_left(times, t)
    return min(abs(other - t) for other in times[max(0, at - 1) : at + 1])
