# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Keys other than the receive time: a field of the message, its content, a name."""

from __future__ import annotations

import copy
import threading

import genpy
import pytest
from diagnostic_msgs.msg import KeyValue
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import OccupancyGrid
from sensor_msgs.msg import Imu
from std_msgs.msg import (
    Empty,
    Float32,
    Float64,
    Header,
    Int64,
    String,
    UInt8MultiArray,
    UInt64,
)
from suites import sparing
from tf2_msgs.msg import TFMessage

from cassandra_ros import RosCassandra
from cassandra_ros.arguments import MAX_TTL_SEC
from cassandra_ros.errors import (
    InvalidKey,
    InvalidName,
    InvalidOption,
    InvalidQuery,
    MessageNotFound,
    TopicExists,
    TopicNotFound,
)
from cassandra_ros.keys import MAX_NS, RowName
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.messages.stamps import iso_time
from cassandra_ros.topics.row_finder import Finder

SEC = 10**9
T0 = 1_500_000_000 * SEC


def imu(ns, number=0):
    message = Imu()
    message.header.stamp = genpy.Time(*divmod(ns, SEC))
    message.header.seq = number
    return message


class TestTimeField:
    def test_lies_in_the_order_of_its_field(self, cassandra, keyspace):
        now = [T0]
        with RosCassandra(
            cassandra.host, cassandra.port, keyspace=keyspace, clock=lambda: now[0]
        ) as rosCas:
            topic = rosCas.addTopic("/imu", key_format="msg_part", key_part="header.stamp")
            for number, second in enumerate((5, 3, 9, 3)):
                now[0] = T0 + number
                key = topic.addData(imu(second * SEC, number))
                assert key.ns == second * SEC
            assert [k.ns // SEC for k, _ in topic.items()] == [3, 3, 5, 9]
            assert [m.header.seq for m in topic.getData(3.0, 5.0)] == [1, 3, 0]
            assert topic.getData(3 * SEC).header.seq == 1
            assert topic.getData(key).header.seq == 3
            assert topic.getData(6.0, nearest="before").header.seq == 0
            assert topic.countTopicData(3.0, 5.0) == 3
            assert [row.received - T0 for row in topic.rows()] == [1, 3, 0, 2]
            assert [k for (k,) in rosCas.executeCQL("select KEY from /imu where KEY > 4.0")] == [
                genpy.Time(5),
                genpy.Time(9),
            ]
            assert topic.removeData(3.0, 4.0) == 2
            assert rosCas.info(["/imu"])[0].count == 2

    def test_both_ends_of_a_range_of_reception_are_included(self, rosCas):
        rosCas.addTopic("/imu", key_format="msg_part", key_part="header.stamp").addData(imu(SEC))
        with rosCas.messageWriter(writer_id=9) as writer:
            handle = writer.connect(api_connection("/imu", definition_of(Imu), "/x"))
            for number in range(5):
                writer.write(handle, T0 + number, number, serialize(imu((9 - number) * SEC)))
        rows = rosCas.readMessages(["/imu"], T0 + 1, T0 + 3, received=True)
        assert [row.received - T0 for row in rows] == [1, 2, 3]

    def test_equal_times_of_reception_are_in_the_order_of_nodes(self, rosCas):
        rosCas.addTopic("/imu", key_format="msg_part", key_part="header.stamp").addData(imu(SEC))
        for node, writer_id in (("a", 9), ("b", 5)):
            with rosCas.messageWriter(writer_id=writer_id, nodeID=node) as writer:
                for name in ("/imu", "/other"):
                    handle = writer.connect(api_connection(name, definition_of(Imu), "/x"))
                    for number in range(2):
                        wire = serialize(imu((9 - number) * SEC, number))
                        writer.write(handle, T0, number + 10 * (name == "/imu"), wire)
        rows = list(rosCas.readMessages(to_key=T0, received=True))
        order = [(row.received, row.node, row.seq) for row in rows]
        assert [row.node for row in rows] == ["a"] * 4 + ["b"] * 4
        assert order == sorted(order)

    def test_times_that_are_none(self, rosCas):
        """What has no time lies where it was received; nothing is refused."""
        topic = rosCas.addTopic(
            *("/imu", "ros"),
            key_format="msg_part",
            key_part="stamp",
            msg_type="std_msgs/Header",
        )
        wires = [
            b"\0" * 4 + b"\xff" * 8 + b"\0" * 4,  # nsecs beyond a second
            b"\1\2",  # no message at all
        ]
        with rosCas.messageWriter() as writer:
            definition = topic.tables[0].definition
            handle = writer.connect(api_connection("/imu", definition, "/x"))
            for number, wire in enumerate(wires):
                writer.write(handle, T0 + number, number, wire)
        assert sorted(row.wire for row in topic.rows()) == sorted(wires)
        assert {row.t for row in topic.rows()} <= {MAX_NS, T0, T0 + 1}

    def test_a_type_without_the_field(self, rosCas):
        with pytest.raises(InvalidKey, match=r"did you mean header\.stamp"):
            rosCas.addTopic(
                *("/a", "ros"),
                key_format="msg_part",
                key_part="header.stmp",
                msg_type="sensor_msgs/Imu",
            )
        assert not rosCas.existTopic("/a")
        with pytest.raises(InvalidKey, match="array of messages"):
            rosCas.addTopic(
                *("/a", "ros"),
                key_format="msg_part",
                key_part="transforms.child_frame_id",
                msg_type="tf2_msgs/TFMessage",
            )
        topic = rosCas.addTopic("/a", key_format="msg_part", key_part="header.stamp")
        with pytest.raises(InvalidKey, match="no field"):
            topic.addData(String())
        assert topic.addData(imu(7 * SEC)).ns == 7 * SEC

    def test_a_second_definition_without_the_field_is_found_by_time(self, rosCas, caplog):
        rosCas.addTopic("/a", key_format="msg_part", key_part="header.stamp").addData(imu(SEC))
        with rosCas.messageWriter() as writer:
            handle = writer.connect(api_connection("/a", definition_of(Twist), "/x"))
            writer.write(handle, 2 * SEC, 0, serialize(Twist()))
        assert "found by time" in caplog.text
        assert [type(m) for _, m in rosCas.getTopic("/a").items()] == [Imu, Twist]


VALUES = [
    (KeyValue, "key", ["a", "", "it's", "Zoë", "x" * 1000, "y" * 5000, "z" * 9000]),
    (UInt64, "data", [0, 1, 2**63, 2**64 - 1]),
    (Int64, "data", [0, -1, 2**63 - 1, -(2**63)]),
    (Float64, "data", [0.0, 1.5, float("inf"), -float("inf"), 1e300]),
    (Float32, "data", [0.5, 1.0, 3.0]),
    (UInt8MultiArray, "data", [b"", b"uuid-of-16-bytes", bytes(range(256))]),
    (Imu, "angular_velocity_covariance", [[0.0] * 9, [float(n) for n in range(9)]]),
    (PoseStamped, "header.frame_id", ["map", "odom"]),
]


@pytest.mark.parametrize("format_name", sparing(["binary", "ros"], kept=["ros"]))
def test_values_of_any_field(rosCas, format_name):
    for cls, field, values in VALUES:
        name = "/" + cls.__name__
        topic = rosCas.addTopic(name, format_name, key_format="msg_part", key_part=field)
        keys = {}
        for number, value in enumerate([*values, values[0]]):
            message = cls()
            *way, last = field.split(".")
            place = message
            for part in way:
                place = getattr(place, part)
            setattr(place, last, value)
            keys[number] = topic.addData(message)
        for number, value in enumerate(values):
            assert list(topic.items(value))[0][0] == keys[number]
            assert topic.countTopicData(value) == (2 if number == 0 else 1)
            found = topic.getData(value)
            assert serialize(found) == serialize(topic.getData(keys[number]))
        assert topic.countTopicData() == len(values) + 1
        assert [k.seq for k, _ in topic.items(values[0], reverse=True)] == [
            keys[len(values)].seq,
            keys[0].seq,
        ]
        assert topic.removeData(values[0]) == 2
        with pytest.raises(MessageNotFound, match="key field is"):
            topic.getData(values[0])
        assert topic.getData(values[0], default=None) is None


def test_numbers_are_compared_as_numbers(rosCas):
    floats = rosCas.addTopic("/f", key_format="msg_part", key_part="data")
    for value in (-0.0, 0.0, float("nan"), 0.1):
        floats.addData(Float64(data=value))
    assert floats.countTopicData(0) == 2
    assert floats.countTopicData(-0.0) == 2
    assert floats.countTopicData(float("nan")) == 0
    assert floats.countTopicData(0.1) == 1
    assert floats.countTopicData() == 4
    narrow = rosCas.addTopic("/n", key_format="msg_part", key_part="data")
    narrow.addData(Float32(data=0.1))
    assert narrow.countTopicData(0.1) == 1  # the float32 that is nearest
    assert narrow.countTopicData(0.2) == narrow.countTopicData(1e300) == 0
    (stored,) = [m.data for _, m in narrow.items()]
    assert narrow.countTopicData(stored) == 1
    with pytest.raises(InvalidKey, match="no order"):
        narrow.getData(0.5, nearest="after")
    ints = rosCas.addTopic("/i", key_format="msg_part", key_part="data")
    ints.addData(Int64(data=3))
    assert ints.getData(3.0).data == 3
    assert ints.getData(2**70, default=None) is None
    for wrong in ("3", 3.5, True, float("inf"), float("nan")):
        with pytest.raises(InvalidKey, match="int64"):
            ints.getData(wrong)
    with pytest.raises(InvalidKey, match=r"order of time.*executeCQL"):
        ints.getData(3, 5)
    with pytest.raises(InvalidKey, match="comes from the message itself"):
        ints.addData(Int64(), key=3)


def test_times_of_a_topic_with_values(rosCas):
    topic = rosCas.addTopic("/a", key_format="msg_part", key_part="data")
    keys = [topic.addData(String(data=text)) for text in "abab"]
    assert [m.data for m in topic.getData(keys[1], keys[2])] == ["b", "a"]
    assert topic.getData(genpy.Time(keys[3].secs, keys[3].nsecs)).data == "b"
    assert [m.data for _, m in topic.items("b")] == ["b", "b"]
    assert topic.countTopicData() == 4


def test_more_rows_of_a_value_than_are_put_in_order_at_once(rosCas, monkeypatch):
    monkeypatch.setattr("cassandra_ros.store.rows.fetch.ONE_QUERY_KEYS", 3)
    topic = rosCas.addTopic(
        "/a", key_format="msg_part", key_part="data", msg_type="std_msgs/String"
    )
    with rosCas.messageWriter() as writer:
        handle = writer.connect(api_connection("/a", definition_of(String), "/x"))
        for number in range(40):
            wire = serialize(String(data="ab"[number % 2]))
            writer.write(handle, T0 + number * 600 * SEC, number, wire)
    found = [k.ns for k, _ in topic.items("b")]
    assert found == [T0 + number * 600 * SEC for number in range(1, 40, 2)]


class TestNames:
    def test_versions(self, rosCas):
        topic = rosCas.addTopic("maps", key_format="manual")
        grid = OccupancyGrid()
        keys = []
        for width in (10, 20, 30):
            grid.info.width = width
            keys.append(topic.addData(grid, key="kitchen"))
        topic.addData(OccupancyGrid(), key="hall")
        assert topic.getData("kitchen").info.width == 30
        assert [m.info.width for _, m in topic.items("kitchen")] == [10, 20, 30]
        assert [m.info.width for _, m in topic.items("kitchen", reverse=True)] == [30, 20, 10]
        assert [k for k, _ in topic.items()] == ["kitchen", "kitchen", "kitchen", "hall"]
        assert topic.getData(keys[1]).info.width == 20
        assert keys[1] == "kitchen" and str(keys[1]) == "kitchen"
        assert (topic.countTopicData("kitchen"), topic.countTopicData()) == (3, 4)
        info = rosCas.info(["maps"])[0]
        assert (info.count, info.buckets, info.largest_bucket) == (4, 2, 3)
        assert topic.removeData(keys[1]) == 1
        assert [m.info.width for _, m in topic.items("kitchen")] == [10, 30]
        assert topic.removeData("kitchen") == 2
        with pytest.raises(KeyError, match="under the name 'kitchen'"):
            topic.getData("kitchen")
        assert topic.getData("kitchen", default=None) is None
        with pytest.raises(MessageNotFound):
            topic.removeData("kitchen")

    def test_names_have_no_order(self, rosCas):
        topic = rosCas.addTopic("/a", key_format="manual")
        topic.addData(String(data="x"), key="a")
        for ask in (
            lambda: topic.getData("a", "b"),
            lambda: list(topic.items("a", "b")),
            lambda: topic.getData("a", nearest="before"),
            lambda: topic.countTopicData("a", "b"),
            lambda: topic.removeData("a", "b"),
        ):
            with pytest.raises(InvalidKey, match="no order"):
                ask()

    def test_all_are_counted_whenever_the_first_came(self, rosCas):
        topic = rosCas.addTopic("/a", key_format="manual")
        assert rosCas.executeCQL("select count(*) from a") == [(0,)]
        counting = rosCas.iterCQL("select count(*) from a")
        topic.addData(String(), key="a")
        assert list(counting) == [(1,)]

    @pytest.mark.parametrize("name", [None, "", 5, "\udc80", "x" * 5000, genpy.Time(1)])
    def test_what_is_no_name(self, rosCas, name):
        topic = rosCas.addTopic("/a", key_format="manual")
        with pytest.raises(InvalidKey, match="name"):
            topic.addData(String(), key=name)
        assert topic.countTopicData() == 0

    def test_hostile_names_nodes_and_large_messages(self, rosCas):
        topic = rosCas.addTopic("/a", "binary", key_format="manual")
        names = ["it's", '"', "a; DROP TABLE x", "nul\0", "漢字", "a/b", "?", "%s"]
        for size, name in enumerate(names):
            topic.addData(UInt8MultiArray(data=bytes(size)), key=name)
            topic.addData(UInt8MultiArray(data=bytes(600_000 + size)), key=name, nodeID="r'2")
        for size, name in enumerate(names):
            assert len(topic.getData(name).data) == 600_000 + size
            assert len(topic.getData(name, nodeID="").data) == size
            assert len(list(topic.items(name))) == 2
        assert sorted(topic.getMeta["nodeIDs"]) == ["", "r'2"]
        assert topic.countTopicData() == 2 * len(names)
        chunks = f'SELECT count(*) FROM {rosCas.keyspace}."{topic.tables[0].name}_c"'
        assert rosCas.cassandra.execute(chunks)[0][0] == 2 * len(names)
        assert topic.removeData(names[0], nodeID="r'2") == 1
        assert rosCas.cassandra.execute(chunks)[0][0] == 2 * len(names) - 2
        assert [len(m.data) for _, m in topic.items(names[0])] == [0]

    def test_recorded_messages_bear_the_name_of_the_topic(self, rosCas):
        topic = rosCas.addTopic("/map", "ros", key_format="manual", msg_type="std_msgs/String")
        with rosCas.messageWriter() as writer:
            handle = writer.connect(api_connection("/map", definition_of(String), "/x"))
            for number in range(3):
                writer.write(handle, T0 + number, number, serialize(String(data=str(number))))
        assert topic.getData("/map").data == "2"
        assert [row.t - T0 for row in topic.rows()] == [0, 1, 2]


class TestContent:
    def test_equal_messages_are_kept_once(self, rosCas):
        topic = rosCas.addTopic("/a", "ros", key_format="hash")
        first = topic.addData(String(data="same"))
        again = topic.addData(String(data="same"))
        other = topic.addData(String(data="other"))
        assert first == again != other
        assert len(first) == 32 and int(first, 16)
        assert topic.countTopicData() == 2
        assert topic.getData(str(first)).data == topic.getData(first).data == "same"
        assert {m.data for _, m in topic.items()} == {"same", "other"}
        table = topic.tables[0]
        rows = rosCas.cassandra.execute(
            f'SELECT "_t", "_seq" FROM {rosCas.keyspace}."{table.name}"'
        )
        assert rows == [(0, 0)] * 2
        assert topic.removeData(first) == 1
        assert [m.data for _, m in topic.items()] == ["other"]
        with pytest.raises(InvalidKey, match="comes from the message itself"):
            topic.addData(String(), key="x")

    def test_large_messages(self, rosCas):
        topic = rosCas.addTopic("/a", key_format="hash")
        keys = {topic.addData(UInt8MultiArray(data=bytes(700_000))) for _ in range(2)}
        assert len(keys) == 1
        assert len(topic.getData(keys.pop()).data) == 700_000
        assert topic.countTopicData() == 1


@pytest.mark.parametrize(
    "key_format, key_part",
    [
        ("time", ""),
        ("manual", ""),
        ("hash", ""),
        ("msg_part", "header.stamp"),
        ("msg_part", "header.seq"),
    ],
)
def test_life_of_a_topic(rosCas, key_format, key_part):
    """Rename, truncate, cursors, copies of another client: the same for all key formats."""
    topic = rosCas.addTopic(
        "/a", key_format=key_format, key_part=key_part, metadata={"site": "lab"}
    )
    name = "x" if key_format == "manual" else None
    for number in range(7):
        topic.addData(imu(number * SEC, number), key=name)
    rows = list(topic.rows())
    assert len(rows) == 7
    for number, row in enumerate(rows):
        rest = [r.position for r in topic.rows(after=row.position)]
        assert rest == [r.position for r in rows[number + 1 :]]
        back = [r.position for r in topic.rows(after=row.position, reverse=True)]
        assert back == [r.position for r in rows[:number]][::-1]
        assert topic.getRow(row.key).wire == row.wire
    assert [r.position for r in topic.rows(limit=3)] == [r.position for r in rows[:3]]
    rosCas.renameTopic("a", "/b")
    topic = rosCas.getTopic("/b")
    assert not rosCas.existTopic("/a")
    assert [row.wire for row in topic.rows()] == [row.wire for row in rows]
    assert [row.topic for row in rosCas.readMessages()] == ["/b"] * 7
    old = topic.tables[0].name
    rosCas.truncateTopic("/b")
    assert topic.countTopicData() == 0 and list(topic.rows()) == []
    assert topic.tables[0].name != old
    meta = topic.getMeta
    assert (meta["site"], meta["key_format"], meta["key_part"]) == ("lab", key_format, key_part)
    key = topic.addData(imu(3 * SEC, 3), key=name)
    assert topic.getData(key).header.seq == 3
    with pytest.raises(TopicExists, match="key_format"):
        rosCas.addTopic("/b", key_format="time" if key_format != "time" else "manual")
    assert rosCas.addTopic("/b").getMeta["key_format"] == key_format


def test_what_is_no_key_format(rosCas):
    with pytest.raises(InvalidKey, match="time, msg_part, hash, manual"):
        rosCas.addTopic("/a", key_format="uuid")
    with pytest.raises(InvalidKey, match="key_part"):
        rosCas.addTopic("/a", key_format="msg_part")
    with pytest.raises(InvalidKey, match="key_part"):
        rosCas.addTopic("/a", key_part="header.stamp")


def test_rename(rosCas):
    rosCas.addTopic("/a").addData(String(data="1"), key=T0)
    rosCas.addTopic("/b")
    with pytest.raises(TopicExists, match="/b is stored already"):
        rosCas.renameTopic("/a", "/b")
    with pytest.raises(TopicExists, match="/b is stored already"):
        rosCas.renameTopic("/a", "b")
    with pytest.raises(InvalidName):
        rosCas.renameTopic("/a", "")
    rosCas.renameTopic("/b", "/c")
    assert rosCas.existTopic("/c") and not rosCas.existTopic("/b")
    with rosCas.messageWriter() as writer:
        handle = writer.connect(api_connection("/a", definition_of(Twist), "/x"))
        writer.write(handle, T0 + 1, 0, serialize(Twist()))
    rosCas.renameTopic("/a", "/it's")
    assert [type(m) for _, m in rosCas.getTopic("/it's").items()] == [String, Twist]
    rosCas.addTopic("/a").addData(TFMessage(), key=T0)
    assert [type(m) for _, m in rosCas.getTopic("/a").items()] == [TFMessage]


def test_a_topic_is_not_renamed_to_itself(rosCas):
    rosCas.addTopic("/n").addData(String(data="1"), key=T0)
    rosCas.addTopic("pending")
    for topic, same in (("/n", "n"), ("pending", "/pending")):
        for old, new in ((topic, topic), (topic, same), (same, topic), (same, same)):
            with pytest.raises(TopicExists, match="give another name"):
                rosCas.renameTopic(old, new)
    assert sorted(topic.name for topic in rosCas.getAllTopics()) == ["/n", "pending"]


def test_own_metadata(rosCas):
    topic = rosCas.addTopic("/a", msg_type="std_msgs/String", metadata={"site": "lab", "n": [1, 2]})
    assert (topic.getMeta["site"], topic.getMeta["n"]) == ("lab", [1, 2])
    topic.setMeta(site="it's", floor={"level": 3}, n=None, comment="changed")
    meta = rosCas.getTopic("/a").getMeta
    assert (meta["site"], meta["floor"], meta["comment"]) == ("it's", {"level": 3}, "changed")
    assert "n" not in meta
    topic.addData(String(data="x"))
    bad = [
        object(),
        float("nan"),
        [{"a": -float("inf")}],
        (1, 2),
        [[(1,)]],
        {1: 2},
        {"a": {True: 1}},
    ]
    bad += [{None: 1}, {1, 2}, b"x", 1j, "a\ud800", {"a\ud800": 1}, 10**5000, {1: "a", "1": "b"}]
    for keys in ({"topic": "/b"}, {"ttl": 3}, *({"x": value} for value in bad)):
        with pytest.raises(InvalidName, match="cannot be"):
            topic.setMeta(**keys)
        with pytest.raises(InvalidName, match="cannot be"):
            rosCas.addTopic("/b", metadata=keys)
    with pytest.raises(InvalidName, match=r"metadata 'x'=\{1: 2\} .* dicts whose keys are texts"):
        topic.setMeta(x={1: 2})
    good = {"text": "✓", "many": [1, -0.5, True, None, [], {"a": {"b": [2**70]}}]}
    topic.setMeta(**good)
    assert {name: topic.getMeta[name] for name in good} == good
    assert "x" not in topic.getMeta and not rosCas.existTopic("/b")
    with pytest.raises(InvalidName):
        rosCas.addTopic("/b", metadata={"md5sum": "x"})
    assert topic.getMeta["site"] == "it's"


class TestQueries:
    def test_names(self, rosCas):
        topic = rosCas.addTopic("results", key_format="manual")
        for number in range(6):
            topic.addData(Int64(data=number), key="ab"[number % 2])
        ask = rosCas.executeCQL
        assert ask("select KEY, data from results where KEY = 'a'") == [
            ("a", 0),
            ("a", 2),
            ("a", 4),
        ]
        assert ask("select data from results where KEY = 'a' and data > 1 limit 1") == [(2,)]
        assert ask("select data from results where KEY in ('b', 'c') order by KEY desc") == [
            (5,),
            (3,),
            (1,),
        ]
        assert ask("select data from results where KEY != 'a' and NODE = ''") == [(1,), (3,), (5,)]
        assert ask("select count(*) from results where KEY = 'b'") == [(3,)]
        assert ask("select count(*) from results") == [(6,)]
        assert ask("select data from results where KEY = 'a' and KEY = 'b'") == []
        for bad in ("KEY > 'a'", "KEY between 'a' and 'b'", "not KEY <= 'a'"):
            with pytest.raises(InvalidQuery, match="no order"):
                ask(f"select data from results where {bad}")
        with pytest.raises(InvalidQuery, match="KEY is text"):
            ask("select data from results where KEY = 5")

    def test_pages(self, rosCas):

        topic = rosCas.addTopic("/r", key_format="manual")
        for number in range(7):
            topic.addData(Int64(data=number), key="ab"[number % 2])
        for condition in ("", " where KEY = 'a'", " where data > 2"):
            statement = f"select data from /r{condition}"
            found, cursor = [], None
            while True:
                with rosCas.statements.select(statement, after=cursor, limit=2) as result:
                    page = list(result)
                    cursor = result.cursor
                found += page
                if not page:
                    break
            assert found == rosCas.executeCQL(statement)


def test_export_keeps_the_times_of_reception(cassandra, keyspace, tmp_path):
    import rosbag

    from cassandra_ros.files.bag.comparison import verify_bag
    from cassandra_ros.files.bag.exporter import export_bag
    from cassandra_ros.files.bag.importer import import_bag

    now = [T0]
    with RosCassandra(
        cassandra.host, cassandra.port, keyspace=keyspace, clock=lambda: now[0]
    ) as rosCas:
        part = {"key_format": "msg_part", "key_part": "header.stamp"}
        topics = [
            rosCas.addTopic("/part", **part),
            rosCas.addTopic("/value", key_format="msg_part", key_part="header.seq"),
            rosCas.addTopic("/name", key_format="manual"),
            rosCas.addTopic("/hash", key_format="hash"),
        ]
        wanted = []
        for number, topic in enumerate(topics * 3):
            now[0] += SEC
            message = imu((100 - number) * SEC, number)
            topic.addData(message, key="x" if topic.name == "/name" else None)
            wanted.append((topic.name, now[0], number))
        path = str(tmp_path / "all.bag")
        export_bag(rosCas, path)
        with rosbag.Bag(path) as bag:
            found = [(t, stamp.to_nsec(), m.header.seq) for t, m, stamp in bag.read_messages()]
        assert found == wanted
        assert verify_bag(rosCas, path).equal
    with RosCassandra(cassandra.host, cassandra.port, keyspace=keyspace) as rosCas:
        for topic in list(topics):
            rosCas.truncateTopic(topic.name)
        for _ in range(2):
            import_bag(rosCas, path)
            assert verify_bag(rosCas, path).equal
        assert [rosCas.getTopic(t.name).countTopicData() for t in topics] == [3, 3, 3, 3]
        assert rosCas.getTopic("/part").first() == genpy.Time(92)
        assert rosCas.getTopic("/name").getData("/name").header.seq == 10


class TestOtherClients:
    """What another process does to a topic of names is not undone by one that goes on."""

    @pytest.fixture
    def other(self, cassandra, keyspace, rosCas):
        with RosCassandra(cassandra.host, cassandra.port, keyspace=keyspace) as store:
            yield store

    def test_a_dropped_topic_comes_back_as_it_was(self, rosCas, other):
        topic = rosCas.addTopic("m", key_format="manual", ttl=3600, comment="c", metadata={"a": 1})
        topic.addData(String(data="1"), key="kitchen")
        other.removeTopic("m")
        assert topic.addData(String(data="2"), key="kitchen") == "kitchen"
        meta = rosCas.getTopic("m").getMeta
        assert [meta[k] for k in ("key_format", "ttl", "comment", "a")] == ["manual", 3600, "c", 1]
        assert [m.data for _, m in topic.items("kitchen")] == ["2"]

    @pytest.mark.parametrize("made_anew", [False, True])
    def test_after_a_rename_nothing_goes_astray(self, rosCas, other, made_anew, monkeypatch):
        monkeypatch.setattr("cassandra_ros.store.tables.schema.CACHE_SEC", 0.0)
        topic = rosCas.addTopic("p")
        topic.addData(String(data="1"))
        other.renameTopic("p", "p2")
        if made_anew:
            other.addTopic("p")
        key = topic.addData(String(data="2"))
        assert rosCas.getTopic("p").getData(key).data == "2"
        assert [m.data for _, m in rosCas.getTopic("p2").items()] == ["1"]

    @pytest.mark.parametrize("formats", [("ros", "ros"), ("ros", "json")])
    def test_two_key_formats_at_once(self, rosCas, other, formats):
        """The second client gets an error."""
        barrier = threading.Barrier(2)
        outcomes = []

        def make(store, form, key_format):
            barrier.wait()
            try:
                store.addTopic("p", form, msg_type="std_msgs/String", key_format=key_format)
                outcomes.append("made")
            except TopicExists:
                outcomes.append("exists")

        makers = [
            threading.Thread(target=make, args=args)
            for args in ((rosCas, formats[0], "time"), (other, formats[1], "manual"))
        ]
        for maker in makers:
            maker.start()
        for maker in makers:
            maker.join()
        assert sorted(outcomes) == ["exists", "made"]
        rosCas.catalog.keyspace.schema.tables(fresh=True)
        assert len({t.metadata.key_format for t in rosCas.getTopic("p").tables}) == 1

    def test_who_added_a_topic_hears_that_it_is_gone(self, rosCas, other):
        topic = rosCas.addTopic("g")
        assert topic.countTopicData() == 0  # nothing yet, not gone
        topic.addData(String())
        other.removeTopic("g")
        rosCas.catalog.keyspace.schema.tables(fresh=True)
        for ask in (topic.countTopicData, lambda: topic.getData(0, 1), lambda: topic.removeData(0)):
            with pytest.raises(TopicNotFound, match="any more"):
                ask()


def test_several_definitions_with_a_key_field(rosCas, cassandra, keyspace):
    topic = rosCas.addTopic("p", key_format="msg_part", key_part="data")
    topic.addData(String(data="q"))
    with rosCas.messageWriter() as writer:
        for n, cls in enumerate((Empty, Int64)):
            handle = writer.connect(api_connection("p", definition_of(cls), "/x"))
            writer.write(handle, T0 + n, n, serialize(cls()))
    topic = rosCas.addTopic("p", key_format="msg_part", key_part="data")
    assert len(topic.tables) == 3
    assert [type(m) for _, m in topic.items()] == [Empty, Int64, String]
    assert topic.getData("q").data == "q"
    assert topic.getData(0).data == 0
    for tables in (topic.tables, topic.tables[::-1]):
        assert Finder(rosCas.catalog.keyspace, "p", "msg_part", tables).of_text("0") == 0
    assert topic.keyOfText("0") == 0
    assert topic.keyOfText("q") == "q"
    with pytest.raises(InvalidKey, match="key of these messages"):
        topic.getData([1])
    assert topic.getData(genpy.Time(*divmod(T0, SEC))) == Empty()


def test_typed_keys(rosCas):
    numbers = rosCas.addTopic("/n", key_format="msg_part", key_part="data")
    key = numbers.addData(Int64(data=5))
    texts = rosCas.addTopic("/t", key_format="msg_part", key_part="data")
    text_key = texts.addData(String(data="17"))
    assert numbers.getData(numbers.keyOfText(" 5 ")).data == 5
    assert numbers.getData(numbers.keyOfText(iso_time(key.ns))).data == 5
    with pytest.raises(MessageNotFound, match="the nearest lies at"):
        numbers.getData(genpy.Time(1))  # the time of reception, besides the field
    assert texts.getData(texts.keyOfText("17")).data == "17"
    assert texts.getData(texts.keyOfText(iso_time(text_key.ns))).data == "17"
    assert rosCas.addTopic("/m", key_format="manual").keyOfText("17") == "17"
    assert rosCas.addTopic("/p").keyOfText("17") == 17
    for wrong in ("1e400", "x", "{"):
        with pytest.raises(InvalidKey):
            numbers.getData(numbers.keyOfText(wrong))


def test_names_that_were_not_given_back_are_names(rosCas):
    topic = rosCas.addTopic("/m", key_format="manual")
    key = topic.addData(String(data="x"), key="kitchen")
    assert topic.getData(RowName("kitchen")).data == "x"
    assert copy.copy(key) == key and copy.deepcopy(key).seq == key.seq


@pytest.mark.parametrize("ttl", [-5, 10**9, 0.5, 630_720_000])
def test_what_is_no_ttl(rosCas, ttl):
    with pytest.raises(InvalidOption, match="ttl"):
        rosCas.addTopic("/a", ttl=ttl)
    with pytest.raises(InvalidOption, match="ttl"):
        rosCas.messageWriter(ttl=ttl)
    assert not rosCas.existTopic("/a")


def test_the_longest_ttl(rosCas):
    topic = rosCas.addTopic("/a", ttl=MAX_TTL_SEC)
    topic.addData(UInt8MultiArray(data=bytes(600_000)), key=T0)
    assert topic.countTopicData() == 1
    rosCas.addTopic("/a", "json").addData(UInt8MultiArray(), key=T0 + 1)
    assert {t.metadata.ttl for t in topic.tables} == {MAX_TTL_SEC}


@pytest.mark.parametrize("key_format, key_part", [("hash", ""), ("msg_part", "stamp")])
def test_a_bag_of_equal_times_keeps_its_order(rosCas, tmp_path, key_format, key_part):
    import rosbag

    from cassandra_ros.files.bag.comparison import verify_bag
    from cassandra_ros.files.bag.exporter import export_bag
    from cassandra_ros.files.bag.importer import import_bag

    path = str(tmp_path / "in.bag")
    with rosbag.Bag(path, "w") as bag:
        for number in range(6):
            stamp = genpy.Time(100 - number)
            for topic in ("/plain", "/keyed"):
                bag.write(topic, Header(seq=number, stamp=stamp), genpy.Time(1000))
    keys = {"key_format": key_format, "key_part": key_part}
    rosCas.addTopic("/keyed", msg_type="std_msgs/Header", **keys)
    import_bag(rosCas, path)
    assert verify_bag(rosCas, path).equal
    export_bag(rosCas, tmp_path / "out.bag")
    assert verify_bag(rosCas, tmp_path / "out.bag").equal

    def told(which):
        with rosbag.Bag(which) as bag:
            return [(t, m.seq, stamp) for t, m, stamp in bag.read_messages()]

    assert told(str(tmp_path / "out.bag")) == told(path)


def test_an_export_has_the_names_of_now(rosCas, tmp_path):
    import rosbag

    from cassandra_ros.files.bag.exporter import export_bag

    rosCas.addTopic("/o").addData(String(data="first"), key=T0)
    rosCas.renameTopic("/o", "/n")
    rosCas.addTopic("/o").addData(String(data="second"), key=T0 + 1)
    report = export_bag(rosCas, tmp_path / "out.bag")
    assert report.messages == {"/n": 1, "/o": 1}
    with rosbag.Bag(str(tmp_path / "out.bag")) as bag:
        found = [(topic, m.data) for topic, m, _ in bag.read_messages()]
    assert found == [("/n", "first"), ("/o", "second")]
