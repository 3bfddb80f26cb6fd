# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Events of running nodes: the service ~mark, conditions of the settings, and a killed recorder."""

from __future__ import annotations

import json
import signal

import pytest
from nodes.children import await_true, start_client, start_node
from nodes.raw_publisher import RawPublisher, header_of, message
from std_msgs.msg import Int32
from viewers import running_viewer

from cassandra_ros.errors import InvalidOption
from cassandra_ros.files.bag.exporter import export_bag
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.nodes.mark_answer import read_values

SEC = 10**9
SETTINGS = """
events:
- {name: high, topic: /n, where: data > 5, labels: {kind: level}}
"""


def test_values_keep_all_their_digits_or_are_refused():
    assert read_values('{"at": 1368021980238582676, "x": 0.5}') == {
        "at": 1368021980238582676,
        "x": 0.5,
    }
    with pytest.raises(InvalidOption, match="would become 1368021980.2385826"):
        read_values('{"at": [1368021980.238582676]}')


@pytest.fixture
def client(roscore):
    with start_client(roscore) as client:
        yield client


@pytest.mark.suite("all", "test_every_door makes events in make test")
def test_a_recorder_marks_and_watches(roscore, recorder, rosCas, client, tmp_path):
    config = tmp_path / "settings.yaml"
    config.write_text(SETTINGS)
    child = recorder("/n", "--config", config, "--node-id", "husky", "-O", "one")

    def mark(name, **request):
        answer = client.call("/recorder/mark", name=name, **request)
        assert answer["success"], answer
        return answer

    with RawPublisher(roscore.uri, "/n", header_of(Int32)) as numbers:
        numbers.await_subscribers()
        begun = mark("door", labels=["room=hall"], values='{"people": 2}')
        assert begun["lasting"]
        for n in (1, 8, 9, 2, 7):
            numbers.publish(message(Int32(n)))
        await_true(lambda: len(list(rosCas.events("high"))) == 2)
        ended = mark("door", values='{"people": 3}')
        assert (ended["lasting"], ended["key"]) == (False, begun["key"])
        mark("lasts")
    for request, said in (
        ({"name": ""}, "name of an event"),
        ({"name": "x", "labels": ["room"]}, "is not a label"),
        ({"name": "x", "values": "[1]"}, "a JSON object"),
        ({"name": "x", "values": "{"}, "values"),
        ({"name": "x", "node_id": "jackal"}, "its own robot"),
    ):
        answer = client.call("/recorder/mark", **request)
        assert not answer["success"] and said in answer["message"], answer
    assert child.end() == 0, child.output
    (run,) = rosCas.runs()
    (door,) = rosCas.events("door")
    assert (door.node, door.writer, door.labels) == ("husky", run.writer, {"room": "hall"})
    assert door.values == {"people": 3}
    # What the recorder has begun ends with it.
    assert all(event.end_ns is not None for event in rosCas.events())
    high = list(rosCas.events("high"))
    assert [(event.node, event.labels) for event in high] == [("husky", {"kind": "level"})] * 2
    rows = rosCas.executeCQL("SELECT data FROM /n WHERE EVENT 'high'")
    assert rows == [(8,), (9,), (7,)]


@pytest.mark.suite("all", "it kills or cuts something, and waits")
def test_an_event_of_a_killed_recorder_lasts(recorder, rosCas, client, call_verb):
    child = recorder("/n")
    begun = client.call("/recorder/mark", name="door")
    await_true(lambda: len(list(rosCas.events("door"))) == 1)
    child.end(signal.SIGKILL)
    (event,) = rosCas.events("door")
    assert (event.key, event.end_ns) == (begun["key"], None)
    assert json.loads(call_verb("event", "list", "--json"))[0]["lasts"]
    # The next recorder's event of this name is another one.
    second = recorder("/n", ready="")
    second.await_line("recording ")
    assert client.call("/recorder/mark", name="door")["lasting"]
    second.end()
    assert [event.end_ns is None for event in rosCas.events("door")] == [True, False]
    rosCas.endEvent(event, event.start_ns + 1)
    assert next(rosCas.events("door")).end_ns == event.start_ns + 1


@pytest.fixture
def call_verb(cassandra, keyspace, capsys):
    from cassandra_ros.cli import cassandra_bag

    def call(*words):
        where = ("--host", cassandra.host, "--port", str(cassandra.port), "--keyspace", keyspace)
        assert cassandra_bag.main([*words, *where]) == 0
        return capsys.readouterr().out

    return call


@pytest.mark.suite("test", "each door of events")
def test_every_door_makes_an_event_of_the_same_name(
    roscore, cassandra, keyspace, recorder, rosCas, client, call_verb, fresh, tmp_path
):
    def at(second):
        return 1_500_000_000 * SEC + second * SEC

    # Python, the command line, the viewer, an MCAP file.
    rosCas.addEvent("bump", at(0), at(1), nodeID="husky", labels={"door": "python"})
    times = ("--start", str(at(10)), "--end", str(at(11)))
    call_verb("event", "add", "bump", *times, "--node-id", "husky", "--label", "door=verb")
    added = {"name": "bump", "start": str(at(20)), "end": str(at(21)), "node": "husky"}
    with running_viewer(rosCas, allow_writes=True) as viewer:
        assert viewer.ask("/api/events/add", added, "POST").status == 200
    with fresh() as other:
        other.addTopic("/n", format="ros").addData(Int32(3), key=at(30))
        other.addEvent("bump", at(30), at(31), nodeID="husky", labels={"door": "file"})
        export_bag(other, tmp_path / "bump.mcap")
    import_bag(rosCas, tmp_path / "bump.mcap", nodeID="husky")
    # Services of both nodes, and a condition of the recorder's settings.
    config = tmp_path / "settings.yaml"
    config.write_text(SETTINGS.replace("high", "bump"))
    child = recorder("/n", "--config", config, "--node-id", "husky")
    with RawPublisher(roscore.uri, "/n", header_of(Int32)) as numbers:
        numbers.await_subscribers()
        for n in (1, 8, 2):
            numbers.publish(message(Int32(n)))
        await_true(lambda: len(list(rosCas.events("bump"))) == 5)
        for _ in range(2):
            assert client.call("/recorder/mark", name="bump", labels=["door=mark"])["success"]
    assert child.end() == 0, child.output
    where = ("--host", cassandra.host, "--port", str(cassandra.port), "--keyspace", keyspace)
    with start_node(roscore, "query_server", *where, "--allow-writes") as child:
        child.await_line("writes are allowed")
        for _ in range(2):
            answer = client.call("/cassandra_ros/mark", name="bump", node_id="husky")
            assert answer["success"], answer
        assert child.end() == 0, child.output

    events = list(rosCas.events("bump"))
    assert [event.start_ns for event in events[:4]] == [at(0), at(10), at(20), at(30)]
    doors = [event.labels.get("door", "") for event in events]
    assert doors[:4] == ["python", "verb", "", "file"] and doors.count("mark") == 1
    assert [event.labels for event in events].count({"kind": "level"}) == 1
    assert len(events) == 7
    assert all(event.node == "husky" and event.end_ns is not None for event in events)
    listed = json.loads(call_verb("event", "list", "bump", "--json"))
    assert len(listed) == 7
    rows = rosCas.executeCQL("SELECT data FROM /n WHERE EVENT 'bump' AND NODE = 'husky'")
    assert rows == [(3,), (8,)]


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_query_server_marks_if_it_may_write(roscore, cassandra, keyspace, rosCas, client):
    where = ("--host", cassandra.host, "--port", str(cassandra.port), "--keyspace", keyspace)
    with start_node(roscore, "query_server", *where) as child:
        child.await_line("read-only")
        answer = client.call("/cassandra_ros/mark", name="door")
        assert not answer["success"] and "allow_writes" in answer["message"]
        assert list(rosCas.events()) == []
        child.end()
    with start_node(roscore, "query_server", *where, "--allow-writes") as child:
        child.await_line("writes are allowed")
        mark = "/cassandra_ros/mark"
        first = client.call(mark, name="door", node_id="husky")
        other = client.call(mark, name="door", node_id="jackal")
        assert first["lasting"] and other["lasting"] and first["key"] != other["key"]
        assert not client.call(mark, name="door", node_id="husky")["lasting"]
        assert not client.call(mark, name="")["success"]
        (lasting,) = (event for event in rosCas.events() if event.end_ns is None)
        assert lasting.node == "jackal"
        assert child.end() == 0, child.output
    assert all(event.end_ns is not None for event in rosCas.events())
