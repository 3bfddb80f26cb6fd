# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""List recordings and imports: name, robot, times, state, numbers of stored and lost messages.

The column run shows the value for --run: a name, which several runs may have, or the writer id of a
run without name. The column id always shows the writer id. Start and end are the times of recording
or import, in UTC. A run that has not ended, and has given no sign of life for a minute, is shown as
interrupted; its stored messages are counted.
"""

from __future__ import annotations

import argparse
from datetime import datetime
from typing import TYPE_CHECKING, Mapping

from cassandra_ros.cli.json_answer import add_json_option, print_json
from cassandra_ros.cli.options import add_store_options, open_store
from cassandra_ros.cli.terminal_text import format_table
from cassandra_ros.printable import shown

if TYPE_CHECKING:
    from cassandra_ros.store.tables.registry import Run

_HEADER = ("run", "id", "robot", "kind", "start", "end", "state", "messages", "lost", "labels")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the form of the answer and the store."""
    add_json_option(parser)
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Print a line for each run, the oldest first."""
    with open_store(options) as ros_cas:
        runs = sorted(ros_cas.runs(), key=lambda run: str(run.started))
    if options.json:
        # Without the labels that an import adds for its own use.
        print_json([{**vars(run), "labels": run.public_labels} for run in runs])
    elif runs:
        print(format_table(_HEADER, [_row(run) for run in runs], right=("messages", "lost")))
    else:
        print(f"keyspace {options.keyspace} holds no run")
    return 0


def _row(run: Run) -> tuple[str, ...]:
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
        _labels(run.public_labels) or "-",
    )


def _labels(labels: Mapping[str, str]) -> str:
    # A label may have no value.
    named = sorted(labels.items())
    return shown(", ".join(f"{k}={v}" if v else k for k, v in named))


def time_of(when: datetime | None) -> str:
    """Return a time of a run as text, in UTC; '-' for None."""
    return "-" if when is None else f"{when:%Y-%m-%dT%H:%M:%SZ}"
