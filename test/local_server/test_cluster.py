# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The life of a real server, in one directory, from the first start to the last clear."""

from __future__ import annotations

import contextlib
import functools
import itertools
import json
import os
import re
import shutil
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
import zlib
from collections import Counter

import psutil
import pytest
from cassandra import ConsistencyLevel
from cassandra.cluster import EXEC_PROFILE_DEFAULT, Cluster, ExecutionProfile
from cassandra.policies import WhiteListRoundRobinPolicy
from cassandra.query import BatchStatement, BatchType, SimpleStatement
from nodes.children import PROGRAMS, Child
from std_msgs.msg import String
from suites import CAMPAIGN
from topics.by_index import await_built

from cassandra_ros import RosCassandra
from cassandra_ros.cli import cassandra_bag, local_cassandra
from cassandra_ros.errors import ServerError, StoreUnavailable
from cassandra_ros.local_server import LocalCluster, free_port, node_tool, preflight, processes
from cassandra_ros.local_server import cluster as cluster_module
from cassandra_ros.local_server.cluster_settings import change_settings, new_settings, save_settings
from cassandra_ros.local_server.commit_log import cut_torn_end
from cassandra_ros.local_server.cql import answers_cql
from cassandra_ros.local_server.processes import read_start


def make(folder, **options):
    said = []
    cluster = LocalCluster(folder, say=said.append, **options)
    cluster.said = said
    return cluster


@contextlib.contextmanager
def session(cluster):
    """A session of the driver, on the first node."""
    host = cluster.settings.host
    profile = ExecutionProfile(WhiteListRoundRobinPolicy([host]), request_timeout=180)
    driver = Cluster(
        [host],
        port=cluster.settings.port,
        protocol_version=5,
        execution_profiles={EXEC_PROFILE_DEFAULT: profile},
        connect_timeout=180,
        control_connection_timeout=180,
        schema_metadata_enabled=False,
        token_metadata_enabled=False,
    )
    try:
        yield driver.connect()
    finally:
        driver.shutdown()


def ask(cluster, statement):
    """Answer of a statement, as a list of rows."""
    with session(cluster) as opened:
        return list(opened.execute(statement))


def await_answers(cluster):
    """Wait until all nodes answer: a busy one may take longer than status waits."""
    deadline = time.monotonic() + 180
    while not all(status.answers for status in cluster.status()):
        assert time.monotonic() < deadline, cluster.status()


def kill(cluster):
    pid = cluster.status()[0].pid
    os.kill(pid, signal.SIGKILL)
    while processes.command_line(pid):
        time.sleep(0.01)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A directory whose server has run, holds one row, and is stopped after each test."""
    folder = tmp_path_factory.mktemp("my servers") / "größe"  # names that need quoting
    cluster = make(folder, port=free_port())
    try:
        assert cluster.start(die_with_us=True)
        ask(
            cluster,
            "CREATE KEYSPACE k WITH replication = "
            "{'class': 'NetworkTopologyStrategy', 'datacenter1': 1}",
        )
        ask(cluster, "CREATE TABLE k.t (i int PRIMARY KEY, s text)")
        ask(cluster, "INSERT INTO k.t (i, s) VALUES (1, 'kept')")
        yield folder
    finally:
        cluster.stop()


def test_it_runs_and_a_second_start_does_nothing(folder):
    cluster = make(folder)
    await_answers(cluster)
    [status] = cluster.status()
    assert make(folder).start() is False
    assert cluster.status()[0].pid == status.pid
    assert read_start(status.node.pid_file).pid == status.pid


def test_it_listens_on_loopback_only(folder):
    pid = make(folder).status()[0].pid
    inodes = set()
    for fd in os.listdir(f"/proc/{pid}/fd"):
        with contextlib.suppress(FileNotFoundError):  # closed meanwhile
            inodes.add(os.readlink(f"/proc/{pid}/fd/{fd}"))
    with open("/proc/net/tcp") as table, open("/proc/net/tcp6") as table6:
        lines = [line.split() for line in [*table, *table6]]
    mine = [w[1] for w in lines if w[3] == "0A" and f"socket:[{w[9]}]" in inodes]
    assert len(mine) == 2  # CQL, and the storage port; no JMX
    assert all(address.startswith("0100007F:") for address in mine)


def test_other_options_while_it_runs_are_refused(folder):
    with pytest.raises(ServerError, match="runs already with other options.*stop it first"):
        make(folder, port=free_port()).start()
    with pytest.raises(ServerError, match=r"1 node\(s\), not 2.*clear --yes"):
        make(folder, nodes=2).start()
    with pytest.raises(ServerError, match="only several nodes have copies to compare"):
        make(folder).repair()


def test_it_is_not_cleared_while_it_runs(folder):
    with pytest.raises(ServerError, match="stop it first"):
        make(folder).clear()
    assert ask(make(folder), "SELECT s FROM k.t")[0].s == "kept"


def test_it_is_found_without_its_pid_file(folder):
    cluster = make(folder)
    [status] = cluster.status()
    status.node.pid_file.unlink()
    assert make(folder).status()[0].pid == status.pid
    assert make(folder).start() is False
    processes.write_start(status.node.pid_file, status.pid)


@pytest.mark.suite("all", "it starts or kills Cassandras")
def test_data_survive_stop_and_start(folder):
    cluster = make(folder)
    assert cluster.stop() is True
    assert cluster.stop() is False
    assert not cluster.status()[0].pid
    assert "Cassandra shutdown complete" in cluster.nodes[0].log.read_text()
    assert cluster.start(die_with_us=True)
    assert ask(cluster, "SELECT s FROM k.t")[0].s == "kept"


@pytest.mark.suite("all", "it starts a Cassandra")
def test_what_was_acknowledged_survives_kill_9(folder):
    cluster = make(folder)
    ask(cluster, "INSERT INTO k.t (i, s) VALUES (2, 'written last')")
    kill(cluster)
    assert not cluster.status()[0].pid
    # The pid in the file may belong to another process by now: ours, for example.
    cluster.nodes[0].pid_file.write_text(f"{os.getpid()} 1\n")  # which began at another time
    assert make(folder).status()[0].pid == 0
    assert make(folder).stop() is False
    assert cluster.start(die_with_us=True)
    assert [text for text in cluster.said if "stale" in text and f"pid {os.getpid()}" in text]
    assert ask(cluster, "SELECT s FROM k.t WHERE i = 2")[0].s == "written last"


def write_until_killed(cluster, session, after):
    """Keep 16 batches of 100 rows on their way; kill the server after a number of acknowledgements.

    Returns the numbers of the acknowledged batches, and how many were not when it was killed.
    """
    insert = session.prepare("INSERT INTO k.many (part, i, data) VALUES (?, ?, ?)")
    acknowledged, places, failed = [], threading.Semaphore(16), threading.Event()
    killer = threading.Thread(target=kill, args=(cluster,))

    def done(_rows, number):
        acknowledged.append(number)
        places.release()

    def lost(_exc):
        failed.set()
        places.release()

    for number in itertools.count():
        places.acquire()
        if failed.is_set():
            killer.join()
            for _ in range(15):
                places.acquire()  # all have their answer now
            return acknowledged, number - len(acknowledged)
        if len(acknowledged) >= after and killer.ident is None:
            killer.start()
        batch = BatchStatement(BatchType.UNLOGGED)
        for i in range(100):
            batch.add(insert, (number, i, os.urandom(300)))
        session.execute_async(batch).add_callbacks(done, lost, callback_args=(number,))
    raise AssertionError("the loop above returns")


@pytest.mark.suite("all", "it starts or kills Cassandras")
def test_batches_in_flight_survive_kill_9_as_far_as_they_were_acknowledged(folder):
    cluster = make(folder)
    ask(cluster, "CREATE TABLE k.many (part int, i int, data blob, PRIMARY KEY (part, i))")
    with session(cluster) as writer:
        acknowledged, others = write_until_killed(cluster, writer, after=150)
    assert others  # it was killed amid them
    assert cluster.start(die_with_us=True)
    found = Counter(row.part for row in ask(cluster, "SELECT part FROM k.many"))
    assert {number: found[number] for number in acknowledged} == dict.fromkeys(acknowledged, 100)
    assert set(found.values()) == {100}  # those, too, whose answer was on its way


def segments(cluster):
    """Files of the commit log, the last one first."""
    return sorted((cluster.nodes[0].directory / "commitlog").glob("*.log"), reverse=True)


@pytest.mark.suite("all", "it starts a Cassandra")
def test_it_starts_after_a_write_of_its_commit_log_that_was_cut_short(folder):
    cluster = make(folder)
    cluster.start(die_with_us=True)
    ask(cluster, "INSERT INTO k.t (i, s) VALUES (3, 'before')")
    ask(cluster, f"INSERT INTO k.t (i, s) VALUES (4, '{'x' * 100_000}')")
    kill(cluster)
    log = next(path for path in segments(cluster) if b"x" * 1000 in path.read_bytes())
    # As if it had been killed in the middle of the last write, which it had not acknowledged.
    os.truncate(log, log.read_bytes().rindex(b"x" * 1000) + 10)
    assert cluster.start(die_with_us=True)
    assert [text for text in cluster.said if text.startswith("cut ") and str(log) in text]
    assert {row.i: row.s for row in ask(cluster, "SELECT i, s FROM k.t WHERE i IN (1, 3, 4)")} == {
        1: "kept",
        3: "before",
    }


def write_segment(folder, number, *sections):
    """Write a segment of a commit log; return its path and the positions of its sections."""
    data, positions = struct.pack(">iqH", 8, number, 2) + b"{}" + b"crc ", []
    for content in sections:
        positions.append(len(data))
        place = struct.pack(">IIi", number & 0xFFFFFFFF, number >> 32, len(data))
        data += struct.pack(">II", len(data) + 8 + len(content), zlib.crc32(place)) + content
    path = folder / f"CommitLog-8-{number}.log"
    path.write_bytes(data)
    return path, [*positions, len(data)]


@pytest.mark.parametrize("missing, sections", [(0, 2), (1, 1), (30, 1), (31, 1), (38, 1), (39, 0)])
def test_only_the_last_section_of_a_commit_log_is_cut_off(tmp_path, missing, sections):
    number = 1795662573845
    before, (*_, end_before) = write_segment(tmp_path, number - 1, b"a" * 50)
    os.truncate(before, end_before - 1)
    log, positions = write_segment(tmp_path, number, b"b" * 50, b"c" * 30)
    write_segment(tmp_path, number + 1)  # made in advance
    left = positions[-1] - missing
    os.truncate(log, left)
    note = cut_torn_end(tmp_path)
    # Fewer bytes than a section begins with are taken for the end by Cassandra, too.
    torn = 0 if left < positions[sections] + 8 else left - positions[sections]
    assert note.startswith(f"cut {torn} bytes off the end of {log}") if torn else note == ""
    assert log.stat().st_size == left - torn
    assert before.stat().st_size == end_before - 1


@pytest.mark.suite("all", "it starts or kills Cassandras")
def test_a_table_is_there_or_not_after_kill_9_while_it_was_made(folder):
    cluster = make(folder)
    cluster.start(die_with_us=True)
    ask(cluster, "CREATE KEYSPACE made WITH replication = {'class': 'SimpleStrategy'}")
    numbers = itertools.count()
    for _ in range(3 if CAMPAIGN else 1):
        with session(cluster) as maker:
            futures = [
                maker.execute_async(f"CREATE TABLE made.t{next(numbers)} (i int PRIMARY KEY)")
                for _ in range(6)
            ]
            futures[0].result()
            kill(cluster)
        cluster.start(die_with_us=True)
        names = "SELECT table_name FROM system_schema.tables WHERE keyspace_name = 'made'"
        for row in ask(cluster, names):  # each table that is listed can be used
            assert not ask(cluster, f"SELECT * FROM made.{row.table_name}")


@pytest.mark.suite("all", "it starts a Cassandra")
def test_a_taken_port_is_refused_with_its_owner(folder):
    cluster = make(folder)
    cluster.stop()
    with socket.socket() as server:
        server.bind(("127.0.0.1", cluster.settings.port))
        server.listen()
        with pytest.raises(ServerError, match=rf"taken by .*\(pid {os.getpid()}\).*--port"):
            make(folder).start()
    assert not cluster.status()[0].pid


@pytest.mark.suite("all", "it starts a Cassandra")
def test_a_port_of_another_cassandra_is_refused_with_what_to_do(folder, cassandra, monkeypatch):
    make(folder).stop()
    patient = functools.partial(answers_cql, timeout_sec=60)
    monkeypatch.setattr(preflight, "answers_cql", patient)
    with pytest.raises(ServerError, match=r"speaks CQL(.|\n)*--host 127.0.0.1 --port"):
        make(folder, port=cassandra.port).start()


@pytest.fixture
def little_space(monkeypatch):
    usage = shutil.disk_usage("/")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=100 << 20))


def test_no_space(tmp_path, little_space):
    with pytest.raises(ServerError, match="no space: .* has 100 MiB free.*make room"):
        make(tmp_path / "new", port=free_port()).start()


def test_each_node_needs_its_space(tmp_path, monkeypatch):
    """There is enough for two nodes, and not for three: refused before anything is made."""
    usage = shutil.disk_usage("/")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=2000 << 20))
    assert preflight.make_directory(tmp_path / "two", 2) == ""
    with pytest.raises(ServerError, match="2000 MiB free, Cassandra needs 2304 MiB; make room"):
        preflight.make_directory(tmp_path / "three", 3)
    assert not (tmp_path / "three").exists()


def test_a_cluster_with_data_is_started_where_there_is_little_space(
    tmp_path, little_space, monkeypatch
):
    """What is stored can be read then, and deleted; the warning says what is missing."""
    started = []
    monkeypatch.setattr(LocalCluster, "_start_nodes", lambda self, nodes, _: started.append(nodes))
    for name in ("_await_answer", "_await_neighbours"):
        monkeypatch.setattr(LocalCluster, name, lambda *_: None)
    save_settings(tmp_path, change_settings(new_settings(), port=free_port()))
    cluster = make(tmp_path)
    assert cluster.exists and cluster.start()
    assert [node.number for nodes in started for node in nodes] == [1]
    assert "has 100 MiB free, Cassandra needs 768 MiB; make room" in cluster.said[0]


@pytest.mark.suite("all", "it starts or kills Cassandras")
def test_data_are_read_where_there_is_little_space(folder, little_space):
    cluster = make(folder)
    cluster.stop()
    assert cluster.start(die_with_us=True)
    assert "has 100 MiB free, Cassandra needs 768 MiB; make room" in cluster.said[0]
    assert ask(cluster, "SELECT key FROM system.local")
    cluster.stop()


@pytest.mark.suite("all", "it starts a Cassandra")
def test_data_of_another_cluster_are_refused(folder):
    cluster = make(folder)
    cluster.stop()
    path = folder / "cluster.json"
    before = path.read_text()
    path.write_text(json.dumps({**json.loads(before), "cluster_name": "another"}))
    try:
        with pytest.raises(ServerError) as caught:
            make(folder).start(die_with_us=True)
    finally:
        path.write_text(before)
    text = str(caught.value)
    assert "data of another cluster" in text
    assert str(cluster.nodes[0].log) in text  # where the log is, and its last lines
    assert "Saved cluster name" in text
    assert not make(folder).status()[0].pid


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_failure_of_java_itself_is_shown(folder):
    cluster = make(folder, heap="900G")
    cluster.stop()
    with pytest.raises(ServerError, match=r"heap(.|\n)*console.log"):
        cluster.start(die_with_us=True)
    with pytest.raises(ServerError, match="ended by itself"):
        cluster.wait()


@pytest.mark.suite("test", "clear")
def test_one_that_is_cleared_is_new(folder):
    """Last: nothing is left of the data, and the jars stay."""
    cluster = make(folder, heap="512M")
    cluster.stop()
    assert cluster.clear() is True
    assert cluster.clear() is False
    assert not list(folder.glob("node*"))
    assert make(folder).exists is False
    assert make(folder).stop() is False


def connect(cluster, **options):
    return RosCassandra(
        cluster.settings.address(3), cluster.settings.port, keyspace="robot", **options
    )


def nodes_asked(rosCas):
    listed = rosCas.cassandra.execute_on_each("SELECT key FROM system.local", what="asking each")
    return len(listed)


@pytest.mark.suite("all", "it starts or kills Cassandras")
def test_three_nodes(tmp_path, monkeypatch, caplog, capsys):
    monkeypatch.setattr(cluster_module, "START_TIMEOUT_SEC", 600.0)
    monkeypatch.setattr(cluster_module, "_NEIGHBOUR_TIMEOUT_SEC", 120.0)
    cluster = make(tmp_path, nodes=3, host="127.0.0.11", port=free_port(), heap="256M")
    try:
        assert cluster.start(die_with_us=True)
        assert (
            "starting 3 nodes with a Java heap of 256 MiB each: about 2118 MiB" in cluster.said[0]
        )
        # Nothing less than all three will do, and at once.
        ask(
            cluster,
            "CREATE KEYSPACE k WITH replication = "
            "{'class': 'NetworkTopologyStrategy', 'datacenter1': 3}",
        )
        ask(cluster, "CREATE TABLE k.t (i int PRIMARY KEY)")
        insert = SimpleStatement(
            "INSERT INTO k.t (i) VALUES (1)", consistency_level=ConsistencyLevel.ALL
        )
        ask(cluster, insert)
        with connect(cluster) as rosCas:
            assert nodes_asked(rosCas) == 3
            topic = rosCas.addTopic("/t", msg_type="std_msgs/String", nodeID="n")
            assert "making keyspace robot: 3 nodes have to agree" in caplog.text
            for number in range(20):
                topic.addData(String(str(number % 5)), key=number)
            assert topic.createIndex("data") == 20
            assert topic.countTopicData(where="data = '3'") == 4
            assert list(await_built(rosCas).values()) == [[(True,)]] * 3
            ((options,),) = rosCas.cassandra.execute(
                "SELECT compaction FROM system_schema.tables "
                "WHERE keyspace_name = ? AND table_name = ?",
                ("robot", topic.tables[0].name),
            )
            assert options.get("enabled", "true") == "true"
        # One that died is started alone.
        kill(cluster)
        assert [bool(s.pid) for s in cluster.status()] == [False, True, True]
        with connect(cluster) as rosCas:
            assert nodes_asked(rosCas) == 2
            assert rosCas.getTopic("/t").countTopicData(where="data = '3'") == 4
            # With two dead it is said which one answers, and what is needed.
            os.kill(cluster.status()[1].pid, signal.SIGKILL)
            table = rosCas.getTopic("/t").tables[0].qualified
            with pytest.raises(StoreUnavailable) as failed:
                rosCas.cassandra.execute(f"SELECT * FROM {table}", what="reading", retry_sec=60)
        text = str(failed.value)
        assert "no Cassandra node answers" not in text
        assert "of 3 nodes 127.0.0.13 answers and 127.0.0.11, 127.0.0.12 does not" in text
        assert "LOCAL_QUORUM needs more than half of the copies of a row" in text
        assert "read with consistency='ONE' (programs: --consistency ONE)" in text
        with connect(cluster, consistency="ONE") as rosCas:
            assert [m.data for _, m in rosCas.getTopic("/t").items()] == [
                str(n % 5) for n in range(20)
            ]
        where = ["--host", cluster.settings.address(3), "--port", str(cluster.settings.port)]
        where += ["--keyspace", "robot"]
        assert cassandra_bag.main(["list", *where, "--consistency", "ONE"]) == 0
        assert "/t" in capsys.readouterr().out
        assert make(tmp_path).start(die_with_us=True)
        await_answers(make(tmp_path))
        ask(cluster, insert)
    finally:
        make(tmp_path).stop()
    assert not any(status.pid for status in make(tmp_path).status())


def count_on(cluster, number, table):
    """Count the rows that one node has itself."""
    host = cluster.settings.address(number)
    profile = ExecutionProfile(WhiteListRoundRobinPolicy([host]), request_timeout=180)
    driver = Cluster(
        [host],
        port=cluster.settings.port,
        execution_profiles={EXEC_PROFILE_DEFAULT: profile},
        connect_timeout=180,
        control_connection_timeout=180,
    )
    try:
        asked = SimpleStatement(
            f"SELECT count(*) FROM {table}", consistency_level=ConsistencyLevel.ONE
        )
        return driver.connect().execute(asked).one()[0]
    finally:
        driver.shutdown()


@pytest.mark.suite("campaign", "three Cassandras, and minutes")
def test_a_node_whose_data_are_lost_comes_back(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(cluster_module, "START_TIMEOUT_SEC", 600.0)
    monkeypatch.setattr(cluster_module, "_NEIGHBOUR_TIMEOUT_SEC", 120.0)
    cluster = make(tmp_path, nodes=3, host="127.0.0.21", port=free_port(), heap="256M")
    try:
        assert cluster.start(die_with_us=True)
        with pytest.raises(ServerError, match="node 2 runs"):
            cluster.replace(2)
        with pytest.raises(ServerError, match="there is no node 4"):
            cluster.replace(4)
        pids = [status.pid for status in cluster.status()]
        with connect(cluster) as rosCas:
            topic = rosCas.addTopic("/t", format="ros", msg_type="std_msgs/String")
            for number in range(20):
                topic.addData(String(str(number)), key=number)
            table = topic.tables[0].qualified
            assert nodes_asked(rosCas) == 3
        os.kill(pids[1], signal.SIGKILL)
        while processes.command_line(pids[1]):
            time.sleep(0.01)
        with pytest.raises(ServerError, match="node 2 has data"):
            cluster.replace(2)
        shutil.rmtree(tmp_path / "node2" / "data")
        shutil.rmtree(tmp_path / "node2" / "commitlog", ignore_errors=True)
        cluster = make(tmp_path)
        with pytest.raises(ServerError, match="bring it back with: local_cassandra replace N"):
            cluster.start(die_with_us=True)
        await_nodes(cluster, [1, 3])
        with pytest.raises(ServerError, match="node 1 runs"):
            cluster.replace(1)
        # A replacement that was interrupted has left a part of the data.
        (tmp_path / "node2" / "data" / "robot").mkdir(parents=True)
        (tmp_path / "node2" / "replacing").touch()
        with pytest.raises(ServerError, match="only a part of its data.* replace 2"):
            cluster.start(die_with_us=True)
        cluster.replace(2, die_with_us=True)
        await_answers(cluster)
        assert [count_on(cluster, number, table) for number in (1, 2, 3)] == [20, 20, 20]
        with connect(cluster) as rosCas:
            assert nodes_asked(rosCas) == 3
            assert [m.data for _, m in rosCas.getTopic("/t").items()] == [str(n) for n in range(20)]
        # Where only a keyspace is lost, the node starts, and repair sends it what it lacks.
        pid = cluster.status()[1].pid
        os.kill(pid, signal.SIGKILL)
        while processes.command_line(pid):
            time.sleep(0.01)
        with pytest.raises(ServerError, match="node 2 does not answer"):
            cluster.repair()
        shutil.rmtree(tmp_path / "node2" / "data" / "robot")
        shutil.rmtree(tmp_path / "node2" / "commitlog")
        assert cluster.start(die_with_us=True)
        await_answers(cluster)
        assert count_on(cluster, 2, table) == 0
        # A repair that was killed has left its door open, and the password of it.
        left = tmp_path / "node2" / "jmx_left"
        left.mkdir()
        node_tool._jmx_port(cluster.nodes[1], cluster.status()[1].pid, left).__enter__()
        cluster.repair()
        assert not list(tmp_path.glob("node2/jmx_*"))
        assert count_on(cluster, 2, table) == 20
        await_answers(cluster)
        capsys.readouterr()
        words = ["status", "--wait", "180", "--dir", str(tmp_path)]
        assert local_cassandra.main(words) == 0
        out = capsys.readouterr().out
        assert len(re.findall(r"node \d .* answers, pid \d+, [\d.]+ MB of memory, ", out)) == 3
        assert len(re.findall(r"  keyspaces: robot [\d.]+ [kKM]?B", out)) == 3
        # Its door for commands is closed again.
        pid = cluster.status()[1].pid
        assert "jmx.local.port" not in " ".join(processes.command_line(pid))
    finally:
        make(tmp_path).stop()


def await_nodes(cluster, numbers):
    """Wait until some nodes answer."""
    deadline = time.monotonic() + 180
    while not all(status.answers for status in cluster.status() if status.node.number in numbers):
        assert time.monotonic() < deadline, cluster.status()


@pytest.mark.suite("all", "it starts or kills Cassandras")
def test_who_has_not_started_a_server_does_not_stop_it(tmp_path):
    """Two launch files run it at once; one of them ends."""
    command = [PROGRAMS / "local_cassandra", "run", "--dir", tmp_path, "--port", str(free_port())]
    with Child(command, os.environ) as one, Child(command, os.environ) as other:
        for child in (one, other):
            child.await_line("Cassandra answers at", 300)
        pid = make(tmp_path).status()[0].pid
        owner, guest = one, other
        if psutil.Process(pid).ppid() != one.process.pid:
            owner, guest = other, one
        assert psutil.Process(pid).ppid() == owner.process.pid
        assert guest.end() == 0, guest.output
        assert make(tmp_path).status()[0].pid == pid
        assert "stopped" not in guest.output
        assert owner.end() == 0, owner.output
        assert "stopped" in owner.output
    assert not make(tmp_path).status()[0].pid


@pytest.mark.suite("all", "it starts or kills Cassandras")
def test_two_starts_at_once_make_one_server(tmp_path):
    program = (
        "import sys; from cassandra_ros.local_server import LocalCluster\n"
        "print(LocalCluster(sys.argv[1], port=int(sys.argv[2])).start())"
    )
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", program, str(tmp_path), str(free_port())]
    try:
        starts = [
            subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=env) for _ in "12"
        ]
        assert sorted(start.communicate()[0] for start in starts) == ["False\n", "True\n"]
        await_answers(make(tmp_path))
    finally:
        make(tmp_path).stop()
