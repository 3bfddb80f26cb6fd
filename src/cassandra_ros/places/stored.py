# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is needed of a keyspace to say where its robots were: whoever has it provides it."""

from __future__ import annotations

from typing import FrozenSet, NamedTuple, Optional, Protocol, Sequence

from cassandra_ros.places.sources import ArraySource


class Extent(NamedTuple):
    """A time range in which a run has, or may have, messages in a table."""

    table: str
    writer: int
    """Of the run."""
    low: int
    high: int
    """Keys, ns, both included."""


class Stored(Protocol):
    """The topics of a keyspace."""

    def find(self, name: str) -> ArraySource:
        """Return a topic by its name; raises TopicNotFound."""

    def topics(self) -> Sequence[ArraySource]:
        """List all topics, sorted by name."""

    def nodes(self, topic: ArraySource) -> Sequence[str]:
        """List the nodeIDs that have messages of a topic, sorted."""

    def extents(self, topic: ArraySource, node: str, low: int, high: int) -> Sequence[Extent]:
        """List when runs of a node have messages of a topic, as far as that touches [low, high]."""

    def run_nodes(self, writers: FrozenSet[int]) -> Optional[FrozenSet[str]]:
        """Return the nodeIDs of the runs of some writers; None where a writer has no run."""

    def run_text(self, writer: int) -> str:
        """Return what RUN says of the messages of a writer."""
