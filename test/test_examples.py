# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The examples run as they stand (the demo and its listing: make demo)."""

from __future__ import annotations

import subprocess
import sys

from conftest import ROOT


def test_results_under_names(cassandra, keyspace, ros_env):
    command = [sys.executable, str(ROOT / "examples/named_results.py")]
    options = ["--host", cassandra.host, "--port", str(cassandra.port), "--keyspace", keyspace]
    for run in (1, 2):
        done = subprocess.run(
            [*command, *options], env=ros_env, capture_output=True, text=True, timeout=120
        )
        assert done.returncode == 0, done.stderr
        assert f"kitchen: 81 x 60 cells, newest of {2 * run} versions" in done.stdout
        assert "the first was 80 cells wide" in done.stdout
        assert "4000000 cells" in done.stdout
        assert "names:   ['hall', 'kitchen']" in done.stdout
        assert "64 triangles" in done.stdout
        assert "50 points" in done.stdout
        assert done.stdout.count("('to the door', 5.0)") == run
        assert not done.stderr
