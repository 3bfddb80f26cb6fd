# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Describe what is stored of each topic: messages, bytes, times, nodes, bucket lengths.

A topic has a line for each type, format and node. Times are UTC and cut to seconds; --yaml
prints them exactly, in nanoseconds. Where messages are found by something else than their receive
time the last column says by what. What should have been recorded and was not is listed with the
reason, also of topics that are not stored; then the latest recordings and imports.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import TYPE_CHECKING, Iterator

from cassandra_ros.cli.answers import add_json_option, print_json
from cassandra_ros.cli.options import (
    add_origin_options,
    add_store_options,
    open_store,
    store_place,
)
from cassandra_ros.cli.text import format_bytes, format_length, format_table, format_time, shown
from cassandra_ros.cli.topic_options import add_topics, stored_topics
from cassandra_ros.cli.verbs.runs import time_of
from cassandra_ros.keys import NAMED_FORMATS

if TYPE_CHECKING:
    from cassandra_ros.store.registry import Loss, LossKind, Run
    from cassandra_ros.topics.totals import TopicInfo

_HEADER = ("topic", "type", "format", "node", "messages", "size", "first", "last", "bucket")
_RIGHT = ("messages", "size", "bucket")
_RUNS_SHOWN = 20


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add topics, the form of the output and the store."""
    add_topics(parser)
    add_origin_options(parser)
    form = parser.add_mutually_exclusive_group()
    form.add_argument("-y", "--yaml", action="store_true", help="print YAML")
    add_json_option(form)
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Print the description."""
    with open_store(options) as ros_cas:
        asked = {"nodeID": options.node_id, "run": options.run}
        topics = stored_topics(ros_cas, options)
        infos = ros_cas.info(topics, **asked)
        losses = ros_cas.losses(topics, **asked)
        runs = sorted(ros_cas.runs(), key=lambda run: str(run.started))
    if options.run:
        runs = [run for run in runs if options.run in (run.name, str(run.writer))]
    if options.yaml or options.json:
        answer = _answer(options, infos, losses, runs)
        (_print_yaml if options.yaml else print_json)(answer)
        return 0
    total = sum(info.count for info in infos)
    size = sum(info.bytes for info in infos)
    names = {info.topic for info in infos}
    hosts, port = store_place(options)
    print(f"keyspace:  {options.keyspace} at {','.join(hosts)}:{port}")
    print(f"messages:  {total} of {len(names)} topics, {format_bytes(size)}")
    if infos:
        print()
        with_keys = any(info.key != "time" for info in infos)
        header = (*_HEADER, "key") if with_keys else _HEADER
        lines = [_topic_row(info)[: len(header)] for info in infos]
        print(format_table(header, lines, right=_RIGHT))
    if losses:
        print()
        columns = ("lost of topic", "node", "run", "messages", "from", "to", "why")
        print(format_table(columns, list(_loss_rows(losses, runs)), right=("messages",)))
    if runs and not options.topics:
        print()
        rows = [_run_row(run) for run in runs[-_RUNS_SHOWN:]]
        columns = ("run", "kind", "node", "started", "state", "messages", "lost")
        print(format_table(columns, rows, right=("messages", "lost")))
        if len(runs) > _RUNS_SHOWN:
            print(f"… and {len(runs) - _RUNS_SHOWN} earlier ones")
    return 0


def _topic_row(info: TopicInfo) -> tuple[str, ...]:
    return (
        shown(info.topic),
        info.type,
        info.format,
        shown(info.node) or "-",
        str(info.count),
        format_bytes(info.bytes),
        format_time(info.first_ns),
        format_time(info.last_ns),
        "-" if info.key in NAMED_FORMATS else format_length(info.bucket_ns),
        info.key,
    )


def _run_row(run: Run) -> tuple[str, ...]:
    return (
        shown(run.name) or "-",
        run.kind,
        shown(run.node) or "-",
        time_of(run.started),
        run.state,
        str(sum(run.stored.values())),
        str(sum(run.lost.values())),
    )


def _loss_rows(losses: list[Loss], runs: list[Run]) -> Iterator[tuple[str, ...]]:
    """Yield a line for each topic, run and reason."""
    names = {run.writer: run.name for run in runs}
    groups: dict[tuple[str, str, int, LossKind], list[Loss]] = {}
    for loss in losses:
        groups.setdefault((loss.topic, loss.node, loss.writer, loss.kind), []).append(loss)
    for (topic, node, writer, kind), group in sorted(groups.items()):
        count = sum(loss.count for loss in group)
        unknown = "" if all(loss.count for loss in group) else "?" if not count else " or more"
        yield (
            shown(topic),
            shown(node) or "-",
            shown(names.get(writer) or str(writer)),
            f"{count or ''}{unknown}",
            format_time(min(loss.first_ns for loss in group)),
            format_time(max(loss.last_ns for loss in group)),
            kind.value,
        )


def _answer(
    options: argparse.Namespace, infos: list[TopicInfo], losses: list[Loss], runs: list[Run]
) -> dict[str, object]:
    return {
        "keyspace": options.keyspace,
        "topics": [asdict(info) for info in infos],
        "losses": [{**asdict(loss), "kind": loss.kind.value} for loss in losses],
        "runs": [
            {**vars(run), **{k: dict(getattr(run, k)) for k in ("labels", "stored", "lost")}}
            for run in runs
        ],
    }


def _print_yaml(answer: object) -> None:
    import yaml

    print(yaml.safe_dump(answer, sort_keys=False, allow_unicode=True), end="")
