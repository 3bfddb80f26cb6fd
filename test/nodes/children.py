# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Nodes of the package as child processes, whose lines are waited for."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
import threading
import time
import xmlrpc.client
from pathlib import Path

from conftest import WORKSPACE

PROGRAMS = WORKSPACE / "devel/lib/cassandra_ros"
CLIENT = Path(__file__).with_name("client.py")


class Child:
    """A process and the lines that it has printed."""

    def __init__(self, command, env):
        self.lines = []
        self.process = subprocess.Popen(
            [str(word) for word in command],
            env=env,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self):
        for line in self.process.stdout:
            self.lines.append(line.rstrip("\n"))

    @property
    def output(self):
        return "\n".join(self.lines)

    def await_line(self, text, timeout_sec=120):
        """Wait for a line that contains a text; return it."""
        deadline = time.monotonic() + timeout_sec
        while time.monotonic() < deadline:
            found = [line for line in self.lines if text in line]
            if found:
                return found[0]
            if self.process.poll() is not None and not self._reader.is_alive():
                break
            time.sleep(0.02)
        raise AssertionError(f"{text!r} never came:\n{self.output}")

    def end(self, number=signal.SIGINT, timeout_sec=180):
        """Send a signal and return the exit status."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        return self.wait(timeout_sec)

    def wait(self, timeout_sec=180):
        """Return the exit status when it ends by itself."""
        status = self.process.wait(timeout_sec)
        self._reader.join(60)
        return status

    def __enter__(self):
        return self

    def __exit__(self, *exc_info):
        if self.process.poll() is None:
            self.process.kill()
        self.wait()


class Client(Child):
    """Calls services from a process of its own, for pytest's must not be a node."""

    def __exit__(self, *exc_info):
        # It leaves the master's lists: later its port is another's.
        with contextlib.suppress(OSError, subprocess.TimeoutExpired):
            self.process.stdin.close()
            self.process.wait(180)
        super().__exit__(*exc_info)

    def call(self, service, timeout_sec=180, **request):
        """Return the response as a dictionary."""
        number = len(self.lines)
        print(json.dumps([service, request]), file=self.process.stdin, flush=True)
        deadline = time.monotonic() + timeout_sec
        while time.monotonic() < deadline:
            answers = [line for line in self.lines[number:] if line.startswith("{")]
            if answers:
                return json.loads(answers[0])
            time.sleep(0.005)
        raise AssertionError(f"no answer from {service}:\n{self.output}")


def await_true(condition, timeout_sec=180):
    """Wait until a condition holds; most do soon, and some ask a server."""
    began = time.monotonic()
    while not condition():
        waited = time.monotonic() - began
        assert waited < timeout_sec
        time.sleep(min(0.01 + waited / 4, 0.2))


def told(child, *, outages=False):
    """Return the lines of a node but those that come on a busy machine alone.

    There a master, a publisher or the store may answer late.

    Args:
        outages: Whether what is said of a store that does not answer is returned, too.
    """
    late = ("the ROS master ", "not all publishers of ")
    if not outages:
        late += ("the store at ", "a request fails and is tried again")
    return [line for line in child.lines if not any(text in line for text in late)]


def services_of(roscore, node):
    """Return the names of the services that a node offers, but those that rospy adds."""
    master = xmlrpc.client.ServerProxy(roscore.uri)
    _, _, (_, _, services) = master.getSystemState("/test")
    names = {name for name, nodes in services if node in nodes}
    return names - {f"{node}/get_loggers", f"{node}/set_logger_level"}


def start_node(roscore, name, *arguments, env=()):
    """Start an executable of the package, as rosrun finds it."""
    return Child([PROGRAMS / name, *arguments], {**roscore.env, **dict(env)})


def start_recorder(roscore, cassandra, keyspace, *arguments, env=()):
    """Start a recorder; it does not record yet."""
    where = ("--host", cassandra.host, "--port", cassandra.port, "--keyspace", keyspace)
    return start_node(roscore, "recorder", *where, *arguments, env=env)


def start_client(roscore):
    """Start a process that calls services."""
    client = Client([sys.executable, CLIENT], roscore.env)
    client.await_line("ready")
    return client
