# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest
from other_user import NOBODY, refusal_of

from cassandra_ros.errors import ServerError
from cassandra_ros.local_server import LocalCluster, disk, free_port, node_tool, processes
from cassandra_ros.local_server.cluster_settings import save_settings

_SLEEP = [sys.executable, "-c", "import time; time.sleep(600)"]


def test_a_server_is_known_by_its_command_line_only(tmp_path):
    config = tmp_path / "cassandra.yaml"
    child = subprocess.Popen([*_SLEEP, processes.config_argument(config)])
    other = subprocess.Popen(_SLEEP)
    while not all(processes.command_line(one.pid) for one in (child, other)):
        time.sleep(0.001)
    try:
        assert processes.is_server(child.pid, config)
        assert processes.find_server(config, tmp_path / "pid") == child.pid
        assert not processes.is_server(other.pid, config)
        assert processes.find_server(tmp_path / "other.yaml", tmp_path / "pid") == 0
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
        "print(child.pid, flush=True); time.sleep(600)"
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
            ["sleep", "600"], tmp_path / "out", dict(os.environ), die_with_us=False
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


# A program that looks like a server. Its words: what it does first, a folder, the configuration.
_FOREIGN = """
import ctypes, os, sys, time
if sys.argv[1] == "chroot":
    os.chroot(sys.argv[2])
else:
    ctypes.CDLL(None).prctl(4, 0, 0, 0, 0)  # PR_SET_DUMPABLE: only root looks into it now
print("ready", flush=True)
time.sleep(600)
"""


@contextlib.contextmanager
def foreign_server(config, action, root):
    # Who is not root may change its root in a user namespace of its own.
    may = [] if action != "chroot" or os.geteuid() == 0 else ["unshare", "--map-root-user"]
    words = [action, root, processes.config_argument(config)]
    words.append(f"-Dcassandra.storagedir={config.parent}")
    with subprocess.Popen(
        [*may, sys.executable, "-c", _FOREIGN, *words], stdout=subprocess.PIPE
    ) as child:
        try:
            assert child.stdout.readline() == b"ready\n"
            yield child
        finally:
            child.kill()


def test_a_server_in_another_root_with_the_same_paths_is_not_ours(tmp_path):
    directory, root = tmp_path / "cassandra", tmp_path / "root"
    cluster = LocalCluster(directory, port=free_port())
    [node] = cluster.nodes
    for folder in (node.directory, root / node.directory.relative_to("/")):
        folder.mkdir(parents=True)
    save_settings(directory, cluster.settings)
    with foreign_server(node.config, "chroot", root) as child:
        assert processes.find_server(node.config, node.pid_file) == 0
        processes.write_start(node.pid_file, child.pid)
        assert processes.find_server(node.config, node.pid_file) == 0
        assert disk.local_nodes(directory) == 0
        assert disk.local_directory("127.0.0.1", cluster.settings.port) is None
        assert cluster.stop() is False
        assert LocalCluster(directory).clear() is True
        assert child.poll() is None


def test_a_server_that_cannot_be_looked_into_is_known_by_its_start(tmp_path):
    # Not in tmp_path, which other users cannot enter.
    with tempfile.TemporaryDirectory(prefix="cassandra_ros_start_") as name:
        folder = Path(name)
        folder.chmod(0o755)
        config, pid_file = folder / "cassandra.yaml", folder / "pid"

        def check(pid):
            assert processes.find_server(config, pid_file) == pid

        with foreign_server(config, "hide", folder) as child:
            assert refusal_of(check, 0) == ""
            pid_file.write_text(f"{child.pid} {processes.start_time(child.pid) + 1}\n")
            assert refusal_of(check, 0) == ""
            processes.write_start(pid_file, child.pid)
            assert refusal_of(check, child.pid) == ""


def test_a_socket_of_java_is_that_of_its_user(tmp_path):
    """In /tmp another user can make one, and would get the commands that are for the server."""
    path = tmp_path / ".java_pid1"
    assert not node_tool._is_socket_of(path, os.getpid())
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        assert node_tool._is_socket_of(path, os.getpid())
        if os.geteuid() == 0:
            os.chown(path, NOBODY, NOBODY)
            assert not node_tool._is_socket_of(path, os.getpid())
        else:
            assert not node_tool._is_socket_of(path, 1)
    (tmp_path / "link").symlink_to(path)
    assert not node_tool._is_socket_of(tmp_path / "link", os.getpid())


def test_a_wait_is_told_every_ten_seconds():
    said = []
    tell = processes.ProgressLines(said.append)
    for seconds in (0.1, 9.9, 10.1, 11.0, 19.9, 20.0, 0.1, 10.0):
        tell("waiting", seconds)
    assert said == ["waiting … 10 s", "waiting … 20 s", "waiting … 10 s"]
