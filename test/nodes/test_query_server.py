# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The services, called over ROS: answers, pages, and requests that make no sense."""

from __future__ import annotations

import base64
import json
import math
import signal
import socket
import subprocess
import time
import uuid

import pytest
from nodes.children import start_client, start_node, told
from nodes.raw_publisher import message
from nodes.raw_subscriber import find
from sensor_msgs.msg import Image, NavSatFix
from std_msgs.msg import Int64, String, UInt8MultiArray
from tf2_msgs.msg import TFMessage

from cassandra_ros import RosCassandra
from cassandra_ros.errors import KeyspaceNotFound
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.store.tables.registry import Run

SEC = 10**9
T0 = 1_405_015_391 * SEC + 123_456_789
COUNT = 250


@pytest.fixture(scope="module")
def store(cassandra, cql):
    """A keyspace with a few topics."""
    name = f"t_{uuid.uuid4().hex[:16]}"
    with RosCassandra(cassandra.host, cassandra.port, keyspace=name) as rosCas:
        topic = rosCas.addTopic("/fix", format="ros")
        for n in range(COUNT):
            msg = NavSatFix(latitude=float(n), longitude=math.nan)
            topic.addData(msg, key=T0 + n * SEC, nodeID="ab"[n % 2])
        tf = rosCas.addTopic("/tf")
        for n in range(4):
            msg = TFMessage()
            for child in "xyz":
                from geometry_msgs.msg import TransformStamped

                msg.transforms.append(TransformStamped(child_frame_id=child + str(n)))
            tf.addData(msg, key=T0 + n)
        large = rosCas.addTopic("/image")
        for n in range(8):
            large.addData(Image(data=bytes([n]) * (3 << 20)), key=T0 + n)
        names = rosCas.addTopic("/results", key_format="manual")
        for n in range(5):
            names.addData(String(data=str(n)), key=["kitchen", "17"][n % 2])
        numbers = rosCas.addTopic("/numbers", key_format="msg_part", key_part="data")
        for n in range(3):
            numbers.addData(Int64(data=n))
        writer = rosCas.messageWriter()
        broken = writer.connect(live_connection("/broken", {"type": "a/B", "md5sum": "1" * 32}))
        writer.write(broken, T0, 0, b"\1\2\3")
        short = {"type": String._type, "md5sum": String._md5sum}
        short["message_definition"] = String._full_text
        writer.write(writer.connect(live_connection("/short", short)), T0, 1, b"\xff\xff\xff\xff")
        writer.close()
        for number, called in ((7, "morning"), (8, "evening")):
            run = Run("", number, "recording", name=called)
            with rosCas.messageWriter(writer_id=number, run=run) as writer:
                header = {"type": String._type, "md5sum": String._md5sum}
                header["message_definition"] = String._full_text
                handle = writer.connect(live_connection("/runs", header))
                for n in range(3):
                    writer.write(handle, T0 + n, n, message(String(called)))
        yield rosCas
    cql.execute(f"DROP KEYSPACE {name}")


@pytest.fixture(scope="module")
def server(roscore, cassandra, store):
    where = ("--host", cassandra.host, "--port", cassandra.port, "--keyspace", store.keyspace)
    with start_node(roscore, "query_server", *where) as child:
        child.await_line("serving keyspace")
        assert told(child)[0] == "services under /cassandra_ros"
        yield child
        assert child.process.poll() is None, child.output  # nothing has killed it
        assert child.end(signal.SIGINT) == 0


@pytest.fixture(scope="module")
def client(roscore, server):
    with start_client(roscore) as child:
        yield child


@pytest.fixture
def get(client):
    return lambda **request: client.call("/cassandra_ros/getData", **request)


@pytest.fixture
def span(client):
    return lambda **request: client.call("/cassandra_ros/range", **request)


@pytest.fixture
def ask(client):
    return lambda statement, *params, **request: client.call(
        "/cassandra_ros/executeCQL", statement=statement, params=list(params), **request
    )


def test_runs_are_told_apart(get, span, ask):
    for run, name in (("morning", "morning"), ("evening", "evening"), ("8", "evening")):
        found = get(topic="/runs", key=T0 + 1, run=run)["data"]
        assert base64.b64decode(found["data"]) == message(String(name))
        for where in ("", "data != 'noon'"):
            answer = span(topic="/runs", run=run, where=where)
            assert [base64.b64decode(each["data"]) for each in answer["data"]] == [
                message(String(name))
            ] * 3
        rows = ask("select data, RUN from runs", run=run)["rows"]
        assert [row["values"] for row in rows] == [[json.dumps(name)] * 2] * 3
    for answer in (get(topic="/runs", run="morn"), span(topic="/runs", run="morn")):
        assert (answer["success"], "did you mean morning" in answer["message"]) == (False, True)
    assert "no run" in ask("select data from runs", run="morn")["message"]


def test_a_peer_without_a_header_does_not_delay_calls(roscore, get):
    with socket.create_connection(find(roscore.uri, "/rosout", 60, "/cassandra_ros"), 60):
        assert get(topic="/fix", key=T0, timeout_sec=60)["success"]


def test_one_message(get):
    answer = get(topic="/fix", key=T0)
    assert (answer["success"], answer["message"]) == (True, "")
    data = answer["data"]
    msg = NavSatFix(latitude=0.0, longitude=math.nan)
    assert (data["key"], data["key_text"], data["node_id"]) == (T0, str(T0), "a")
    assert (data["topic"], data["type"]) == ("/fix", "sensor_msgs/NavSatFix")
    assert data["md5sum"] == NavSatFix._md5sum
    assert base64.b64decode(data["data"]) == message(msg)
    assert data["yaml"] == str(msg)


def test_what_is_left_out(get):
    assert get(topic="fix", key=T0, omit_data=True)["data"]["data"] == ""
    assert get(topic="fix", key=T0, omit_yaml=True)["data"]["yaml"] == ""


@pytest.mark.parametrize(
    "text",
    [str(T0), "1405015391.123456789", "2014-07-10T18:03:11.123456789Z",
     "2014-07-10 20:03:11.123456789+02:00", f" {T0} "],
)  # fmt: skip
def test_key_text_wins(get, text):
    assert get(topic="fix", key=5, key_text=text, omit_data=True)["data"]["key"] == T0


def test_names_and_values(get, span):
    for text, value in (("kitchen", "4"), ("17", "3")):
        data = get(topic="results", key_text=text)["data"]
        assert (data["key_text"], data["yaml"]) == (text, f'data: "{value}"')
        assert abs(data["key"] / SEC - time.time()) < 3600
    assert get(topic="numbers", key_text="2")["data"]["yaml"] == "data: 2"
    for request, word in (
        ({"topic": "results", "key_text": "cellar"}, "under the name 'cellar'"),
        ({"topic": "results", "key": T0}, "kept under names"),
        ({"topic": "results", "key_text": "17", "nearest": "before"}, "no order"),
        ({"topic": "numbers", "key_text": "7"}, "key field is 7"),
        ({"topic": "numbers", "key_text": "x"}, "int64"),
    ):
        answer = get(**request)
        assert not answer["success"] and word in answer["message"]
    found, cursor = [], ""
    while True:
        answer = span(topic="results", limit=2, cursor=cursor)
        found += [data["key_text"] for data in answer["data"]]
        cursor = answer["next_cursor"]
        if not cursor:
            break
    assert found == ["kitchen", "17"] * 2 + ["kitchen"]


def test_neighbours(get):
    def key(**request):
        answer = get(topic="fix", omit_data=True, omit_yaml=True, **request)
        return answer["data"]["key"] - T0 if answer["success"] else None

    between = T0 + SEC + 300_000_000
    assert key(key=between) is None
    assert key(key=between, nearest="before") == SEC
    assert key(key=between, nearest="after") == 2 * SEC
    assert key(key=between, nearest="either") == SEC
    assert key(key=between + 300_000_000, nearest="either") == 2 * SEC
    assert key(key=T0 + SEC + SEC // 2, nearest="either") == SEC  # equally near: the earlier
    assert key(nearest="after") == 0
    assert key(key=T0 - 1, nearest="before") is None
    assert key(key=between, nearest="before", node_id="a") == 0
    assert key(key=T0, node_id="b") is None


def test_one_message_that_satisfies_a_condition(get):
    def found(**request):
        answer = get(topic="fix", omit_data=True, omit_yaml=True, **request)
        return (answer["data"]["key"] - T0) // SEC if answer["success"] else answer["message"]

    at = T0 + 50 * SEC
    assert found(key=at, where="latitude = 50") == 50
    assert "satisfies 'latitude > 50'" in found(key=at, where="latitude > 50")
    assert found(key=at, nearest="after", where="latitude > 60.5 and NODE = 'b'") == 61
    assert found(key=at, nearest="before", where="latitude < 20", node_id="b") == 19
    assert found(key=at, nearest="either", where="latitude < 20 or latitude > 70") == 71
    assert "did you mean latitude" in found(key=at, where="lat > 5")
    names = get(topic="results", key_text="kitchen", where="data < '3'", omit_data=True)
    assert names["data"]["yaml"] == 'data: "2"'


def test_a_number_as_time_went_through_a_float(get):
    """rosservice makes a double of an integer: the last digits change."""
    answer = get(topic="fix", key=T0 + 211)
    assert not answer["success"]
    assert f"{{secs: {T0 // SEC}, nsecs: {T0 % SEC}}}" in answer["message"]
    assert "secs" not in get(topic="fix", key=T0 + 300)["message"]


@pytest.mark.suite("all", "it starts many programs")
def test_the_same_on_the_command_line(roscore, server, store):
    def call(request):
        words = ["rosservice", "call", "/cassandra_ros/getData", request]
        done = subprocess.run(words, env=roscore.env, capture_output=True, text=True, check=True)
        return done.stdout

    exact = f"{{topic: fix, key: {{secs: {T0 // SEC}, nsecs: {T0 % SEC}}}, omit_data: true}}"
    assert "success: True" in call(exact)
    assert "goes through a float" in call(f"{{topic: fix, key: {T0}}}")
    assert "success: True" in call(f"{{topic: fix, key_text: '{T0}', omit_data: true}}")


@pytest.mark.parametrize(
    ("request_", "word"),
    [
        ({"topic": "/fixx", "key": T0}, "/fix"),
        ({"topic": "", "key": T0}, "topic"),
        ({"topic": "'; drop keyspace x; -- \n", "key": T0}, "not stored"),
        ({"topic": "/fix", "key_text": "noon"}, "noon"),
        ({"topic": "/fix", "key_text": "1405015391"}, "did you mean seconds"),
        ({"topic": "/fix", "key": T0, "nearest": "sideways"}, "sideways"),
        ({"topic": "/fix", "key": 17}, "no message"),
        ({"topic": "/fix", "key": T0, "node_id": "x" * 70_000}, "nodeID="),
    ],
)
def test_bad_requests_are_answered(get, request_, word):
    answer = get(**request_)
    assert not answer["success"]
    assert word in answer["message"]
    assert answer["data"]["topic"] == ""


def test_messages_that_cannot_be_decoded(get):
    data = get(topic="broken", key=T0)["data"]
    assert base64.b64decode(data["data"]) == b"\1\2\3"
    assert data["yaml"].startswith("#")
    data = get(topic="short", key=T0)["data"]
    assert base64.b64decode(data["data"]) == b"\xff" * 4
    assert data["yaml"].startswith("#")
    data = get(topic="image", key=T0)["data"]
    assert len(base64.b64decode(data["data"])) > 3 << 20
    assert data["yaml"].startswith("#")


def test_pages_of_a_range(span):
    keys, cursor = [], ""
    for _ in range(4):
        answer = span(topic="fix", cursor=cursor, omit_data=True, omit_yaml=True)
        assert answer["success"]
        keys += [data["key"] for data in answer["data"]]
        cursor = answer["next_cursor"]
        if not cursor:
            break
    assert keys == [T0 + n * SEC for n in range(COUNT)]
    assert len(span(topic="fix", omit_data=True, omit_yaml=True)["data"]) == 100


@pytest.mark.parametrize("limit", [1, 5, 1000])
def test_both_ends_belong_to_the_range(span, limit):
    answer = span(topic="fix", key=T0 + 3 * SEC, to_key=T0 + 7 * SEC, limit=limit)
    keys = [(data["key"] - T0) // SEC for data in answer["data"]]
    assert keys == [3, 4, 5, 6, 7][:limit]
    assert bool(answer["next_cursor"]) == (limit < 5)


def test_ranges_with_a_condition(span):
    where = "latitude > 10 and latitude < 200 and longitude != 0"
    found, cursor = [], ""
    while True:
        answer = span(topic="fix", where=where, node_id="b", limit=30, cursor=cursor)
        assert answer["success"], answer["message"]
        found += [(data["key"] - T0) // SEC for data in answer["data"]]
        cursor = answer["next_cursor"]
        if not cursor:
            break
    assert found == [n for n in range(11, 200) if n % 2]
    one = span(topic="tf", where="transforms.child_frame_id = 'y2'")
    assert [data["key"] for data in one["data"]] == [T0 + 2]


def test_a_page_ends_where_it_would_be_too_large(span):
    sizes, cursor = [], ""
    for _ in range(8):
        answer = span(topic="image", omit_yaml=True, cursor=cursor)
        sizes.append(len(answer["data"]))
        cursor = answer["next_cursor"]
        if not cursor:
            break
    assert sizes == [6, 2]


@pytest.mark.parametrize(
    ("request_", "word"),
    [
        ({"topic": "/nothing"}, "not stored"),
        ({"topic": "fix", "key": T0 + 5, "to_key": T0}, "lies before"),
        ({"topic": "fix", "cursor": "nonsense"}, "not a cursor"),
        ({"topic": "fix", "node_id": "x" * 70_000}, "nodeID="),
        ({"topic": "fix", "where": "lat > 5"}, "did you mean latitude"),
        ({"topic": "fix", "where": "latitude >"}, "^"),
        ({"topic": "fix", "where": "latitude > ?"}, "1 parameters"),
        ({"topic": "fix", "where": "__import__('os').system('touch /tmp/x')"}, "^"),
    ],
)
def test_bad_ranges_are_answered(span, request_, word):
    answer = span(**request_)
    assert not answer["success"]
    assert word in answer["message"]
    assert answer["data"] == []


def rows(answer):
    assert answer["success"], answer["message"]
    return [row["values"] for row in answer["rows"]]


def test_values_are_json(ask):
    answer = ask("select KEY, NODE, latitude, longitude, header.stamp from fix limit 1")
    assert answer["columns"] == ["KEY", "NODE", "latitude", "longitude", "header.stamp"]
    assert rows(answer) == [[str(T0), '"a"', "0.0", "NaN", "0"]]
    assert answer["next_cursor"] == ""


def test_parameters_are_json(ask):
    statement = "select latitude from fix where latitude > ? and NODE = %s and KEY < ?"
    found = rows(ask(statement, "3", '"b"', "1405015400.2"))
    assert found == [["5.0"], ["7.0"], ["9.0"]]
    assert rows(ask("select latitude from fix where latitude in ?", "[1, 5, 7.0]")) == [
        ["1.0"], ["5.0"], ["7.0"]
    ]  # fmt: skip


@pytest.mark.parametrize("limit", [1, 7, 0, 5000])
def test_pages_of_rows(ask, limit):
    statement = "select transforms.child_frame_id, KEY from tf where KEY > 0 limit 10"
    found, cursor = [], ""
    while True:
        answer = ask(statement, limit=limit, cursor=cursor)
        found += rows(answer)
        cursor = answer["next_cursor"]
        if not cursor:
            break
    assert found == [[json.dumps(c + str(n)), str(T0 + n)] for n in range(4) for c in "xyz"][:10]


def test_counts(ask):
    assert rows(ask("select count(*) from fix")) == [[str(COUNT)]]
    assert rows(ask("select count(*) from fix", node_id="a")) == [[str(COUNT // 2)]]
    assert rows(ask("select count(*) from tf where transforms.child_frame_id < 'y'")) == [["4"]]


def test_rows_too_large_for_a_reply(ask):
    answer = ask("select data from image")
    assert len(answer["rows"]) == 4  # base64 makes 4 MiB of each
    assert len(ask("select data from image", cursor=answer["next_cursor"])["rows"]) == 4


@pytest.mark.parametrize(
    ("statement", "params", "word"),
    [
        ("", (), "SELECT"),
        ("drop table x", (), "removeTopic"),
        ("delete from fix", (), "TRUNCATE"),
        ("select latitude frm fix", (), "did you mean FROM?"),
        ("select latitude from fix where latitude > ?", ("abc",), "not JSON"),
        ("select latitude from fix where latitude > ?", ("null",), "null"),
        ("select latitude from fix where latitude > ?", (), "1 parameters, 0"),
        ("select latitude from fix where latitude = ?", ('"x"',), "number"),
        ("select latitude from nowhere", (), "not stored"),
        ("select x from broken", (), "no definition"),
        ("select '\udcff", (), "closed"),
    ],
)
def test_bad_statements_are_answered(ask, statement, params, word):
    answer = ask(statement.replace("\udcff", "\xff"), *params)
    assert not answer["success"]
    assert word in answer["message"]
    assert answer["rows"] == []


def test_cursors_from_elsewhere(ask):
    assert "not a cursor" in ask("select KEY from fix", cursor="x.y.z")["message"]


@pytest.mark.suite("all", "it starts many programs")
def test_a_second_server_does_not_take_the_name(roscore, cassandra, store, server):
    where = ("--port", cassandra.port, "--keyspace", store.keyspace)
    second = start_node(roscore, "query_server", *where)
    assert second.wait() == 1
    assert "a node /cassandra_ros runs already" in second.output
    with start_node(roscore, "query_server", *where, "__name:=other") as third:
        third.await_line("services under /other")
        assert third.end(signal.SIGTERM) == 0


def test_cursors_survive_the_node(roscore, cassandra, store, client, ask):
    first = ask("select KEY from fix", limit=10)
    parameters = [f"_port:={cassandra.port}", f"_keyspace:={store.keyspace}", "__name:=later"]
    with start_node(roscore, "query_server", *parameters) as child:
        child.await_line("serving keyspace")
        second = client.call(
            "/later/executeCQL", statement="select KEY from fix", cursor=first["next_cursor"]
        )
    assert rows(second)[0] == [str(T0 + 10 * SEC)]


def test_topics_made_later_are_seen(store, ask, get):
    assert not get(topic="/later", key=T0)["success"]
    store.addTopic("/later").addData(UInt8MultiArray(data=b"\1\2"), key=T0)
    assert rows(ask("select data from later")) == [['"AQI="']]
    assert get(topic="/later", key=T0)["success"]


@pytest.mark.suite("all", "it starts many programs")
def test_a_keyspace_that_a_recorder_makes_later(roscore, cassandra, connect, new_keyspace, client):
    where = ("--port", cassandra.port, "--keyspace", new_keyspace, "__name:=early")
    with start_node(roscore, "query_server", *where) as child, connect() as store:
        child.await_line("serving keyspace")
        assert f"there is no keyspace '{new_keyspace}'" in child.output
        refused = client.call("/early/getData", topic="/a", key=T0)
        assert f"there is no keyspace '{new_keyspace}'" in refused["message"]
        with pytest.raises(KeyspaceNotFound):
            store.connectToKeyspace(new_keyspace, make=False)
        store.connectToKeyspace(new_keyspace)
        store.addTopic("/a").addData(String(data="a"), key=T0)
        assert client.call("/early/getData", topic="/a", key=T0)["success"]
        assert child.end() == 0


@pytest.mark.suite("all", "it starts a node; make test asks the recorder")
def test_no_server(roscore):
    child = start_node(roscore, "query_server", "--port", "1", "__name:=lonely")
    assert child.wait() == 1
    assert "rosrun cassandra_ros local_cassandra start" in child.output
