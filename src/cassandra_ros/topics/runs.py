# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The recordings and imports of a keyspace: found by name, what they lost, how they began."""

from __future__ import annotations

import difflib
from datetime import datetime
from typing import FrozenSet, Optional, Sequence, Union

from cassandra_ros.arguments import check_run
from cassandra_ros.errors import RunNotFound
from cassandra_ros.store.registry import Loss, Run
from cassandra_ros.store.run_context import RunContext
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.selection import Nodes, Stretch, spellings

RunName = Union[None, str, int]
"""A run's name, or its writer id as a number or text; None = all runs."""
Writers = Optional[FrozenSet[int]]
"""Writer ids whose messages are meant; None = all."""


class Runs:
    """Finds the runs of one keyspace. Thread-safe."""

    def __init__(self, keyspace: Keyspace) -> None:
        self._keyspace = keyspace

    def find(self, run: Union[str, int]) -> list[Run]:
        """Find the runs of a name, or the one of a writer id; the newest first.

        Raises:
            RunNotFound: There is none; the text gives the nearest names.
            InvalidName: It is no text, and no writer id.
        """
        wanted, every = check_run(run), self._keyspace.registry.runs()
        found = [each for each in every if each.name == wanted and wanted]
        if not found:
            found = [each for each in every if str(each.writer) == str(wanted)]
        if not found:
            raise RunNotFound(self._absent(wanted, every))
        return sorted(found, key=_began, reverse=True)

    def writers(self, run: RunName) -> Writers:
        """Return the writer ids of a run, or of all of its name; raises as find does."""
        return None if run is None else frozenset(each.writer for each in self.find(run))

    def _absent(self, run: RunName, every: Sequence[Run]) -> str:
        names = sorted({each.name or str(each.writer) for each in every})
        near = difflib.get_close_matches(str(run), names, n=3, cutoff=0.5)
        hint = f"did you mean {', '.join(near)}?" if near else f"it holds {len(every)} runs"
        return f"there is no run {run!r:.80} in keyspace {self._keyspace.name}; {hint}"

    def context(self, run: RunName) -> Optional[RunContext]:
        """Return what stood around a run at its start; None where that was not kept."""
        for each in self.find("" if run is None else run):
            found = self._keyspace.registry.get_context(each.writer, each.node)
            if found is not None:
                return found
        return None

    def losses(
        self, topics: Optional[Sequence[str]], stretch: Stretch, nodes: Nodes, run: RunName
    ) -> list[Loss]:
        """List losses that touch a stretch of time; of topics None = of all."""
        writers = self.writers(run)
        if topics is not None:
            topics = [name for topic in topics for name in spellings(topic)]
        return [
            loss
            for loss in self._keyspace.registry.losses(topics)
            if loss.first_ns <= stretch.high and stretch.low <= loss.last_ns
            if nodes is None or loss.node in nodes
            if writers is None or loss.writer in writers
        ]


def _began(run: Run) -> datetime:
    return run.started or datetime.min
