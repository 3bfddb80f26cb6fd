# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Describe what is stored of each topic: messages, bytes, times, nodes, bucket lengths.

A topic has a line for each type, format and node. Times are UTC and cut to seconds; --yaml
prints them exactly, in nanoseconds. Where messages are found by something else than their receive
time the last column says by what.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import TYPE_CHECKING

from cassandra_ros.cli.options import add_store_options, open_store
from cassandra_ros.cli.text import format_bytes, format_length, format_table, format_time, shown
from cassandra_ros.keys import NAMED_FORMATS

if TYPE_CHECKING:
    from cassandra_ros.store.registry import Run
    from cassandra_ros.topics.totals import TopicInfo

_HEADER = ("topic", "type", "format", "node", "messages", "size", "first", "last", "bucket")
_RIGHT = ("messages", "size", "bucket")
_RUNS_SHOWN = 20


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add topics, the form of the output and the store."""
    parser.add_argument("topics", nargs="*", metavar="TOPIC", help="only these topics")
    parser.add_argument("-y", "--yaml", action="store_true", help="print YAML")
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Print the description."""
    with open_store(options) as ros_cas:
        infos = ros_cas.info(options.topics or None)
        runs = sorted(ros_cas.runs(), key=lambda run: str(run.started))
    if options.yaml:
        _print_yaml(options, infos, runs)
        return 0
    total = sum(info.count for info in infos)
    size = sum(info.bytes for info in infos)
    topics = len({info.topic for info in infos})
    print(f"keyspace:  {options.keyspace} at {options.host}:{options.port}")
    print(f"messages:  {total} of {topics} topics, {format_bytes(size)}")
    if infos:
        print()
        with_keys = any(info.key != "time" for info in infos)
        header = (*_HEADER, "key") if with_keys else _HEADER
        lines = [_topic_row(info)[: len(header)] for info in infos]
        print(format_table(header, lines, right=_RIGHT))
    if runs and not options.topics:
        print()
        rows = [_run_row(run) for run in runs[-_RUNS_SHOWN:]]
        columns = ("run", "kind", "node", "started", "messages", "lost")
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
        f"{run.started:%Y-%m-%dT%H:%M:%SZ}" if run.started else "-",
        str(sum(run.stored.values())) if run.ended else "not ended",
        str(sum(run.lost.values())),
    )


def _print_yaml(options: argparse.Namespace, infos: list[TopicInfo], runs: list[Run]) -> None:
    import yaml

    found = {
        "keyspace": options.keyspace,
        "topics": [asdict(info) for info in infos],
        "runs": [
            {**vars(run), **{k: dict(getattr(run, k)) for k in ("labels", "stored", "lost")}}
            for run in runs
        ],
    }
    print(yaml.safe_dump(found, sort_keys=False, allow_unicode=True), end="")
