# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The runs of a keyspace: found by name or writer id, with their losses and contexts."""

from __future__ import annotations

import difflib
import logging
import os
import threading
import time
from datetime import datetime
from typing import Callable, Collection, FrozenSet, Iterable, Sequence, Union

from cassandra_ros.arguments import check_run, spellings
from cassandra_ros.errors import RunNotFound
from cassandra_ros.keys import MAX_WRITER
from cassandra_ros.read import Read, Writers
from cassandra_ros.store.tables.context_blob import RunContext
from cassandra_ros.store.tables.registry import Loss, Registry, Run

_log = logging.getLogger(__name__)

RunName = Union[None, str, int, FrozenSet[int]]
"""A run's name, its writer id as a number or text, the path of the file from which it was imported
or of the folder of such files, or a set of writer ids; None = all runs."""
_MOST_NAMED = 3
"""Maximum number of runs named in a text."""
RUN_NAME_CACHE_SEC = 5.0
"""How long the cached name of a writer's run is used, s."""


class Runs:
    """Finds the runs of one keyspace. Thread-safe.

    Args:
        keyspace: Name of the keyspace.
        has_written: Returns whether messages of a writer id are stored; clients without a run have
            a writer id too.
        robots: Returns the nodeIDs that have messages; clients without a run have one too.
    """

    def __init__(
        self,
        keyspace: str,
        registry: Registry,
        has_written: Callable[[int], bool],
        robots: Callable[[], Iterable[str]],
    ) -> None:
        self._name = keyspace
        self._registry = registry
        self._has_written = has_written
        self._robots = robots
        self._seen_robots: set[str] = set()
        """Robots that are known to have runs or messages; they are not looked for again."""
        self._told_robots: set[str] = set()
        """Robots of which a warning was given."""
        self._texts: dict[int, tuple[str, float]] = {}
        """Writer id → text of its run, and monotonic time until which it is valid, s."""
        self._mutex = threading.Lock()

    def find(self, run: str | int) -> list[Run]:
        """Return the runs with a name, a writer id, or an imported file; the newest first.

        Raises:
            RunNotFound: There is no such run; the text has similar names.
            InvalidName: ``run`` is neither a text nor a writer id.
        """
        runs = self._matches(check_run(run))
        if not runs:
            raise RunNotFound(self._absent(run))
        return runs

    def _matches(self, run: RunName) -> list[Run]:
        """Return the runs that are meant, the newest first; empty if no run is meant.

        They are found by name, else by writer id, else by file, else by its folder. '' is no name.
        """
        runs = sorted(self._registry.runs(), key=_began, reverse=True)
        text = str(run)
        for matches in (
            [other for other in runs if other.name == run and run],
            [other for other in runs if str(other.writer) == text],
            [other for other in runs if os.sep in text and other.source == _absolute(text)],
            [other for other in runs if os.sep in text and _folder(other) == _absolute(text)],
        ):
            if matches:
                return matches
        return []

    def describe_several(self, run: str) -> str:
        """Say which runs a name means; '' = not several."""
        runs = self._matches(run)
        return describe_runs(runs) if len(runs) > 1 else ""

    def writers(self, run: RunName) -> Writers:
        """Return the writer ids of a run, or of all runs with its name; raises like find.

        The id of a client without a run is found, too, if it has stored messages.
        """
        if run is None or isinstance(run, frozenset):
            return run
        writers = frozenset(other.writer for other in self._matches(check_run(run)))
        writer = _writer(str(run))
        if not writers and writer is not None and self._has_written(writer):
            writers = frozenset([writer])
        if not writers:
            raise RunNotFound(self._absent(run))
        return writers

    def robots(self, writer: int) -> list[str]:
        """Return the nodeIDs of a writer's run: several while it gets another one."""
        return [run.node for run in self._registry.runs() if run.writer == writer]

    def called(self, text: str) -> frozenset[int]:
        """Return the writer ids for which ``self.text`` returns ``text``, also without messages."""
        with self._mutex:
            texts = self._learn()  # later calls of text() for single rows agree with this
        writers = {writer for writer, run_text in texts.items() if run_text == text}
        writer = _writer(text)
        return frozenset(writers if writer is None or writer in texts else writers | {writer})

    def unknown(self, text: str) -> str:
        """Say that no run has this value of RUN, with similar ones; '' = one has it.

        A client without a run has its writer id as value, if it has stored messages.
        """
        writers = self.called(text)
        named = [run for run in self._registry.runs() if run.writer in writers]
        if named or any(map(self._has_written, writers)):
            return ""
        return self._absent(text)

    def unknown_robot(self, node: str) -> str:
        """Say that no run and no message is of a robot, with similar names; '' = one is.

        It is also '' if nothing is stored of any robot.
        """
        if node in self._seen_robots:
            return ""
        names = {run.node for run in self._registry.runs()}
        if node not in names:
            names.update(self._robots())
        self._seen_robots |= names
        if node in names or not names:
            return ""
        where = f"no message in keyspace {self._name} is of robot {node!r:.80}"
        return f"{where}; {_similar(node, names - {''}, 'robots')}"

    def check_robot(self, node: str | None) -> None:
        """Warn once of a robot that has no run and no messages; None = all robots."""
        if node is None or node in self._told_robots:
            return
        reason = self.unknown_robot(node)
        if reason:
            self._told_robots.add(node)
            _log.warning("%s", reason)

    def text(self, writer: int) -> str:
        """Return the name of a writer's run; its id if it has no run or the run has no name."""
        with self._mutex:
            text, until = self._texts.get(writer, ("", 0.0))
            if time.monotonic() > until:
                text = self._learn().get(writer, str(writer))
                # A run is stored before its first message: this one has no run, or is new.
                self._texts[writer] = text, time.monotonic() + RUN_NAME_CACHE_SEC
            return text

    def _learn(self) -> dict[int, str]:
        """Read the names of the writers' runs, and cache them; the caller holds the mutex.

        They are read again and again because a repeated import may change them.
        """
        texts = {run.writer: run.name or str(run.writer) for run in self._registry.runs()}
        until = time.monotonic() + RUN_NAME_CACHE_SEC
        self._texts.update((writer, (text, until)) for writer, text in texts.items())
        return texts

    def _absent(self, run: RunName) -> str:
        """Return the error text for a run that is not stored, with those that may be meant."""
        text, runs = str(run), self._registry.runs()
        where = f"there is no run {run!r:.80} in keyspace {self._name}"
        base = os.path.basename(text)
        alike = [
            other
            for other in runs
            if base and base in (other.name, str(other.writer), os.path.basename(other.source))
        ]
        if len(alike) > 1:
            return f"{where}; did you mean one of these: {_describe(alike)}?"
        for other in alike:
            return f"{where}; did you mean {other.name or other.writer}, run {other.writer}?"
        names = {other.name or str(other.writer) for other in runs}
        return f"{where}; {_similar(text, names, 'runs')}"

    def nodes(self, writers: frozenset[int]) -> frozenset[str] | None:
        """Return the nodeIDs of the runs of some writers; None if a writer has no run."""
        runs = [run for run in self._registry.runs() if run.writer in writers]
        has_runs = {run.writer for run in runs} == writers
        return frozenset(run.node for run in runs) if has_runs and writers else None

    def context(self, run: RunName) -> RunContext | None:
        """Return parameters and node graph at the start of a run; None if they were not stored.

        Of several runs with its name the newest is taken.

        Raises:
            RunNotFound, InvalidName: As ``find``; also if ``run`` is None or a set of ids.
        """
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


def describe_runs(runs: Sequence[Run]) -> str:
    """Tell apart, in words, runs that have the name of the first."""
    return f"{len(runs)} runs are called {runs[0].name}: {_describe(runs)}"


def _describe(runs: Sequence[Run]) -> str:
    """Return ids, robots and sources of the first _MOST_NAMED runs as a list in words."""
    descriptions = [
        f"{run.writer}{f' of robot {run.node}' if run.node else ''}"
        + (f" (from {run.source})" if run.source else "")
        for run in runs[:_MOST_NAMED]
    ]
    if len(runs) > _MOST_NAMED:
        descriptions.append(f"{len(runs) - _MOST_NAMED} more, see 'cassandra_bag runs'")
    return ", ".join(descriptions)


def _similar(name: str, names: Collection[str], what: str) -> str:
    """Return a hint with the known names that are similar, or that there are few, or how many."""
    lowered = {other.lower(): other for other in sorted(names)}
    near = difflib.get_close_matches(name.lower(), lowered, n=_MOST_NAMED, cutoff=0.5)
    if near:
        return f"did you mean {', '.join(lowered[other] for other in near)}?"
    if 0 < len(names) <= _MOST_NAMED:
        return f"it holds the {what} {', '.join(sorted(names))}"
    return f"it holds {len(names)} {what}"


def _absolute(path: str) -> str:
    """Return the path of a file as it is stored with its run."""
    return os.path.abspath(path) if "\0" not in path else path


def _folder(run: Run) -> str:
    """Return the folder of the file from which a run was imported; '' = it was recorded."""
    return os.path.dirname(run.source) if run.kind == "import" else ""


def _began(run: Run) -> datetime:
    """Return the start of a run for sorting; a run without one is the oldest."""
    return run.started or datetime.min


def _writer(text: str) -> int | None:
    """Return the writer id that a text is, written without leading zeros; None if it is not one."""
    digits = text.isascii() and text.isdigit() and len(text) < 20
    return int(text) if digits and str(int(text)) == text and 0 < int(text) <= MAX_WRITER else None
