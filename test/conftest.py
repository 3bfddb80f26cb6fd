# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the tests share: one real Cassandra and one real roscore a run, a keyspace a test."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import uuid
import xmlrpc.client
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
WORKSPACE = ROOT / ".ws"

# The generated messages; a shell that has sourced the workspace names the folder already.
GENERATED = WORKSPACE / "devel/lib/python3/dist-packages"
if str(GENERATED) not in sys.path:
    sys.path.append(str(GENERATED))


@dataclass(frozen=True)
class CassandraServer:
    host: str
    port: int


@dataclass(frozen=True)
class RosMaster:
    uri: str
    env: dict[str, str]
    """Environment for child processes: workspace, master, ROS home and log of this run."""


def pytest_configure(config):
    # Fixtures are torn down on Ctrl-C; let them be on a SIGTERM as well, and where a shell
    # started us in the background and SIGINT is ignored, here and by inheritance in every node.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)


@pytest.fixture(scope="session")
def workspace_env():
    """Environment of a shell that has sourced the workspace."""
    setup = WORKSPACE / "devel/setup.bash"
    if not setup.is_file():
        pytest.fail(f"{setup} is missing; make it with: make setup")
    done = subprocess.run(
        ["bash", "-c", 'source "$1" && env -0', "bash", str(setup)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        check=True,
    )
    return dict(
        os.fsdecode(pair).split("=", 1) for pair in done.stdout.split(b"\0") if b"=" in pair
    )


@pytest.fixture(scope="session")
def ros_home():
    """A ROS home of this run, for child processes."""
    with tempfile.TemporaryDirectory(prefix="cassandra_ros_home_") as folder:
        yield Path(folder)


@pytest.fixture(scope="session")
def ros_env(workspace_env, ros_home):
    """Environment for programs of the package, without a master."""
    from cassandra_ros.local_server.paths import jars_directory

    env = {name: value for name, value in workspace_env.items() if name != "ROS_HOSTNAME"}
    env.update(
        ROS_HOME=str(ros_home),
        ROS_LOG_DIR=str(ros_home / "log"),
        ROS_IP="127.0.0.1",
        CASSANDRA_ROS_JARS=str(jars_directory()),
        PYTHONUNBUFFERED="1",
    )
    return env


@pytest.fixture(scope="session")
def cassandra():
    """The Cassandra of this run: .host and .port."""
    from cassandra_ros.errors import ServerError
    from cassandra_ros.local_server import LocalCluster, free_port

    running = os.environ.get("CASSANDRA_ROS_TEST_SERVER")
    if running:
        host, _, port = running.rpartition(":")
        yield CassandraServer(host, int(port))
        return
    folder = tempfile.mkdtemp(prefix="cassandra_ros_server_")
    cluster = LocalCluster(folder, port=free_port(), heap="1G")
    try:
        cluster.start(die_with_us=True)
        yield CassandraServer(cluster.settings.host, cluster.settings.port)
    finally:
        pids = [node.pid for node in cluster.status() if node.pid]
        try:
            cluster.stop()
        except ServerError:
            for pid in pids:
                os.kill(pid, signal.SIGKILL)
            raise
        finally:
            shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture(scope="session")
def cql(cassandra):
    """A session of the bare driver: the measure that our own store is compared with."""
    import socket

    from cassandra.cluster import EXEC_PROFILE_DEFAULT, Cluster, ExecutionProfile
    from cassandra.policies import WhiteListRoundRobinPolicy
    from cassandra.query import tuple_factory

    profile = ExecutionProfile(
        load_balancing_policy=WhiteListRoundRobinPolicy([cassandra.host]),
        request_timeout=60,
        row_factory=tuple_factory,
    )
    cluster = Cluster(
        [cassandra.host],
        port=cassandra.port,
        protocol_version=5,
        execution_profiles={EXEC_PROFILE_DEFAULT: profile},
        sockopts=[(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)],
    )
    try:
        yield cluster.connect()
    finally:
        cluster.shutdown()


@pytest.fixture
def keyspace(cql):
    """Name of a keyspace of this test alone; it does not exist yet, and is dropped afterwards."""
    name = f"t_{uuid.uuid4().hex[:16]}"
    yield name
    cql.execute(f"DROP KEYSPACE IF EXISTS {name}")


@pytest.fixture
def rosCas(cassandra, keyspace):
    """A RosCassandra that is connected to a fresh keyspace."""
    from cassandra_ros import RosCassandra

    with RosCassandra(cassandra.host, cassandra.port) as store:
        store.connectToKeyspace(keyspace)
        yield store


@pytest.fixture(scope="session")
def roscore(ros_env):
    """The master of this run: .uri, and .env for child processes."""
    from cassandra_ros.local_server import free_port
    from cassandra_ros.local_server.processes import spawn

    port = free_port()
    env = dict(ros_env, ROS_MASTER_URI=f"http://127.0.0.1:{port}")
    log = Path(env["ROS_HOME"]) / "roscore.log"
    process = spawn(["roscore", "-p", str(port)], log, env, die_with_us=True)
    try:
        _await_master(env["ROS_MASTER_URI"], process, log)
        yield RosMaster(env["ROS_MASTER_URI"], env)
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()


def _await_master(uri, process, log):
    """Wait for the master and for its rosout node, whose topics would appear later."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and process.poll() is None:
        try:
            state = xmlrpc.client.ServerProxy(uri).getSystemState("/cassandra_ros_tests")[2]
            if any(topic == "/rosout" for topic, _ in state[1]):
                return
        except OSError:
            pass
        time.sleep(0.1)
    pytest.fail(f"roscore does not answer at {uri}:\n{log.read_text(errors='replace')[-2000:]}")


@pytest.fixture(scope="session")
def bags():
    """The folder of the test bags."""
    named = os.environ.get("CASSANDRA_ROS_BAGS")
    folder = Path(named) if named else ROOT.parent / "shared/data/bags"
    if not folder.is_dir():
        text = f"no test bags in {folder}; name their folder in CASSANDRA_ROS_BAGS"
        if os.environ.get("CI") == "true":
            pytest.fail(text)
        pytest.skip(text)
    return folder
