# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the demos share: commands as a user types them, programs in the background, the table."""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Mapping, Sequence

from cassandra_ros.errors import ServerError
from cassandra_ros.files.bag.bag_reader import BagReader
from cassandra_ros.local_server import LocalCluster, free_port
from cassandra_ros.local_server.ports import is_free

HERE = Path(__file__).resolve().parent
RUN = ["rosrun", "cassandra_ros"]
_OF_ROSCORE = ("/rosout", "/rosout_agg")
SMALL_HEAP = "400M"
"""Java heap of each of several nodes on one machine."""
PATIENCE_SEC = 600
"""Maximum time for a program to start or to end, s. A recorder stores first what still waits in its
buffer, and a loaded machine is slow."""
TELL_SEC = 10.0
"""Interval between two lines that say what is being waited for, s."""


def say(text: str) -> None:
    """Head a step."""
    print(f"\n=== {text}", flush=True)


def print_table(findings: Sequence[tuple[str, str]]) -> None:
    """Print what was found out, a line each."""
    width = max(len(what) for what, _ in findings)
    for what, figure in findings:
        print(f"{what:{width}}  {figure}")


class Shell:
    """A shell of one machine, and the programs that it started.

    Args:
        env: Its environment, which the caller may change later.
        folder: Folder for the output of programs.
        stack: Stops the programs when it is closed.
        name: Name of the machine, before each command that is printed; '' = no name.
    """

    def __init__(
        self, env: Mapping[str, str], folder: Path, stack: ExitStack, name: str = ""
    ) -> None:
        self.env = dict(env)
        self._folder, self._stack = folder, stack
        self._prompt = f"{name}$"

    def echo(self, text: str) -> None:
        """Print a command."""
        print(f"{self._prompt} {text}", flush=True)

    def run(self, *command: object, shown: int | None = None, status: int | None = 0) -> str:
        """Run a command as a user would; print it and what it prints.

        Args:
            command: Its words.
            shown: Maximum number of lines to print; None = all.
            status: The exit status that it must have; None = any.

        Raises:
            SystemExit: It has another exit status.
        """
        words = [str(word) for word in command]
        self.echo(shell_text(words))
        done = subprocess.run(
            words, env=self.env, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True
        )
        lines = done.stdout.rstrip().splitlines()
        cut = lines if shown is None or len(lines) <= shown else [*lines[:shown], "..."]
        print("\n".join(cut), flush=True)
        if status is not None and done.returncode != status:
            raise SystemExit(f"demo: {words[2] if words[0] == 'rosrun' else words[0]} failed")
        return done.stdout

    def output(self, *command: str) -> str:
        """Return what a command prints, without a word of it; '' if it fails."""
        done = subprocess.run(
            command, env=self.env, stdin=subprocess.DEVNULL, capture_output=True, text=True
        )
        return done.stdout

    def begin(self, name: str, command: Sequence[str]) -> Program:
        """Start a program that goes on while others run."""
        self.echo(f"{shell_text(command)} &")
        program = Program(name, command, self.env, self._folder)
        self._stack.callback(program.stop)
        return program

    def spawn(self, name: str, command: Sequence[str], ready: str) -> Program:
        """Start a program that stays, and wait for a line that says it is ready."""
        program = self.begin(name, command)
        program.wait_for(ready)
        return program


class Drive:
    """A bag that is played to a recorder, which a real robot recorded.

    Args:
        path: The bag.
        prefix: Prefix of the topics of rosout: roscore's own node writes to the plain names. A
            remapping would not do: it would also rename the player's own log topic, and roscpp
            numbers all messages of a topic that it logs to anew (header.seq).
    """

    def __init__(self, path: Path, prefix: str) -> None:
        self.path = path
        self._prefix = prefix
        with BagReader(path) as bag:
            self.topics = sorted({each.topic for each in bag.connections.values()})
            self.count = bag.message_count
        self.renamed = {topic: prefix + topic for topic in self.topics if topic in _OF_ROSCORE}

    @property
    def recorded(self) -> list[str]:
        """The names under which the topics are recorded."""
        return [self.renamed.get(topic, topic) for topic in self.topics]

    @property
    def maps(self) -> list[str]:
        """Options of verify: which topic of the bag was recorded as which."""
        return [word for a, b in self.renamed.items() for word in ("--map", f"{a}:={b}")]

    def play_commands(self, rate: float) -> tuple[list[str], list[str]]:
        """Return the commands that play it: one for the topics of rosout, one for the others."""
        play = ["rosbag", "play", "-q", "-r", f"{rate:g}", "-d", "2", "--wait-for-subscribers"]
        play += ["--queue", "100000", str(self.path)]
        others = [topic for topic in self.topics if topic not in self.renamed]
        return (
            [*play, "--prefix", self._prefix, "--topics", *self.renamed],
            [*play, "--topics", *others],
        )

    def equal(self, text: str) -> str:
        """Return how many messages the output of verify calls equal."""
        match = re.search(r"^equal: .* (\d+) messages", text, re.MULTILINE)
        assert match is not None, text
        return f"{int(match[1]):,} of {self.count:,} messages"


class Program:
    """A program in the background; its output goes to a file."""

    def __init__(
        self, name: str, command: Sequence[str], env: Mapping[str, str], folder: Path
    ) -> None:
        self.name = name
        self.log = folder / f"{name}.log"
        with self.log.open("wb") as sink:
            self.process = subprocess.Popen(
                command, env=env, stdin=subprocess.DEVNULL, stdout=sink, stderr=subprocess.STDOUT
            )

    def text(self) -> str:
        """Return what it has printed."""
        return self.log.read_text(errors="replace").rstrip()

    def wait_for(self, pattern: str) -> None:
        """Wait for a line."""
        deadline = time.monotonic() + PATIENCE_SEC
        while not re.search(pattern, self.text()):
            if self.process.poll() is not None or time.monotonic() > deadline:
                raise SystemExit(f"demo: {self.name} did not start:\n{self.text()}")
            time.sleep(0.1)

    def wait(self) -> None:
        """Wait for its end, which has to be a good one."""
        if self.process.wait(PATIENCE_SEC):
            raise SystemExit(f"demo: {self.name} failed:\n{self.text()}")

    def stop(self) -> int:
        """Interrupt it and wait for its end; return its exit status."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        try:
            return self.process.wait(PATIENCE_SEC)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return self.process.wait()


class Progress:
    """Lines that say what is being waited for, one in a while."""

    def __init__(self) -> None:
        self._told = time.monotonic()

    def tell(self, what: str, seconds: float) -> None:
        """Say what is being waited for, and since how many seconds."""
        if min(seconds, time.monotonic() - self._told) >= TELL_SEC:
            self._told = time.monotonic()
            print(f"{what}: {seconds:.0f} s", flush=True)


def stop_cluster(cluster: LocalCluster) -> None:
    """Stop a Cassandra, also a node that hangs."""
    try:
        cluster.stop()
    except ServerError as exc:
        print(f"demo: {exc}", flush=True)
        for status in cluster.status():
            if status.pid:
                os.kill(status.pid, signal.SIGKILL)


def port_or(usual: int, *hosts: str) -> int:
    """Return a port if it is free on all hosts (none = 127.0.0.1), else another one."""
    hosts = hosts or ("127.0.0.1",)
    return usual if all(is_free(host, usual) for host in hosts) else free_port(*hosts)


def shell_text(words: Sequence[str]) -> str:
    """Return a command as it is typed."""
    words = [os.path.relpath(w) if w.startswith(str(HERE.parent)) else w for w in words]
    return " ".join(w if ":=" in w else shlex.quote(w) for w in words)


def kill(pid: int, what: str, shell: Shell) -> None:
    """Kill a process with SIGKILL."""
    shell.echo(f"kill -9 {pid}    # {what}")
    os.kill(pid, signal.SIGKILL)
