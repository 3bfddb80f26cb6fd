# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Processes of the local Cassandra: found by what they run, never by a number alone.

A pid that a file remembers may belong to somebody else by now. So a process counts as a node's
server only while its command line names that node's configuration file.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import signal
import subprocess
import time
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Callable, Iterator

import psutil

_PR_SET_PDEATHSIG = 1
_CONFIG = "-Dcassandra.config="


def config_argument(config: Path) -> str:
    """Return the argument by which a server's command line names its configuration."""
    return _CONFIG + config.as_uri()


def command_line(pid: int) -> list[str]:
    """Return the arguments of a process; empty when it has ended (also as a zombie)."""
    try:
        return [word for word in psutil.Process(pid).cmdline() if word]
    except psutil.Error:
        return []


def is_server(pid: int, config: Path) -> bool:
    """Tell whether the process is the server of this configuration file."""
    return config_argument(config) in command_line(pid)


def find_server(config: Path) -> int:
    """Return the pid of the running server of this configuration file, 0 if there is none."""
    return next((pid for pid in psutil.pids() if is_server(pid, config)), 0)


def describe_process(pid: int) -> str:
    """Return a name for a process that a person recognises."""
    words = command_line(pid)
    if not words:
        return f"process {pid}, which has ended"
    for word in words:
        if word.startswith(_CONFIG):
            return f"another Cassandra ({word[len(_CONFIG) :]}, pid {pid})"
    return f"{os.path.basename(words[0])} (pid {pid})"


def spawn(
    command: list[str], output: Path, environment: dict[str, str], *, die_with_us: bool
) -> subprocess.Popen[bytes]:
    """Start a process in a session of its own, apart from our terminal and its Ctrl-C.

    With ``die_with_us`` it gets a SIGTERM when this process ends, however that ends.
    """
    with open(output, "wb") as log:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env=environment,
            start_new_session=True,
            preexec_fn=_in_child(die_with_us),
        )
    # In its very first moments it has no command line to be known by.
    while process.poll() is None and not command_line(process.pid):
        time.sleep(0.001)
    return process


def terminate(pid: int) -> None:
    """Ask a process to end; one that has ended already is fine."""
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGTERM)


def _in_child(die_with_us: bool) -> Callable[[], None]:
    prctl = ctypes.CDLL(None).prctl  # found here: little may be done between fork and exec

    def prepare() -> None:
        # A shell's background jobs ignore SIGINT, and what is ignored stays so over exec: Java
        # would never notice that it is asked to end.
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        if die_with_us:
            prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)

    return prepare


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold the lock of a file, made when missing; wait while another process holds it."""
    with open(path, "a", encoding="utf-8") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
