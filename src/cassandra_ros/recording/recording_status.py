# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The status of a running recorder."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Collection, Mapping, Sequence

from cassandra_ros.recording.backlog import OnDisk
from cassandra_ros.recording.topic_counts import TopicReport
from cassandra_ros.stores.copying.quota import QuotaReport

RECORDING, STOPPED, SNAPSHOT, WAITING = "recording", "stopped", "snapshot", "waiting"
"""States of a recorder.

RECORDING: a run is being recorded. STOPPED: no run is being recorded. SNAPSHOT: the newest messages
are kept in memory. WAITING: a run is being recorded into memory because the store has not answered
yet.
"""


@dataclass(frozen=True)
class RecordingStatus:
    """The status of a recorder."""

    state: str
    run: str
    """Name of the run that is being recorded; '' = no run."""
    writer: int
    """Writer id of that run; 0 = no run."""
    topics: Sequence[TopicReport]
    """Counts by topic over all runs of this recorder."""
    subscribed: Collection[str]
    """Topics that are subscribed to."""
    paused: Collection[str]
    """Topics whose recording is paused."""
    held_bytes: int
    """Memory of the messages that wait for the store or are kept for a snapshot, bytes."""
    bound_bytes: int
    """Maximum of that memory, bytes; 0 = no maximum."""
    on_disk: OnDisk = OnDisk()
    """How far the store is behind: messages that wait in the spool."""
    held_sec: float = 0.0
    """In a snapshot: time from the oldest to the newest message in memory, s."""
    held_messages: int = 0
    """In a snapshot: number of messages in memory."""
    quota: QuotaReport | None = None
    """Use of the maximum size of the store; None = it has none, or was not checked yet."""
    held_up: bool = False
    """Whether the run has started in the store, and the store does not answer now."""


class Rates:
    """Messages and bytes per second between the last two calls of ``update``; 0 after the first."""

    def __init__(self) -> None:
        self._before: Mapping[str, tuple[int, int]] = {}
        self._at = 0.0
        self.of: Mapping[str, tuple[float, float]] = {}
        """Messages per second and bytes per second by topic."""

    def update(self, status: RecordingStatus) -> None:
        """Compute the rates from the present status and the one before."""
        now = time.monotonic()
        seconds = max(now - self._at, 1e-3) if self._at else 0.0
        counted = {report.topic: (report.received, report.bytes) for report in status.topics}
        rates = {}
        for topic, (received, nbytes) in counted.items():
            old = self._before.get(topic, (0, 0))
            if seconds:
                rates[topic] = (received - old[0]) / seconds, (nbytes - old[1]) / seconds
            else:
                rates[topic] = 0.0, 0.0
        self.of, self._before, self._at = rates, counted, now

    @property
    def total(self) -> tuple[float, float]:
        """Messages and bytes per second over all topics."""
        rates = self.of.values()
        return sum(rate for rate, _ in rates), sum(nbytes for _, nbytes in rates)
