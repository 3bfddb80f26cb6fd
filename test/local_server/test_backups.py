# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Backups as doc/operations.md describes them: its commands are typed here, one after the other."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest
from conftest import ROOT

from cassandra_ros import RosCassandra
from cassandra_ros.local_server import LocalCluster, free_port

PAGE = ROOT / "doc/operations.md"
HUSKY = ROOT / "examples/data/husky_gps_data.bag"
TURTLES = ROOT / "examples/data/turtlesim_tf.bag"
TOPICS = ("/fix", "/imu/data", "/tf")

NODETOOL = """\
#!{python}
import sys
from cassandra_ros.local_server import LocalCluster
from cassandra_ros.local_server.jars import find_java, jars_directory
from cassandra_ros.local_server.node_tool import run_node_tool
(status,) = LocalCluster({folder!r}).status()
print(run_node_tool(status.node, status.pid, find_java(), jars_directory(), sys.argv[1:]))
"""
CQLSH = """\
#!{python}
import sys
from cassandra.cluster import Cluster
option, value = sys.argv[1:]
text = value if option == "-e" else open(value).read()
patience = dict(connect_timeout=180, control_connection_timeout=180)
with Cluster(["127.0.0.1"], port={port}, **patience) as cluster, cluster.connect() as session:
    for statement in filter(str.strip, (text + "\\n").split(";\\n")):
        session.execute(statement, timeout=300)
"""


def blocks():
    """The commands of the section, a text for each listing."""
    page = PAGE.read_text(encoding="utf-8")
    section = page.split("\n## Backups\n")[1].split("\n## ")[0]
    return re.findall(r"^```sh\n(.*?)^```", section, re.MULTILINE | re.DOTALL)


class Machine:
    """A home with a local Cassandra, and a shell in it.

    Args:
        home: Its home.
        env: Environment of programs of the package.
    """

    def __init__(self, home, env):
        self.home = home
        self.port = free_port()
        self.folder = home / ".ros/cassandra_ros"
        self.folder.parent.mkdir()
        self._bin = home / "bin"
        self._bin.mkdir()
        self.env = {
            **env,
            "HOME": str(home),
            "ROS_HOME": str(home / ".ros"),
            "CASSANDRA_ROS_HOST": "127.0.0.1",
            "CASSANDRA_ROS_PORT": str(self.port),
            "CASSANDRA_ROS_KEYSPACE": "ros",
            "CASSANDRA_ROS_CQLSHRC": "/dev/null",
            "PATH": f"{self._bin}:{env['PATH']}",
        }

    def in_charge(self, folder):
        """Let nodetool and cqlsh speak to the Cassandra of a folder; return it."""
        values = {"python": sys.executable, "folder": str(folder), "port": self.port}
        for name, text in (("nodetool", NODETOOL), ("cqlsh", CQLSH)):
            program = self._bin / name
            program.write_text(text.format(**values))
            program.chmod(0o700)
        return LocalCluster(folder)

    def type(self, commands):
        """Run commands in a shell that ends at the first that fails; return what they print."""
        done = subprocess.run(
            ["bash", "-ec", commands],
            cwd=self.home,
            env=self.env,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            timeout=1200,
        )
        assert done.returncode == 0, f"{commands}\n{done.stdout}"
        return done.stdout

    def bag(self, *words):
        return self.type(" ".join(["cassandra_bag", *map(str, words)]))

    def assert_all_is_there(self):
        for path, topics in ((HUSKY, TOPICS), (TURTLES, ("/turtle1/pose",))):
            assert "equal" in self.bag("verify", path, "--node-id", path.stem, "--topics", *topics)
        self.bag("check")


@pytest.fixture
def machine(tmp_path, ros_env):
    made = Machine(tmp_path, ros_env)
    try:
        yield made
    finally:
        for folder in (made.folder, tmp_path / "cassandra_ros_copy"):
            if folder.exists():
                LocalCluster(folder).stop()


@pytest.mark.suite("all", "it starts Cassandras")
def test_what_was_backed_up_comes_back(machine):
    to_store, of_store, as_bag, of_bag, copy, of_copy, snapshot, tables, of_snapshot = blocks()
    # The other store is another keyspace of the same Cassandra.
    here = f"127.0.0.1:{machine.port}"
    to_store = to_store.replace("backup.local/ros", f"{here}/kept")
    of_store = of_store.replace("backup.local --keyspace ros", "127.0.0.1 --keyspace kept")
    of_store = of_store.replace("localhost/ros", f"{here}/ros")
    cluster = LocalCluster(machine.folder, port=machine.port, heap="512M")
    cluster.start()
    for path, topics in ((HUSKY, TOPICS), (TURTLES, ("/turtle1/pose --format packed",))):
        machine.bag("import", path, "--node-id", path.stem, "--topics", *topics)
    machine.bag("index", "/fix", "status.status")
    machine.assert_all_is_there()

    machine.type(to_store)
    drop(machine)
    machine.type(of_store)
    machine.assert_all_is_there()

    machine.type(as_bag)
    machine.type(copy)
    machine.type("rosrun cassandra_ros local_cassandra stop")
    machine.type("rosrun cassandra_ros local_cassandra clear --yes")
    machine.type(of_copy)
    cluster = machine.in_charge(machine.home / "cassandra_ros_copy")
    machine.assert_all_is_there()

    data = str(cluster.nodes[0].directory / "data")
    machine.type(snapshot.replace("/var/lib/cassandra/data", data))
    drop(machine)
    machine.type(tables.replace("'replication_factor': 3", "'replication_factor': 1"))
    machine.type(of_snapshot)
    machine.assert_all_is_there()
    with RosCassandra("127.0.0.1", machine.port, keyspace="ros") as store:
        assert store.getTopic("/fix").hasIndex("status.status")
        assert len(store.executeCQL("select KEY from fix where status.status >= 0")) == 95

    drop(machine)
    machine.type(of_bag)
    assert "equal" in machine.bag("verify", "~/all.bag")


def drop(machine):
    """Lose everything."""
    with RosCassandra("127.0.0.1", machine.port, keyspace="ros") as store:
        store.cassandra.schema_change("DROP KEYSPACE ros", what="losing everything")
