# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The interface to a keyspace that this room needs; the caller provides it."""

from __future__ import annotations

from typing import NamedTuple, Protocol, Sequence

from cassandra_ros.places.array_source import ArraySource


class Extent(NamedTuple):
    """A time range in which a run has, or may have, messages in a table."""

    table: str
    writer: int
    """Writer id of the run."""
    low: int
    high: int
    """First and last row key, ns, both included."""


class StoredTopics(Protocol):
    """The topics of a keyspace."""

    def find(self, name: str) -> ArraySource:
        """Return a topic by its name; raises TopicNotFound."""

    def topics(self) -> Sequence[ArraySource]:
        """Return all topics, sorted by name."""

    def nodes(self, topic: ArraySource) -> Sequence[str]:
        """Return the nodeIDs that have messages of a topic, sorted."""

    def extents(self, topic: ArraySource, node: str, low: int, high: int) -> Sequence[Extent]:
        """Return the time ranges of a node's messages of a topic, by run, touching [low, high]."""

    def run_nodes(self, writers: frozenset[int]) -> frozenset[str] | None:
        """Return the nodeIDs of the runs of some writers; None if a writer has no run."""

    def run_text(self, writer: int) -> str:
        """Return the value of RUN for the messages of a writer."""
