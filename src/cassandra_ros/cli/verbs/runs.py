# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""List the recordings and imports: name, robot, times, state, how much they stored and lost.

What --run takes is in the column run: a name, which several may bear, or where there is none the
writer id; that stands in the column id. Start and end are when it was recorded or imported, UTC. A
run that neither ended nor was heard of for a minute is interrupted; what it stored counts.
"""

from __future__ import annotations

import argparse
from datetime import datetime
from typing import TYPE_CHECKING, Mapping

from cassandra_ros.cli.options import add_store_options, open_store
from cassandra_ros.cli.text import format_table, shown

if TYPE_CHECKING:
    from cassandra_ros.store.registry import Run

_HEADER = ("run", "id", "robot", "kind", "start", "end", "state", "messages", "lost", "labels")
_OWN_LABELS = ("content",)
"""What an import notes to find itself again."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the store."""
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Print a line for each run, the oldest first."""
    with open_store(options) as ros_cas:
        runs = sorted(ros_cas.runs(), key=lambda run: str(run.started))
    if runs:
        print(format_table(_HEADER, [_row(run) for run in runs], right=("messages", "lost")))
    else:
        print(f"keyspace {options.keyspace} holds no run")
    return 0


def _row(run: Run) -> tuple[str, ...]:
    labels = {name: text for name, text in run.labels.items() if name not in _OWN_LABELS}
    return (
        shown(run.name) or str(run.writer),
        str(run.writer),
        shown(run.node) or "-",
        run.kind,
        time_of(run.started),
        time_of(run.ended),
        run.state,
        str(sum(run.stored.values())),
        str(sum(run.lost.values())),
        _labels(labels) or "-",
    )


def _labels(labels: Mapping[str, str]) -> str:
    # A label may be a word alone.
    return shown(", ".join(f"{k}={v}" if v else k for k, v in sorted(labels.items())))


def time_of(when: datetime | None) -> str:
    """Write a time of a run, UTC; '-' where there is none."""
    return "-" if when is None else f"{when:%Y-%m-%dT%H:%M:%SZ}"
