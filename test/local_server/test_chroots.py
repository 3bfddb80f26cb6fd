# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from cassandra_ros.local_server import nodes

COMMAND = ["sh", "-c", "cat /proc/mounts"]


def test_where_the_root_is_mounted_nothing_changes(tmp_path, monkeypatch):
    monkeypatch.setattr(nodes, "mount_points", lambda: ["/proc", nodes.mount_point_of(tmp_path)])
    assert nodes.with_visible_root(COMMAND, tmp_path) == COMMAND


def test_who_is_not_root_cannot_change_it(tmp_path, monkeypatch):
    monkeypatch.setattr(nodes, "mount_points", lambda: ["/proc"])
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    assert nodes.with_visible_root(COMMAND, tmp_path) == COMMAND


def test_another_file_system_is_a_mount_point_of_its_own():
    assert nodes.mount_point_of(Path("/proc/self")) == "/proc"
    assert "/proc" in nodes.mount_points()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may mount")
def test_the_root_becomes_a_mount_for_that_process_alone(tmp_path, monkeypatch):
    before = nodes.mount_points()
    monkeypatch.setattr(nodes, "mount_points", lambda: ["/proc"])
    wrapped = nodes.with_visible_root(["cat", "/proc/mounts", str(tmp_path / "file")], tmp_path)
    assert wrapped != COMMAND
    (tmp_path / "file").write_text("seen there as well")
    done = subprocess.run(wrapped, capture_output=True, text=True)
    if "Operation not permitted" in done.stderr:
        pytest.skip("this root may not mount either")
    assert done.returncode == 0, done.stderr
    assert " / " in done.stdout
    assert done.stdout.endswith("seen there as well")
    monkeypatch.undo()
    assert nodes.mount_points() == before
