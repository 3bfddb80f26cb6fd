# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Processes of the local Cassandra, identified by their folder, never by a pid alone.

A pid in a file may belong to another process by now. So a process counts as a node's server only
if its command line names that node's configuration file, and the folder of this file, as that
process sees it, is the node's folder: in a chroot or a container another folder can have the same
path. Where the system does not let us look through its eyes, it must be the process whose pid and
start time the node's folder holds.
"""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import time
from contextlib import contextmanager
from pathlib import Path
from typing import Callable, Iterator, Mapping, NamedTuple, Sequence

import psutil

from cassandra_ros.errors import ServerError
from cassandra_ros.own_files import lock_holder, lock_own, open_regular

_PR_SET_PDEATHSIG = 1
_CONFIG = "-Dcassandra.config="
LOCK_SEC = 600.0
"""Maximum time to wait for another process that holds a lock, s."""
_LOCK_POLL_SEC = 0.1
TELL_SEC = 10.0
"""Time between two lines that say what is being waited for, s."""
_PID_CHARS = 64


class ServerStart(NamedTuple):
    """What a pid file holds.

    Attributes:
        pid: Pid of the server; 0 = the file is missing or damaged.
        time: Its start time, see start_time; 0 = the file is missing or damaged.
    """

    pid: int
    time: int


_NOT_NOTED = ServerStart(0, 0)


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


def start_time(pid: int) -> int:
    """Return when a process was started, in ticks since the machine was; 0 = it has ended."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        return 0
    return int(text.rpartition(")")[2].split()[19])  # the name before it may have parentheses


def write_start(pid_file: Path, pid: int) -> None:
    """Write the pid and the start time of a server into its pid file."""
    pid_file.write_text(f"{pid} {start_time(pid)}\n", encoding="ascii")


def read_start(pid_file: Path) -> ServerStart | None:
    """Return what a pid file holds; None = its folder is another user's, and we may not read it."""
    try:
        with open(open_regular(pid_file), encoding="ascii", errors="replace") as file:
            words = file.read(_PID_CHARS).split()
        return ServerStart(int(words[0]), int(words[1]))
    except PermissionError:
        return None
    except (OSError, ValueError, IndexError):
        return _NOT_NOTED


def is_server(pid: int, config: Path, started: ServerStart | None = _NOT_NOTED) -> bool:
    """Return whether a process is the server with this configuration file, in this very folder.

    Args:
        pid: The process.
        config: The configuration file.
        started: What the pid file holds; see read_start. It counts only where the system does not
            show us the folder of the process.
    """
    if config_argument(config) not in command_line(pid):
        return False
    try:
        return os.path.samestat(os.stat(f"/proc/{pid}/root{config.parent}"), config.parent.stat())
    except PermissionError:
        # A process or a folder of another user, or a process with more rights. If the pid file
        # cannot be read either, the command line must do: then we cannot end that process.
        return started is None or started == (pid, start_time(pid))
    except OSError:
        return False  # there is no such folder where it runs, or it has ended


def find_server(config: Path, pid_file: Path) -> int:
    """Return the pid of the server with this configuration file; 0 = it is not running."""
    started = read_start(pid_file)
    first = [started.pid] if started and started.pid else []
    return next((pid for pid in (*first, *psutil.pids()) if is_server(pid, config, started)), 0)


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
        completed = subprocess.run(
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
    return completed.returncode, completed.stdout


def run_to_end(
    command: Sequence[str], environment: Mapping[str, str], timeout_sec: float, failure: str
) -> None:
    """Run a program to its end.

    Args:
        environment: Variables in addition to ours. Secrets go this way: other users see arguments.
        failure: Beginning of the error text.

    Raises:
        ServerError: The program fails, or takes longer than the timeout.
    """
    status, output = run_program(command, timeout_sec, {**environment, "LC_ALL": "C.UTF-8"})
    if status:
        raise ServerError(f"{failure}: {output.strip()[-500:]}")


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

    Args:
        command: The program and its arguments.
        output: File for its output, made anew.
        environment: All of its environment variables.
        die_with_us: Whether it gets SIGTERM when this process ends for any reason. Linux sends it
            when the thread ends that calls this function: call it on the main thread.
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
    """Return what the child does between fork and exec."""
    # Loaded before the fork: little is allowed after it.
    prctl = ctypes.CDLL(None).prctl

    def prepare() -> None:
        # Background jobs of a shell ignore SIGINT, and exec keeps ignored signals ignored. Java
        # would then ignore it, too.
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        if die_with_us:
            prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)

    return prepare


class ProgressLines:
    """A progress callback that says every 10 s what is being waited for, in one wait after another.

    Args:
        say: Callback that gets a line of text.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._step = 0

    def __call__(self, text: str, seconds: float) -> None:
        """Say a text if another 10 s of its wait have passed."""
        step, self._step = self._step, int(seconds // TELL_SEC)
        if self._step > step:
            self._say(f"{text} … {seconds:.0f} s")


@contextmanager
def locked(
    path: Path,
    progress: Callable[[str, float], None] = lambda text, seconds: None,
    limit_sec: float = LOCK_SEC,
) -> Iterator[None]:
    """Hold the lock of a file, which is created if needed; wait for other processes.

    Args:
        path: The file. No other user can open it, and so hold the lock.
        progress: Callback that gets regularly what is being waited for, and since how many seconds.
        limit_sec: Maximum time to wait, s.

    Raises:
        ServerError: The file cannot be opened, or another process holds the lock for longer.
    """
    begun = time.monotonic()
    while True:
        try:
            lock = lock_own(path)
            break
        except BlockingIOError:
            waited = time.monotonic() - begun
        except OSError as exc:
            raise ServerError(
                f"{path} cannot be opened: {exc.strerror}; was it made by another user?"
            ) from exc
        pid = lock_holder(path)
        holder = describe_process(pid) if pid else "a process that is not known"
        if waited > limit_sec:
            raise ServerError(
                f"{path} is still locked by {holder} after {waited:.0f} s; wait until that has "
                "ended, or end it"
            )
        progress(f"waiting for {holder}, which has locked {path}", waited)
        time.sleep(_LOCK_POLL_SEC)
    try:
        yield
    finally:
        os.close(lock)
