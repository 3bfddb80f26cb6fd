# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What programs import before they need it: a person waits for every module."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = {
    *("numpy", "cassandra", "lark", "genpy", "rospy", "pandas", "tqdm", "yaml", "matplotlib"),
    *("PIL", "aiohttp", "asyncio", "xmlrpc", "geometry_msgs", "zstandard"),
}
PROGRAM = """
import sys
from importlib import import_module
try:
    import_module("cassandra_ros.cli." + sys.argv.pop(1)).main()
except SystemExit as ended:
    assert ended.code in (0, None), ended
print("modules", *{name.split(".")[0] for name in sys.modules})
"""


def modules_after(*words):
    """The modules that a program has imported when it ends."""
    run = [sys.executable, "-c", PROGRAM, *words]
    done = subprocess.run(run, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.splitlines()[-1].split())


@pytest.mark.parametrize(
    "words",
    [
        ["cassandra_bag", "--help"],
        ["cassandra_bag", "query", "--help"],
        ["recorder", "--help"],
        ["player", "--help"],
        ["query_server", "--help"],
        ["viewer", "--help"],
        ["local_cassandra", "--help"],
    ],
    ids=" ".join,
)
def test_help_imports_nothing_heavy(words):
    assert not HEAVY & modules_after(*words)


@pytest.mark.suite("all", "it starts each program")
def test_what_reads_no_statement_makes_no_grammar(rosCas):
    where = rosCas.cassandra
    place = ["--host", where.hosts[0], "--port", str(where.port)]
    rosCas.connectToKeyspace(rosCas.keyspace)
    loaded = modules_after("cassandra_bag", "info", *place, "--keyspace", rosCas.keyspace)
    assert not {"lark", "geometry_msgs", "pandas", "rospy", "matplotlib"} & loaded
    assert "cassandra" in loaded
