# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Processes of the local Cassandra, identified by their command line, never by a pid alone.

A pid in a file may belong to another process by now. So a process counts as a node's server only
if its command line names that node's configuration file.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import signal
import subprocess
import time
from contextlib import contextmanager
from pathlib import Path
from typing import Callable, Iterator, Mapping, Sequence

import psutil

from cassandra_ros.errors import ServerError

_PR_SET_PDEATHSIG = 1
_CONFIG = "-Dcassandra.config="


def config_argument(config: Path) -> str:
    """Return the argument that names the configuration in a server's command line."""
    return _CONFIG + config.as_uri()


def command_line(pid: int) -> list[str]:
    """Return the command line of a process; [] = it has ended (or is a zombie)."""
    try:
        return [word for word in psutil.Process(pid).cmdline() if word]
    except psutil.Error:
        return []


def resident_bytes(pid: int) -> int:
    """Return the resident memory of a process, bytes; 0 = it has ended."""
    try:
        return int(psutil.Process(pid).memory_info().rss)
    except psutil.Error:
        return 0


def is_server(pid: int, config: Path) -> bool:
    """Return whether a process is the server with this configuration file."""
    return config_argument(config) in command_line(pid)


def find_server(config: Path) -> int:
    """Return the pid of the server with this configuration file; 0 = it is not running."""
    return next((pid for pid in psutil.pids() if is_server(pid, config)), 0)


def run_program(
    command: Sequence[str], timeout_sec: float, environment: Mapping[str, str] | None = None
) -> tuple[int, str]:
    """Run a program to its end.

    Args:
        timeout_sec: Time after which it is killed, s.
        environment: Environment variables in addition to those of this process.

    Returns:
        Its exit status (1 if it does not start, or not end in time) and its output.
    """
    try:
        done = subprocess.run(
            command,
            env={**os.environ, **(environment or {})},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            timeout=timeout_sec,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return 1, f"[ERROR] {command[0]} did not end within {timeout_sec:.0f} s"
    except OSError as exc:
        return 1, f"[ERROR] {exc}"
    return done.returncode, done.stdout


def describe_process(pid: int) -> str:
    """Return a description of a process for people."""
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
    """Start a process in a session of its own, so that Ctrl-C in our terminal does not reach it.

    With ``die_with_us`` it gets SIGTERM when this process ends for any reason.
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
    # Wait until the process has its command line, by which it is identified.
    while process.poll() is None and not command_line(process.pid):
        time.sleep(0.001)
    return process


def terminate(pid: int) -> None:
    """Send SIGTERM to a process; do nothing if it has ended already.

    Raises:
        ServerError: It belongs to another user.
    """
    try:
        os.kill(pid, signal.SIGTERM)
    except ProcessLookupError:
        pass
    except PermissionError as exc:
        raise ServerError(f"process {pid} belongs to another user, who can end it") from exc


def _in_child(die_with_us: bool) -> Callable[[], None]:
    prctl = ctypes.CDLL(
        None
    ).prctl  # loaded before the fork: little is allowed between fork and exec

    def prepare() -> None:
        # Background jobs of a shell ignore SIGINT, and exec keeps ignored signals ignored. Java
        # would then ignore it, too.
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        if die_with_us:
            prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)

    return prepare


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold the lock of a file, which is created if needed; wait for other processes.

    Raises:
        ServerError: The file cannot be opened.
    """
    try:
        file = open(path, "a", encoding="utf-8")
    except OSError as exc:
        raise ServerError(
            f"{path} cannot be opened: {exc.strerror}; was it made by another user?"
        ) from exc
    with file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
