# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What became of the messages of each topic: received, stored, lost and why, gaps in numbers."""

from __future__ import annotations

import logging
import struct
import threading
import time
from collections import defaultdict
from dataclasses import dataclass, field
from typing import Mapping, Optional

from cassandra_ros.recording.buffer import Feed

_log = logging.getLogger(__name__)

REPORT_SEC = 10.0
"""A topic that loses messages is warned of at once, then at most this often."""
MAX_REASONS = 5
MAX_SEQUENCES = 1024
"""Publishers of a topic whose numbers are followed: anonymous ones come without end."""
LEFT_OVER = "the recorder ended before they were stored"

MIN_STEPS = 4
"""Fewer numbers do not show whether they are those of a counter."""
_JUMP = 100_000
"""A sequence number that leaps further was set anew, nothing was lost."""
_sequence = struct.Struct("<I").unpack_from


@dataclass(frozen=True)
class TopicReport:
    """One line of the closing table."""

    topic: str
    types: tuple[str, ...]
    received: int
    stored: int
    lost: int
    reasons: Mapping[str, int]
    """Why messages were lost → how many."""
    gaps: Optional[int]
    """Numbers of header.seq that never came here: not sent, or lost on the way to us.

    None = the numbers are not those of a counter.
    """
    bytes: int
    """Serialised bytes received."""
    rate_hz: float
    unheard_sec: float = 0.0
    """How long publishers may have sent what never came here, for the master had forgotten us."""
    published: bool = True
    """Whether something came, or a publisher was connected at some time."""


@dataclass
class _Topic:
    types: set[str] = field(default_factory=set)
    received: int = 0
    nbytes: int = 0
    first: float = 0.0
    last: float = 0.0
    lost: dict[str, int] = field(default_factory=dict)
    warned: float = -REPORT_SEC
    sequences: dict[str, _Sequence] = field(default_factory=dict)
    unheard: float = 0.0
    past_gaps: int = 0
    """Gaps of publishers that are not remembered any more."""

    def sequence(self, callerid: str) -> _Sequence:
        """Return what is known of a publisher; of too many the oldest is forgotten."""
        found = self.sequences.get(callerid)
        if found is None:
            while len(self.sequences) >= MAX_SEQUENCES:
                self.past_gaps += self.sequences.pop(next(iter(self.sequences))).gaps or 0
            found = self.sequences[callerid] = _Sequence()
        return found


@dataclass
class _Sequence:
    """``header.seq`` of one publisher: what is missing between two messages never came here."""

    last: int = 0
    feed: Optional[Feed] = None
    mixed: bool = False
    """The numbers are not those of one counter."""
    steps: int = 0
    leaps: int = 0
    """Steps that left numbers out."""
    missing: int = 0

    @property
    def gaps(self) -> Optional[int]:
        """Numbers that are missing; None where they count nothing."""
        # A bag that was thinned out, or a driver that numbers in ticks, leaps all the time.
        sparse = self.steps >= MIN_STEPS and 2 * self.leaps > self.steps
        return None if self.mixed or sparse else self.missing

    def see(self, number: int, feed: Feed) -> None:
        """Take the number of the next message."""
        if self.feed is not None:
            step = (number - self.last) & 0xFFFFFFFF
            if 0 < step < _JUMP:
                self.steps += 1
                self.leaps += step > 1
                self.missing += step - 1
            elif feed is self.feed:
                # No number, or several counters behind one publisher (a played bag, a relay).
                self.mixed = True
        self.last, self.feed = number, feed


class Counts:
    """Counts by topic. Thread-safe."""

    def __init__(self) -> None:
        self._topics: defaultdict[str, _Topic] = defaultdict(_Topic)
        self._mutex = threading.Lock()

    def expect(self, topic: str) -> None:
        """List a topic from which nothing may come."""
        with self._mutex:
            self._topics[topic]  # makes its line

    def unheard(self, topic: str, seconds: float) -> None:
        """Note that publishers of a topic may have been missed for so long."""
        with self._mutex:
            self._topics[topic].unheard += seconds

    def received(self, topic: str, wire: bytes) -> None:
        """Count a message that arrived."""
        now = time.monotonic()
        with self._mutex:
            counted = self._topics[topic]
            if not counted.received:
                counted.first = now
            counted.last = now
            counted.received += 1
            counted.nbytes += len(wire)

    def attribute(self, topic: str, wire: bytes, feed: Feed) -> None:
        """Note the connection over which a message arrived, and its sequence number."""
        connection = feed.source.connection
        with self._mutex:
            counted = self._topics[topic]
            counted.types.add(connection.type)
            if feed.source.has_header and len(wire) >= 4:
                counted.sequence(connection.callerid).see(_sequence(wire, 0)[0], feed)

    def lost(self, topic: str, messages: int, reason: str) -> None:
        """Count messages that will not be stored."""
        now = time.monotonic()
        with self._mutex:
            counted = self._topics[topic]
            known = reason in counted.lost or len(counted.lost) < MAX_REASONS
            reason = reason if known else "other reasons"
            counted.lost[reason] = counted.lost.get(reason, 0) + messages
            total = sum(counted.lost.values())
            if now - counted.warned < REPORT_SEC:
                return
            counted.warned = now
        _log.warning("topic %s: %d messages lost so far: %s", topic, total, reason)

    def of(self, topic: str) -> int:
        """Return how many messages of a topic arrived."""
        with self._mutex:
            return self._topics[topic].received if topic in self._topics else 0

    def reports(self, stored: Mapping[str, int], final: bool) -> list[TopicReport]:
        """Describe all topics, sorted by name, beside the messages that the store acknowledged.

        ``final``: Nothing is on its way any more: what is neither stored nor lost is lost.
        """
        with self._mutex:
            names = sorted(self._topics)
            return [_report(n, self._topics[n], stored.get(n, 0), final) for n in names]


def _report(name: str, counted: _Topic, stored: int, final: bool) -> TopicReport:
    reasons = dict(counted.lost)
    left = counted.received - stored - sum(reasons.values())
    if final and left > 0:
        reasons[LEFT_OVER] = left
    gaps = [s.gaps for s in counted.sequences.values() if s.gaps is not None]
    span = counted.last - counted.first
    return TopicReport(
        topic=name,
        types=tuple(sorted(counted.types)),
        received=counted.received,
        stored=stored,
        lost=sum(reasons.values()),
        reasons=reasons,
        gaps=counted.past_gaps + sum(gaps) if gaps else None,
        bytes=counted.nbytes,
        unheard_sec=counted.unheard,
        rate_hz=(counted.received - 1) / span if span > 0 else 0.0,
    )
