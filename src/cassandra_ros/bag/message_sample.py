# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the first messages of a topic tell: its connections and its median rate, as rosbag info."""

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
    """The first messages of one topic, or those of them that lie in one table."""

    times: list[int] = field(default_factory=list)
    """When they were received, ns, in the order of their keys."""
    found: dict[tuple[str, int], Connection] = field(default_factory=dict)
    """The connections over which they came, by table and their number in it."""

    @property
    def connections(self) -> list[Connection]:
        """The connections, in the order that they have in their bag."""
        return sorted(self.found.values(), key=lambda each: each.number)

    @property
    def frequency(self) -> float | None:
        """Messages a second, by the median of the periods; None where that is 0 or unknown."""
        times = sorted(self.times)
        periods = [later - former for former, later in zip(times, times[1:])]
        middle = statistics.median(periods) if periods else 0
        return SECOND_NS / middle if middle else None


def read_samples(
    topic: CassandraTopic, most: int, node: str | None, run: RunName
) -> dict[str, MessageSample]:
    """Read the first messages of a topic, at most so many, and return those of each table."""
    samples: dict[str, MessageSample] = {}
    for row in topic.rows(nodeID=node, run=run, limit=most, columns=lambda table: ()):
        sample = samples.setdefault(row.table.name, MessageSample())
        sample.times.append(row.received)
        place = (row.table.name, row.conn)
        if place not in sample.found:
            sample.found[place] = row.connection
    return samples


def joined(samples: Iterable[MessageSample]) -> MessageSample:
    """Return the samples of several tables as one."""
    whole = MessageSample()
    for sample in samples:
        whole.times += sample.times
        whole.found.update(sample.found)
    return whole
