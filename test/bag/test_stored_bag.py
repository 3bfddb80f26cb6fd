# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Class Bag beside rosbag's: the same assertions hold for both."""

from __future__ import annotations

import pickle
import subprocess
import sys
from functools import partial
from io import BytesIO
from random import Random

import genpy
import pytest
import rosbag
import rospy
import yaml
from bag.truth import STRING_MD5, string_connection, string_wire
from geometry_msgs.msg import Twist
from std_msgs.msg import Header, String
from suites import FURTHER

import cassandra_ros
from cassandra_ros.errors import (
    BagError,
    BagNotFound,
    InvalidKey,
    InvalidOption,
    RunNotFound,
    TypeMismatch,
)
from cassandra_ros.files.bag import stored_bag
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.files.bag.summary import Summary, TopicSummary
from cassandra_ros.keys import MAX_NS
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.messages.stamps import Stamp

SEC = 10**9
T0 = 1_368_021_980 * SEC
CALLERS = ("/alice", "/bob")
WORDS = [(T0 + n * SEC // 10, CALLERS[n % 2], f"word {n}") for n in range(20)]
TWISTS = [(T0 + 1 + n * SEC // 2, n / 4) for n in range(4)]


def twist(x):
    msg = Twist()
    msg.linear.x = x
    return msg


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """A bag: words of two publishers, twists, and one header."""
    path = tmp_path_factory.mktemp("bags") / "walk.bag"
    header = {"topic": "/cmd_vel", "type": "geometry_msgs/Twist", "md5sum": Twist._md5sum}
    header["message_definition"] = Twist._full_text
    with BagWriter(path, "none") as writer:
        numbers = {
            caller: writer.connection(string_connection("/chatter", callerid=caller), n)
            for n, caller in enumerate(CALLERS)
        }
        velocity = writer.connection(live_connection("/cmd_vel", header), 2)
        messages = [(t, numbers[caller], string_wire(text)) for t, caller, text in WORDS]
        for t, x in TWISTS:
            messages.append((t, velocity, twist_wire(x)))
        for t, number, wire in sorted(messages):
            writer.write(number, t, wire)
    return path


def twist_wire(x):
    buffer = BytesIO()
    twist(x).serialize(buffer)
    return buffer.getvalue()


@pytest.fixture(scope="module")
def store(fresh, path):
    """The bag as a run, one topic packed, and beside it a message that is not of the run."""
    with fresh() as store:
        store.addTopic("/cmd_vel", "packed")
        other = store.addTopic("/chatter", msg_type="std_msgs/String")
        other.addData(String(data="of another run"), key=T0 + 5)
        import_bag(store, path)
        yield store


@pytest.fixture(params=["rosbag", "store"])
def bag(request, path, store):
    opened = (
        rosbag.Bag(str(path))
        if request.param == "rosbag"
        else cassandra_ros.Bag(str(path), rosCas=store)
    )
    with opened as bag:
        yield bag


def times(messages):
    return [t.to_nsec() for _, _, t in messages]


def test_all_messages_in_order(bag):
    read = [(topic, t.to_nsec()) for topic, msg, t in bag]
    expected = [("/chatter", t) for t, _, _ in WORDS] + [("/cmd_vel", t) for t, _ in TWISTS]
    assert read == sorted(expected, key=lambda each: each[1])
    first = next(bag.read_messages())
    assert first.topic == "/chatter"
    assert (first.message.data, first.message._type) == ("word 0", "std_msgs/String")
    assert first.timestamp == rospy.Time(T0 // SEC)
    assert first._fields == ("topic", "message", "timestamp")
    assert (rospy.Time(T0 // SEC + 3) - first.timestamp).to_sec() == 3.0
    assert first.timestamp.to_sec() == T0 / SEC


def test_topics(bag):
    assert len(list(bag.read_messages("/cmd_vel"))) == 4
    assert len(list(bag.read_messages(["/cmd_vel"]))) == 4
    assert len(list(bag.read_messages(topics=["/cmd_vel", "/chatter"]))) == 24
    assert len(list(bag.read_messages(topics=[]))) == 24
    assert list(bag.read_messages(topics=["/none"])) == []
    assert [m.linear.x for _, m, _ in bag.read_messages("/cmd_vel")] == [x for _, x in TWISTS]


def test_a_time_range(bag):
    start, end = rospy.Time(T0 // SEC, SEC // 10), genpy.Time(T0 // SEC, SEC // 2)
    found = times(bag.read_messages("/chatter", start, end))
    assert found == [t for t, _, _ in WORDS[1:6]]
    assert times(bag.read_messages("/chatter", start_time=end)) == [t for t, _, _ in WORDS[5:]]
    assert times(bag.read_messages("/cmd_vel", end_time=start)) == [TWISTS[0][0]]
    assert list(bag.read_messages(end_time=genpy.Time(5))) == []


def test_connections(bag):
    asked = []

    def of_bob(topic, datatype, md5sum, msg_def, header):
        asked.append((topic, datatype, md5sum))
        assert header["topic"] == topic.encode()
        assert "data" in msg_def or datatype != "std_msgs/String"
        return header.get("callerid") == b"/bob"

    words = [m.data for _, m, _ in bag.read_messages(connection_filter=of_bob)]
    assert words == [text for _, caller, text in WORDS if caller == "/bob"]
    assert ("/chatter", "std_msgs/String", STRING_MD5) in asked
    assert list(bag.read_messages(connection_filter=lambda *facts: False)) == []
    for *_, header in bag.read_messages("/chatter", return_connection_header=True):
        assert header["callerid"] in (b"/alice", b"/bob")
    one = next(bag.read_messages(return_connection_header=True))
    assert (one.topic, one.connection_header["callerid"]) == ("/chatter", b"/alice")


def test_raw(bag):
    topic, raw, t = next(bag.read_messages("/cmd_vel", raw=True))
    datatype, data, md5sum, _, pytype = raw
    assert (topic, datatype, md5sum) == ("/cmd_vel", "geometry_msgs/Twist", Twist._md5sum)
    assert (data, t.to_nsec()) == (twist_wire(0), TWISTS[0][0])
    assert pytype().deserialize(data).linear.x == 0


def test_counts(bag):
    assert bag.get_message_count() == 24
    assert bag.get_message_count("/chatter") == bag.get_message_count(["/chatter"]) == 20
    assert bag.get_message_count(topic_filters=["/chatter", "/cmd_vel"]) == 24
    assert bag.get_message_count("/none") == bag.get_message_count([]) == 0


def test_types_and_topics(bag):
    types, topics = bag.get_type_and_topic_info()
    assert types == {"std_msgs/String": STRING_MD5, "geometry_msgs/Twist": Twist._md5sum}
    assert list(topics) == ["/chatter", "/cmd_vel"]
    chatter = topics["/chatter"]
    assert (chatter.msg_type, chatter.message_count) == ("std_msgs/String", 20)
    assert (chatter.connections, round(chatter.frequency, 3)) == (2, 10.0)
    info = bag.get_type_and_topic_info(topic_filters="/cmd_vel")
    assert list(info.topics) == ["/cmd_vel"]
    assert tuple(info.topics["/cmd_vel"])[:3] == ("geometry_msgs/Twist", 4, 1)
    assert info.msg_types == types
    assert bag.get_type_and_topic_info([]).topics == {}


def test_times_names_and_text(bag, path):
    assert bag.get_start_time() == T0 / SEC
    assert bag.get_end_time() == pytest.approx((WORDS[-1][0]) / SEC, abs=1e-6)
    assert (bag.filename, bag.mode, bag.version) == (str(path), "r", 200)
    assert bag.size > 0
    assert bag.options == {"compression": "none", "chunk_threshold": 768 * 1024}
    assert (bag.compression, bag.chunk_threshold) == ("none", 768 * 1024)
    lines = [line.split() for line in str(bag).splitlines()]
    alike = [line for line in lines if line[0] not in ("size:", "compression:")]
    with rosbag.Bag(str(path)) as truth:
        others = [line.split() for line in str(truth).splitlines()]
    assert alike == [line for line in others if line[0] not in ("size:", "compression:")]


def test_the_facts_as_yaml(bag, path):
    """As the wiki of rosbag shows it."""
    facts = yaml.safe_load(bag._get_yaml_info())
    order = "path version duration start end size messages indexed compression types topics"
    assert list(facts) == order.split()
    with rosbag.Bag(str(path)) as truth:
        expected = yaml.safe_load(truth._get_yaml_info())
    facts.pop("size"), expected.pop("size")  # of a file
    assert facts.pop("duration") == pytest.approx(expected.pop("duration"), abs=1e-5)
    for one in (*facts["topics"], *expected["topics"]):
        one["frequency"] = round(one["frequency"], 3)
    assert facts == expected
    assert bag._get_yaml_info(key="messages").strip() == "24"
    assert bag._get_yaml_info("colour") is None
    (first, *_) = yaml.safe_load(bag._get_yaml_info("types"))
    assert list(first.items())[:1] == [("type", "geometry_msgs/Twist")]


def test_closed(bag):
    bag.close()
    bag.close()
    with pytest.raises(ValueError, match="closed"):
        bag.read_messages()
    with pytest.raises(ValueError, match="closed"):
        bag.write("/a", String())


@pytest.mark.parametrize("kind", ["rosbag", "store"])
def test_writing(kind, store, tmp_path):
    name = str(tmp_path / f"written_{kind}.bag")

    def opened(mode):
        if kind == "rosbag":
            return rosbag.Bag(name, mode)
        return cassandra_ros.Bag(name, mode, rosCas=store)

    with opened("w") as bag:
        bag.write("/out", String(data="one"), rospy.Time(5, 6))
        bag.write("/out", String(data="two"), t=genpy.Time(7, 8))
        (_, raw, t) = next(bag.read_messages(raw=True))
        bag.write("/copy", raw, t, raw=True)
        header = {"topic": "/known", "type": raw[0], "md5sum": raw[2], "callerid": "/me"}
        header["message_definition"] = String._full_text
        bag.write("/known", String(data="x"), t, connection_header=header)
        bag.write("/now", Header())
        bag.flush()
        assert bag.get_message_count() == 5
        # rosbag gives messages twice that were read while it was writing.
        if kind == "store":
            assert [m.data for _, m, _ in bag.read_messages("/out")] == ["one", "two"]
    with opened("a") as bag:
        bag.write("/out", String(data="three"), genpy.Time(6))
    with opened("r") as bag:
        assert [m.data for _, m, _ in bag.read_messages("/out")] == ["one", "three", "two"]
        ((_, copied, t),) = bag.read_messages("/copy")
        assert (copied.data, t.to_nsec()) == ("one", 5 * SEC + 6)
        ((_, _, _, known),) = bag.read_messages("/known", return_connection_header=True)
        assert known["callerid"] in (b"/me", "/me")
        assert bag.get_start_time() == 5.000000006
        assert (bag.get_message_count(), bag.mode) == (6, "r")
        with pytest.raises((ValueError, OSError)):
            bag.write("/out", String())


def test_what_is_being_written_is_counted(store):
    """Count, size, times and types include each message that was written, without a flush."""
    with cassandra_ros.Bag("counted.bag", "w", rosCas=store) as bag:
        for n in range(3):
            bag.write("/counted", String(data=str(n)), rospy.Time(5 + n))
            assert bag.get_message_count() == bag.get_message_count("/counted") == n + 1
            assert bag.get_end_time() == 5.0 + n
            assert bag.get_type_and_topic_info().topics["/counted"].message_count == n + 1
        assert bag.size == 3 * len(string_wire("0"))


SCRIPT = """
import sys
out = Bag(sys.argv[2], "w")
for topic, msg, t in Bag(sys.argv[1]).read_messages(topics=["/chatter"]):
    if msg.data.endswith("7"):
        out.write(topic, msg, t)
        print(topic, msg.data, t, round(t.to_sec(), 3))
"""


def test_a_script_works_by_changing_one_line(store, path, cassandra, ros_env, tmp_path):
    """It forgets to close: what it wrote is stored all the same."""
    env = dict(ros_env, CASSANDRA_ROS_HOST=cassandra.host, CASSANDRA_ROS_PORT=str(cassandra.port))
    env["CASSANDRA_ROS_KEYSPACE"] = store.keyspace
    told = []
    for module in ("rosbag", "cassandra_ros"):
        script = f"from {module} import Bag{SCRIPT}"
        command = [sys.executable, "-c", script, str(path), str(tmp_path / "sevens.bag")]
        done = subprocess.run(command, capture_output=True, text=True, env=env)
        assert done.returncode == 0, done.stderr
        told.append(done.stdout)
    assert told[0] == told[1]
    assert told[0].startswith(f"/chatter word 7 {WORDS[7][0]} ")
    with cassandra_ros.Bag("sevens.bag", rosCas=store) as bag:
        assert [m.data for _, m, _ in bag] == ["word 7", "word 17"]


def test_a_run_is_found_by_name_and_path_and_without_one_all_is_read(store, path):
    (run,) = (each for each in store.runs() if each.name == "walk.bag")
    for name in ("walk.bag", path, bytes(path), str(run.writer)):
        with cassandra_ros.Bag(name, rosCas=store) as bag:
            assert bag.get_message_count() == 24, name
    with cassandra_ros.Bag("walk.bag", rosCas=store) as bag:
        assert repr(bag) == f"<Bag 'walk.bag' of keyspace {store.keyspace}, mode r>"
    with cassandra_ros.Bag(rosCas=store) as bag:
        assert "of another run" in [m.data for _, m, _ in bag.read_messages("/chatter")]
        assert bag.filename == store.keyspace
    with pytest.raises(RunNotFound, match=r"no run 'wolk.bag' .* did you mean walk.bag"):
        cassandra_ros.Bag("wolk.bag", rosCas=store)
    for name in ("walk.bag", path):
        with pytest.raises(BagError, match="is not overwritten: add to it with mode 'a'"):
            cassandra_ros.Bag(name, "w", rosCas=store)
    assert store.getTopic("/chatter").countTopicData(run="walk.bag") == 20
    for wrong in ({"mode": "rb"}, {"mode": "w"}):
        with pytest.raises(InvalidOption):
            cassandra_ros.Bag(rosCas=store, **wrong)


def other_file(folder, name="walk.bag"):
    """Make another bag, which is not stored."""
    folder.mkdir()
    with rosbag.Bag(str(folder / name), "w") as bag:
        bag.write("/other", String(data="of the other file"), rospy.Time(5))
    return folder / name


@pytest.mark.parametrize("mode", ["r", "a"])
def test_another_file_of_a_stored_name_is_not_taken_for_it(
    store, path, tmp_path, monkeypatch, mode
):
    (run,) = (each for each in store.runs() if each.name == "walk.bag")
    other = other_file(tmp_path / "d2")
    known = f"stored run 'walk.bag' is of {path} .open it as Bag.'{path}'. or Bag.'{run.writer}'"
    with pytest.raises(BagNotFound, match=f"{other} is not stored .*; the {known}"):
        cassandra_ros.Bag(other, mode, rosCas=store)
    # Also where the folder is not named: the file is the one that is meant here.
    monkeypatch.chdir(other.parent)
    for name in ("walk.bag", "./walk.bag"):
        with pytest.raises(BagNotFound, match=known):
            cassandra_ros.Bag(name, mode, rosCas=store)
    # And one of which nothing at all is stored.
    new = other_file(tmp_path / "d3", "new.bag")
    with pytest.raises(OSError, match=f"{new} is not stored .*: cassandra_bag import {new}"):
        cassandra_ros.Bag(new, mode, rosCas=store)


def test_a_path_whose_file_was_moved_or_removed(fresh, tmp_path):
    moved = other_file(tmp_path / "before", "drive.bag")
    (tmp_path / "link").symlink_to(moved.parent)
    with fresh() as store:
        import_bag(store, moved)
        for name in (moved, tmp_path / "link" / "drive.bag"):
            with cassandra_ros.Bag(name, rosCas=store) as bag:
                assert [m.data for _, m, _ in bag] == ["of the other file"]
        target = tmp_path / "after.d" / "drive.bag"
        target.parent.mkdir()
        moved.rename(target)
        for name in (moved, "drive.bag", target):
            with cassandra_ros.Bag(name, rosCas=store) as bag:
                assert bag.get_message_count() == 1
        target.write_bytes(target.read_bytes()[:-1])
        with pytest.raises(BagNotFound, match=rf"is not stored .* is of {moved} .open it as Bag"):
            cassandra_ros.Bag(target, rosCas=store)
        target.unlink()
        with pytest.raises(BagNotFound, match=f"is of {moved} "):
            cassandra_ros.Bag(target, rosCas=store)


def words(store, name):
    with cassandra_ros.Bag(name, rosCas=store) as bag:
        return [m.data for _, m, _ in bag.read_messages()]


def test_what_is_written_is_found_by_its_path_and_replaced_under_it_alone(fresh, tmp_path):
    first, second = tmp_path / "d1" / "out.bag", tmp_path / "d2" / "out.bag"
    with fresh() as store:

        def write(name, word, mode="w", **options):
            with cassandra_ros.Bag(name, mode, rosCas=store, **options) as bag:
                bag.write("/out", String(data=word), rospy.Time(5))

        write(first, "one")
        write(second, "two")
        assert (words(store, first), words(store, second)) == (["one"], ["two"])
        assert sorted(words(store, "out.bag")) == ["one", "two"]
        write(second, "three", "a")
        assert (words(store, first), words(store, second)) == (["one"], ["two", "three"])
        write(second, "of a robot", nodeID="robot")
        assert words(store, second) == ["two", "three", "of a robot"]
        # As rosbag empties the file; what another path or robot has stays.
        write(second, "four")
        assert sorted(words(store, second)) == ["four", "of a robot"]
        assert words(store, first) == ["one"]
        with pytest.raises(BagError, match=r"run out.bag .of .*/d[12]/out.bag. is stored already"):
            cassandra_ros.Bag("out.bag", "w", rosCas=store)
        assert len(store.runs()) == 3
        going_on = cassandra_ros.Bag(tmp_path / "open.bag", "w", rosCas=store)
        with going_on, pytest.raises(ValueError, match="goes on"):
            cassandra_ros.Bag(tmp_path / "open.bag", "w", rosCas=store)


def test_by_the_environment(store, path, cassandra, monkeypatch):
    monkeypatch.setenv("CASSANDRA_ROS_HOST", cassandra.host)
    monkeypatch.setenv("CASSANDRA_ROS_PORT", str(cassandra.port))
    monkeypatch.setenv("CASSANDRA_ROS_KEYSPACE", store.keyspace)
    with cassandra_ros.Bag(path) as bag:
        times = [t for _, _, t in bag.read_messages("/cmd_vel")]
    assert times == [Stamp.from_ns(t) for t, _ in TWISTS]
    with pytest.raises(BagError, match="is closed"):
        iter(bag)


EQUAL = [(n // 12, n * 7 % 5) for n in range(60)]
"""Second and connection of messages, of which twelve each have equal times."""


def bag_of_equal_times(path):
    """Write connections in another order than that of their messages, two on each topic."""
    with BagWriter(path, chunk_bytes=500) as writer:
        for number in (3, 0, 4, 1, 2):
            connection = string_connection(f"/t{number % 2}", callerid=f"/n{number}")
            writer.connection(connection, number)
        for n, (t, number) in enumerate(EQUAL):
            writer.write(number, t * SEC, string_wire(f"{number} {n}"))


def texts(bag, **wanted):
    return [(topic, msg.data, t.to_nsec()) for topic, msg, t in bag.read_messages(**wanted)]


@pytest.mark.parametrize("held", [None, 0, 5000])
def test_equal_times_come_in_the_order_of_rosbag(fresh, tmp_path, monkeypatch, held):
    if held is not None:  # more messages of one time than are held at once
        monkeypatch.setattr(stored_bag, "SORTED_BYTES", held)
    path = tmp_path / "equal.bag"
    bag_of_equal_times(path)
    with fresh() as store:
        import_bag(store, path)
        ours, theirs = cassandra_ros.Bag(path, rosCas=store), rosbag.Bag(str(path))
        with ours, theirs:
            assert texts(ours) == texts(theirs)
            ends = {"start_time": rospy.Time(1), "end_time": rospy.Time(3)}
            assert texts(ours, topics="/t1", **ends) == texts(theirs, topics="/t1", **ends)


def test_equal_times_of_what_is_written_come_in_the_order_of_rosbag(fresh, tmp_path):
    path = tmp_path / "written.bag"
    told = []
    with fresh() as store:
        for opened in (rosbag.Bag, partial(cassandra_ros.Bag, rosCas=store)):
            with opened(str(path), "w") as bag:
                for n, (t, number) in enumerate(EQUAL):
                    bag.write(f"/t{4 - number}", String(data=f"{n}"), rospy.Time(t))
            with opened(str(path), "a") as bag:
                for n, (t, number) in enumerate(EQUAL):
                    bag.write(f"/t{number + 2}", String(data=f"more {n}"), rospy.Time(t))
            with opened(str(path)) as bag:
                told.append(texts(bag))
    assert told[0] == told[1]


def test_types_of_all_topics_whatever_is_asked_for(fresh, tmp_path):
    """Also one that only a second connection of a topic names, under the same md5sum."""
    path = tmp_path / "kinds.bag"
    with BagWriter(path) as writer:
        for number, (topic, kind) in enumerate(
            [("/a", "std_msgs/String"), ("/a", "my_msgs/Text"), ("/b", "her_msgs/Words")]
        ):
            connection = string_connection(topic)
            fields = {**connection.fields, "type": kind.encode()}
            writer.connection(live_connection(topic, fields), number)
            writer.write(number, (number + 1) * SEC, string_wire("x"))
    with fresh() as store:
        import_bag(store, path)
        ours, theirs = cassandra_ros.Bag(path, rosCas=store), rosbag.Bag(str(path))
        with ours, theirs:
            for asked in (None, "/a", "/b", ["/a", "/b"], "/none", []):
                types, topics = ours.get_type_and_topic_info(asked)
                assert (types, {name: tuple(t) for name, t in topics.items()}) == tuple(
                    theirs.get_type_and_topic_info(asked)
                ), asked


@pytest.fixture(params=["rosbag", "store"])
def opened(request, fresh, tmp_path):
    """Opens the bag of a name, by rosbag or by us."""
    if request.param == "rosbag":
        yield lambda name="a.bag", *args, **options: rosbag.Bag(
            str(tmp_path / name) if isinstance(name, str) and name else name, *args, **options
        )
        return
    with fresh() as store:
        yield lambda name="a.bag", *args, **options: cassandra_ros.Bag(
            str(tmp_path / name) if isinstance(name, str) and name else name,
            *args,
            **options,
            rosCas=store,
        )


def test_what_rosbag_refuses_is_refused_by_an_error_of_the_same_kind(opened):
    for name in ("", b"", None):
        with pytest.raises(ValueError, match="."):
            opened(name)
    for wrong in (
        {"mode": "z"},
        {"compression": "foobar"},
        {"chunk_threshold": -1000},
        {"options": 5},
        {"options": {"compression": "zip"}},
    ):
        with pytest.raises(ValueError, match="."):
            opened("none.bag", **wrong)
    with pytest.raises(FileNotFoundError):
        opened("none.bag")
    with opened("a.bag", "w") as bag:
        for wrong in ({"compression": "zip"}, {"chunk_threshold": -1}):
            ((name, value),) = wrong.items()
            with pytest.raises(ValueError, match="."):
                setattr(bag, name, value)
        bag.compression, bag.chunk_threshold = "bz2", 5000
        assert bag.options == {"compression": "bz2", "chunk_threshold": 5000}
        for asked in (bag.get_start_time, bag.get_end_time):
            with pytest.raises(rosbag.ROSBagException, match="Bag contains no message") as caught:
                asked()
            assert "Bag contains no message" in caught.value.value
            again = pickle.loads(pickle.dumps(caught.value))  # noqa: S301 - our own bytes
            assert (type(again), str(again)) == (type(caught.value), str(caught.value))
        bag.write("/a", String(data="x"), rospy.Time(5))


def test_a_file_object_stands_for_its_path(opened, tmp_path):
    with opened(open(tmp_path / "a.bag", "w+b"), "w") as bag:  # noqa: SIM115 - the bag closes it
        bag.write("/a", String(data="in a file object"), rospy.Time(5))
    file = open(tmp_path / "a.bag", "rb")  # noqa: SIM115
    with opened(file) as bag:
        assert [m.data for _, m, _ in bag] == ["in a file object"]
    assert file.closed
    with opened("a.bag") as bag:
        assert bag.get_message_count() == 1
    with pytest.raises((rosbag.ROSBagException, ValueError)):
        opened(open(tmp_path / "a.bag"))  # noqa: SIM115 - as a text


def test_an_error_is_rosbags_only_where_rosbag_is_imported():
    script = """
import sys
from cassandra_ros.files.bag.stored_bag import bag_error
print(type(bag_error("x")).__mro__[1].__name__, "rosbag" in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stdout.split() == ["CassandraRosError", "False"], done.stderr


def test_what_is_about_files_is_answered(store, path):
    with cassandra_ros.Bag(path, rosCas=store) as bag:
        info = bag.get_compression_info()
        assert info == ("none", bag.size, bag.size)
        assert info._fields == ("compression", "uncompressed", "compressed")
        assert list(bag.reindex()) == []
        bag.set_encryptor()
        with pytest.raises(rosbag.ROSBagException, match="no chunks to encrypt"):
            bag.set_encryptor("rosbag/AesCbcEncryptor", "user")
    with pytest.raises(ValueError, match="is closed"):
        bag.reindex()
    with pytest.raises(InvalidOption, match="stands for the path of its file"):
        cassandra_ros.Bag(BytesIO(), rosCas=store)


def test_what_cannot_be_written(store):
    with cassandra_ros.Bag("refused", "w", rosCas=store) as bag:
        for wrong in (5, None, String):
            with pytest.raises(TypeMismatch):
                bag.write("/a", wrong)
        with pytest.raises(TypeMismatch, match="a raw message is"):
            bag.write("/a", ("std_msgs/String", b""), raw=True)
        with pytest.raises(InvalidKey):
            bag.write("/a", String(), "soon")
        with pytest.raises(BagError, match="contains no message"):
            bag.get_start_time()
        assert str(bag).splitlines()[-1].split() == ["messages:", "0"]


def test_where_the_key_is_another_time_reception_counts(store):
    store.addTopic("/stamped", msg_type="std_msgs/Header", key_format="msg_part", key_part="stamp")
    with cassandra_ros.Bag("stamped", "w", rosCas=store) as bag:
        for n, t in enumerate((90, 50, 70)):
            bag.write("/stamped", Header(stamp=genpy.Time(t)), genpy.Time(100 + n))
        bag.flush()
        assert times(bag) == [(100 + n) * SEC for n in range(3)]
        assert [m.stamp.secs for _, m, _ in bag] == [90, 50, 70]
        assert (bag.get_start_time(), bag.get_end_time()) == (100, 102)
        assert bag.get_type_and_topic_info().topics["/stamped"].frequency == 1.0


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0, "0.0s"), (59.94, "59.9s"), (61, "1:01s (61s)"), (3723, "1hr 2:03s (3723s)")],
)
def test_durations_read_as_those_of_rosbag(seconds, text):
    lines = [TopicSummary("/a", "std_msgs/String", 1, 1, None)]
    ends = (T0, T0 + int(seconds * SEC))
    summary = Summary("x", 5 * 2**20, ends, {"std_msgs/String": STRING_MD5}, lines).text()
    assert f"duration: {text}\n" in summary.replace("  ", " ").replace(":  ", ": ")
    assert "5.0 MB" in summary


def test_connections_as_rosbag_describes_them(bag, path):
    """They are not part of rosbag's documentation, but scripts use them."""
    with rosbag.Bag(str(path)) as truth:
        expected = [described(c) for c in truth._get_connections()]
        assert len(expected) == 3
        assert [described(c) for c in bag._get_connections()] == expected
        assert [described(c) for c in bag._get_connections("/cmd_vel")] == expected[2:]
        assert [c.id for c in bag._get_connections(["/chatter"], lambda *facts: True)] == [0, 1]
        bobs = bag._get_connections(connection_filter=lambda *facts: b"/bob" in facts[4].values())
        assert [described(c) for c in bobs] == expected[1:2]
        assert list(bag._get_connections("/none")) == []


def described(connection):
    facts = [connection.id, connection.topic, connection.datatype, connection.md5sum]
    return [*facts, connection.msg_def, connection.header]


def test_connections_of_what_is_being_written(store):
    with cassandra_ros.Bag("connected.bag", "w", rosCas=store) as bag:
        assert list(bag._get_connections()) == []
        for topic in ("/b", "/a"):
            bag.write(topic, String(data="x"), rospy.Time(5))
        assert [(c.id, c.topic) for c in bag._get_connections()] == [(0, "/b"), (1, "/a")]


def test_a_filter_of_connections_sees_the_present_name_of_a_topic(fresh, tmp_path):
    with BagWriter(tmp_path / "a.bag") as writer:
        writer.write(writer.connection(string_connection("/old"), 0), T0, string_wire("x"))
    with fresh() as store:
        import_bag(store, tmp_path / "a.bag")
        store.renameTopic("/old", "/new")
        with cassandra_ros.Bag(str(tmp_path / "a.bag"), rosCas=store) as bag:
            assert [c.topic for c in bag._get_connections()] == ["/new"]
            found = bag.read_messages(connection_filter=lambda topic, *facts: topic == "/new")
            assert [message.topic for message in found] == ["/new"]


RANDOM = Random(38)
ENDS = [
    sorted(RANDOM.randrange(low, high) for _ in range(2))
    for low, high in ((0, 10**6), (10**9, 10**10), (T0, 2 * T0), (4 * 10**18, MAX_NS))
    * (3 if FURTHER else 1)
]
ENDS.append([MAX_NS - 1, MAX_NS])


def test_the_ends_never_exclude_their_own_message(store):
    """A float has a step of 240 ns today; a script that takes it as a bound wants all messages."""
    for n, ends in enumerate(ENDS):
        with cassandra_ros.Bag(f"ends{n}.bag", "w", rosCas=store) as bag:
            for ns in ends:
                bag.write("/ends", String(data=str(ns)), Stamp.from_ns(ns))
            start, end = bag.get_start_time(), bag.get_end_time()
            assert start == pytest.approx(ends[0] / SEC, abs=1e-6)
            assert end == pytest.approx(ends[1] / SEC, abs=1e-6)
            for kind in (float, rospy.Time, genpy.Time.from_sec):
                read = times(bag.read_messages("/ends", kind(start), kind(end)))
                assert read == ends, (kind, start, end)
            assert int(start * SEC) <= ends[0] and ends[1] <= int(end * SEC)


ODD_NAMES = ["/a", "a", "/a/", "//a", "/a/b", "/a//b", "a/b/", "/", "/\u00e4 b", "a b", "/A"]


@pytest.fixture(scope="module")
def odd(fresh, tmp_path_factory):
    """A bag with names that only a bag may hold, some with two publishers, and its store."""
    path = tmp_path_factory.mktemp("odd") / "odd.bag"
    with BagWriter(path) as writer:
        each = [
            writer.connection(string_connection(name, callerid=caller), 2 * n + k)
            for n, name in enumerate(ODD_NAMES)
            for k, caller in enumerate(CALLERS[: 1 + n % 2])
        ]
        for n in range(60):
            writer.write(RANDOM.choice(each), T0 + n // 3 * SEC, string_wire(f"{n}"))
        for n, number in enumerate(each):
            writer.write(number, T0 + n * SEC, string_wire(f"of {number}"))
    with fresh() as store:
        import_bag(store, path)
        yield path, store


def everything(bag, topics, start, end):
    """Return what a bag tells of some topics."""
    types, facts = bag.get_type_and_topic_info(topics)
    return (
        [(t, m.data, at.to_nsec()) for t, m, at in bag.read_messages(topics, start, end)],
        [described(c) for c in bag._get_connections(topics)],
        bag.get_message_count(topics),
        types,
        {name: tuple(each)[:3] for name, each in facts.items()},
    )


FILTERS = [None, "", [], [""], *ODD_NAMES, "b", "/b", "///", "/a///b", "a/", "//\u00e4 b/"]
FILTERS += [RANDOM.sample(ODD_NAMES, n % 5 + 1) for n in range(10 if FURTHER else 3)]


@pytest.mark.suite("test", "each filter beside rosbag")
def test_filters_select_what_rosbag_selects(odd):
    path, store = odd
    with rosbag.Bag(str(path)) as truth, cassandra_ros.Bag(str(path), rosCas=store) as bag:
        for n, topics in enumerate(FILTERS):
            start = rospy.Time(T0 // SEC + n % 7) if n % 3 else None
            end = rospy.Time(T0 // SEC + 10 + n % 5) if n % 2 else None
            assert everything(bag, topics, start, end) == everything(truth, topics, start, end), (
                topics
            )
