# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The player as a node: what it plays is recorded by rosbag and compared."""

from __future__ import annotations

import struct
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from functools import partial
from types import SimpleNamespace

import pytest
import rosbag
from nodes.children import Child, await_true, services_of, start_client, start_node, told
from nodes.raw_publisher import message
from nodes.raw_subscriber import RawSubscriber
from std_msgs.msg import Int32, String

from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.stores.copying.replicator import Replicator

SEC = 10**9
T0 = 1_405_015_391 * SEC
MOST = 90
"""Number of messages of a topic that rosbag record is sent: it queues 100 and drops the rest."""


@pytest.fixture
def start(roscore, cassandra):
    """Start players of a keyspace; they are gone afterwards."""
    with ExitStack() as children:

        def start(keyspace, *arguments, ready="services under ", **options):
            where = ("--host", cassandra.host, "--port", cassandra.port, "--keyspace", keyspace)
            child = start_node(roscore, "player", *where, *arguments, **options)
            children.enter_context(child)
            if ready:
                child.await_line(ready)
            return child

        yield start


@pytest.fixture
def player(start, keyspace):
    """Start players of the test's keyspace."""
    return partial(start, keyspace)


@contextmanager
def stored(fresh, path):
    """A keyspace with a bag, and what that holds: .keyspace and .expected, without the log."""
    with fresh() as rosCas:
        import_bag(rosCas, path)
        expected = {topic: each for topic, each in recorded(path).items() if "rosout" not in topic}
        yield SimpleNamespace(keyspace=rosCas.keyspace, expected=expected)


@pytest.fixture(scope="module")
def turtle(bags, fresh):
    with stored(fresh, bags / "turtlesim_tf.bag") as whole:
        yield whole


@pytest.fixture(scope="module")
def beginning(bags, fresh, tmp_path_factory):
    """The first messages of each topic, no more than the queues of rosbag record take."""
    path, counts = tmp_path_factory.mktemp("beginning") / "a.bag", Counter()
    with rosbag.Bag(str(bags / "turtlesim_tf.bag")) as bag, rosbag.Bag(str(path), "w") as part:
        for topic, raw, t, header in bag.read_messages(raw=True, return_connection_header=True):
            counts[topic] += 1
            if counts[topic] <= MOST:
                part.write(topic, raw, t, raw=True, connection_header=header)
    with stored(fresh, path) as first:
        yield first


def recorded(path):
    """What a bag holds by topic: type, md5, definition, latching and bytes of each message."""
    found = {}
    with rosbag.Bag(str(path)) as bag:
        for topic, raw, _, header in bag.read_messages(raw=True, return_connection_header=True):
            kind, wire, md5sum = raw[:3]
            definition = header["message_definition"]
            latching = header.get("latching", b"0") in (b"1", "1")
            found.setdefault(topic, []).append((kind, md5sum, definition, latching, wire))
    return found


@pytest.mark.suite("all", "it plays a whole bag")
def test_a_bag_is_played_at_once_without_a_loss(roscore, start, turtle):
    expected = turtle.expected
    child = start(turtle.keyspace, *expected, "-i", "--queue", "5", "--wait-for-subscribers")

    def hear(topic):
        with RawSubscriber(roscore.uri, topic) as heard:
            return heard.header, heard.rest()

    with ThreadPoolExecutor(len(expected)) as pool:
        found = dict(zip(expected, pool.map(hear, expected)))
    assert child.wait() == 0, child.output
    for topic, (header, wires) in found.items():
        kind, md5sum, definition, latching, _ = expected[topic][0]
        assert header["type"].decode() == kind
        assert header["md5sum"].decode() == md5sum
        assert header["message_definition"] == definition
        assert header["latching"] == (b"1" if latching else b"0")
        assert wires == [each[4] for each in expected[topic]], topic
    assert told(child)[-1] == f"played {sum(map(len, expected.values()))} messages of 8 topics"


def record_again(roscore, start, played, folder, topics, *options):
    """Let rosbag record what a player plays; compare."""
    by_count = {}
    for topic in topics:
        by_count.setdefault(len(played.expected[topic]), []).append(topic)
    options += ("-p", "/p", "--wait-for-subscribers")
    found = {}
    with ExitStack() as records:
        # They end by themselves: Ctrl-C would drop what they have not taken out of their queues.
        running = []
        for count, group in by_count.items():
            command = ["rosbag", "record", "-O", folder / f"{count}.bag", "-b", "0", "-l", count]
            command += [f"/p{topic}" for topic in group]
            running.append(records.enter_context(Child(command, roscore.env)))
        child = start(played.keyspace, *topics, *options, ready=None)
        assert child.wait() == 0, child.output
        for record in running:
            assert record.wait() == 0, record.output
    for count in by_count:
        found.update(recorded(folder / f"{count}.bag"))
    for topic in topics:
        assert found["/p" + topic] == played.expected[topic], topic
    total = sum(len(played.expected[topic]) for topic in topics)
    assert told(child)[-1].startswith(f"played {total} messages of {len(topics)} topics")


@pytest.mark.suite("all", "make test asks others of its kind")
def test_what_is_played_is_recorded_as_it_was(roscore, start, beginning, tmp_path):
    few = ("/tf_static", "/turtle1/cmd_vel")
    record_again(roscore, start, beginning, tmp_path, few, "-r", "20")


@pytest.mark.suite("all", "it waits for seconds of playing")
def test_a_bag_is_recorded_as_it_was(roscore, start, beginning, tmp_path):
    record_again(roscore, start, beginning, tmp_path, tuple(beginning.expected))


@pytest.mark.suite("test", "--store")
def test_several_stores_are_played_as_one(roscore, fresh):
    with fresh() as home, fresh() as robot:
        numbers = robot.addTopic("/n", format="packed")
        for n in range(60):
            if n == 40:
                assert Replicator(robot, home).copy().complete
            numbers.addData(Int32(n), key=T0 + n * SEC)
        at = f"{robot.cassandra.hosts[0]}:{robot.cassandra.port}"
        places = [f"{at}/{home.keyspace}", f"{at}/{robot.keyspace}", "127.0.0.1:1"]
        options = [word for place in places for word in ("--store", place)]
        options += ["--store-timeout", "180", "--wait-for-subscribers"]
        command = ("player", *options, "/n", "-i", "-d", "0")
        with start_node(roscore, *command) as child:
            with RawSubscriber(roscore.uri, "/n") as heard:
                played = [struct.unpack("<i", wire)[0] for wire in heard.rest()]
            assert child.wait() == 3, child.output
    assert played == list(range(60))
    assert "the replay goes on without store 127.0.0.1:1: " in child.output
    assert told(child)[-1].startswith("player: store 127.0.0.1:1 did not answer")


@pytest.mark.suite("test", "the services of the player")
def test_steered_by_services(roscore, player, rosCas):
    numbers = rosCas.addTopic("/n", format="binary")
    for n in range(40):
        numbers.addData(Int32(n), key=T0 + n * SEC)
    child = player("--pause", "-k", "-d", "0", "/n:=/m")
    with RawSubscriber(roscore.uri, "/m") as heard, start_client(roscore) as client:

        def call(service, **request):
            return client.call(f"/player/{service}", **request)

        def read(count):
            return [struct.unpack("<i", heard.read())[0] for _ in range(count)]

        await_true(lambda: call("status")["topics"][0]["subscribers"] == 1)
        assert call("step")["time"] == T0
        assert call("step", count=3) == {"success": True, "message": "", "time": T0 + 3 * SEC}
        assert read(4) == [0, 1, 2, 3]
        assert call("seek", time=T0 + 30 * SEC)["time"] == T0 + 30 * SEC
        assert call("step")["time"] == T0 + 30 * SEC
        assert call("seek", text="12.5")["time"] == T0 + 12 * SEC + SEC // 2
        assert call("step")["success"]
        assert read(2) == [30, 13]
        assert call("setRate", rate=1e5) == {"success": True, "message": "", "rate": 1e5}
        wrong = call("setRate", rate=-1.0)
        assert (wrong["success"], wrong["rate"]) == (False, 1e5)
        assert "more than 0" in wrong["message"]
        assert "not a time to play" in call("seek", text="yesterday")["message"]
        answer = call("pause_playback", data=True)
        assert answer == {"success": False, "message": "Playback is already paused."}
        assert call("pause_playback", data=False)["message"] == "Playback is now resumed"
        assert read(26) == list(range(14, 40))
        await_true(lambda: call("status")["state"] == "ended")
        assert "only a paused replay" in call("step")["message"]
        assert call("seek", text="39")["success"]
        assert read(1) == [39]
        status = call("status")
        (topic,) = status.pop("topics")
        assert (topic["topic"], topic["type"], topic["published"]) == ("/m", "std_msgs/Int32", 33)
        wanted = {"start": T0, "end": T0 + 39 * SEC, "published": 33, "missed": 0, "left_out": 0}
        assert {name: status[name] for name in wanted} == wanted
        assert call("pause")["success"]
        assert call("pause")["message"] == "it was paused already"
        assert call("resume")["success"]
        assert call("stop")["success"]
        assert child.wait() == 0, child.output
        assert heard.rest() == []
    assert told(child)[0] == "services under /player"
    assert told(child)[-1] == "played 33 messages of 1 topic"


@pytest.mark.suite("test", "a promise of SECURITY.md")
def test_no_services(roscore, player, rosCas):
    rosCas.addTopic("/m").addData(Int32(1), key=T0)
    child = player("-k", "--no-services", ready="/player offers no services")
    child.await_line("playing 1 topic")
    assert services_of(roscore, "/player") == set()
    assert child.end() == 0, child.output
    for word in ("--pause", "--pause-topics=/m"):
        child = player("--no-services", word, ready="")
        assert child.wait() == 2
        assert f"leave out {word.partition('=')[0]} or --no-services" in child.output


@pytest.mark.suite("test", "promise 1, with a real subscriber")
def test_stored_types_and_latched_messages_go_out_as_they_are(roscore, player, rosCas):
    writer = rosCas.messageWriter()
    counter = iter(range(100))

    def write(topic, wires, t, **header):
        fields = {"type": "std_msgs/String", "md5sum": String._md5sum, "callerid": "/x"}
        fields["message_definition"] = String._full_text
        handle = writer.connect(live_connection(topic, {**fields, **header}))
        for n, wire in enumerate(wires):
            writer.write(handle, T0 + t * SEC + n, next(counter), wire)

    def text(value):
        return message(String(value))

    lost = "Header header\nfloat32[] ranges\n" + "=" * 80 + "\nMSG: std_msgs/Header\n"
    lost += "uint32 seq\ntime stamp\nstring frame_id\n"
    definition = parse_definition("lost_msgs/Thing", lost)
    latin = b"# angle in \xb0\nstring data\n"
    write("/fixed", [text("a"), text("b")], 0, latching="1", callerid="/one")
    write("/fixed", [text("c")], 1, latching="1", callerid="/two")
    write(
        "/lost",
        [b"\1\2\3"],
        2,
        type="lost_msgs/Thing",
        md5sum=definition.md5sum,
        message_definition=lost,
    )
    write("/latin", [text("d")], 2, message_definition=latin)
    write(
        "/mixed",
        [message(Int32(1))],
        2,
        type="std_msgs/Int32",
        md5sum=Int32._md5sum,
        message_definition=Int32._full_text,
    )
    write("/mixed", [text("e"), text("f")], 3)
    for number, brackets in enumerate(["", "[]", ""]):  # the first one without its definition
        text_of = f"Part{brackets} parts\n" + "=" * 80 + "\nMSG: lost_msgs/Part\nint32 value\n"
        write(
            "/parts",
            [b"%d" % number],
            2 + number,
            type="lost_msgs/Parts",
            md5sum=parse_definition("lost_msgs/Parts", text_of).md5sum,
            message_definition=text_of if number else "",
        )
    write("/bare", [b"xyz"], 4, type="a/B", md5sum="", message_definition="")
    write("/no name", [text("g")], 4)
    writer.close()
    child = player("-s", "1.5", "-k", "--wait-for-subscribers")
    heard = {}
    for topic in ("/fixed", "/lost", "/latin", "/mixed", "/parts", "/bare"):
        heard[topic] = RawSubscriber(roscore.uri, topic)
    child.await_line("without its definition")
    assert heard["/lost"].header["message_definition"].decode() == lost
    assert heard["/lost"].header["md5sum"].decode() == definition.md5sum
    assert heard["/latin"].header["message_definition"] == latin
    assert [heard[t].header["latching"] for t in ("/fixed", "/latin")] == [b"1", b"0"]
    assert heard["/bare"].header["type"] == b"a/B"
    assert heard["/fixed"].read() == text("b")
    assert heard["/fixed"].read() == text("c")
    assert heard["/bare"].read() == b"xyz"
    assert [heard["/parts"].read() for _ in range(2)] == [b"0", b"1"]
    with RawSubscriber(roscore.uri, "/fixed", md5sum=String._md5sum) as late:
        assert [late.read(), late.read()] == [text("b"), text("c")]
    with RawSubscriber(roscore.uri, "/fixed", md5sum=Int32._md5sum) as wrong:
        assert b"do not match" in wrong.header["error"]
    assert child.end() == 0, child.output
    assert "stored with several types" in child.output
    assert "topic /no name is not played" in child.output
    assert "left out: 2 of /mixed, 1 of /no name, 1 of /parts" in told(child)[-1]
    for one in heard.values():
        one.close()
