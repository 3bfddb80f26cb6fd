# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Runs get another name, other labels, or another robot, after they were recorded."""

from __future__ import annotations

from dataclasses import replace
from typing import Callable, Mapping, Optional, Sequence

from cassandra_ros.arguments import check_labels, check_new_node, check_run_name
from cassandra_ros.errors import InvalidName, SchemaConflict
from cassandra_ros.read import Whose
from cassandra_ros.store.tables.registry import OWN_LABELS, Run
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.run_list import list_runs
from cassandra_ros.topics.upkeep.conversion import move_messages
from cassandra_ros.topics.upkeep.run_places import index_places, places_of_runs

MoveProgress = Optional[Callable[[str, int, int], None]]
"""Called with a topic, the number of its messages that are done, and that of all its messages."""


def change_runs(
    catalog: Catalog,
    run: str | int,
    name: str | None,
    node: str | None,
    labels: Mapping[str, str | None],
    progress: MoveProgress,
) -> list[Run]:
    """Change runs; return them as they are now, see ``Upkeep.setRuns``."""
    registry = catalog.keyspace.registry
    writers = frozenset(match.writer for match in catalog.keyspace.runs.find(run))
    if name is not None:
        check_run_name(name)
    if node is not None:
        check_new_node(node)
    for key in labels:
        if key in OWN_LABELS:
            raise InvalidName(f"label {key!r} cannot be set: an import finds its run by it")
    added = check_labels({key: text for key, text in labels.items() if text is not None})
    _require_ended(_listed(catalog, writers), node)
    for stored in [stored for stored in registry.runs() if stored.writer in writers]:
        kept = {key: text for key, text in stored.labels.items() if key not in labels}
        changed = replace(stored, labels={**kept, **added})
        changed = changed if name is None else replace(changed, name=name)
        if changed != stored:
            registry.put_run(changed)
    if node is not None:
        runs = [stored for stored in registry.runs() if stored.writer in writers]
        others = [stored for stored in runs if stored.node != node]
        if others:
            _move(catalog, others, node, progress)
    return _listed(catalog, writers)


def _listed(catalog: Catalog, writers: frozenset[int]) -> list[Run]:
    """Return the runs of some writers with their states."""
    every = list_runs(catalog.keyspace, catalog.tables(None), times=True)
    return [run for run in every if run.writer in writers]


def _require_ended(runs: Sequence[Run], node: str | None) -> None:
    """Raise SchemaConflict if a run cannot be changed now."""
    for run in runs:
        called = f"run {run.name or run.writer!s:.80}"
        if run.state == "recording":
            raise SchemaConflict(f"{called} goes on: change it when it has ended")
        if node not in (None, run.node) and run.kind == "import" and run.state != "ended":
            raise SchemaConflict(
                f"{called} is an import that was interrupted, and a repetition would not find it "
                "under another robot: import the file again first"
            )


def _move(catalog: Catalog, runs: Sequence[Run], node: str, progress: MoveProgress) -> None:
    """Give the messages and events of runs another robot, then the runs with their losses.

    The run is last: until then a repetition finds what is still to be done.
    """
    space = catalog.keyspace
    robots = {(run.writer, run.node): node for run in runs}
    writers = frozenset(run.writer for run in runs)
    is_indexed = any(p.state == "indexed" for p in places_of_runs(catalog, None, writers))
    for topic in catalog.all(None):

        def tell(done: int, total: int, topic_name: str = topic.name) -> None:
            if progress is not None:
                progress(topic_name, done, total)

        move_messages(space, topic.name, robots, tell)
    for event in list(space.events.find(whose=Whose(None, writers))):
        if (event.writer, event.node) in robots:
            space.events.move(event, node)
    for run in runs:
        space.registry.move_run(run, node)
    if is_indexed:
        index_places(catalog, node, writers, None)
