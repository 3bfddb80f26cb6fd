# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""server/setup.sh: what it refuses, what it skips, what it says."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def set_up(folder, path=""):
    return subprocess.run(
        ["bash", "server/setup.sh"],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        env={**os.environ, "PATH": f"{path}:{os.environ['PATH']}"},
        timeout=300,
    )


def checkout(folder):
    """A copy of what setup.sh reads before its first step."""
    (folder / "server").mkdir(parents=True)
    shutil.copy(ROOT / "server" / "setup.sh", folder / "server")
    shutil.copy(ROOT / "Makefile", folder)
    return folder


def test_a_second_set_up_skips_every_step():
    done = set_up(ROOT)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert [line.split(":")[1].strip() for line in lines[:-1]] == [
        "packages",
        "python",
        "cassandra",
        "studio",
        "workspace",
    ]
    assert all("skipped" in line or "was already" in line for line in lines[:-1])
    assert "source .ws/devel/setup.bash" in lines[-1]


@pytest.mark.parametrize("sign", [".catkin_workspace", ".catkin_tools", "src/CMakeLists.txt"])
def test_in_somebodys_workspace_it_stops_and_prints_their_command(tmp_path, sign):
    theirs = tmp_path / "their_ws"
    folder = checkout(theirs / "src" / "robots" / "cassandra_ros")
    if sign == ".catkin_tools":
        (theirs / sign).mkdir()
    else:
        (theirs / sign).write_text("catkin_workspace()\n")
    done = set_up(folder)
    assert done.returncode == 1
    assert done.stdout == ""
    assert f"cd {theirs} && catkin_make -DPYTHON_EXECUTABLE=" in done.stderr
    assert f"pip install -r {folder}/requirements.txt" in done.stderr
    assert not (folder / ".ws").exists()


def test_without_root_and_sudo_it_prints_the_one_command(tmp_path):
    stubs = tmp_path / "bin"
    stubs.mkdir()
    for name, text in (("id", "echo 1000"), ("sudo", "exit 1"), ("dpkg-query", "exit 1")):
        (stubs / name).write_text(f"#!/bin/sh\n{text}\n")
        (stubs / name).chmod(0o755)
    done = set_up(checkout(tmp_path / "checkout"), path=str(stubs))
    assert done.returncode == 1
    commands = [line for line in done.stderr.splitlines() if "apt-get install" in line]
    assert len(commands) == 1
    assert commands[0].strip().startswith("sudo sh -c 'apt-get update && apt-get install")
    assert "openjdk-17-jre-headless" in commands[0]
    assert "\n" not in commands[0].strip()
