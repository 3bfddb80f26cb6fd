# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Counts of messages by topic: received, stored, lost by reason, and gaps in sequence numbers."""

from __future__ import annotations

import logging
import struct
import threading
import time
from collections import defaultdict
from dataclasses import dataclass, field, replace
from typing import Iterable, Mapping, Sequence

from cassandra_ros.recording.losses import LossLog, LossTotal
from cassandra_ros.recording.message_buffer import Feed
from cassandra_ros.store.tables.registry import LossKind

_log = logging.getLogger(__name__)

REPORT_SEC = 10.0
"""Minimum time between two warnings that a topic loses messages, s."""
MAX_SEQUENCES = 1024
"""Maximum number of publishers of a topic whose sequence numbers are checked.

Publishers with anonymous names come without end.
"""
MIN_STEPS = 4
"""Minimum number of steps needed to tell whether sequence numbers are those of a counter."""
_NEVER_CAME = (LossKind.NOT_READ, LossKind.UNHEARD)
"""Losses of messages that were never received."""
_JUMP = 100_000
"""Step of a sequence number above which it was reset, so that no message is missing."""
_sequence = struct.Struct("<I").unpack_from


@dataclass(frozen=True)
class TopicReport:
    """The counts of one topic: one line of the table that the recorder prints at its end."""

    topic: str
    types: tuple[str, ...]
    received: int
    stored: int
    lost: int
    losses: Mapping[LossKind, LossTotal]
    """Lost messages by reason."""
    gaps: int | None
    """Number of header.seq values that were not received: not sent, or lost on the way.

    None = the numbers are not those of a counter.
    """
    bytes: int
    """Serialised bytes received."""
    rate_hz: float
    """Mean rate from the first to the last received message, Hz; 0 = not known."""
    unheard_sec: float = 0.0
    """Time in which messages were missed because the master was restarted, or a connection was
    broken, s."""
    published: bool = True
    """Whether a message was received or a publisher was connected at some time."""
    left_out: int = 0
    """Number of messages left out on purpose: by a condition or a maximum rate."""
    paused: int = 0
    """Number of messages received while the recording of the topic was paused."""
    last: float = 0.0
    """Time of reception of the last message, monotonic clock, s; 0 = no message."""
    spooled: int = 0
    """Number of messages that the ended run left in the spool: a later process stores them."""

    @property
    def reasons(self) -> Mapping[LossKind, int]:
        """Number of lost messages by reason; 0 = the number is not known."""
        return {kind: total.count for kind, total in self.losses.items()}

    @property
    def waiting(self) -> int:
        """Number of messages that are to be stored and are neither stored nor lost yet.

        It may be negative, after ``Recording.abandon``: a message that was counted as lost may be
        stored after all.
        """
        lost = sum(n for kind, n in self.reasons.items() if kind not in _NEVER_CAME)
        done = self.stored + self.spooled + lost
        return self.received - self.left_out - self.paused - done

    def plus(self, later: TopicReport) -> TopicReport:
        """Return the report of this and a later run of the same topic together."""
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
            spooled=self.spooled + later.spooled,
            last=max(self.last, later.last),
        )


def merge_reports(runs: Iterable[Sequence[TopicReport]]) -> list[TopicReport]:
    """Return one report for each topic of several runs, sorted by name.

    Args:
        runs: The reports of each run, in the order of the runs.
    """
    merged: dict[str, TopicReport] = {}
    for reports in runs:
        for report in reports:
            earlier = merged.get(report.topic)
            merged[report.topic] = report if earlier is None else earlier.plus(report)
    return [merged[name] for name in sorted(merged)]


@dataclass
class _TopicCount:
    """The counts of one topic, changed under the lock of Counts."""

    types: set[str] = field(default_factory=set)
    received: int = 0
    nbytes: int = 0
    first: float = 0.0
    last: float = 0.0
    """Times of reception of the first and the last message, monotonic clock, s; 0 = no message."""
    left_out: int = 0
    paused: int = 0
    warned: float = -REPORT_SEC
    """Monotonic time at which a loss was logged last, s."""
    sequences: dict[str, _Sequence] = field(default_factory=dict)
    """Sequence numbers by callerid of the publisher."""
    unheard: float = 0.0
    """Time in which publishers may not have been heard, s."""
    spooled: int = 0
    past_gaps: int = 0
    """Number of missing messages of publishers that are not remembered any more."""

    def sequence(self, callerid: str) -> _Sequence:
        """Return the sequence of a publisher; forget the oldest above MAX_SEQUENCES."""
        sequence = self.sequences.get(callerid)
        if sequence is None:
            while len(self.sequences) >= MAX_SEQUENCES:
                self.past_gaps += self.sequences.pop(next(iter(self.sequences))).gaps or 0
            sequence = self.sequences[callerid] = _Sequence()
        return sequence


@dataclass
class _Sequence:
    """The values of ``header.seq`` of one publisher: missing values are messages not received."""

    last: int = 0
    """Number of the last message."""
    feed: Feed | None = None
    """Connection of the last message: over a new one a publisher may begin with any number."""
    mixed: bool = False
    """Whether the numbers are not those of one counter."""
    steps: int = 0
    leaps: int = 0
    """Number of steps that left numbers out."""
    missing: int = 0
    """Number of numbers that were left out."""

    @property
    def gaps(self) -> int | None:
        """Number of missing messages; None if the numbers are not those of a counter."""
        # A thinned bag, or a driver that uses clock ticks, leaves out numbers all the time.
        sparse = self.steps >= MIN_STEPS and 2 * self.leaps > self.steps
        return None if self.mixed or sparse else self.missing

    def see(self, number: int, feed: Feed) -> None:
        """Add the number of the next message."""
        if self.feed is not None:
            step = (number - self.last) & 0xFFFFFFFF
            if 0 < step < _JUMP:
                self.steps += 1
                self.leaps += step > 1
                self.missing += step - 1
            elif feed is self.feed:
                # Not numbered, or several counters in one publisher (a played bag, a relay).
                self.mixed = True
        self.last, self.feed = number, feed


class Counts:
    """The counts of all topics. Thread-safe.

    Args:
        losses: Log of lost messages.
    """

    def __init__(self, losses: LossLog) -> None:
        self._losses = losses
        self._topics: defaultdict[str, _TopicCount] = defaultdict(_TopicCount)
        self._mutex = threading.Lock()
        self.total_bytes = 0
        """Serialised size of all received messages that were not left out, bytes."""
        self.total_messages = 0
        """Number of these messages."""

    def expect(self, topic: str) -> None:
        """List a topic in the reports even if no message of it is received."""
        with self._mutex:
            self._topics[topic]  # makes its line

    def unheard(self, topic: str, seconds: float) -> None:
        """Add a time in which publishers of a topic may not have been heard, s."""
        with self._mutex:
            self._topics[topic].unheard += seconds

    def received(self, topic: str, wire: bytes) -> None:
        """Count a received message."""
        now = time.monotonic()
        with self._mutex:
            counted = self._topics[topic]
            if not counted.received:
                counted.first = now
            counted.last = now
            counted.received += 1
            counted.nbytes += len(wire)
            self.total_bytes += len(wire)
            self.total_messages += 1

    def attribute(self, topic: str, wire: bytes, feed: Feed) -> None:
        """Record the connection and the sequence number of a message, after ``received``."""
        source = feed.source
        with self._mutex:
            counted = self._topics[topic]
            counted.types.add(source.connection.type)
            if source.has_header and len(wire) >= 4:
                number = _sequence(wire, 0)[0]
                counted.sequence(source.connection.callerid).see(number, feed)

    def leave_out(self, topic: str, wire: bytes, paused: bool) -> None:
        """Count a received message that is not to be stored."""
        with self._mutex:
            counted = self._topics[topic]
            self.total_bytes -= len(wire)
            self.total_messages -= 1
            counted.paused += paused
            counted.left_out += not paused

    def lost(
        self,
        topic: str,
        messages: int,
        kind: LossKind,
        t: int,
        detail: str = "",
        last: int | None = None,
    ) -> None:
        """Count messages that will not be stored; warn at most once in REPORT_SEC for a topic.

        Args:
            messages: Number of messages; 0 = not known, which is not logged here.
            t, last: Times of reception of the first and the last of them, ns; last None = t.
            detail: An explanation in addition to the kind; '' = none is needed.
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
        """Return the number of received messages of a topic."""
        with self._mutex:
            return self._topics[topic].received if topic in self._topics else 0

    def kept(self, topic: str) -> int:
        """Return the number of messages of a topic that were received and not left out."""
        with self._mutex:
            counted = self._topics.get(topic)
            if counted is None:
                return 0
            return counted.received - counted.left_out - counted.paused

    def note_spooled(self, spooled: Mapping[str, int]) -> None:
        """Note how many messages by topic the run has left in the spool, when it has ended."""
        with self._mutex:
            for topic, count in spooled.items():
                self._topics[topic].spooled = max(count, 0)

    def count_rest_as_lost(self, stored: Mapping[str, int], t: int) -> None:
        """Count as lost the messages that still wait, at the end.

        A message whose request is still pending may be stored afterwards and is then both.

        Args:
            stored: Number of messages by topic that the store acknowledged.
            t: Time of the losses, ns.
        """
        for report in self.reports(stored):
            if report.waiting > 0:
                self.lost(report.topic, report.waiting, LossKind.AT_END, t)

    def reports(self, stored: Mapping[str, int]) -> list[TopicReport]:
        """Return the reports of all topics, sorted by name.

        Args:
            stored: Number of messages by topic that the store acknowledged.
        """
        with self._mutex:
            return [self._report(name, stored.get(name, 0)) for name in sorted(self._topics)]

    def _report(self, name: str, stored: int) -> TopicReport:
        """Return the report of a topic; the caller holds the lock."""
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
            spooled=counted.spooled,
            last=counted.last,
        )
