# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""bag → store → bag, through a real Cassandra, judged by the rosbag module."""

from __future__ import annotations

import shutil
import subprocess
from collections import Counter
from itertools import islice, product

import pytest
import rosbag
from bag.test_reader import READABLE
from bag.truth import STRING_MD5, read_with_rosbag, string_connection, string_wire
from mcap.writer import Writer
from nodes.raw_publisher import header_of
from std_msgs.msg import String
from suites import sparing

from cassandra_ros.errors import (
    BagError,
    BagUnindexed,
    InvalidKey,
    InvalidQuery,
    MessageNotFound,
    TopicExists,
    TopicNotFound,
)
from cassandra_ros.files.bag import exporter
from cassandra_ros.files.bag.bag_reader import BagReader
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.bag.comparison import verify_bag
from cassandra_ros.files.bag.exporter import export_bag
from cassandra_ros.files.bag.identity import read_content
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.files.bag.message_file import match_topics
from cassandra_ros.keys import split_seq
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.metadata import FORMAT_NAMES, Kind
from cassandra_ros.store.tables.registry import Run
from cassandra_ros.topics import topic_table


def stored_rows(rosCas):
    """Everything that is stored, comparable between keyspaces."""
    return [
        (row.t, row.node, row.seq, row.topic, row.table.name, row.conn, row.size, row.wire)
        for row in rosCas.readMessages()
    ]


def counts_agree(rosCas, cql):
    """Compare the counts of info with SELECT count(*); return them by topic."""

    def count():
        counted = Counter()
        for topic in rosCas.getAllTopics():
            for table in topic.tables:
                what = 'sum("_n")' if table.packed else "count(*)"
                rows = cql.execute(f'SELECT {what} FROM {rosCas.keyspace}."{table.name}"')
                counted[topic.name] += rows.one()[0]
        return counted

    before, told, after = None, None, count()
    # What a killed client had sent may still be written, and only then: rows only become more.
    while before != after:
        assert before is None or sum(before.values()) < sum(after.values())
        before, told = after, Counter()
        for info in rosCas.info():
            told[info.topic] += info.count
        after = count()
    assert dict(told) == dict(after)
    return dict(after)


def beginning(path, target, part):
    """Write the first messages of a bag, its number of messages divided by ``part``."""
    with rosbag.Bag(str(path)) as bag, rosbag.Bag(str(target), "w") as out:
        count = bag.get_message_count() // part
        messages = bag.read_messages(raw=True, return_connection_header=True)
        for topic, raw, t, header in islice(messages, count):
            out.write(topic, raw, t, raw=True, connection_header=header)
    return target


# Every bag in every format; make test leaves the large bags to larger suites.
LATER_BAGS = ("backpack_multiecho_bz2", "husky_gps_data")
OF_ONE_BAG = {"turtlesim_tf": ("binary", "ros", "packed")}


def suites_of(name, form):
    """Return the mark that leaves this format of this bag to a larger suite, in a list."""
    if name not in LATER_BAGS and form in OF_ONE_BAG.get(name, ("packed",)):
        return [pytest.mark.suite("test", "bag, store, bag")]
    if form == "yaml" or (name == "backpack_multiecho_bz2" and form in ("json", "string")):
        return [pytest.mark.suite("campaign", "large bags in their slowest formats")]
    return [pytest.mark.suite("all", "make test asks small bags, and most formats of one")]


@pytest.mark.parametrize(
    ("name", "form"),
    [
        pytest.param(name, form, marks=suites_of(name, form))
        for name, form in product(READABLE, FORMAT_NAMES)
        if (name, form) != ("backpack_multiecho_bz2", "yaml")
    ],
)
def test_every_bag_comes_back_as_it_was(rosCas, bags, tmp_path, name, form):
    comes_back(rosCas, bags / f"{name}.bag", tmp_path, form)


@pytest.mark.suite("campaign", "large bags in their slowest formats")
def test_the_largest_bag_comes_back_from_yaml(rosCas, bags, tmp_path):
    # Slow, 50 us a number, and more of the same: not all of it.
    part = 5
    path = beginning(bags / "backpack_multiecho_bz2.bag", tmp_path / "in.bag", part)
    comes_back(rosCas, path, tmp_path, "yaml")


def comes_back(rosCas, path, tmp_path, form):
    """Import a bag, verify and export it, and compare by the rosbag module."""
    report = import_bag(rosCas, path, format=form)
    expected = read_with_rosbag(path)
    assert report.messages == len(expected[1])
    told = {topic: info.messages for topic, info in report.topics.items()}
    assert told == Counter(message.topic for message in expected[1])
    verified = verify_bag(rosCas, path)
    assert verified.equal, verified.first
    assert verified.equal_messages == len(expected[1])
    export_bag(rosCas, tmp_path / "out.bag")
    assert read_with_rosbag(tmp_path / "out.bag") == expected
    with BagReader(path) as original, BagReader(tmp_path / "out.bag") as copy:
        assert copy.connections == original.connections


@pytest.mark.parametrize("form", sparing(["binary", "ros"], kept=["ros"]))
def test_a_bag_of_what_satisfies_conditions(rosCas, bags, tmp_path, form):
    path = bags / "turtlesim_tf.bag"
    import_bag(rosCas, path, format=form)
    where = {
        "turtle1/pose": "x > 5.6 AND NOT theta = 0",
        "/tf": ("transforms.child_frame_id = ? AND transforms.header.seq = 0", ["turtle1"]),
    }
    report = export_bag(rosCas, tmp_path / "out.bag", where=where)
    with rosbag.Bag(str(path)) as original:
        kept = []
        for topic, message, stamp in original.read_messages():
            if topic == "/turtle1/pose":
                satisfied = message.x > 5.6 and message.theta != 0
            else:
                satisfied = topic != "/tf" or any(
                    t.child_frame_id == "turtle1" and t.header.seq == 0 for t in message.transforms
                )
            if satisfied:
                kept.append((topic, message, stamp))
    with rosbag.Bag(str(tmp_path / "out.bag")) as written:
        assert [tuple(entry) for entry in written.read_messages()] == kept
    counts = Counter(topic for topic, *_ in kept)
    assert report.messages == counts
    assert 0 < counts["/turtle1/pose"] < 1344
    assert 0 < counts["/tf"] < 2688


def test_an_invalid_condition_creates_no_bag(rosCas, tmp_path):
    rosCas.addTopic("/a", msg_type="std_msgs/String")
    for where, error in (({"/a": "data >"}, InvalidQuery), ({"/b": "data = ''"}, TopicNotFound)):
        with pytest.raises(error):
            export_bag(rosCas, tmp_path / "out.bag", where=where)
    assert list(tmp_path.iterdir()) == []


def test_a_definition_that_is_none_is_kept_as_binary_with_a_warning(rosCas, bags, tmp_path):
    report = import_bag(rosCas, bags / "empty_message_definition.bag", format="ros")
    assert report.topics["/led_array_status"].format == "binary"
    assert len(report.warnings) == 1
    assert "/led_array_status is kept as binary" in report.warnings[0]


def test_a_broken_definition_does_not_stop_the_others(rosCas, tmp_path):
    path = tmp_path / "a.bag"
    hostile = "int8 _md5sum;open('/tmp/cassandra_ros_was_here','w');B=1\n"
    with BagWriter(path) as writer:
        good = writer.connection(string_connection("/good"))
        bad = writer.connection(string_connection("/bad", message_definition=hostile))
        for i in range(10):
            writer.write(good, i, string_wire(f"good {i}"))
            writer.write(bad, i, string_wire(f"bad {i}"))
    report = import_bag(rosCas, path, format="ros")
    assert {t: (i.format, i.messages) for t, i in report.topics.items()} == {
        "/good": ("ros", 10),
        "/bad": ("binary", 10),
    }
    assert len(report.warnings) == 1
    assert verify_bag(rosCas, path).equal
    with BagReader(path) as reader:
        expected = [(m.number, m.t_ns, m.data) for m in reader.messages()]
    export_bag(rosCas, tmp_path / "out.bag")
    with BagReader(tmp_path / "out.bag") as reader:
        assert [(m.number, m.t_ns, m.data) for m in reader.messages()] == expected


def test_a_type_without_a_class_is_imported_twice(rosCas, cql, tmp_path):
    """genpy cannot make a class with a field called serialize: the topic is kept as binary."""
    definition = "int32 serialize\n"
    md5sum = parse_definition("odd_msgs/Odd", definition).md5sum
    path = tmp_path / "a.bag"
    with BagWriter(path) as writer:
        fields = {"type": "odd_msgs/Odd", "md5sum": md5sum, "message_definition": definition}
        number = writer.connection(string_connection("/odd", **fields))
        for i in range(5):
            writer.write(number, i, i.to_bytes(4, "little"))
    for _ in range(2):
        report = import_bag(rosCas, path, format="ros")
        assert report.topics["/odd"].format == "binary"
        assert counts_agree(rosCas, cql) == {"/odd": 5}
    assert verify_bag(rosCas, path).equal


@pytest.mark.parametrize("form", ["binary", "ros"])
def test_one_topic_of_two_types_and_two_names_of_one_type(rosCas, tmp_path, form):
    path = tmp_path / "a.bag"
    kinds = [
        ("std_msgs/String", STRING_MD5, "string data\n"),
        ("std_msgs/Int32", "da5909fbe378aeaf85e547e830cc1bb7", "int32 data\n"),
        ("other_msgs/Text", STRING_MD5, "string data\n"),
    ]
    with BagWriter(path) as writer:
        for i in range(60):
            msg_type, md5sum, definition = kinds[i % 3]
            if i < 3:
                fields = {"type": msg_type, "md5sum": md5sum, "message_definition": definition}
                writer.connection(string_connection("/mixed", **fields), i)
            wire = i.to_bytes(4, "little") if i % 3 == 1 else string_wire(f"text {i}")
            writer.write(i % 3, 10**18 + i // 4, wire)
    import_bag(rosCas, path, format=form)
    assert verify_bag(rosCas, path).equal
    export_bag(rosCas, tmp_path / "out.bag")
    assert read_with_rosbag(tmp_path / "out.bag") == read_with_rosbag(path)


def two_unusable_types(path):
    """Write an MCAP with two types on one topic, neither with a definition that can be used."""
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start("ros1")
        for name in ("odd_msgs/One", "odd_msgs/Two"):
            schema = writer.register_schema(name, "ros1msg", b"what is this")
            writer.register_channel("/odd", "ros1", schema)
        for n in range(20):
            writer.add_message(1 + n % 2, 10 + n, string_wire(str(n)), 10 + n)
        writer.finish()
    return path


def tables_of(rosCas):
    return sorted((info.type, info.md5sum, info.count) for info in rosCas.info(["/odd"]))


def test_two_types_with_unusable_definitions_get_two_tables(rosCas, cql, tmp_path):
    path = two_unusable_types(tmp_path / "a.mcap")
    both = [("odd_msgs/One", "*", 10), ("odd_msgs/Two", "*", 10)]
    import_bag(rosCas, path)
    rows = stored_rows(rosCas)
    assert [row.type for row in rosCas.getTopic("/odd").rows()] == [both[0][0], both[1][0]] * 10
    import_bag(rosCas, path)
    assert stored_rows(rosCas) == rows
    assert rosCas.convertTopic("/odd", "ros").tables == 0  # they stay binary, and two
    assert tables_of(rosCas) == both
    assert counts_agree(rosCas, cql) == {"/odd": 20}
    assert verify_bag(rosCas, path).equal
    rosCas.truncateTopic("/odd")
    assert len(rosCas.getTopic("/odd").tables) == 2
    import_bag(rosCas, path)
    assert tables_of(rosCas) == both


def test_types_that_share_a_table_stay_there(rosCas, connect, cql, tmp_path, monkeypatch):
    path = two_unusable_types(tmp_path / "a.mcap")
    with monkeypatch.context() as earlier:
        earlier.setattr(
            topic_table, "message_kind", lambda md5sum, _, arrays: Kind(md5sum, "", arrays)
        )
        import_bag(rosCas, path)
    rows = stored_rows(rosCas)
    assert tables_of(rosCas) == [("odd_msgs/One", "*", 20)]
    with connect(keyspace=rosCas.keyspace) as other:
        import_bag(other, path)
        assert stored_rows(other) == rows
    assert counts_agree(rosCas, cql) == {"/odd": 20}
    assert verify_bag(rosCas, path).equal


def test_connection_numbers_of_32_bits(rosCas, connect, tmp_path):
    path = tmp_path / "a.bag"
    numbers = [0, 2**31 - 1, 2**31, 2**32 - 2, 2**32 - 1]
    with BagWriter(path) as writer:
        for number in numbers:
            writer.connection(string_connection(f"/topic{number % 2}"), number)
            # Equal times: the numbers decide the order.
            writer.write(number, 1000, string_wire(f"over {number}"))
    import_bag(rosCas, path)
    rosCas.addTopic("/live", msg_type="std_msgs/String").addData(String("x"), key=2000)
    with connect(keyspace=rosCas.keyspace) as another:  # it has read no connection yet
        assert verify_bag(another, path).equal
        found = {row.connection.number for row in another.readMessages()}
        assert found == {-1, *numbers}
        export_bag(another, tmp_path / "part.bag", topics=["/topic0", "/topic1"])
        assert read_with_rosbag(tmp_path / "part.bag") == read_with_rosbag(path)
        export_bag(another, tmp_path / "all.bag")
    connections, messages = read_with_rosbag(tmp_path / "all.bag")
    assert {number for number, *_ in connections} == {*numbers, 1}
    assert messages[:-1] == read_with_rosbag(path)[1]


def test_an_empty_bag_is_an_import_of_nothing(rosCas, tmp_path, monkeypatch):
    BagWriter(tmp_path / "a.bag").close()
    assert import_bag(rosCas, tmp_path / "a.bag").messages == 0
    assert verify_bag(rosCas, tmp_path / "a.bag").equal
    with monkeypatch.context() as watched:
        watched.setattr(exporter, "make_file", None)  # not begun: who follows it would get a part
        with pytest.raises(MessageNotFound, match="holds none of these topics"):
            export_bag(rosCas, tmp_path / "out.bag")
    assert not (tmp_path / "out.bag").exists()


def test_bags_that_cannot_be_read_store_nothing(rosCas, bags, tmp_path):
    with pytest.raises(BagUnindexed, match="rosbag reindex"):
        import_bag(rosCas, bags / "truncated_header_only.bag")
    whole = (bags / "husky_gps_data.bag").read_bytes()
    (tmp_path / "cut.bag").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(BagUnindexed, match="rosbag reindex"):
        import_bag(rosCas, tmp_path / "cut.bag")
    assert rosCas.getAllTopics() == []
    assert rosCas.runs() == []


def test_damage_in_the_middle_says_how_much_was_stored(rosCas, cql, tmp_path):
    path = tmp_path / "a.bag"
    with BagWriter(path, "bz2", chunk_bytes=50_000) as writer:
        number = writer.connection(string_connection())
        for i in range(10_000):
            writer.write(number, i, string_wire(f"text {i}"))
    with BagReader(path) as reader:
        info = reader.chunk_info(5)
    changed = bytearray(path.read_bytes())
    changed[info.position + 200] ^= 0xFF
    path.write_bytes(changed)
    with pytest.raises(BagError, match=f"chunk 6 of .* the {info.first} messages before it are"):
        import_bag(rosCas, path)
    assert counts_agree(rosCas, cql) == {"/chatter": info.first}


def test_importing_twice_changes_nothing(rosCas, cql, bags, tmp_path):
    path = bags / "turtlesim_tf.bag"
    import_bag(rosCas, path)
    rows, counts = stored_rows(rosCas), counts_agree(rosCas, cql)
    shutil.copy(path, tmp_path / "another name.bag")
    import_bag(rosCas, tmp_path / "another name.bag")
    assert stored_rows(rosCas) == rows
    assert counts_agree(rosCas, cql) == counts
    assert sum(counts.values()) == 8647
    assert len(rosCas.runs()) == 1


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_part_and_then_the_whole_is_the_whole(rosCas, cql, bags):
    path = bags / "turtlesim_tf.bag"
    part = import_bag(rosCas, path, topics=["tf", "/rosout"])
    assert {t: i.messages for t, i in part.topics.items()} == {"/tf": 2688, "/rosout": 10}
    assert verify_bag(rosCas, path, topics=["/tf", "/rosout"]).equal
    difference = verify_bag(rosCas, path)
    assert difference.differences == 8647 - 2698
    assert "/turtle1/pose is not stored: its 1344 messages are missing" in difference.first
    import_bag(rosCas, path)
    rows = stored_rows(rosCas)
    assert verify_bag(rosCas, path).equal
    assert sum(counts_agree(rosCas, cql).values()) == 8647
    import_bag(rosCas, path, topics=["/rosout"])
    assert stored_rows(rosCas) == rows
    with BagReader(path) as reader:
        expected = {(m.t_ns, m.position) for m in reader.messages()}
        assert {split_seq(row[2])[0] for row in rows} == {read_content(reader).writer_id()}
    assert {(row[0], split_seq(row[2])[1]) for row in rows} == expected


def long_bag(path, changed=-1, count=2500):
    """Write a bag; one byte of the message with the number changed is another."""
    with BagWriter(path) as writer:
        numbers = [writer.connection(string_connection(topic)) for topic in ("/a", "/b")]
        for i in range(count):
            writer.write(
                numbers[i % 2], i // 3, string_wire(f"text {i}{'!' if i == changed else '.'}")
            )
    return path


@pytest.mark.suite("all", "make test asks others of its kind")
def test_bags_that_differ_in_the_middle_lie_side_by_side(rosCas, cql, tmp_path):
    paths = [long_bag(tmp_path / "a.bag"), long_bag(tmp_path / "b.bag", changed=1250)]
    first = import_bag(rosCas, paths[0])
    rows = stored_rows(rosCas)
    second = import_bag(rosCas, paths[1])
    assert first.writer_id != second.writer_id
    both = stored_rows(rosCas)
    assert [row for row in both if split_seq(row[2])[0] == first.writer_id] == rows
    assert counts_agree(rosCas, cql) == {"/a": 2500, "/b": 2500}
    for path in (*paths, paths[0]):
        import_bag(rosCas, path)
        import_bag(rosCas, path, topics=["/a"])
        assert stored_rows(rosCas) == both
        assert verify_bag(rosCas, path).equal
    assert len(rosCas.runs()) == 2


def test_an_id_that_is_another_bags_by_chance_is_not_taken(rosCas, tmp_path):
    path = long_bag(tmp_path / "a.bag", count=20)
    with BagReader(path) as reader:
        writer_id = read_content(reader).writer_id()
    other = Run("", writer_id, "import", labels={"content": "of another bag"})
    rosCas.catalog.keyspace.registry.put_run(other, started=True)
    for _ in range(2):
        assert import_bag(rosCas, path).writer_id == writer_id + 1
    assert verify_bag(rosCas, path).equal
    assert len(stored_rows(rosCas)) == 20


def test_a_second_format_of_the_same_bag_is_refused(rosCas, bags):
    import_bag(rosCas, bags / "primitive_arrays.bag", format="binary")
    with pytest.raises(TopicExists, match="in format binary.*twice.*cassandra_bag convert"):
        import_bag(rosCas, bags / "primitive_arrays.bag", format="ros")
    rosCas.removeTopic("/array_test")
    import_bag(rosCas, bags / "primitive_arrays.bag", format="ros")
    assert verify_bag(rosCas, bags / "primitive_arrays.bag").equal


def test_a_second_format_is_refused_wherever_the_messages_lie(rosCas, tmp_path):
    """The keys are names, so no bucket of the time of the bag lists them."""
    path = long_bag(tmp_path / "a.bag", count=20)
    for topic in ("/a", "/b"):
        rosCas.addTopic(topic, "ros", msg_type="std_msgs/String", key_format="hash")
    import_bag(rosCas, path, format="ros")
    with pytest.raises(TopicExists, match="in format ros.*twice"):
        import_bag(rosCas, path, format="json")
    import_bag(rosCas, path)
    assert len(list(rosCas.getTopic("/a").rows())) == 10


def test_two_nodes_keep_two_copies(rosCas, bags, tmp_path):
    path = bags / "primitive_arrays.bag"
    first, second = (import_bag(rosCas, path, nodeID=node) for node in ("r1", "r2"))
    assert first.writer_id != second.writer_id  # so that a run has the messages of one robot
    assert len(stored_rows(rosCas)) == 40
    assert {row.node for row in rosCas.readMessages(run=second.writer_id)} == {"r2"}
    with pytest.raises(InvalidKey, match="'r1', 'r2'; choose one"):
        verify_bag(rosCas, path)
    assert verify_bag(rosCas, path, nodeID="r2").equal
    export_bag(rosCas, tmp_path / "out.bag", nodeID="r1")
    assert read_with_rosbag(tmp_path / "out.bag") == read_with_rosbag(path)


def test_unknown_topics_are_named(rosCas, bags):
    with pytest.raises(TopicNotFound, match="no topic /turtle1/poze in .*; it has /turtle1/pose"):
        import_bag(rosCas, bags / "turtlesim_tf.bag", topics=["/turtle1/poze"])
    with pytest.raises(TopicNotFound) as raised:
        import_bag(rosCas, bags / "turtlesim_tf.bag", topics=["/nope"])
    listing = str(raised.value).partition("; it has ")[2]
    with BagReader(bags / "turtlesim_tf.bag") as reader:
        names = {connection.topic for connection in reader.connections.values()}
    assert listing.endswith(" (9 topics)")
    assert set(listing[: -len(" (9 topics)")].split(", ")) == names
    assert rosCas.getAllTopics() == []


def test_of_many_topics_the_nearest_are_named():
    present = {f"/robot{i}/scan" for i in range(20)} | {"/a", "/b", "/c", "/tf"}
    with pytest.raises(TopicNotFound) as raised:
        match_topics(["/robot7/scam"], present, "a.bag")
    text = str(raised.value)
    assert text.startswith("there is no topic /robot7/scam in a.bag; it has /robot7/scan, /robot")
    assert text.endswith(" and 14 more (24 topics)")
    wanted = "/x in a.bag; it has /c, /b, .* and 14 more .24 topics.$"
    with pytest.raises(TopicNotFound, match=wanted):
        match_topics(["/x"], present, "a.bag")
    with pytest.raises(TopicNotFound, match="/x in a.bag; it has none$"):
        match_topics(["/x"], set(), "a.bag")


def test_two_bags_of_the_same_topics_verify_each_and_export_together(rosCas, tmp_path):
    def write(name, start):
        with BagWriter(tmp_path / name) as writer:
            numbers = [
                writer.connection(string_connection(topic, callerid=f"/{name}/{i}"))
                for i, topic in enumerate(("/a", "/a", "/b"))
            ]
            for i in range(300):
                # Three messages share each stamp, in an order that is not that of the numbers.
                writer.write(numbers[-i % 3], start + i // 3, string_wire(f"{name} {i}"))
        return tmp_path / name

    first, second = write("one", 1000), write("two", 1050)
    for path in (first, second):
        import_bag(rosCas, path)
    for path in (first, second):
        assert verify_bag(rosCas, path).equal
    export_bag(rosCas, tmp_path / "both.bag")
    messages = read_with_rosbag(tmp_path / "both.bag")[1]
    assert [m.t_ns for m in messages] == sorted(m.t_ns for m in messages)
    for name, path in (("one", first), ("two", second)):
        mine = [m for m in messages if m.header["callerid"].startswith(b"/" + name.encode())]
        assert mine == read_with_rosbag(path)[1]


def test_a_time_range_of_some_topics(rosCas, bags, tmp_path):
    path = bags / "turtlesim_tf.bag"
    import_bag(rosCas, path)
    everything = read_with_rosbag(path)[1]
    start, end = everything[2000].t_ns, everything[5000].t_ns
    report = export_bag(
        rosCas, tmp_path / "out.bag", topics=["/tf", "tf", "turtle1/pose"], start=start, end=end
    )
    wanted = ("/tf", "/turtle1/pose")
    expected = [m for m in everything if m.topic in wanted and start <= m.t_ns <= end]
    assert read_with_rosbag(tmp_path / "out.bag")[1] == expected
    assert sum(report.messages.values()) == len(expected)


@pytest.mark.parametrize("compression", sparing(["bz2", "lz4"], kept=["lz4"]))
def test_compressed_export(rosCas, bags, tmp_path, compression):
    path = bags / "luminar_stage_lz4.bag"
    import_bag(rosCas, path)
    export_bag(rosCas, tmp_path / "out.bag", compression=compression)
    assert read_with_rosbag(tmp_path / "out.bag") == read_with_rosbag(path)
    info = subprocess.run(
        ["rosbag", "info", "-y", "-k", "compression", str(tmp_path / "out.bag")],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert info.strip() == compression


def test_a_file_is_not_replaced_unasked(rosCas, bags, tmp_path):
    import_bag(rosCas, bags / "primitive_arrays.bag")
    path = tmp_path / "out.bag"
    path.write_bytes(b"precious")
    with pytest.raises(BagError, match="exists"):
        export_bag(rosCas, path)
    assert path.read_bytes() == b"precious"
    export_bag(rosCas, path, force=True)
    assert read_with_rosbag(path) == read_with_rosbag(bags / "primitive_arrays.bag")


def test_messages_that_were_added_by_hand_are_exported(rosCas, tmp_path):
    from std_msgs.msg import String

    rosCas.addTopic("/by_hand", msg_type="std_msgs/String")
    topic = rosCas.getTopic("/by_hand")
    for i in range(5):
        topic.addData(String(f"text {i}"), key=10**18 + i)
    export_bag(rosCas, tmp_path / "out.bag")
    messages = read_with_rosbag(tmp_path / "out.bag")[1]
    assert [(m.topic, m.t_ns, m.type) for m in messages] == [
        ("/by_hand", 10**18 + i, "std_msgs/String") for i in range(5)
    ]
    assert [m.data for m in messages] == [string_wire(f"text {i}") for i in range(5)]


@pytest.mark.parametrize("format", [None, "ros"])
def test_one_of_two_publishers_without_a_definition(rosCas, cql, tmp_path, format):
    """A repeated import finds the table of each publisher."""
    definition = parse_definition("own_msgs/One", "string data\n", None)
    path = tmp_path / "a.bag"
    with BagWriter(path) as writer:
        for n, text in enumerate(("string data\n", "")):
            fields = {"md5sum": definition.md5sum, "message_definition": text}
            header = {**header_of(String, f"/n{n}"), "type": "own_msgs/One", **fields}
            number = writer.connection(live_connection("/t", header))
            for k in range(10):
                writer.write(number, 1000 + 2 * k + n, string_wire(f"{n} {k}"))
    for _ in range(2):
        import_bag(rosCas, path, format=format)
        assert counts_agree(rosCas, cql) == {"/t": 20}
        assert [row.table.metadata.format for row in rosCas.getTopic("/t").rows()] == [
            "ros",
            "binary",
        ] * 10
        assert verify_bag(rosCas, path).equal
