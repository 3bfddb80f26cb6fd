# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""How a recorder stands while it runs."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Collection, Mapping, Sequence, Tuple

from cassandra_ros.recording.topic_counts import TopicReport

RECORDING, STOPPED, SNAPSHOT, WAITING = "recording", "stopped", "snapshot", "waiting"
"""States: a run is being recorded; none is; the newest messages are kept in memory; a run is being
recorded into memory, for the store did not answer yet."""


@dataclass(frozen=True)
class Status:
    """How a recorder stands."""

    state: str
    run: str
    """Name of the run that is being recorded; '' = none."""
    writer: int
    """Its writer id; 0 = none."""
    topics: Sequence[TopicReport]
    """Of all runs of this recorder together."""
    subscribed: Collection[str]
    paused: Collection[str]
    """Topics whose messages are left out for now."""
    held_bytes: int
    """What waits for the store, or is kept for a snapshot."""
    bound_bytes: int
    """0 = no bound."""
    held_sec: float = 0.0
    """In a snapshot: how many seconds are kept."""
    held_messages: int = 0
    """In a snapshot."""


class Rates:
    """Messages and bytes a second, between the last two times that it was told how it stands."""

    def __init__(self) -> None:
        self._before: Mapping[str, Tuple[int, int]] = {}
        self._at = 0.0
        self.of: Mapping[str, Tuple[float, float]] = {}
        """Topic → messages a second, bytes a second."""

    def update(self, status: Status) -> None:
        """Take how it stands now."""
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
    def total(self) -> Tuple[float, float]:
        """Messages and bytes a second over all topics."""
        rates = self.of.values()
        return sum(rate for rate, _ in rates), sum(nbytes for _, nbytes in rates)
