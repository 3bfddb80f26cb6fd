# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What runs cassandra_bag in a process of its own; the fixture call does so in this one."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def env(cassandra, keyspace):
    return {
        **os.environ,
        "PYTHONPATH": str(ROOT / "src"),
        "CASSANDRA_ROS_HOST": cassandra.host,
        "CASSANDRA_ROS_PORT": str(cassandra.port),
        "CASSANDRA_ROS_KEYSPACE": keyspace,
    }


@pytest.fixture
def type_in(env):
    """Run cassandra_bag as a process; return its exit status, output and errors."""

    def run(*arguments, **changed):
        done = subprocess.run(
            [sys.executable, str(ROOT / "scripts/cassandra_bag"), *map(str, arguments)],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            env={**env, **changed},
            timeout=300,
        )
        return done.returncode, done.stdout, done.stderr

    return run
