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
from cassandra_ros.topics.upkeep.run_places import index_places

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
    """Change runs; return them as they are now, see ``Upkeep.setRuns``.

    The name is last, so that after a kill the same call finds what is still to be done.
    """
    registry = catalog.keyspace.registry
    runs = catalog.keyspace.runs.find(run)
    if name is not None:
        check_run_name(name)
    if node is not None:
        check_new_node(node)
    _check_labels(labels)
    _require_ended(catalog, runs, node)
    if node is not None:
        _move(catalog, runs, node, progress)
    keys = {(stored.writer, stored.node if node is None else node) for stored in runs}
    for stored in [stored for stored in registry.runs() if (stored.writer, stored.node) in keys]:
        texts = {**stored.labels, **labels}
        new_labels = {key: text for key, text in texts.items() if text is not None}
        changed = replace(stored, labels=new_labels, name=stored.name if name is None else name)
        if changed != stored:
            registry.put_run(changed)
    all_runs = list_runs(catalog.keyspace, catalog.tables(None), times=True)
    return [stored for stored in all_runs if (stored.writer, stored.node) in keys]


def _check_labels(labels: Mapping[str, str | None]) -> None:
    """Raise InvalidName if a label cannot be set, or removed (None)."""
    # '' stands for a label that is removed: it is a valid text.
    check_labels({key: "" if text is None else text for key, text in dict(labels).items()})
    for key in OWN_LABELS:
        if key in labels:
            raise InvalidName(f"label {key!r} cannot be set: an import finds its run by it")


def _require_ended(catalog: Catalog, runs: Sequence[Run], node: str | None) -> None:
    """Raise SchemaConflict if a run cannot be changed now."""
    all_runs = list_runs(catalog.keyspace, catalog.tables(None))
    states = {(run.writer, run.node): run.state for run in all_runs}
    for run in runs:
        state = states.get((run.writer, run.node))
        subject = f"run {run.name or run.writer!s:.80}"
        if state == "recording":
            raise SchemaConflict(f"{subject} goes on: change it when it has ended")
        if node not in (None, run.node) and run.kind == "import" and state != "ended":
            raise SchemaConflict(
                f"{subject} is an import that was interrupted, and a repetition would not find it "
                "under another robot: import the file again first"
            )


def _move(catalog: Catalog, runs: Sequence[Run], node: str, progress: MoveProgress) -> None:
    """Give runs another robot: first a second entry of each, which tells where its messages are.

    The first entry is deleted when all has moved. So after a kill there are two, and a repetition,
    or a move to yet another robot, finds the messages at both.
    """
    space = catalog.keyspace
    moved = [run for run in runs if run.node != node]
    robots = {(run.writer, run.node): node for run in moved}
    for run in moved:
        space.registry.put_run(replace(run, node=node))
    for topic in catalog.all(None) if moved else ():

        def tell(done: int, total: int, topic_name: str = topic.name) -> None:
            if progress is not None:
                progress(topic_name, done, total)

        move_messages(space, topic.name, robots, tell)
    writers = frozenset(run.writer for run in runs)
    for event in list(space.events.find(whose=Whose(None, writers))):
        if (event.writer, event.node) in robots:
            space.events.move(event, node)
    for run in moved:
        space.registry.move_run(run, node)
    if space.side_tables.has("cr_placed"):
        index_places(catalog, node, writers, None)
