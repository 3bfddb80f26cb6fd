# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the tests share: one real Cassandra and one real roscore a run, a keyspace a test."""

from __future__ import annotations

import contextlib
import functools
import gc
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import xmlrpc.client
import zlib
from dataclasses import dataclass
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from keyspaces import Keyspaces, new_name
from proxy import Proxy
from suites import CAMPAIGN, ROUNDS, SLOW_SEC, SUITE, runs, suite_mark

ROOT = Path(__file__).resolve().parent.parent
WORKSPACE = Path(os.environ.get("CASSANDRA_ROS_TEST_WORKSPACE", ROOT / ".ws"))
"""The built workspace; other_python.py names that of another Python."""

# The generated messages; a shell that has sourced the workspace names the folder already.
GENERATED = WORKSPACE / "devel/lib/python3/dist-packages"
if str(GENERATED) not in sys.path:
    sys.path.append(str(GENERATED))

SERVER_VARIABLE = "CASSANDRA_ROS_TEST_SERVER"
"""Names a running server, host:port, that the tests use instead of one of their own."""

# The servers of single tests live for seconds: the second compiler would take more time than it
# saves, at a start more than half.
ONE_COMPILER = "-XX:TieredStopAtLevel=1"

# Nothing is synced to the disk of the server that all share: it is never killed, those that are
# have their own. A table is made in a third of the time. Here the second compiler pays: each change
# of the schema reads all of it, which takes a quarter less of the processor then. But it took a
# sixth of the server's time; with four times the usual thresholds it compiles less, and an eighth
# of the server's time is saved.
SHARED = (
    "-XX:+UseTransparentHugePages "
    "-XX:Tier4InvocationThreshold=20000 -XX:Tier4MinInvocationThreshold=2400 "
    "-XX:Tier4CompileThreshold=60000 -XX:Tier4BackEdgeThreshold=160000 "
    "-Dcassandra.unsafesystem=true -Dcassandra.config.allow_system_properties=true "
    "-Dcassandra.settings.commitlog_sync=periodic "
    "-Dcassandra.settings.commitlog_sync_period=10000ms"
)

MEMORY = Path("/dev/shm")  # noqa: S108 - a name in it is made by mkdtemp
MEMORY_FREE = 4 << 30
"""Minimum free space of MEMORY for that server to keep its files there, bytes."""

NO_MASTER = "http://127.0.0.1:1/"
"""Connections are refused there at once. A test that needs a master uses the fixture roscore."""

BEGAN = pytest.StashKey[float]()
"""Beginning of the session, s of the monotonic clock."""
LAST = "cassandra_ros/{}"
"""Key of pytest's cache under which a suite's last whole run is kept."""
REASON = "reason"
"""Name of a test's property that says why it takes more than SLOW_SEC in make test."""

ONE_BY_ONE = {
    "replays": {
        "test_history_subscriber.py",
        "test_launch.py",
        "test_player.py",
        "test_player_behaviour.py",
        "test_player_windows.py",
        "test_examples.py",
    },
    "recorders": {"test_recorder.py", "test_recorder_control.py", "test_query_server.py"},
    "programs": {"nodes", "rostest", "test_import_process.py"},
    "servers": {"local_server"},
    "faults": {"test_faults.py"},
    "pages": {"browser"},
    "sources": {"test_imports.py"},
}
"""Tests that run one after the other on a worker, by folder or file."""
PARTS = {"faults": 3}
"""Number of workers for such tests where it is not one: these wait most of the time."""


@dataclass(frozen=True)
class CassandraServer:
    host: str
    port: int


@dataclass(frozen=True)
class RosMaster:
    uri: str
    env: dict[str, str]
    """Environment for child processes: workspace, master, ROS home and log of this run."""


def pytest_addoption(parser):
    group = parser.getgroup("hostile", "changed inputs for each reader of foreign data")
    text = "number of inputs of each target (default: by the suite)"
    group.addoption("--inputs", type=int, metavar="N", help=text)
    text = "number of the first input (default: %(default)s)"
    group.addoption("--first", type=int, default=0, metavar="N", help=text)
    text = "go on after a failure, and tell one of each kind at the end"
    group.addoption("--every", action="store_true", help=text)


def pytest_configure(config):
    # Fixtures are torn down on Ctrl-C. Tear them down on SIGTERM, too, and where a shell
    # started us in the background and SIGINT is ignored, here and by inheritance in every node.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # nohup ignores it
    os.environ.setdefault("JAVA_TOOL_OPTIONS", ONE_COMPILER)
    # The developer may have a cluster that requires a login, and a local one with data to lose.
    os.environ["CASSANDRA_ROS_CQLSHRC"] = os.devnull
    os.environ.pop("CASSANDRA_ROS_DIR", None)
    # A master may run on this machine, with topics called as ours: only the tests' own is asked.
    os.environ["ROS_MASTER_URI"] = NO_MASTER


def pytest_sessionstart(session):
    session.config.stash[BEGAN] = time.monotonic()
    # With workers (pytest -n) the server is ours, for they end one after the other.
    config = session.config
    if not getattr(config.option, "numprocesses", None) or SERVER_VARIABLE in os.environ:
        return
    server = contextlib.ExitStack()
    config.add_cleanup(server.close)
    running = server.enter_context(_local_server())
    server.enter_context(pytest.MonkeyPatch.context()).setenv(
        SERVER_VARIABLE, f"{running.host}:{running.port}"
    )


# What needs more examples says so; what needs many is a search, see suites.py. On a busy machine
# examples take long.
settings.register_profile(
    "suite",
    max_examples=50 if CAMPAIGN else 25,
    derandomize=not CAMPAIGN,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("suite")


def pytest_generate_tests(metafunc):
    if ROUNDS > 1 and metafunc.definition.get_closest_marker("fault"):
        metafunc.fixturenames.append("_round")
        metafunc.parametrize("_round", range(ROUNDS))


def pytest_collection_modifyitems(config, items):
    """Leave the tests of larger suites to these; see suites.py."""
    config.hook.pytest_deselected(items=[item for item in items if not runs(item)])
    items[:] = filter(runs, items)
    for item in items:
        mark = suite_mark(item)
        if mark is not None:
            item.user_properties.append((REASON, mark.args[1]))
    if hasattr(config, "workerinput"):
        # What takes long begins first, so that no worker is left alone with it at the end. The
        # tests of a scope stay in their order.
        items.sort(key=lambda item: suite_mark(item) is None or _scope(item.nodeid) != item.nodeid)


def pytest_collection_finish():
    # What is there now stays to the end; it need not be looked at whenever garbage is collected.
    gc.freeze()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    from xdist.scheduler import LoadScopeScheduling

    class Scheduling(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            return _scope(nodeid)

    return Scheduling(config, log)


def _scope(nodeid):
    """Return the name of the tests that run one after the other, on one worker, with this one.

    What starts programs and waits for them shares few workers: more at a time are too many for a
    small machine. So does what looks at all sources, which are parsed once then.
    """
    module = nodeid.split("::")[0]
    for scope, places in ONE_BY_ONE.items():
        if places.intersection(module.split("/")):
            part = zlib.crc32(nodeid.encode()) % PARTS.get(scope, 1)
            return f"{scope} {part}"
    return module if _shares(module) else nodeid


@functools.lru_cache(maxsize=None)
def _shares(module):
    """Tell whether the tests of a module share what is stored for them."""
    return 'scope="module"' in (ROOT / module).read_text(encoding="utf-8")


def pytest_report_header(config):
    """Say what will run, and how long that took last time."""
    workers = getattr(config.option, "numprocesses", None)
    server = os.environ.get(SERVER_VARIABLE, "a Cassandra of its own")
    line = f"suite {SUITE}, on {server}"
    line += f", with {workers} workers and a roscore each" if workers else ", with a roscore"
    last = config.cache.get(LAST.format(SUITE), None) if hasattr(config, "cache") else None
    if last is not None:
        line += f"; last time: {last['tests']:,} tests in {last['seconds'] / 60:.1f} minutes"
    return line


def pytest_terminal_summary(terminalreporter, config):
    reports = terminalreporter.getreports("passed")
    for report in reports:
        for name, value in report.user_properties:
            if name == "told":
                terminalreporter.write_line(value)
    slow = [report for report in reports if report.duration > SLOW_SEC]
    unexplained = [report for report in slow if REASON not in dict(report.user_properties)]
    if SUITE == "test" and unexplained:
        terminalreporter.section(f"over {SLOW_SEC:g} s, without a reason (see suites.py)")
        for report in sorted(unexplained, key=lambda report: -report.duration):
            terminalreporter.write_line(f"{report.duration:6.1f} s  {report.nodeid}")
    if _is_whole(config) and hasattr(config, "cache"):
        seconds = time.monotonic() - config.stash[BEGAN]
        config.cache.set(LAST.format(SUITE), {"tests": len(reports), "seconds": seconds})


def _is_whole(config):
    """Tell whether a run was asked for all tests of its suite."""
    chosen = (config.option.keyword, config.option.markexpr)
    return config.args_source == config.ArgsSource.TESTPATHS and not any(chosen)


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
    from cassandra_ros.local_server.jars import jars_directory

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
    running = os.environ.get(SERVER_VARIABLE)
    if running:
        host, _, port = running.rpartition(":")
        yield CassandraServer(host, int(port))
        return
    with _local_server() as server:
        yield server


@contextlib.contextmanager
def _local_server():
    from cassandra_ros.errors import ServerError
    from cassandra_ros.local_server import LocalCluster, free_port

    in_memory = MEMORY.is_dir() and shutil.disk_usage(MEMORY).free > MEMORY_FREE
    folder = tempfile.mkdtemp(prefix="cassandra_ros_server_", dir=MEMORY if in_memory else None)
    cluster = LocalCluster(folder, port=free_port(), heap="1G")
    try:
        with pytest.MonkeyPatch.context() as environment:
            environment.setenv("JAVA_TOOL_OPTIONS", SHARED)
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
        request_timeout=180,
        row_factory=tuple_factory,
    )
    cluster = Cluster(
        [cassandra.host],
        port=cassandra.port,
        protocol_version=5,
        execution_profiles={EXEC_PROFILE_DEFAULT: profile},
        sockopts=[(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)],
        connect_timeout=180,
        control_connection_timeout=180,
        schema_metadata_enabled=False,
        token_metadata_enabled=False,
    )
    try:
        yield cluster.connect()
    finally:
        cluster.shutdown()


@pytest.fixture(scope="session")
def connect(cassandra):
    """Makes a RosCassandra on the server of this run, which answers."""
    from cassandra_ros import RosCassandra
    from cassandra_ros.errors import ConnectionFailed

    def make(**options):
        try:
            return RosCassandra(cassandra.host, cassandra.port, **options)
        except ConnectionFailed as exc:
            if exc.refused:
                raise
            # The machine stood still for longer than the driver waits.
            return RosCassandra(cassandra.host, cassandra.port, **options)

    return make


@pytest.fixture(scope="session")
def keyspaces(cql, connect):
    """Lends keyspaces."""
    lender = Keyspaces(cql, connect)
    yield lender
    lender.close()


@pytest.fixture
def keyspace(keyspaces):
    """Name of an empty keyspace of this test alone."""
    with keyspaces.lend() as name:
        yield name


@pytest.fixture
def new_keyspace(cql):
    """Name of a keyspace that does not exist yet, and is dropped afterwards."""
    name = new_name()
    yield name
    cql.execute(f"DROP KEYSPACE IF EXISTS {name}")


@pytest.fixture(scope="session")
def fresh(keyspaces, connect):
    """Makes a RosCassandra that is connected to an empty keyspace."""

    @contextlib.contextmanager
    def make():
        with keyspaces.lend() as name, connect(keyspace=name) as store:
            yield store

    return make


@pytest.fixture
def rosCas(keyspace, connect):
    """A RosCassandra that is connected to the keyspace of this test."""
    with connect(keyspace=keyspace) as store:
        yield store


@pytest.fixture
def call(cassandra, keyspace, capsys):
    """Run cassandra_bag in this process; return its exit status, output and errors."""
    from cassandra_ros.cli import cassandra_bag

    def run(*arguments, keyspace=keyspace):
        store = ("--host", cassandra.host, "--port", str(cassandra.port), "--keyspace", keyspace)
        try:
            status = cassandra_bag.main([*map(str, arguments), *store])
        except SystemExit as exc:
            status = exc.code
        out, err = capsys.readouterr()
        return status, out, err

    return run


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
            process.wait(60)
        except subprocess.TimeoutExpired:
            process.kill()


def _await_master(uri, process, log):
    """Wait for the master and for its rosout node, whose topics would appear later."""
    deadline = time.monotonic() + 180
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


@pytest.fixture
def make_certificate(tmp_path):
    """Return a function that makes a PEM file with a new key and its certificate.

    A certificate of 0 days has expired: OpenSSL 3.5 takes no negative number.
    """

    def make(name, days=2):
        key, request, made = (tmp_path / f"{name}.{kind}" for kind in ("key", "csr", "pem"))
        curve = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1"]
        _openssl(
            "req", "-new", *curve, "-nodes", "-subj", f"/CN={name}", "-keyout", key, "-out", request
        )
        _openssl("x509", "-req", "-in", request, "-signkey", key, "-days", days, "-out", made)
        made.write_text(made.read_text() + key.read_text())
        if not days:
            time.sleep(2)  # it is valid in the second in which it was made
        return made

    return make


def _openssl(*words):
    subprocess.run(["openssl", *map(str, words)], check=True, capture_output=True, timeout=180)


@pytest.fixture
def proxy(cassandra):
    with Proxy(cassandra.host, cassandra.port) as running:
        yield running


@pytest.fixture
def far(proxy, keyspace):
    """A RosCassandra behind the proxy, on the keyspace of the test."""
    from cassandra_ros import RosCassandra

    with RosCassandra(proxy.host, proxy.port, keyspace=keyspace) as store:
        yield store
