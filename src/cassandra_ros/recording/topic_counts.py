# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What became of the messages of each topic: received, stored, lost and why, gaps in numbers."""

from __future__ import annotations

import logging
import struct
import threading
import time
from collections import defaultdict
from dataclasses import dataclass, field, replace
from typing import Iterable, Mapping, Optional, Sequence

from cassandra_ros.recording.losses import LossLog, LossTotal
from cassandra_ros.recording.message_buffer import Feed
from cassandra_ros.tables.registry import LossKind

_log = logging.getLogger(__name__)

REPORT_SEC = 10.0
"""A topic that loses messages is warned of at once, then at most this often."""
MAX_SEQUENCES = 1024
"""Publishers of a topic whose numbers are followed: anonymous ones come without end."""
MIN_STEPS = 4
"""Fewer numbers do not show whether they are those of a counter."""
_NEVER_CAME = (LossKind.NOT_READ, LossKind.UNHEARD)
"""Losses of messages that were never received."""
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
    losses: Mapping[LossKind, LossTotal]
    """Why messages were lost → how many, and when."""
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
    left_out: int = 0
    """Messages that were left out on purpose: by a condition, or above a rate."""
    paused: int = 0
    """Messages that came while their recording was paused."""
    last: float = 0.0
    """When the last message came, by time.monotonic(); 0 = none came."""

    @property
    def reasons(self) -> Mapping[LossKind, int]:
        """Why messages were lost → how many; 0 = the number is not known."""
        return {kind: total.count for kind, total in self.losses.items()}

    @property
    def waiting(self) -> int:
        """Messages that are to be stored, and are neither stored nor lost."""
        lost = sum(n for kind, n in self.reasons.items() if kind not in _NEVER_CAME)
        return self.received - self.left_out - self.paused - self.stored - lost

    def plus(self, later: TopicReport) -> TopicReport:
        """Return one of this and a later run together."""
        losses = dict(self.losses)
        for kind, total in later.losses.items():
            losses[kind] = losses[kind].plus(total) if kind in losses else total
        gaps = [report.gaps for report in (self, later) if report.gaps is not None]
        messages = self.received + later.received
        spans = [(r.received, r.rate_hz) for r in (self, later) if r.rate_hz > 0]
        seconds = sum(received / rate for received, rate in spans)
        return replace(
            self,
            types=tuple(sorted({*self.types, *later.types})),
            received=messages,
            stored=self.stored + later.stored,
            lost=self.lost + later.lost,
            losses=losses,
            gaps=sum(gaps) if gaps else None,
            bytes=self.bytes + later.bytes,
            rate_hz=sum(received for received, _ in spans) / seconds if seconds else 0.0,
            unheard_sec=self.unheard_sec + later.unheard_sec,
            published=self.published or later.published,
            left_out=self.left_out + later.left_out,
            paused=self.paused + later.paused,
            last=max(self.last, later.last),
        )


def merge_reports(runs: Iterable[Sequence[TopicReport]]) -> list[TopicReport]:
    """Return a report for each topic of several runs, in the order of the runs; sorted by name."""
    found: dict[str, TopicReport] = {}
    for reports in runs:
        for report in reports:
            known = found.get(report.topic)
            found[report.topic] = report if known is None else known.plus(report)
    return [found[name] for name in sorted(found)]


@dataclass
class _Topic:
    types: set[str] = field(default_factory=set)
    received: int = 0
    nbytes: int = 0
    first: float = 0.0
    last: float = 0.0
    left_out: int = 0
    paused: int = 0
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
    """Counts by topic. Thread-safe.

    Args:
        losses: Keeps what was lost.
    """

    def __init__(self, losses: LossLog) -> None:
        self._losses = losses
        self._topics: defaultdict[str, _Topic] = defaultdict(_Topic)
        self._mutex = threading.Lock()
        self.total_bytes = 0
        """Serialised bytes of all messages that arrived."""

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
            self.total_bytes += len(wire)

    def attribute(self, topic: str, wire: bytes, feed: Feed) -> None:
        """Note the connection over which a message arrived, and its sequence number."""
        source = feed.source
        with self._mutex:
            counted = self._topics[topic]
            counted.types.add(source.connection.type)
            if source.has_header and len(wire) >= 4:
                number = _sequence(wire, 0)[0]
                counted.sequence(source.connection.callerid).see(number, feed)

    def leave_out(self, topic: str, paused: bool) -> None:
        """Count a message that arrived and is not to be stored."""
        with self._mutex:
            counted = self._topics[topic]
            counted.paused += paused
            counted.left_out += not paused

    def lost(
        self,
        topic: str,
        messages: int,
        kind: LossKind,
        t: int,
        detail: str = "",
        last: Optional[int] = None,
    ) -> None:
        """Count messages that will not be stored.

        Args:
            messages: How many; 0 = nobody knows.
            t, last: When the first and the last of them came, ns; last None = as t.
            detail: A sentence, where the kind does not say it all.
        """
        total = self._losses.add(topic, kind, messages, t, t if last is None else last, detail)
        now = time.monotonic()
        with self._mutex:
            counted = self._topics[topic]
            if not messages or now - counted.warned < REPORT_SEC:
                return
            counted.warned = now
        why = f"{kind.value}: {detail}" if detail else kind.value
        _log.warning("topic %s: %d messages lost so far: %s", topic, total, why)

    def of(self, topic: str) -> int:
        """Return how many messages of a topic arrived."""
        with self._mutex:
            return self._topics[topic].received if topic in self._topics else 0

    def kept(self, topic: str) -> int:
        """Return how many messages of a topic arrived and were not left out."""
        with self._mutex:
            counted = self._topics.get(topic)
            if counted is None:
                return 0
            return counted.received - counted.left_out - counted.paused

    def settle(self, stored: Mapping[str, int], t: int) -> None:
        """Count as lost what is neither stored nor lost: nothing is on its way any more."""
        for report in self.reports(stored):
            if report.waiting > 0:
                self.lost(report.topic, report.waiting, LossKind.AT_END, t)

    def reports(self, stored: Mapping[str, int]) -> list[TopicReport]:
        """Describe all topics, sorted by name, beside the messages that the store acknowledged."""
        with self._mutex:
            return [self._report(name, stored.get(name, 0)) for name in sorted(self._topics)]

    def _report(self, name: str, stored: int) -> TopicReport:
        counted = self._topics[name]
        lost = self._losses.of(name)
        gaps = [s.gaps for s in counted.sequences.values() if s.gaps is not None]
        span = counted.last - counted.first
        return TopicReport(
            topic=name,
            types=tuple(sorted(counted.types)),
            received=counted.received,
            stored=stored,
            lost=sum(total.count for total in lost.values()),
            losses=lost,
            gaps=counted.past_gaps + sum(gaps) if gaps else None,
            bytes=counted.nbytes,
            unheard_sec=counted.unheard,
            rate_hz=(counted.received - 1) / span if span > 0 else 0.0,
            left_out=counted.left_out,
            paused=counted.paused,
            last=counted.last,
        )
