# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Services that may write: who is allowed to, what stays data, cursors that outlive the node."""

from __future__ import annotations

import json
import signal
import subprocess
import uuid
from contextlib import contextmanager

import pytest
import yaml
from geometry_msgs.msg import TransformStamped
from nodes.children import start_client, start_node, told
from std_msgs.msg import Int64, String
from suites import sparing
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
        assert told(child)[1].endswith("read-only")
        yield lambda statement, *params, **more: client.call(
            "/reading/executeCQL", statement=statement, params=list(params), **more
        )


@pytest.fixture(scope="module")
def write(roscore, cassandra, store, client):
    with serving(roscore, cassandra, store, "writing", "_allow_writes:=true") as child:
        assert told(child)[1].endswith("writes are allowed")
        yield lambda statement, *params, **more: client.call(
            "/writing/executeCQL", statement=statement, params=list(params), **more
        )


def rows(answer):
    assert answer["success"], answer["message"]
    return [[json.loads(value) for value in row["values"]] for row in answer["rows"]]


def indexes(store, name):
    (topic,) = store.getAllTopics(name)  # asks the server, where getTopic may be 2 s late
    return set(topic.getMeta["indexes"])


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


@pytest.mark.suite("all", "make test asks others of its kind")
def test_an_option_allows_writes_too(roscore, cassandra, store, client):
    name = "optional"
    # What stands on the command line counts.
    with serving(roscore, cassandra, store, name, "--allow-writes", "_allow_writes:=false"):
        answer = client.call(f"/{name}/executeCQL", statement="delete from numbers where KEY = 5")
        assert not answer["success"] and "nanoseconds" in answer["message"]


@pytest.mark.suite("all", "make test asks others of its kind")
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


@pytest.mark.suite("all", "it kills or cuts something, and waits")
@pytest.mark.parametrize("end", sparing([signal.SIGINT, signal.SIGKILL], kept=[signal.SIGKILL]))
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
            # Returned messages are deleted, and new ones come before and after the cursor.
            topic.removeData(T0, T0)
            topic.addData(TFMessage([TransformStamped(child_frame_id="late")]), key=T0)
    shown = [json.loads(row["values"][0]) for row in found["executeCQL"]]
    assert shown == [f"{n}{name}" for n in range(6) for name in "abc"]
    assert [data["key"] - T0 for data in found["range"]] == list(range(7))
    assert not any(cursors.values())


def typed(roscore, service, request):
    """Call a service as a person does in a shell; return what is printed, as YAML reads it."""
    words = ["rosservice", "call", service, request]
    done = subprocess.run(words, env=roscore.env, capture_output=True, text=True, check=True)
    return yaml.safe_load(done.stdout)


@pytest.mark.suite("test", "services as a person types them")
def test_a_message_typed_into_a_shell_is_stored_told_and_removed(roscore, write, store):
    """By rosservice alone."""
    what = "topic: /typed, type: std_msgs/String, yaml: 'data: hello'"
    added = typed(roscore, "/writing/addData", f"{{{what}, key_text: '{T0}'}}")
    assert (added["success"], added["message"]) == (True, "")
    assert added["key"] == {"secs": T0 // 10**9, "nsecs": 0}
    assert added["key_text"] == str(T0)
    assert store.getTopic("/typed").getData(T0).data == "hello"
    told = typed(roscore, "/writing/info", "{topics: [/typed]}")
    assert (told["success"], told["keyspace"]) == (True, store.keyspace)
    assert [(t["topic"], t["type"], t["messages"]) for t in told["topics"]] == [
        ("/typed", "std_msgs/String", 1)
    ]
    assert told["topics"][0]["first"] == told["topics"][0]["last"] == added["key"]
    text = typed(roscore, "/writing/explainCQL", "{statement: 'select data from typed'}")["text"]
    assert "rows returned: 1" in text
    gone = typed(roscore, "/writing/removeData", f"{{topic: /typed, key_text: '{T0}'}}")
    assert (gone["success"], gone["messages"]) == (True, 1)
    assert store.getTopic("/typed").countTopicData() == 0


def test_nothing_is_added_or_removed_where_only_reading_is_allowed(read, client, store):
    for service, more in (("addData", {"yaml": "data: 1"}), ("removeData", {"where": "data > 3"})):
        answer = client.call(f"/reading/{service}", topic="/numbers", **more)
        assert not answer["success"]
        assert "_allow_writes:=true" in answer["message"]
    told = client.call("/reading/info", node_id="a")
    assert [(t["topic"], t["messages"]) for t in told["topics"]] == [("/numbers", 20)]
    assert not client.call("/reading/info", topics=["/number"])["success"]
    assert store.getTopic("/numbers").countTopicData() == 40


def test_messages_are_added_as_bytes_or_yaml(write, client, store):
    def add(**request):
        return client.call("/writing/addData", **request)

    wire = (5).to_bytes(8, "little")
    kind = {"type": "std_msgs/Int64", "format": "packed"}
    first = add(topic="/added", data=list(wire), node_id="a", **kind)
    assert first["success"], first["message"]
    topic = store.getTopic("/added")
    assert topic.getMeta["format"] == "packed"
    assert topic.getData(int(first["key_text"])).data == 5
    # The type is known now; times may be typed in any form.
    assert add(topic="added", yaml="[7]", key_text="2014-05-13T16:53:20Z")["key"] == T0
    assert add(topic="added", yaml="{}", key=T0 + 1)["key_text"] == str(T0 + 1)
    assert add(topic="added", yaml="8", key=T0 + 2)["success"]
    values = [(row.t, row.message().data, row.node) for row in topic.rows(T0, T0 + 2)]
    assert values == [(T0, 7, ""), (T0 + 1, 0, ""), (T0 + 2, 8, "")]
    # A type that is nowhere installed comes with its definition.
    mine = {"type": "my_msgs/Pair", "definition": "int8 a\nint8 b\n"}
    assert add(topic="/pairs", data=[1, 2], **mine)["success"]
    assert add(topic="/pairs", yaml="{a: 3, b: 4}")["success"]
    rows_ = client.call("/writing/executeCQL", statement="select a, b from pairs")["rows"]
    assert [row["values"] for row in rows_] == [["1", "2"], ["3", "4"]]
    store.addTopic("/places", key_format="manual", msg_type="std_msgs/String")
    named = add(topic="/places", yaml="data: x", key_text="kitchen")
    assert (named["success"], named["key_text"]) == (True, "kitchen")
    assert store.getTopic("/places").getData("kitchen").data == "x"


@pytest.mark.parametrize(
    ("request_", "word"),
    [
        ({"topic": "/new", "yaml": "data: 1"}, "give the type"),
        ({"topic": "/new", "type": "a/B", "yaml": "data: 1"}, "not installed"),
        ({"topic": "/new", "type": "a/B", "definition": "int8 = ", "data": [1]}, "a/B"),
        ({"topic": "/new", "type": "std_msgs/Int64", "md5sum": "1" * 32}, "give definition"),
        ({"topic": "/numbers", "type": "std_msgs/String", "yaml": "data: x"}, "std_msgs/Int64"),
        ({"topic": "/numbers", "data": [1] * 7}, "7 bytes are no std_msgs/Int64"),
        ({"topic": "/numbers", "data": [1] * 9}, "9 bytes are no std_msgs/Int64"),
        ({"topic": "/numbers"}, "0 bytes are no std_msgs/Int64"),
        ({"topic": "/numbers", "yaml": "data: x"}, "Int64"),
        ({"topic": "/numbers", "yaml": "date: 3"}, "date"),
        ({"topic": "/numbers", "yaml": "[1, 2]"}, "the YAML is no"),
        # Ten times as many values in each turn, which an error text would show.
        ({"topic": "/numbers", "yaml": "[[&a [1, 1], &b [*a, *a], *b, *b]]"}, "alias"),
        ({"topic": "/numbers", "yaml": "!!python/object:os.system {}"}, "the YAML is no"),
        ({"topic": "/numbers", "yaml": "data: 3", "data": [1] * 8}, "not as both"),
        ({"topic": "/numbers", "yaml": "data: 3", "key_text": "noon"}, "noon"),
    ],
)
def test_what_cannot_be_added_says_why(write, client, store, request_, word):
    answer = client.call("/writing/addData", **request_)
    assert not answer["success"]
    assert word in answer["message"]
    assert "internal error" not in answer["message"]
    assert not store.existTopic("/new")
    assert store.getTopic("/numbers").countTopicData() == 40


def test_messages_are_removed_by_time_node_condition_and_run(write, client, store):
    def remove(**request):
        return client.call("/writing/removeData", topic="/less", **request)

    less = store.addTopic("/less", format="ros")
    for n in range(20):
        less.addData(Int64(data=n), key=T0 + n, nodeID="ab"[n % 2])
    assert remove(where="data > 15", dry_run=True)["messages"] == 4
    assert less.countTopicData() == 20
    assert remove(where="data > 15", node_id="a")["messages"] == 2
    assert remove(key=T0 + 17)["messages"] == 1
    assert remove(key=T0, to_key=T0 + 4)["messages"] == 5
    assert remove(to_key=T0 + 5)["messages"] == 1
    assert remove(key=T0 + 6, to_key=T0 + 9, where="data < 8", dry_run=True)["messages"] == 2
    for request in ({}, {"dry_run": True}, {"node_id": "a"}):
        answer = remove(**request)
        assert (answer["success"], answer["messages"]) == (False, 0)
        assert "TRUNCATE /less" in answer["message"]
    assert "no message" in remove(key=T0 + 3)["message"]
    assert "did you mean data" in remove(where="date > 3")["message"]
    assert "no run" in remove(run="noon")["message"]
    assert less.countTopicData() == 11


def test_a_statement_is_explained(read, client):
    def explain(statement, *params):
        return client.call("/reading/explainCQL", statement=statement, params=list(params))

    answer = explain("select data from numbers where data < ? and KEY > 5", "3")
    assert (answer["success"], answer["topic"]) == (True, "/numbers")
    assert answer["rows_returned"] == 6
    assert answer["server"] or answer["client"]
    assert f"rows read:     {answer['rows_read']}" in answer["text"]
    assert answer["whole"] + answer["filtered"] + answer["indexed"] <= answer["buckets"]
    answer = explain("select data frm numbers")
    assert not answer["success"]
    assert answer["message"].endswith("^")
    assert not explain("delete from numbers where KEY > 0")["success"]


@pytest.mark.suite("test", "~sql")
def test_sql_is_answered_within_its_bounds(read, write, client):

    def ask(statement, **more):
        return client.call("/reading/sql", statement=statement, **more)

    answer = ask("SELECT NODE, max(data) AS most FROM numbers GROUP BY NODE ORDER BY NODE")
    assert answer["success"] and answer["columns"] == ["NODE", "most"] and not answer["more"]
    nodes = [row["values"][0] for row in answer["rows"]]
    assert nodes == sorted(nodes) and '"a"' in nodes
    above = "SELECT KEY, n.data AS n FROM numbers n WHERE data > ? ORDER BY KEY"
    answer = ask(above, params=["3"], limit=2)
    assert answer["more"] and len(answer["rows"]) == 2
    assert all(int(row["values"][0]) >= T0 for row in answer["rows"])
    assert ask("SELECT 1", node_id="a")["rows"][0]["values"] == ["1"]
    for statement, word in {
        "DELETE FROM numbers": "takes a SELECT",
        "SELECT * FROM read_csv('/etc/passwd')": "files are not read",
        "SELECT dat FROM numbers": "did you mean data",
    }.items():
        answer = ask(statement)
        assert not answer["success"] and word in answer["message"]
    pairs = "range(1000000) a, range(1000000) b WHERE a.range % 7 = b.range % 5"
    answer = ask(f"SELECT count(*) FROM {pairs}", timeout=0.5)
    assert not answer["success"] and "stopped after 0.5 s" in answer["message"]
    for wrong in (-5.0, float("nan")):
        answer = ask("SELECT 1", timeout=wrong)
        assert not answer["success"] and "timeout=" in answer["message"]
