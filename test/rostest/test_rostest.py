# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a catkin user types: rostest cassandra_ros services.test."""

from __future__ import annotations

import subprocess
import time

import pytest

from cassandra_ros.local_server import LocalCluster, free_port


@pytest.mark.suite("all", "it starts many programs")
def test_rostest_runs_the_launch_file_and_asks_the_services(ros_env, tmp_path):
    folder = tmp_path / "server"
    arguments = [f"port:={free_port()}", f"dir:={folder}"]
    try:
        done = subprocess.run(
            ["rostest", "cassandra_ros", "services.test", *arguments],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            env=ros_env,
            timeout=900,
        )
        assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-3000:]
        assert "TESTS: 2" in done.stdout
        # The launch file leaves nothing running; a slow server may still drain what it has.
        deadline = time.monotonic() + 300
        while any(status.pid for status in LocalCluster(folder).status()):
            assert time.monotonic() < deadline
            time.sleep(0.2)
    finally:
        LocalCluster(folder).stop()
