# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""~executeCQL: who may write, what stays data, and cursors that outlive the node."""

from __future__ import annotations

import json
import signal
import uuid
from contextlib import contextmanager

import pytest
from geometry_msgs.msg import TransformStamped
from nodes.children import start_client, start_node
from std_msgs.msg import Int64, String
from tf2_msgs.msg import TFMessage

from cassandra_ros import RosCassandra

T0 = 1_400_000_000 * 10**9
WRITES = (
    "delete from numbers where KEY > 0",
    "delete from numbers where data = 3",
    "  TRUNCATE numbers;",
    "create index on numbers (data)",
    "create index if not exists n on numbers (data)",
    "drop index if exists n",
)


@pytest.fixture(scope="module")
def client(roscore):
    with start_client(roscore) as child:
        yield child


@pytest.fixture(scope="module")
def store(cassandra, cql):
    name = f"t_{uuid.uuid4().hex[:16]}"
    with RosCassandra(cassandra.host, cassandra.port, keyspace=name) as rosCas:
        numbers = rosCas.addTopic("/numbers", format="ros")
        for n in range(20):
            for node in "ab":
                numbers.addData(Int64(data=n), key=T0 + n, nodeID=node)
        yield rosCas
    cql.execute(f"DROP KEYSPACE {name}")


@contextmanager
def serving(roscore, cassandra, store, name, *options, end=signal.SIGINT):
    where = ("--host", cassandra.host, "--port", cassandra.port, "--keyspace", store.keyspace)
    with start_node(roscore, "query_server", *where, f"__name:={name}", *options) as child:
        child.await_line("serving keyspace")
        yield child
        assert child.process.poll() is None, child.output
        assert child.end(end) == (0 if end == signal.SIGINT else -end)


@pytest.fixture(scope="module")
def read(roscore, cassandra, store, client):
    with serving(roscore, cassandra, store, "reading") as child:
        assert child.lines[1].endswith("read-only")
        yield lambda statement, *params, **more: client.call(
            "/reading/executeCQL", statement=statement, params=list(params), **more
        )


@pytest.fixture(scope="module")
def write(roscore, cassandra, store, client):
    with serving(roscore, cassandra, store, "writing", "_allow_writes:=true") as child:
        assert child.lines[1].endswith("writes are allowed")
        yield lambda statement, *params, **more: client.call(
            "/writing/executeCQL", statement=statement, params=list(params), **more
        )


def rows(answer):
    assert answer["success"], answer["message"]
    return [[json.loads(value) for value in row["values"]] for row in answer["rows"]]


def indexes(store, name):
    (topic,) = store.getAllTopics(name)  # asks the server, where getTopic may be 2 s late
    return set(topic.getMeta["indexes"])


# -------------------------------------------------------------------- who may write


@pytest.mark.parametrize("statement", WRITES)
def test_a_node_only_reads_unless_it_may_write(read, store, statement):
    answer = read(statement)
    assert not answer["success"]
    assert "_allow_writes:=true" in answer["message"]
    assert (answer["rows"], answer["columns"], answer["next_cursor"]) == ([], [], "")
    assert store.getTopic("numbers").countTopicData() == 40
    assert indexes(store, "/numbers") == set()
    assert rows(read("select count(*) from numbers")) == [[40]]


def test_a_mistake_is_told_before_the_right_to_write(read):
    assert "did you mean DELETE" in read("delet from numbers")["message"]
    assert "1 parameters, 0" in read("delete from numbers where data = ?")["message"]


def test_writes(write, store):
    topic = store.addTopic("/written", format="ros")
    for n in range(6):
        topic.addData(Int64(data=n), key=T0 + n // 2, nodeID="xy"[n % 2])
    answer = write("delete from written where KEY = ? and NODE = 'x'", str(T0))
    assert (rows(answer), answer["columns"]) == ([[1]], ["deleted"])
    assert rows(write("delete from written where data in ?", "[2, 3]", node_id="y")) == [[1]]
    assert rows(write("select data, NODE from written")) == [[1, "y"], [2, "x"], [4, "x"], [5, "y"]]
    assert rows(write("delete from written where KEY > 1400000000.0", limit=1)) == [[3]]
    answer = write("truncate written", node_id="x")
    assert not answer["success"] and "NODE" in answer["message"]
    assert rows(write("truncate written")) == []
    assert topic.countTopicData() == 0
    answer = write("create index w on written (data)")
    assert (rows(answer), answer["columns"]) == ([], [])
    assert indexes(store, "/written") == {"data"}
    assert rows(write("drop index w")) == []
    assert indexes(store, "/written") == set()
    cursor = write("select KEY from numbers", limit=1)["next_cursor"]
    answer = write("delete from numbers where KEY > 0", cursor=cursor)
    assert not answer["success"] and "cursor" in answer["message"]
    assert store.getTopic("numbers").countTopicData() == 40


def test_an_option_allows_writes_too(roscore, cassandra, store, client):
    name = "optional"
    # What stands on the command line counts.
    with serving(roscore, cassandra, store, name, "--allow-writes", "_allow_writes:=false"):
        answer = client.call(f"/{name}/executeCQL", statement="delete from numbers where KEY = 5")
        assert not answer["success"] and "nanoseconds" in answer["message"]


def test_a_parameter_that_is_neither_true_nor_false(roscore):
    child = start_node(roscore, "query_server", "_allow_writes:=perhaps", "__name:=doubtful")
    assert child.wait() == 2
    assert "~allow_writes: 'perhaps' is neither true nor false" in child.output


HOSTILE = ["'; DROP KEYSPACE ros; -- ", '"x"; truncate "/numbers"', "/* */ ? %s \\", "\n ü ☃ '\""]


def test_hostile_names_and_values_stay_data(write, store):
    for name in HOSTILE:
        quoted = name.replace('"', '""')
        literal = name.replace("'", "''")
        topic = store.addTopic(name, format="ros")
        for number, text in enumerate((name, name * 2, "plain")):
            topic.addData(String(text), key=T0 + number, nodeID=name)
        asked = f"select data from \"{quoted}\" where NODE = '{literal}' and data = ?"
        assert rows(write(asked, json.dumps(name))) == [[name]]
        delete = f'delete from "{quoted}" where data = '
        assert rows(write(delete + f"'{literal}'", node_id=name)) == [[1]]
        assert rows(write(delete + "%s", json.dumps(name * 2), node_id=name)) == [[1]]
        assert not write(delete + f"'{name}'; truncate numbers; --'")["success"]
        assert not write(f'drop index "{quoted}"')["success"]
        assert not write("truncate " + name)["success"]
        assert rows(write(f'select data from "{quoted}"')) == [["plain"]]
    assert store.getTopic("numbers").countTopicData() == 40


# -------------------------------------------------------------------- pages


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGKILL])
def test_cursors_outlive_the_node(roscore, cassandra, store, client, end):
    topic = store.addTopic("/tf", format="ros")
    store.truncateTopic("/tf")
    for n in range(7):
        frames = [TransformStamped(child_frame_id=f"{n}{name}") for name in "abc"]
        topic.addData(TFMessage(frames), key=T0 + n)
    asked = {
        "executeCQL": {"statement": "select transforms.child_frame_id, KEY from tf limit 18"},
        "range": {"topic": "tf", "where": "transforms.child_frame_id != '3b'", "omit_yaml": True},
    }
    found = {name: [] for name in asked}
    cursors = dict.fromkeys(asked, "")
    for turn in range(4):
        name = "turning"
        with serving(roscore, cassandra, store, name, end=end):
            for service, request in asked.items():
                if turn and not cursors[service]:
                    continue
                answer = client.call(
                    f"/{name}/{service}", **request, limit=5, cursor=cursors[service]
                )
                assert answer["success"], answer["message"]
                found[service] += answer["rows" if "rows" in answer else "data"]
                cursors[service] = answer["next_cursor"]
        if turn == 0:
            # What was given is gone, and something comes in, before the cursor and behind it.
            topic.removeData(T0, T0)
            topic.addData(TFMessage([TransformStamped(child_frame_id="late")]), key=T0)
    shown = [json.loads(row["values"][0]) for row in found["executeCQL"]]
    assert shown == [f"{n}{name}" for n in range(6) for name in "abc"]
    assert [data["key"] - T0 for data in found["range"]] == list(range(7))
    assert not any(cursors.values())
