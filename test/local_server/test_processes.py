# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cassandra_ros.errors import ServerError
from cassandra_ros.local_server import processes

_SLEEP = [sys.executable, "-c", "import time; time.sleep(60)"]


def test_a_server_is_known_by_its_command_line_only(tmp_path):
    config = tmp_path / "cassandra.yaml"
    child = subprocess.Popen([*_SLEEP, processes.config_argument(config)])
    other = subprocess.Popen(_SLEEP)
    while not all(processes.command_line(one.pid) for one in (child, other)):
        time.sleep(0.001)
    try:
        assert processes.is_server(child.pid, config)
        assert processes.find_server(config) == child.pid
        assert not processes.is_server(other.pid, config)
        assert processes.find_server(tmp_path / "other.yaml") == 0
        assert str(config) in processes.describe_process(child.pid)
    finally:
        for process in (child, other):
            process.kill()
            process.wait()
    assert not processes.is_server(child.pid, config)
    assert "ended" in processes.describe_process(child.pid)


def test_a_zombie_has_ended(tmp_path):
    child = subprocess.Popen([sys.executable, "-c", ""])
    while Path(f"/proc/{child.pid}/stat").read_text().split()[2] != "Z":
        time.sleep(0.01)
    assert processes.command_line(child.pid) == []
    child.wait()


def test_a_process_that_is_gone_can_be_terminated():
    child = subprocess.Popen([sys.executable, "-c", ""])
    child.wait()
    processes.terminate(child.pid)


def test_a_child_ends_with_a_parent_that_was_killed(tmp_path):
    program = (
        "import sys, time; from pathlib import Path\n"
        "from cassandra_ros.local_server.processes import spawn\n"
        f"child = spawn({_SLEEP!r}, Path({str(tmp_path / 'log')!r}), {{}}, die_with_us=True)\n"
        "print(child.pid, flush=True); time.sleep(60)"
    )
    parent = subprocess.Popen(
        [sys.executable, "-c", program],
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    child = int(parent.stdout.readline())
    assert processes.command_line(child)
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    parent.stdout.close()
    deadline = time.monotonic() + 180
    while processes.command_line(child) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not processes.command_line(child)


def test_a_child_can_be_ended_where_signals_are_ignored(tmp_path):
    """As in a background job of a shell, whose children inherit that SIGINT is ignored."""
    before = {n: signal.signal(n, signal.SIG_IGN) for n in (signal.SIGINT, signal.SIGTERM)}
    try:
        child = processes.spawn(
            ["sleep", "60"], tmp_path / "out", dict(os.environ), die_with_us=False
        )
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    processes.terminate(child.pid)
    assert child.wait(180) == -signal.SIGTERM


def test_what_belongs_to_another_user_is_told(tmp_path, monkeypatch):
    with pytest.raises(ServerError, match="cannot be opened: Is a directory"):
        with processes.locked(tmp_path):
            pass

    def kill(pid, number):
        raise PermissionError

    monkeypatch.setattr(os, "kill", kill)
    with pytest.raises(ServerError, match="process 7 belongs to another user"):
        processes.terminate(7)
