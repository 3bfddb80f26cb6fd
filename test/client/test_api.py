# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The Python API: the listing of the design and of the paper, keys, errors, nodes."""

from __future__ import annotations

import time

import genpy
import pytest
from geometry_msgs.msg import TransformStamped, Twist
from sensor_msgs.msg import CompressedImage, LaserScan
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from cassandra_ros import RosCassandra, Stamp
from cassandra_ros.errors import (
    ClockNotSet,
    ConnectionFailed,
    InvalidKey,
    InvalidName,
    KeyspaceNotFound,
    MessageNotFound,
    TopicExists,
    TopicNotFound,
    TypeMismatch,
    UnknownFormat,
)

SEC = 10**9
T0 = 1_500_000_000 * SEC


def test_the_listing_of_the_paper(cassandra, new_keyspace):
    """Lines of design 4 and listing 1, as they stand there."""
    rosCas = RosCassandra(cassandra.host, cassandra.port)
    rosCas.connectToKeyspace(new_keyspace)
    rosCas.addTopic("topic", format="ros")
    casTopic = rosCas.getTopic("topic")
    msg = Twist()
    msg.linear.x = 0.75
    key = casTopic.addData(msg)
    msg = casTopic.getData(key)
    assert isinstance(msg, Twist) and msg.linear.x == 0.75

    camera = rosCas.addTopic("/camera", format="binary", nodeID="robot_1")
    t1 = camera.addData(CompressedImage(format="png", data=b"1"), key=genpy.Time(1500000000, 7))
    t2 = camera.addData(CompressedImage(format="png", data=b"2"), key=t1 + 3.5)
    tf = rosCas.addTopic("/tf", format="ros")
    for second in range(-20, 20):
        moved = TransformStamped(child_frame_id="robot_1")
        moved.transform.translation.x = float(second)
        other = TransformStamped(child_frame_id="other")
        other.transform.translation.x = 1000.0
        tf.addData(TFMessage([other, moved]), key=t1 + second)

    found = []
    for topic in rosCas.getAllTopics():
        if topic.getMeta["msg_class"] in ["Image", "CompressedImage"]:
            nodeID = topic.getMeta["nodeID"]
            found.append(topic.name)
    assert (found, nodeID) == (["/camera"], "robot_1")
    stmt = (
        "select transforms.transform.translation.x from tf where transforms.child_frame_id='"
        + nodeID
        + "' and KEY > "
        + str(t1 - 5)
        + " and KEY < "
        + str(t2 + 5)
    )
    x_list = rosCas.executeCQL(stmt)
    x_min = min(x_list)[0]
    x_max = max(x_list)[0]
    assert (x_min, x_max, len(x_list)) == (-4.0, 8.0, 13)

    msgs = tf.getData(key=t1 - 5, to_key=t2 + 5)
    assert [m.transforms[1].transform.translation.x for m in msgs] == list(range(-5, 9))
    keys = [k for k, m in tf.items(key=t1, to_key=t2)]
    assert keys == [t1 + n for n in range(4)]
    rows = rosCas.executeCQL("select KEY, linear.x from /topic where linear.x > ?", [0.5])
    assert rows == [(key, 0.75)]
    rosCas.close()
    rosCas.close()


def test_getMeta(rosCas):
    topic = rosCas.addTopic("/scan", msg_type="sensor_msgs/LaserScan", comment='it\'s a "scan"\n✓')
    meta = topic.getMeta
    assert meta("msg_class") == meta["msg_class"] == "LaserScan"
    names = "topic msg_type msg_class msg_package md5sum definition key_format key_part format "
    names += "nodeID nodeIDs comment date ttl indexes"
    assert set(names.split()) <= set(meta)
    assert meta["comment"] == 'it\'s a "scan"\n✓'
    assert meta["md5sum"] == LaserScan._md5sum
    assert meta["definition"] == LaserScan._full_text
    assert (meta["nodeID"], meta["nodeIDs"]) == ("", [])
    topic.addData(LaserScan(), nodeID="r7")
    assert (topic.getMeta["nodeID"], topic.getMeta["nodeIDs"]) == ("r7", ["r7"])


@pytest.mark.parametrize("format_name", ["binary", "ros"])
def test_keys(rosCas, format_name):
    topic = rosCas.addTopic("/a", format_name)
    key = topic.addData(String(data="x"), key=genpy.Time(1500000000, 123456789))
    assert str(key) == "1500000000123456789"
    for same in (
        key,
        genpy.Time(1500000000, 123456789),
        1500000000123456789,
        "2017-07-14T02:40:00.123456789Z",
        Stamp.from_ns(1500000000123456789),
    ):
        assert topic.getData(same).data == "x"
    with pytest.raises(KeyError, match=r"no message at 2017-07-14T02:40:00\.123456790"):
        topic.getData(key.ns + 1)
    with pytest.raises(MessageNotFound, match=r"secs: 1500000000, nsecs: 123456789"):
        topic.getData(key.ns + 200)
    with pytest.raises(MessageNotFound, match=r"did you mean seconds \(a float\)"):
        topic.getData(1500000000)
    assert topic.getData(1500000000, default=None) is None
    with pytest.raises(InvalidKey):
        topic.getData("yesterday")
    with pytest.raises(InvalidKey, match="items"):
        topic.getData()


@pytest.mark.parametrize("sign", [1, -1])
def test_a_time_that_went_through_a_float(rosCas, sign):
    """A float is off by at most 256 ns; what lies further away is another time."""
    topic = rosCas.addTopic("/a")
    topic.addData(String(data="x"), key=T0 + 5)
    exact = r"256 ns away: write the time as \{secs: 1500000000, nsecs: 5\}"
    with pytest.raises(MessageNotFound, match=exact):
        topic.getData(T0 + 5 + sign * 256)
    with pytest.raises(MessageNotFound, match=rf"the nearest lies at .* \({T0 + 5} ns\)$"):
        topic.getData(T0 + 5 + sign * 257)


def test_nearest(rosCas):
    topic = rosCas.addTopic("/a")
    for second in (0, 10, 1000, 100_000):
        topic.addData(String(data=str(second)), key=T0 + second * SEC)
    ask = lambda t, how: topic.getData(T0 + t * SEC, nearest=how, default=None)  # noqa: E731
    assert ask(4, "before").data == "0"
    assert ask(4, "after").data == "10"
    assert ask(4, "either").data == "0"
    assert ask(6, "either").data == "10"
    assert ask(5, "either").data == "0"
    assert ask(10, "before").data == ask(10, "after").data == "10"
    assert ask(60_000, "either").data == "100000"
    assert ask(500_000, "before").data == "100000"
    assert ask(-1, "before") is None
    assert ask(500_000, "after") is None
    with pytest.raises(InvalidKey, match="before, after, either"):
        ask(0, "near")


def test_equal_stamps_the_first_that_arrived(rosCas):
    topic = rosCas.addTopic("/a")
    keys = [topic.addData(String(data=str(n)), key=T0) for n in range(3)]
    assert topic.getData(T0).data == "0"
    assert [topic.getData(key).data for key in keys] == ["0", "1", "2"]
    assert [m.data for m in topic.getData(T0, T0)] == ["0", "1", "2"]
    assert [m.data for _, m in topic.items(reverse=True)] == ["2", "1", "0"]


@pytest.mark.parametrize("where", [None, "data != '0'"])
def test_of_equal_stamps_the_nearest_is_the_first_of_all_nodes_and_tables(rosCas, where):
    tables = [rosCas.addTopic("/a", format_name) for format_name in ("ros", "binary")]
    for n, node in enumerate(["r2", "r1", "r1", "r2", "r1"]):
        tables[n % 2].addData(String(data=str(n)), key=T0, nodeID=node)
    tables[0].addData(String(data="later"), key=T0 + 10 * SEC)
    topic = rosCas.getTopic("/a")
    for node in (None, "r1", "r2"):
        which = {"nodeID": node, "where": where}
        first = topic.getData(T0, T0, **which)[0]
        assert topic.getData(T0, **which) == first
        for how, second in (("before", 0), ("before", 7), ("either", 3), ("after", 0)):
            assert topic.getData(T0 + second * SEC, nearest=how, **which) == first


def test_wrong_type_stores_nothing(rosCas):
    topic = rosCas.addTopic("/a", msg_type="geometry_msgs/Twist")
    with pytest.raises(TypeMismatch) as caught:
        topic.addData(String(data="x"))
    for part in ("/a", "geometry_msgs/Twist", Twist._md5sum, "std_msgs/String", String._md5sum):
        assert part in str(caught.value)
    assert topic.countTopicData() == 0
    with pytest.raises(TopicExists):
        rosCas.addTopic("/a", msg_type="std_msgs/String")
    assert rosCas.addTopic("/a", msg_type="geometry_msgs/Twist").name == "/a"


def test_topics_by_name(rosCas):
    rosCas.addTopic("/camera/image_raw", msg_type="std_msgs/String")
    rosCas.addTopic("imu", msg_type="std_msgs/String")
    rosCas.addTopic("/imu", msg_type="std_msgs/String")
    assert rosCas.getTopic("camera/image_raw").name == "/camera/image_raw"
    assert rosCas.getTopic("imu").name == "imu"
    assert rosCas.getTopic("/imu").name == "/imu"
    assert rosCas.existTopic("/imu") and not rosCas.existTopic("/odom")
    assert [t.name for t in rosCas.getAllTopics("/.*")] == ["/camera/image_raw", "/imu"]
    with pytest.raises(KeyError, match="did you mean /camera/image_raw"):
        rosCas.getTopic("/camera/imag_raw")
    handle = rosCas.getTopic("imu")
    rosCas.removeTopic("imu")
    assert rosCas.getTopic("imu").name == "/imu"
    with pytest.raises(TopicNotFound, match="not stored"):
        list(handle.rows())
    with pytest.raises(InvalidName, match="regular expression"):
        rosCas.getAllTopics("[")


@pytest.mark.parametrize(
    "name",
    ["/it's", '/"quoted"', "/a;DROP TABLE x", "/line\nbreak", "/ünï/漢字", "/--", "/$$", "/%s?"],
)
def test_hostile_names_and_texts_stay_data(rosCas, name):
    topic = rosCas.addTopic(name, "ros", nodeID=name, comment=name)
    key = topic.addData(String(data=name))
    assert topic.getData(key).data == name
    assert rosCas.getTopic(name).getMeta["comment"] == name
    assert topic.countTopicData(nodeID=name) == 1
    assert topic.countTopicData(nodeID=name + "'") == 0
    rosCas.removeTopic(name)
    assert not rosCas.existTopic(name)


@pytest.mark.parametrize("name", ["", "a b", "a'", 'a"; DROP', "x" * 49, "ü", "a.b", "a\n"])
def test_keyspace_names(cassandra, name):
    with RosCassandra(cassandra.host, cassandra.port) as rosCas:
        with pytest.raises(InvalidName, match="48 letters"):
            rosCas.connectToKeyspace(name)
        with pytest.raises(KeyspaceNotFound, match="connectToKeyspace"):
            rosCas.getAllTopics()


def test_buckets_of_the_keyspace_before_are_closed(rosCas, new_keyspace, monkeypatch):
    # No idle bucket is closed by itself meanwhile, however long it takes.
    monkeypatch.setattr("cassandra_ros.store.rows.writer.HEARTBEAT_SEC", 1e9)
    rosCas.addTopic("/a").addData(String(), key=T0)
    before = rosCas.catalog.keyspace
    (table,) = before.tables.of_topic("/a")
    for closed in (False, True):
        rows = before.directory.find(table.name, "", table.bucket_of(T0))
        assert [row.closed for row in rows] == [closed]
        rosCas.connectToKeyspace(new_keyspace)


def test_bad_names(rosCas):
    for name in ("", "a\0b", "\udc80"):
        with pytest.raises(InvalidName):
            rosCas.addTopic(name)
    with pytest.raises(UnknownFormat, match="binary, string, yaml, json, ros"):
        rosCas.addTopic("/a", format="xml")


def test_no_server():
    with pytest.raises(ConnectionFailed) as caught:
        RosCassandra("127.0.0.1", 1)
    for part in ("127.0.0.1", "port 1 ", "rosrun cassandra_ros local_cassandra start"):
        assert part in str(caught.value)


def test_nodes_are_merged_and_apart(rosCas):
    topic = rosCas.addTopic("/a")
    for number in range(20):
        for node in ("b", "a", ""):
            topic.addData(String(data=f"{node}{number}"), key=T0 + number, nodeID=node)
    assert topic.countTopicData() == 60
    assert topic.countTopicData(nodeID="a") == 20
    assert [m.data for m in topic.getData(T0, T0 + 1)] == ["0", "a0", "b0", "1", "a1", "b1"]
    assert [m.data for m in topic.getData(T0, T0 + 1, nodeID="b")] == ["b0", "b1"]
    assert topic.getMeta["nodeIDs"] == ["", "a", "b"]
    assert topic.removeData(T0, T0 + 4, nodeID="a") == 5
    assert topic.countTopicData() == 55
    assert topic.countTopicData(nodeID="a") == 15
    assert [m.data for m in topic.getData(T0, T0)] == ["0", "b0"]


def test_remove_data(rosCas):
    topic = rosCas.addTopic("/a")
    for number in range(10):
        topic.addData(String(data=str(number)), key=T0 + number * SEC)
    assert topic.removeData(T0 + 3 * SEC, T0 + 5 * SEC) == 3
    assert [m.data for _, m in topic.items()] == list("0126789")
    with pytest.raises(MessageNotFound):
        topic.removeData(T0 + 3 * SEC)
    topic.addData(String(data="again"), key=T0 + 3 * SEC)
    assert topic.getData(T0 + 3 * SEC).data == "again"
    assert rosCas.info(["/a"])[0].count == 8


def test_clock(cassandra, keyspace):
    with RosCassandra(
        cassandra.host, cassandra.port, keyspace=keyspace, clock=lambda: genpy.Time(7, 9)
    ) as rosCas:
        topic = rosCas.addTopic("/a")
        assert topic.addData(String()) == genpy.Time(7, 9)


def test_clock_of_simulated_time(monkeypatch):
    import sys
    from types import SimpleNamespace

    from cassandra_ros.topics.message_adder import clock_ns

    rospy = SimpleNamespace(
        core=SimpleNamespace(is_initialized=lambda: True),
        rostime=SimpleNamespace(get_rostime=lambda: genpy.Time(0), is_wallclock=lambda: False),
    )
    monkeypatch.setitem(sys.modules, "rospy", rospy)
    with pytest.raises(ClockNotSet, match="/clock"):
        clock_ns(None)
    rospy.rostime.is_wallclock = lambda: True  # then rospy rounds the time to a float
    before = time.time_ns()
    assert before <= clock_ns(None) <= time.time_ns()


def test_a_dropped_topic_brings_nothing_back(rosCas):
    topic = rosCas.addTopic("/a")
    topic.addData(String(data="old"), key=T0)
    name = topic.tables[0].name
    rosCas.removeTopic("/a")
    topic = rosCas.addTopic("/a")
    topic.addData(String(data="new"), key=T0 + 1)
    assert topic.tables[0].name != name
    assert [m.data for _, m in topic.items()] == ["new"]


def test_foreign_tables_are_left_out(rosCas, cql):
    rosCas.addTopic("/a", msg_type="std_msgs/String")
    space = rosCas.keyspace
    cql.execute(
        f"CREATE TABLE {space}.foreign (a int PRIMARY KEY) WITH comment = 'not \"cassandra_ros\"'"
    )
    assert [t.name for t in rosCas.getAllTopics()] == ["/a"]
    cql.execute(
        f"CREATE TABLE {space}.alike (a int PRIMARY KEY) "
        'WITH comment = \'{"cassandra_ros": {"version": 1}}\''
    )
    rosCas.catalog.keyspace.schema.tables(fresh=True)
    assert [t.name for t in rosCas.getAllTopics()] == ["/a"]


def test_one_of_two_messages_of_a_stamp_is_removed(rosCas):
    topic = rosCas.addTopic("/a")
    first = topic.addData(String(data="1"), key=T0)
    topic.addData(String(data="2"), key=T0)
    topic.addData(String(data="3"), key=T0, nodeID="r2")
    assert topic.removeData(first) == 1
    assert [m.data for _, m in topic.items()] == ["2", "3"]
    assert topic.countTopicData() == 2
    with pytest.raises(MessageNotFound):
        topic.getData(first)


def test_counts_hold_when_a_living_writer_closes_after_a_deletion(cassandra, keyspace):
    with RosCassandra(cassandra.host, cassandra.port, keyspace=keyspace) as rosCas:
        topic = rosCas.addTopic("/a")
        for number in range(10):
            topic.addData(String(), key=T0 + number)
        assert topic.removeData(T0, T0 + 2) == 3
    with RosCassandra(cassandra.host, cassandra.port, keyspace=keyspace) as rosCas:
        assert rosCas.info()[0].count == rosCas.getTopic("/a").countTopicData() == 7


def test_two_robots_share_a_topic(cassandra, keyspace, rosCas):
    rosCas.addTopic("/a", nodeID="r1").addData(String(data="of r1"), key=T0)
    with RosCassandra(cassandra.host, cassandra.port, keyspace=keyspace) as other:
        topic = other.addTopic("/a", nodeID="r2")
        topic.addData(String(data="of r2"), key=T0)
        assert len(topic.tables) == 1
        assert [m.data for _, m in topic.items(nodeID="r2")] == ["of r2"]


def test_the_format_that_was_asked_for(rosCas):
    rosCas.addTopic("/a", "binary").addData(String(data="1"), key=T0)
    rosCas.addTopic("/a", "ros").addData(String(data="2"), key=T0 + 1)
    topic = rosCas.getTopic("/a")
    assert {t.metadata.format for t in topic.tables} == {"binary", "ros"}
    assert [m.data for _, m in topic.items()] == ["1", "2"]


class TestAnotherClient:
    """What another client changes is seen at most two seconds later."""

    @pytest.fixture
    def other(self, cassandra, keyspace, rosCas, monkeypatch):
        monkeypatch.setattr("cassandra_ros.store.tables.schema.CACHE_SEC", 0.0)
        with RosCassandra(cassandra.host, cassandra.port, keyspace=keyspace) as store:
            yield store

    def test_adds_a_second_definition(self, rosCas, other):
        topic = rosCas.addTopic("/a")
        topic.addData(String(data="1"), key=T0)
        with other.messageWriter() as writer:
            from cassandra_ros.messages.classes import serialize
            from cassandra_ros.messages.connection_header import api_connection
            from cassandra_ros.messages.definition import definition_of

            handle = writer.connect(api_connection("/a", definition_of(Twist), "/x"))
            writer.write(handle, T0 + 1, 0, serialize(Twist()))
        assert [type(m) for _, m in topic.items()] == [String, Twist]
        other.removeTopic("/a")
        assert not rosCas.existTopic("/a")
        assert not rosCas.catalog.keyspace.schema.tables(fresh=True)

    def test_drops_and_makes_a_topic_anew(self, rosCas, other):
        topic = rosCas.addTopic("/a")
        topic.addData(String(data="old"), key=T0)
        other.removeTopic("/a")
        other.addTopic("/a").addData(String(data="new"), key=T0 + 1)
        topic.addData(String(data="mine"), key=T0 + 2)
        assert [m.data for _, m in topic.items()] == ["new", "mine"]
        assert [m.data for _, m in other.getTopic("/a").items()] == ["new", "mine"]
        assert rosCas.info()[0].count == 2
