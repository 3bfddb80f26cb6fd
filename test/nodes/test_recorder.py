# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The recorder as a node: a real roscore, real publishers, and some that misbehave."""

from __future__ import annotations

import signal
import struct
import subprocess
import sys
import xmlrpc.client
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import genpy
import pytest
import rosbag
from nodes.children import Child, await_true, start_client, start_node, told
from nodes.raw_publisher import RawPublisher, header_of, message
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Int32, String
from suites import sparing

from cassandra_ros.cli import recorder as recorder_program
from cassandra_ros.messages.classes import message_class
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.metadata import FORMAT_NAMES
from cassandra_ros.store.tables.registry import LossKind


def text(n):
    return message(String(str(n)))


def wires(rosCas, topic):
    return [row.wire for row in rosCas.getTopic(topic).rows()]


def publisher(roscore, topic_name, msg_class=String, name="/raw", **fields):
    return RawPublisher(roscore.uri, topic_name, header_of(msg_class, name, **fields), name)


def await_stored(rosCas, **counts):
    """Wait until topics have so many messages, as they are counted."""

    def stored(topic):
        return sum(info.count for info in rosCas.info() if info.topic == f"/{topic}")

    await_true(lambda: {topic: stored(topic) for topic in counts} == counts)


def end(child, topic):
    """End a recorder that has lost nothing.

    A busy machine may tell it later of a publisher that has come again than its connection ends,
    which looks broken then: the recorder warns, though nothing is missing.
    """
    broken = f"a connection of {topic} was broken" in child.output
    assert child.end() == broken, child.output


PLAYED = "turtlesim_tf.bag"
RENAMED = {"/rosout": "/turtle/rosout", "/rosout_agg": "/turtle/rosout_agg"}


@pytest.mark.suite("test", "promise 1, with a real player")
@pytest.mark.parametrize("fmt", sparing(["binary", "ros"], ["ros"], "campaign"))
def test_a_played_bag_is_recorded_message_for_message(bags, roscore, recorder, rosCas, fmt):
    expected = {}
    with rosbag.Bag(str(bags / PLAYED)) as bag:
        for topic, raw, _ in bag.read_messages(raw=True):
            found = expected.setdefault(RENAMED.get(topic, topic), [])
            found.append((raw[0], raw[2], raw[1]))
    child = recorder(*expected, "--format", fmt, "--node-id", "turtle")
    assert told(child)[0] == "services under /recorder"
    assert f"recording {len(expected)} topics" in child.lines
    play = ["rosbag", "play", "-q", "-r", "40", "-d", "0.5", "--wait-for-subscribers"]
    maps = [f"{old}:={new}" for old, new in RENAMED.items()]
    total = sum(map(len, expected.values()))
    # Kept alive: when the player ends, roscpp drops what it has not sent yet.
    play += ["--keep-alive", "--queue", "100000"]
    with Child([*play, bags / PLAYED, *maps], roscore.env) as player:

        def are_stored():
            counts = {info.topic: info.count for info in rosCas.info()}
            return all(counts.get(topic, 0) >= len(sent) for topic, sent in expected.items())

        await_true(are_stored)
        player.end()
    assert child.end() == 0, child.output
    own = 0
    for topic, messages in expected.items():
        rows = list(rosCas.getTopic(topic).rows())
        if topic == "/turtle/rosout":
            # The player's own log goes the same way: what it warned of is no message of the bag,
            # and roscpp renumbers header.seq, the first four bytes. And several publishers had
            # equal stamps, for which it has its own order.
            count = len(rows)
            rows = [row for row in rows if not row.message().name.startswith("/play_")]
            own = count - len(rows)
            recorded = sorted((row.type, row.md5sum, row.wire[4:]) for row in rows)
            messages = sorted((*row[:2], row[2][4:]) for row in messages)
        else:
            recorded = [(row.type, row.md5sum, row.wire) for row in rows]
        assert len(rows) == len(messages), topic
        assert recorded == messages
        assert {row.node for row in rows} == {"turtle"}
    assert "total" in told(child)[-1]
    assert told(child)[-1].split()[1:4] == [str(total + own), str(total + own), "0"]


@pytest.mark.suite("all", "it waits for seconds")
def test_the_end_of_a_burst_is_read(roscore, recorder, rosCas):
    sent = [message(String("x" * 300 + str(n))) for n in range(30_000)]
    child = recorder("/burst")
    first = publisher(roscore, "/burst", name="/first").await_subscribers()
    first.publish(*sent)
    first.hang_up()
    with publisher(roscore, "/burst", name="/second") as second:
        second.await_subscribers().publish(text("last"))
        await_stored(rosCas, burst=len(sent) + 1)
    first.close()
    end(child, "/burst")
    found = wires(rosCas, "/burst")
    found.remove(text("last"))  # may overtake messages in the other connection
    assert found == sent


@pytest.mark.suite("all", "it waits for seconds")
def test_publishers_that_come_at_once(roscore, recorder, rosCas):
    """Each update of the publishers lists all of them; rospy then connects to some twice."""
    child = recorder("/many")
    names = [f"/p{n}" for n in range(12)]
    with ThreadPoolExecutor(len(names)) as pool:
        publishers = list(pool.map(lambda name: publisher(roscore, "/many", name=name), names))
    for one in publishers:
        one.await_subscribers()
    for n in range(50):
        for one in publishers:
            one.publish(text(f"{one.name} {n}"))
    await_stored(rosCas, many=50 * len(names))
    assert [len(one._sockets) for one in publishers] == [1] * len(names)
    for one in publishers:
        one.close()
    assert child.end() == 0, child.output
    rows = list(rosCas.getTopic("/many").rows())
    assert len(rows) == 50 * len(names)
    for name in names:
        own = [row.wire for row in rows if row.connection.callerid == name]
        assert own == [text(f"{name} {n}") for n in range(50)]


@pytest.mark.suite("all", "it kills or cuts something, and waits")
def test_a_publisher_that_comes_again_under_its_uri(roscore, recorder, rosCas):
    """rospy still counts as connected while it reads earlier messages."""
    child = recorder("/again")
    one = publisher(roscore, "/again").await_subscribers()
    for round_ in range(5):
        one.publish(*[text(f"{round_} {n}") for n in range(20_000)])
        one._master.unregisterPublisher(one.name, one.topic, one.uri)
        one.hang_up()
        one._master.registerPublisher(one.name, one.topic, "std_msgs/String", one.uri)
        one.await_subscribers()
    one.close()
    end(child, "/again")
    found = wires(rosCas, "/again")
    assert len(found) == 100_000
    for round_ in range(5):  # a new connection may overtake what lies in the old one
        sent = [text(f"{round_} {n}") for n in range(20_000)]
        assert [wire for wire in found if wire[4:5] == sent[0][4:5]] == sent


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_header_that_is_not_utf8(roscore, recorder, rosCas):
    child = recorder("/latin")
    definition = b"# angle in \xb0\nstring data\n"
    with publisher(roscore, "/latin", message_definition=definition) as one:
        one.await_subscribers().publish(text(1))
        await_stored(rosCas, latin=1)
    assert child.end() == 0, child.output
    (row,) = rosCas.getTopic("/latin").rows()
    assert row.wire == text(1)
    assert row.connection.fields["message_definition"] == definition
    assert row.message().data == "1"


@pytest.mark.suite("all", "make test asks others of its kind")
def test_types_that_differ_on_one_topic(roscore, recorder, rosCas):
    child = recorder("/mixed")
    with publisher(roscore, "/mixed", name="/s") as s, publisher(
        roscore, "/mixed", Int32, name="/i"
    ) as i:
        for n in range(20):
            s.await_subscribers().publish(text(n))
            i.await_subscribers().publish(message(Int32(n)))
        await_stored(rosCas, mixed=40)
    assert child.end() == 0, child.output
    rows = list(rosCas.getTopic("/mixed").rows())
    assert sorted(row.type for row in rows) == ["std_msgs/Int32"] * 20 + ["std_msgs/String"] * 20
    assert {row.message().data for row in rows if row.type == "std_msgs/Int32"} == set(range(20))


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_publisher_that_changes_its_type(roscore, recorder, rosCas):
    """The publisher comes again with its name and URI; the topic goes on in a second table."""
    child = recorder("/changes", "/other")
    with publisher(roscore, "/changes", name="/c") as one, publisher(
        roscore, "/other", name="/o"
    ) as other:
        one.await_subscribers().publish(text(1))
        other.await_subscribers().publish(text(1))
        await_true(lambda: rosCas.existTopic("/changes"))
        one._master.unregisterPublisher(one.name, one.topic, one.uri)
        one.hang_up()
        one.header = header_of(Int32, "/c")
        one._master.registerPublisher(one.name, one.topic, "std_msgs/Int32", one.uri)
        one.await_subscribers().publish(message(Int32(2)))
        other.publish(text(2))
        child.await_line("/changes was stored with type std_msgs/String")
    end(child, "/changes")
    rows = list(rosCas.getTopic("/changes").rows())
    assert [(row.type, row.message().data) for row in rows] == [
        ("std_msgs/String", "1"),
        ("std_msgs/Int32", 2),
    ]
    assert wires(rosCas, "/other") == [text(1), text(2)]


@pytest.mark.suite("test", "promise 3, with a real publisher")
@pytest.mark.parametrize("form", sparing(FORMAT_NAMES, ["ros"], "campaign"))
def test_a_type_that_is_not_installed(roscore, recorder, rosCas, form):
    child = recorder("/lost", "--format", form)
    text_ = "Header header\nfloat32[] ranges\nlost_msgs/Part part\n" + "=" * 80 + "\n"
    text_ += "MSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n" + "=" * 80 + "\n"
    text_ += "MSG: lost_msgs/Part\nstring name\n"
    definition = parse_definition("lost_msgs/Thing", text_)
    other = {"type": definition.type, "md5sum": definition.md5sum, "message_definition": text_}
    thing = message_class(definition)(ranges=[1.5, float("inf")])
    thing.part.name = "wheel"
    with publisher(roscore, "/lost", **other) as one:
        one.await_subscribers().publish(message(thing))
        await_stored(rosCas, lost=1)
    assert child.end() == 0, child.output
    (row,) = rosCas.getTopic("/lost").rows()
    assert (row.type, row.wire, row.table.metadata.format) == (
        definition.type,
        message(thing),
        form,
    )
    header = dict(row.connection.fields)
    assert header == {
        name: value if isinstance(value, bytes) else value.encode()
        for name, value in one.header.items()
    }
    assert row.message().part.name == "wheel"
    assert rosCas.executeCQL("select part.name from lost where ranges[0] > 1") == [("wheel",)]


@pytest.mark.suite("all", "make test asks others of its kind")
def test_headers_without_the_optional_fields(roscore, recorder, rosCas):
    child = recorder("/bare", "--format", "ros")
    fields = {"callerid": None, "latching": None, "message_definition": None, "topic": None}
    with publisher(roscore, "/bare", **fields) as one:
        one.await_subscribers().publish(text(1))
        await_stored(rosCas, bare=1)
    assert child.end() == 0, child.output
    (row,) = rosCas.getTopic("/bare").rows()
    assert (row.wire, row.connection.callerid) == (text(1), "")
    assert rosCas.executeCQL("select data from bare") == [("1",)]


SIGNATURE = "_md5sum;open({!r},'w').write('x');B"


@pytest.mark.suite("all", "make test asks others of its kind")
@pytest.mark.parametrize("place", sparing(["name", "value", "type"], kept=["name"]))
def test_a_hostile_definition_runs_nothing(roscore, recorder, rosCas, tmp_path, place):
    trap = tmp_path / "trap"
    code = SIGNATURE.format(str(trap))
    definition = {
        "name": f"int32 {code}=1\nstring data\n",
        "value": f"float64 A=__import__('os').system('touch {trap}')\nstring data\n",
        "type": f"string[1];open({str(trap)!r},'w') data\n",
    }[place]
    child = recorder("/hostile", "/good", "--format", "ros")
    header = {"message_definition": definition, "type": "pkg/Evil", "md5sum": "1" * 32}
    with publisher(roscore, "/hostile", **header) as one, publisher(
        roscore, "/good", name="/good"
    ) as good:
        one.await_subscribers().publish(text("evil"))
        good.await_subscribers().publish(text("good"))
        await_stored(rosCas, hostile=1, good=1)
    assert child.end() == 0, child.output
    assert "kept as binary" in child.output
    (row,) = rosCas.getTopic("/hostile").rows()
    assert (row.wire, row.table.metadata.format) == (text("evil"), "binary")
    assert row.connection.definition_text == definition
    row.message()
    assert rosCas.executeCQL("select data from good") == [("good",)]
    assert not trap.exists()


@pytest.mark.suite("all", "it waits for seconds")
def test_warnings_reach_rosout(roscore, recorder, rosCas):
    child = recorder("/rosout", "/broken")
    with publisher(roscore, "/broken", message_definition="no definition") as one:
        one.await_subscribers().publish(text(1))

        def isStored():
            rows = rosCas.getTopic("/rosout").rows() if rosCas.getAllTopics("/rosout") else ()
            said = [row.message().msg for row in rows]
            return any("/broken" in line and "kept as binary" in line for line in said)

        await_true(isStored)
    assert child.end() == 0, child.output


@pytest.mark.suite("test", "Ctrl-C loses nothing")
@pytest.mark.parametrize("number", sparing([signal.SIGINT, signal.SIGTERM], kept=[signal.SIGINT]))
def test_signals_drain(roscore, recorder, rosCas, number):
    sent = [message(String("y" * 1000 + str(n))) for n in range(5000)]
    child = recorder("/late")
    with publisher(roscore, "/late") as one:
        one.await_subscribers().publish(*sent)
        assert child.end(number) == 0, child.output
    assert wires(rosCas, "/late") == sent
    assert "5000" in told(child)[-1]


@pytest.mark.suite("all", "it waits for seconds")
def test_a_message_that_never_comes_to_its_end_is_told(roscore, recorder, rosCas):
    child = recorder("/whole", "/torn")
    with publisher(roscore, "/whole", name="/w") as whole, publisher(
        roscore, "/torn", name="/t"
    ) as torn:
        whole.await_subscribers().publish(text(1))
        torn.await_subscribers()
        torn._sockets[0].sendall(struct.pack("<I", 100) + b"and no more")
        assert child.end() == 1, child.output
    assert wires(rosCas, "/whole") == [text(1)]
    assert "the last messages of the publishers of /torn are not recorded" in child.output
    assert "/torn: 1 lost: not read from the socket" in child.output
    (loss,) = rosCas.losses()
    assert (loss.topic, loss.kind, loss.count) == ("/torn", LossKind.NOT_READ, 1)


@pytest.mark.suite("all", "it kills or cuts something, and waits")
def test_rosnode_kill_drains(roscore, recorder, rosCas):
    child = recorder("/killed", "__name:=to_be_killed")
    with publisher(roscore, "/killed") as one, start_client(roscore) as client:
        one.await_subscribers().publish(*[text(n) for n in range(100)])

        def received():
            topics = client.call("/to_be_killed/status")["topics"]
            return sum(each["received"] for each in topics if each["topic"] == "/killed") == 100

        await_true(received)
        killed = subprocess.run(
            ["rosnode", "kill", "/to_be_killed"], env=roscore.env, capture_output=True, check=False
        )
        assert killed.returncode == 0
        assert child.wait() == 0, child.output
    assert len(wires(rosCas, "/killed")) == 100


@pytest.mark.suite("test", "the clock of a simulation")
def test_simulated_time(roscore, recorder, rosCas):
    master = xmlrpc.client.ServerProxy(roscore.uri)
    master.setParam("/test", "/use_sim_time", True)
    try:
        child = recorder("/sim", "/clock")
        with publisher(roscore, "/sim", name="/sim") as one, publisher(
            roscore, "/clock", Clock, name="/clock"
        ) as clock:
            one.await_subscribers().publish(text("too early"))
            child.await_line("1 messages lost so far")
            ticks = [message(Clock(genpy.Time(1234 - 500 + n))) for n in range(1, 501)]
            clock.await_subscribers().publish(*ticks)
            await_true(lambda: {i.topic: i.count for i in rosCas.info()}.get("/clock") == 500)
            one.publish(text("in time"))
            await_stored(rosCas, sim=1)
        assert child.end() == 1, child.output
    finally:
        master.deleteParam("/test", "/use_sim_time")
    (row,) = rosCas.getTopic("/sim").rows()
    assert (row.t, row.wire) == (1234 * 10**9, text("in time"))
    # rospy itself subscribes with a queue of one, which other subscriptions would share.
    assert sorted(wires(rosCas, "/clock")) == sorted(ticks)
    assert "1 lost: no clock: simulated time" in child.output
    assert "1 message was lost" in child.output


@pytest.mark.suite("test", "--limit")
def test_limit_and_duration(roscore, recorder, rosCas):
    child = recorder("/a", "/b", "-l", "3")
    with publisher(roscore, "/a", name="/a") as a, publisher(roscore, "/b", name="/b") as b:
        a.await_subscribers().publish(*[text(n) for n in range(10)])
        b.await_subscribers().publish(*[text(n) for n in range(10)])
        assert child.wait() == 0, child.output
    assert wires(rosCas, "/a") == wires(rosCas, "/b") == [text(n) for n in range(3)]


@pytest.mark.suite("test", "-a and -x, which look at the master again and again")
def test_all_and_exclude(roscore, recorder, rosCas):
    with publisher(roscore, "/old", name="/old", latching="1") as old:
        child = recorder("-a", "-x", "/(secret|rosout_agg).*")
        old.await_subscribers().publish(text("old"))
        # In this order: who has found the new topic has seen the secret one, too.
        with publisher(roscore, "/secret/x", name="/secret") as secret, publisher(
            roscore, "/new/topic", name="/new"
        ) as new:
            new.await_subscribers().publish(text("new"))
            child.await_line("/new/topic")
            assert child.end() == 0, child.output
            assert not secret._sockets
    names = {topic.name for topic in rosCas.getAllTopics()}
    assert {"/old", "/new/topic"} <= names
    assert not any("secret" in name or name == "/rosout_agg" for name in names)


@pytest.mark.suite("test", "-e")
def test_regular_expressions(roscore, recorder, rosCas):
    with publisher(roscore, "/cam/1", name="/c1") as one, publisher(
        roscore, "/cam/1/info", name="/c2"
    ) as info:
        child = recorder("-e", "/cam/[0-9]")
        one.await_subscribers().publish(text(1))
        assert child.end() == 0, child.output
        assert not info._sockets
    assert [topic.name for topic in rosCas.getAllTopics()] == ["/cam/1"]


@pytest.mark.suite("all", "it starts many programs")
def test_no_name_of_a_living_node_is_taken(roscore, recorder, rosCas):
    first = recorder("/x")
    second = recorder("/x")
    assert "a node /recorder runs already; this one is /recorder_" in second.output
    with publisher(roscore, "/x") as one:
        one.await_subscribers(2).publish(text(1))
        await_stored(rosCas, x=2)
    assert (first.end(), second.end()) == (0, 0)
    assert len(wires(rosCas, "/x")) == 2


@pytest.mark.suite("all", "it starts many programs")
def test_a_second_node_of_a_name_has_the_parameters_that_roslaunch_wrote_there(
    roscore, recorder, rosCas
):
    first = recorder("/x")
    master = xmlrpc.client.ServerProxy(roscore.uri)
    master.setParam("/test", "/recorder/topics", "/y")
    second = recorder("__name:=recorder")
    master.deleteParam("/test", "/recorder/topics")
    assert "a node /recorder runs already; this one is /recorder_" in second.output
    with publisher(roscore, "/x", name="/px") as x, publisher(roscore, "/y", name="/py") as y:
        for one in (x, y):
            one.await_subscribers().publish(text(1))
        await_stored(rosCas, x=1, y=1)
    assert (first.end(), second.end()) == (0, 0)


@pytest.mark.suite("all", "it starts many programs")
def test_recorders_that_start_at_the_same_moment_have_two_names(roscore, recorder, rosCas):
    """The run, too: it is told that a second run has its name, and how to name one of them."""
    both = [recorder("/x", "--name", "lab", ready="") for _ in range(2)]
    with publisher(roscore, "/x") as one:
        one.await_subscribers(2).publish(text(1))
        await_stored(rosCas, x=2)
    assert [child.end() for child in both] == [0, 0]
    second = ["this one is /recorder_" in child.output for child in both]
    assert sorted(second) == [False, True]
    assert any("2 runs are called lab: " in child.output for child in both)


@pytest.mark.suite("test", "a recorder from its start to its end")
def test_quiet(roscore, recorder):
    with publisher(roscore, "/x") as one:
        child = recorder("/x", "-q", "--limit", "1", ready="")
        one.await_subscribers().publish(text(1))
        assert child.wait() == 0
    # A warning that the store is slow is not left out by -q.
    assert [line for line in told(child) if "wait for the store" not in line] == []


@pytest.mark.suite("all", "it waits for seconds")
def test_a_name_that_nobody_publishes(roscore, recorder):
    """The recorder reports it at once, with a similar name, and at the end with its exit status."""
    with publisher(roscore, "/front/scan") as one:
        child = recorder("/front/scna", "/front/scan")
        said = child.await_line("topic /front/scna has no publisher yet")
        assert said.endswith("did you mean /front/scan?")
        one.await_subscribers().publish(text(1))
        assert child.end() == 1
    assert "recorder: no message came on /front/scna: it had no publisher" in child.output
    assert "no message came on /front/scan:" not in child.output
    child = recorder("-e", "/no/such/.*", "--duration", "0.1")
    assert child.wait() == 1
    assert "nothing was recorded" in child.output


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ((), "give topics to record"),
        (("-a", "/x"), "not both"),
        (("-e", "("), "not a regular expression"),
        (("-a", "-x", "["), "not a regular expression"),
        (("/x", "--duration", "soon"), "not a duration"),
        (("/x", "-b", "-5"), "whole number"),
        (("/x", "--format", "xml"), "no format 'xml'"),
        (("/has space",), "'/has space' is not a name of a ROS topic: ' ' may not stand in it"),
        (("/good", "3d"), "it must begin with a letter, / or ~"),
    ],
)
def test_wrong_usage(arguments, word, capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["recorder", *arguments])
    with pytest.raises(SystemExit) as end:
        recorder_program.main()
    assert end.value.code == 2
    assert word in capsys.readouterr().err


def test_nothing_to_record_needs_no_master(roscore):
    child = start_node(roscore, "recorder", env={"ROS_MASTER_URI": "http://127.0.0.1:1/"})
    assert child.wait() == 2
    assert "give topics to record" in child.output


@pytest.mark.suite("test", "four recorders")
def test_help_and_no_server(roscore):
    done = subprocess.run(
        ["rosrun", "cassandra_ros", "recorder", "--help"],
        env=roscore.env,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "record all topics, except" in done.stdout
    child = start_node(roscore, "recorder", "/x", "--port", "1", "--wait", "0")
    assert child.wait() == 1
    assert "rosrun cassandra_ros local_cassandra start" in child.output


def test_scripts_are_thin():
    for script in (Path(__file__).parents[2] / "scripts").iterdir():
        assert len(script.read_text().splitlines()) < 10
        assert not script.stat().st_mode & 0o111
    assert live_connection("/x", {}).header == b""


@pytest.mark.suite("all", "it kills or cuts something, and waits")
def test_a_connection_that_breaks_is_made_again(recorder, roscore, rosCas):
    """A network that was away: the publisher goes on, and the master has nothing to tell."""
    with RawPublisher(roscore.uri, "/a", header_of(String)) as publisher, RawPublisher(
        roscore.uri, "/a", header_of(String, "/other"), "/other"
    ) as other:
        child = recorder("/a")
        publisher.await_subscribers().publish(*(message(String(str(n))) for n in range(5)))
        other.await_subscribers()
        await_true(lambda: len(rosCas.getAllTopics()) == 1 and rosCas.getTopic("/a").last())
        publisher.hang_up()
        publisher.await_subscribers().publish(*(message(String(str(n))) for n in range(5, 9)))
        child.await_line("a connection of /a was broken, while its publisher went on")
        assert child.end() == 1, child.output
    assert "publishers of /a were not heard" in child.output
    assert [m.data for _, m in rosCas.getTopic("/a").items()] == [str(n) for n in range(9)]
    (loss,) = rosCas.losses()
    assert (loss.topic, loss.kind, loss.count) == ("/a", LossKind.UNHEARD, 0)


@pytest.mark.suite("all", "make test asks others of its kind")
def test_who_unsubscribes_hears_no_more_though_another_listens(roscore):
    """A process has two subscribers, and the first one leaves."""
    script = Path(__file__).with_name("two_subscribers.py")
    with RawPublisher(roscore.uri, "/a", header_of(String)) as publisher, Child(
        [sys.executable, script], roscore.env
    ) as child:
        child.await_line("both listen")
        publisher.await_subscribers().publish(message(String("1")))
        child.await_line("one left")
        publisher.publish(message(String("2")))
        child.await_line("other: 2")
        assert child.end() == 0, child.output
    heard = sorted(line for line in child.lines if line.startswith(("ours:", "other:")))
    assert heard == ["other: 1", "other: 2", "ours: 1"]
