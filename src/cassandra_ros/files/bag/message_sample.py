# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Connections and median rate of a topic, computed from its first messages as rosbag info does."""

from __future__ import annotations

import statistics
from dataclasses import dataclass, field
from typing import Iterable

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.topics.cassandra_topic import CassandraTopic
from cassandra_ros.topics.run_finder import RunName


@dataclass
class MessageSample:
    """The first messages of one topic, or of one of its tables."""

    times: list[int] = field(default_factory=list)
    """Receive times of the messages, ns, in the order of their keys."""
    connection_of: dict[tuple[str, int], Connection] = field(default_factory=dict)
    """Connections of the messages, by table name and ``_conn``."""

    @property
    def connections(self) -> list[Connection]:
        """The connections, sorted by their number in the bag."""
        return sorted(self.connection_of.values(), key=lambda connection: connection.number)

    @property
    def frequency(self) -> float | None:
        """Rate of the messages, Hz: 1 / median period; None if the period is 0 or unknown."""
        times = sorted(self.times)
        periods = [later - former for former, later in zip(times, times[1:])]
        middle = statistics.median(periods) if periods else 0
        return SECOND_NS / middle if middle else None


def read_samples(
    topic: CassandraTopic, most: int, node: str | None, run: RunName
) -> dict[str, MessageSample]:
    """Return a sample for each table of a topic that the first messages are in, by its name.

    Args:
        most: Maximum number of messages of the topic; only their keys are read.
        node: nodeID of the robot; None = all.
        run: The run; None = all.
    """
    samples: dict[str, MessageSample] = {}
    for row in topic.rows(nodeID=node, run=run, limit=most, columns=lambda table: ()):
        sample = samples.setdefault(row.table.name, MessageSample())
        sample.times.append(row.received)
        key = (row.table.name, row.conn)
        if key not in sample.connection_of:  # row.connection may ask the store
            sample.connection_of[key] = row.connection
    return samples


def join_samples(samples: Iterable[MessageSample]) -> MessageSample:
    """Return one sample with the messages of several samples."""
    whole = MessageSample()
    for sample in samples:
        whole.times += sample.times
        whole.connection_of.update(sample.connection_of)
    return whole
