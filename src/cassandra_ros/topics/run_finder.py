# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The runs of a keyspace: found by name or writer id, with their losses and contexts."""

from __future__ import annotations

import difflib
import threading
import time
from datetime import datetime
from typing import Callable, FrozenSet, Sequence, Union

from cassandra_ros.arguments import check_run, spellings
from cassandra_ros.errors import RunNotFound
from cassandra_ros.keys import MAX_WRITER
from cassandra_ros.read import Read, Writers
from cassandra_ros.tables.context_blob import RunContext
from cassandra_ros.tables.registry import Loss, Registry, Run

RunName = Union[None, str, int, FrozenSet[int]]
"""A run's name, its writer id as a number or text, or a set of writer ids; None = all runs."""
FRESH_SEC = 5.0
"""How long the cached name of a writer's run is used, s."""


class Runs:
    """Finds the runs of one keyspace. Thread-safe.

    Args:
        keyspace: Name of the keyspace.
        has_written: Returns whether messages of a writer id are stored; clients without a run have
            a writer id too.
    """

    def __init__(
        self, keyspace: str, registry: Registry, has_written: Callable[[int], bool]
    ) -> None:
        self._name = keyspace
        self._registry = registry
        self._has_written = has_written
        self._texts: dict[int, tuple[str, float]] = {}
        """Writer id → text of its run, and monotonic time until which it is valid, s."""
        self._mutex = threading.Lock()

    def find(self, run: str | int) -> list[Run]:
        """Return the runs with a name, or with a writer id; the newest first.

        Raises:
            RunNotFound: There is no such run; the text has similar names.
            InvalidName: ``run`` is neither a text nor a writer id.
        """
        runs = self._known(check_run(run))
        if not runs:
            raise RunNotFound(self._absent(run))
        return runs

    def _known(self, run: RunName) -> list[Run]:
        every = sorted(self._registry.runs(), key=_began, reverse=True)
        found = [each for each in every if each.name == run and run]
        return found or [each for each in every if str(each.writer) == str(run)]

    def writers(self, run: RunName) -> Writers:
        """Return the writer ids of a run, or of all runs with its name; raises like find."""
        if run is None or isinstance(run, frozenset):
            return run
        writers = frozenset(each.writer for each in self._known(check_run(run)))
        writer = _writer(str(run))
        if not writers and writer is not None and self._has_written(writer):
            writers = frozenset([writer])
        if not writers:
            raise RunNotFound(self._absent(run))
        return writers

    def called(self, text: str) -> frozenset[int]:
        """Return the writer ids for which ``self.text`` returns ``text``."""
        with self._mutex:
            texts = self._learn()  # later calls of text() for single rows agree with this
        writers = {writer for writer, known in texts.items() if known == text}
        writer = _writer(text)
        return frozenset(writers if writer is None or writer in texts else writers | {writer})

    def text(self, writer: int) -> str:
        """Return the name of a writer's run; its id if it has no run or the run has no name."""
        with self._mutex:
            text, until = self._texts.get(writer, ("", 0.0))
            if time.monotonic() > until:
                text = self._learn().get(writer, str(writer))
                # A run is stored before its first message: this one has no run, or is new.
                self._texts[writer] = text, time.monotonic() + FRESH_SEC
            return text

    def _learn(self) -> dict[int, str]:
        """Read the names of the writers' runs; a repeated import may change them."""
        found = {each.writer: each.name or str(each.writer) for each in self._registry.runs()}
        until = time.monotonic() + FRESH_SEC
        self._texts.update((writer, (text, until)) for writer, text in found.items())
        return found

    def _absent(self, run: RunName) -> str:
        runs = self._registry.runs()
        names = sorted({each.name or str(each.writer) for each in runs})
        near = difflib.get_close_matches(str(run), names, n=3, cutoff=0.5)
        hint = f"did you mean {', '.join(near)}?" if near else f"it holds {len(runs)} runs"
        return f"there is no run {run!r:.80} in keyspace {self._name}; {hint}"

    def nodes(self, writers: frozenset[int]) -> frozenset[str] | None:
        """Return the nodeIDs of the runs of some writers; None if a writer has no run."""
        runs = [run for run in self._registry.runs() if run.writer in writers]
        known = {run.writer for run in runs} == writers
        return frozenset(run.node for run in runs) if known and writers else None

    def context(self, run: RunName) -> RunContext | None:
        """Return parameters and node graph at the start of a run; None if they were not stored."""
        newest, *_ = self.find("" if run is None or isinstance(run, frozenset) else run)
        return self._registry.get_context(newest.writer, newest.node)

    def losses(self, topics: Sequence[str] | None, read: Read) -> list[Loss]:
        """Return the losses that meet the time range of a read, of its robots and writers.

        Args:
            topics: Their names; None = all.
            read: Time range, robots and writers.
        """
        time_range, whose = read.time_range, read.whose
        if topics is not None:
            topics = [name for topic in topics for name in spellings(topic)]
        return [
            loss
            for loss in self._registry.losses(topics)
            if loss.first_ns <= time_range.high and time_range.low <= loss.last_ns
            if whose.nodes is None or loss.node in whose.nodes
            if whose.writers is None or loss.writer in whose.writers
        ]


def _began(run: Run) -> datetime:
    return run.started or datetime.min


def _writer(text: str) -> int | None:
    """Return the writer id that a text is, written without leading zeros; None if it is not one."""
    digits = text.isascii() and text.isdigit() and len(text) < 20
    return int(text) if digits and str(int(text)) == text and 0 < int(text) <= MAX_WRITER else None
