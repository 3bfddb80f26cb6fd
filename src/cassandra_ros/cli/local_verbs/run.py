# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Run the local Cassandra in the foreground until Ctrl-C or SIGTERM, then drain it.

For a launch file or a service manager that owns it. Clients that are connected at the end get 9 s
to go first; a second Ctrl-C cuts that short. Where Cassandra runs already, this waits beside it
and leaves it running.
"""

from __future__ import annotations

import argparse
import signal
import time
from types import FrameType
from typing import Callable

from cassandra_ros.cli.local_verbs import (
    add_server_options,
    clear_progress,
    open_cluster,
    say,
    show_progress,
    where,
)
from cassandra_ros.local_server.ports import count_clients

# roslaunch sends SIGINT to all its programs at once, a SIGTERM 15 s later: what the recorder still
# holds must be stored before, and the drain takes 3 s.
CLIENTS_SEC = 9.0
_POLL_SEC = 0.1


class _Stopped(BaseException):
    """A signal asked us to end; no handler of ordinary errors may swallow it."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the server."""
    add_server_options(parser)


def run(options: argparse.Namespace) -> int:
    """Start, watch, and stop what was started here."""
    cluster = open_cluster(options)
    _on_signals(_stop)
    running_before = any(status.pid for status in cluster.status())
    try:
        cluster.start(die_with_us=True)
        clear_progress()
        say(f"Cassandra answers at {where(cluster)}")
        cluster.wait()
    except _Stopped:
        clear_progress()
        if not running_before:
            _let_clients_go(cluster.settings.port)
    finally:
        _on_signals(signal.SIG_IGN)  # one more Ctrl-C must not cut the drain short
        if not running_before and cluster.stop():
            clear_progress()
            say(f"Cassandra at {where(cluster)} stopped")
    return 0


def _let_clients_go(port: int) -> None:
    """Give those who are connected time to store what they have; a signal ends it."""
    deadline = time.monotonic() + CLIENTS_SEC
    try:
        while count_clients(port) and time.monotonic() < deadline:
            show_progress("waiting for clients to go", CLIENTS_SEC - deadline + time.monotonic())
            time.sleep(_POLL_SEC)
    except _Stopped:
        pass


def _on_signals(handler: Callable[[int, FrameType | None], None] | signal.Handlers) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, handler)


def _stop(number: int, frame: FrameType | None) -> None:
    raise _Stopped
