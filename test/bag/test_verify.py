# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""verify: finds every kind of difference, and says which message it is."""

from __future__ import annotations

import genpy
import pytest
from bag.truth import string_connection, string_wire
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import Writer
from std_msgs.msg import Header

from cassandra_ros.errors import BagError, MessageNotFound
from cassandra_ros.files.bag.bag_reader import BagReader
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.bag.comparison import (
    Comparison,
    Entry,
    VerifyReport,
    verify_bag,
    verify_content,
)
from cassandra_ros.files.bag.exporter import export_bag
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.files.bag.message_file import read_in_order
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.messages.stamps import Stamp, iso_time

START = 1_700_000_000 * 10**9
MESSAGES = [("/a", START + i * 1000, f"text {i}") for i in range(50)]


def write(path, messages, **header):
    with BagWriter(path) as writer:
        numbers = {
            topic: writer.connection(string_connection(topic, **header))
            for topic in sorted({topic for topic, _, _ in messages})
        }
        for topic, t_ns, text in messages:
            writer.write(numbers[topic], t_ns, string_wire(text))
    return path


@pytest.fixture
def original(rosCas, tmp_path):
    path = write(tmp_path / "original.bag", MESSAGES)
    import_bag(rosCas, path)
    return path


def differences(rosCas, path, **options):
    report = verify_bag(rosCas, path, **options)
    assert report.equal == (not report.first)
    return report.differences, report.first


def test_equal(rosCas, original):
    assert differences(rosCas, original) == (0, [])


def test_a_missing_message(rosCas, original):
    rosCas.getTopic("/a").removeData(MESSAGES[7][1])
    place = iso_time(MESSAGES[7][1])
    assert differences(rosCas, original) == (
        1,
        [f"/a at {place}: message 7 of the bag is not in the store"],
    )


def test_other_bytes_time_and_connection(rosCas, original, tmp_path):
    # Not this very bag, so all that is stored on its topics is compared.
    other = [*MESSAGES[:7], ("/a", MESSAGES[7][1], "TEXT 7"), *MESSAGES[8:]]
    found = differences(rosCas, write(tmp_path / "b.bag", other))
    assert found[0] == 1
    assert "message 7 of the bag: its 10 bytes differ" in found[1][0]
    # The next stored message has these bytes; it stands at its own place.
    other = [*MESSAGES[:7], ("/a", MESSAGES[7][1], "text 8"), *MESSAGES[8:]]
    found = differences(rosCas, write(tmp_path / "f.bag", other))
    assert found[0] == 1
    assert "message 7 of the bag: its 10 bytes differ" in found[1][0]
    other = [*MESSAGES[:7], ("/a", MESSAGES[7][1], "longer text"), *MESSAGES[8:]]
    found = differences(rosCas, write(tmp_path / "c.bag", other))
    assert "15 bytes in the bag, 10 in the store" in found[1][0]
    other = [*MESSAGES[:7], ("/a", MESSAGES[7][1] + 1, "text 7"), *MESSAGES[8:]]
    found = differences(rosCas, write(tmp_path / "d.bag", other))
    assert found[0] == 2
    assert "the bag has no such message" in found[1][0]
    assert "message 7 of the bag is not in the store" in found[1][1]
    found = differences(rosCas, write(tmp_path / "e.bag", MESSAGES, callerid="/other"))
    assert found[0] == 2 * len(MESSAGES)
    assert len(found[1]) == 10
    assert "over this connection" in found[1][1]


def test_order_of_equal_stamps_counts(rosCas, tmp_path):
    equal = [("/a", START, "one"), ("/a", START, "two"), ("/a", START, "one more")]
    import_bag(rosCas, write(tmp_path / "a.bag", equal))
    assert verify_bag(rosCas, tmp_path / "a.bag").equal
    swapped = write(tmp_path / "b.bag", [equal[1], equal[0], equal[2]])
    assert verify_bag(rosCas, swapped).differences == 2


def test_messages_that_the_bag_has_not(rosCas, original, tmp_path):
    report = verify_bag(rosCas, write(tmp_path / "b.bag", MESSAGES[:-2]))
    assert report.differences == 2
    assert report.scope == "all stored messages on its topics"
    assert all("the bag has no such message" in text for text in report.first)


def test_other_rows_of_the_topic_do_not_matter_for_an_import(rosCas, original, tmp_path):
    import_bag(rosCas, write(tmp_path / "b.bag", MESSAGES[10:20], callerid="/other"))
    report = verify_bag(rosCas, original)
    assert report.equal
    assert report.scope == "the import of this bag"


@pytest.mark.suite("test", "promise 1, by the verbs of a person")
def test_an_import_of_the_exported_bag_is_equal_to_the_original(rosCas, bags, keyspace, tmp_path):
    path = bags / "turtlesim_tf.bag"
    import_bag(rosCas, path)
    export_bag(rosCas, tmp_path / "out.bag")
    for topic in rosCas.getAllTopics():
        rosCas.removeTopic(topic.name)
    import_bag(rosCas, tmp_path / "out.bag")
    report = verify_bag(rosCas, path)
    assert report.equal, report.first
    assert report.scope == "all stored messages on its topics"


def record(rosCas, messages, names=None, later=5_000):
    """Store messages as a live recording does: other times and callers."""
    with rosCas.messageWriter() as writer:
        for i, (topic, t_ns, text) in enumerate(messages):
            name = (names or {}).get(topic, topic)
            handle = writer.connect(string_connection(name, callerid="/play", latching="1"))
            writer.write(handle, t_ns + later, i, string_wire(text))


def test_content_of_a_recording(rosCas, tmp_path):
    messages = [("/ab"[:2] if i % 3 else "/b", START + i, f"text {i}") for i in range(60)]
    path = write(tmp_path / "a.bag", messages)
    record(rosCas, messages, {"/b": "/renamed"})
    assert not verify_bag(rosCas, path).equal
    report = verify_content(rosCas, path, mapping={"/b": "/renamed"})
    assert report.equal, report.first
    assert report.equal_messages == 60
    missing = verify_content(rosCas, path)
    assert missing.differences == 20
    assert "has no counterpart" in missing.first[0]


def test_content_differs(rosCas, tmp_path):
    path = write(tmp_path / "a.bag", MESSAGES)
    record(rosCas, [*MESSAGES[:5], ("/a", MESSAGES[5][1], "lost it"), *MESSAGES[6:49]])
    report = verify_content(rosCas, path)
    assert (report.differences, report.equal_messages) == (2, 48)
    assert "message 5 of the bag: 10 bytes in the bag, 11 in the store" in report.first[0]
    assert "message 49 of the bag has no counterpart" in report.first[1]
    record(rosCas, MESSAGES[:3], later=10**12)
    report = verify_content(rosCas, path)
    assert not report.equal
    assert report.equal_messages == 48
    only = verify_content(rosCas, path, start=START, end=START + 10**9)
    assert (only.differences, only.equal_messages) == (2, 48)


def test_content_is_in_the_order_of_reception(rosCas, tmp_path):
    header = definition_of(Header)
    kind = {"type": header.type, "md5sum": header.md5sum, "message_definition": header.text}
    connection = string_connection("/h", **kind)
    wires = [
        serialize(Header(seq=n, stamp=genpy.Time(stamp))) for n, stamp in enumerate((3, 1, 2, 2))
    ]
    with BagWriter(tmp_path / "a.bag") as writer:
        number = writer.connection(connection)
        for n, wire in enumerate(wires):
            writer.write(number, START + n, wire)
    key = {"key_format": "msg_part", "key_part": "stamp"}
    rosCas.addTopic("/h", msg_type="std_msgs/Header", **key)
    with rosCas.messageWriter() as writer:
        handle = writer.connect(connection)
        for n, wire in enumerate(wires):
            writer.write(handle, START + 5000 + n, n, wire)
    assert [row.wire for row in rosCas.readMessages()] != wires
    report = verify_content(rosCas, tmp_path / "a.bag", start=START + 5000)
    assert (report.differences, report.equal_messages) == (0, 4), report.first
    late = verify_content(rosCas, tmp_path / "a.bag", end=START + 5002)
    assert (late.differences, late.equal_messages) == (1, 3)
    rosCas.getTopic("/h").addData(Header(stamp=genpy.Time(9)))
    (surplus,) = verify_content(rosCas, tmp_path / "a.bag").first
    assert iso_time(9 * 10**9) not in surplus


def align(bag, store):
    def entries(texts):
        return [Entry(0, 0, i, "t", "m", text.encode(), "/a") for i, text in enumerate(texts)]

    report = VerifyReport("a.bag", "")
    comparison = Comparison(iter(entries(store)), report, 0)
    for message in entries(bag):
        comparison.add(message)
    comparison.finish()
    return report.equal_messages, report.differences, report.first


NUMBERS = [str(i) for i in range(200)]


def test_one_difference_does_not_spread():
    assert align(NUMBERS, NUMBERS) == (200, 0, [])
    assert align([], []) == (0, 0, [])
    lost = align(NUMBERS, [n for n in NUMBERS if n not in ("7", "8", "150")])
    assert lost[:2] == (197, 3)
    place = f"/a at {iso_time(0)}"
    assert lost[2] == [f"{place}: message {i} of the bag is not in the store" for i in (7, 8, 150)]
    doubled = align(NUMBERS, [*NUMBERS[:10], "x", "y", *NUMBERS[10:]])
    assert doubled[:2] == (200, 2)
    assert align(NUMBERS, [*NUMBERS[:5], "x", *NUMBERS[6:]])[:2] == (199, 1)
    assert align(NUMBERS, NUMBERS[:190])[:2] == (190, 10)
    assert align(NUMBERS[:100], NUMBERS)[:2] == (100, 100)
    assert align(NUMBERS, [])[:2] == (0, 200)
    assert align([], NUMBERS)[:2] == (0, 200)
    assert align(["a"] * 100, ["a"] * 99)[:2] == (99, 1)
    swapped = [*NUMBERS[:3], "4", "3", *NUMBERS[5:]]
    assert align(NUMBERS, swapped)[1] == 2
    assert align("012345", "023145")[:2] == (5, 2)  # the shorter way: one lost, one more


@given(st.lists(st.sampled_from("abc"), max_size=80), st.lists(st.sampled_from("abc"), max_size=80))
def test_only_equal_sequences_are_equal(bag, store):
    equal, differences, _ = align(bag, store)
    assert (differences == 0) == (bag == store)
    assert equal <= min(len(bag), len(store))


def test_overlapping_chunks_are_put_in_order(tmp_path):
    path = tmp_path / "a.bag"
    with BagWriter(path, chunk_bytes=200) as writer:
        numbers = [writer.connection(string_connection(t)) for t in ("/a", "/b", "/c")]
        for i in range(300):
            writer.write(numbers[i % 3], (i * 37) % 100, string_wire("x"))
    with BagReader(path) as reader:
        assert reader.chunk_count > 20
        expected = sorted((m.t_ns, m.number, m.position) for m in reader.messages())
        assert [e[:3] for e in read_in_order(reader, lambda message: b"")] == expected
        some = [e[:3] for e in read_in_order(reader, lambda message: b"", {1})]
        assert some == [entry for entry in expected if entry[1] == 1]


def test_an_index_that_denies_the_times_is_an_error(tmp_path):
    from bag.test_damage import chunk_header, make_bag, message_record

    data = message_record(t=5)
    make_bag(tmp_path / "a.bag", chunk_header(b"none", len(data)), data, times=(6, 7))
    with BagReader(tmp_path / "a.bag") as reader:
        assert len(list(reader.messages())) == 1
        with pytest.raises(BagError, match="outside the times that the index states"):
            list(read_in_order(reader, lambda message: b""))


def test_what_an_import_leaves_out_is_missing(rosCas, tmp_path):
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros1")
        schema = writer.register_schema("std_msgs/String", "ros1msg", b"string data\n")
        for name, encoding in (("/a", "ros1"), ("/b", "json")):
            channel = writer.register_channel(name, encoding, schema)
            for n in range(3):
                writer.add_message(channel, START + n, string_wire(name), START + n)
        writer.add_attachment(START, START, "notes.txt", "text/plain", b"read me")
        writer.finish()
    import_bag(rosCas, path)
    report = verify_bag(rosCas, path)
    assert (report.equal, report.differences, report.missing) == (False, 3, 3)
    assert " messages of /b are not stored: its messages are encoded as 'json'" in report.first[0]
    assert report.extras == {"attachments": 1}
    assert verify_bag(rosCas, path, topics=["/a"]).equal
    # The times of what is left out are not known.
    report = verify_bag(rosCas, path, start=Stamp.from_ns(START), end=Stamp.from_ns(START + 1))
    assert (report.equal, report.equal_messages) == (True, 2)
    (kind,) = report.extras.keys() - {"attachments"}
    assert "messages of /b in the whole file" in kind and report.extras[kind] == 3


def test_messages_outside_of_the_time_range_are_not_missing(rosCas, tmp_path):
    """A topic that is not stored has some; and a range without any message is not equal."""
    other = [("/b", t_ns, text) for _, t_ns, text in MESSAGES[15:30]]
    path = write(tmp_path / "a.bag", sorted([*MESSAGES, *other], key=lambda each: each[1]))
    import_bag(rosCas, path, topics=["/a"])

    def compared(first, last):
        bounds = [Stamp.from_ns(START + n * 1000) for n in (first, last)]
        return verify_bag(rosCas, path, start=bounds[0], end=bounds[1])

    report = compared(10, 19)
    assert (report.differences, report.missing, report.equal_messages) == (5, 5, 10)
    assert report.first == ["/b is not stored: its 5 messages are missing"]
    report = compared(0, 9)
    assert (report.equal, report.equal_messages) == (True, 10)
    with pytest.raises(MessageNotFound, match=f"the file has messages from {iso_time(START)} to"):
        compared(100, 200)


def test_only_a_time_range_is_compared(rosCas, original, tmp_path):
    """In the file and in the store: of an import, and of an export."""
    bounds = {"start": Stamp.from_ns(MESSAGES[10][1]), "end": Stamp.from_ns(MESSAGES[19][1])}
    topic, exported = rosCas.getTopic("/a"), tmp_path / "window.bag"
    topic.removeData(MESSAGES[7][1])
    report = verify_bag(rosCas, original, **bounds)
    assert (report.differences, report.equal_messages) == (0, 10)
    topic.removeData(MESSAGES[12][1])
    assert verify_bag(rosCas, original, **bounds).differences == 1
    export_bag(rosCas, exported, **bounds)
    assert verify_bag(rosCas, exported).differences == 39
    report = verify_bag(rosCas, exported, **bounds)
    assert (report.differences, report.equal_messages) == (0, 9)
    topic.removeData(MESSAGES[19][1])
    assert verify_bag(rosCas, exported, **bounds).differences == 1


@pytest.mark.parametrize("suffix", [".bag", ".mcap"])
def test_an_export_of_several_robots_is_equal_and_tells_them_apart(rosCas, tmp_path, suffix):
    path = write(tmp_path / "a.bag", MESSAGES)
    for node in ("husky", "", "anymal"):
        import_bag(rosCas, path, nodeID=node)
    exported = tmp_path / f"out{suffix}"
    export_bag(rosCas, exported)
    report = verify_bag(rosCas, exported)
    assert (report.differences, report.equal_messages) == (0, 150), report.first
    assert report.mixed_robots == []
    rosCas.getTopic("/a").removeData(MESSAGES[7][1], nodeID="husky")
    assert verify_bag(rosCas, exported).differences == 1
    rosCas.getTopic("/a").removeData(run={run.node: run.writer for run in rosCas.runs()}[""])
    import_bag(rosCas, path, nodeID="jackal")
    report = verify_bag(rosCas, exported)
    assert report.missing >= 50 and not report.equal


def test_two_bags_of_one_publisher_and_of_one_robot_are_equal_to_their_export(rosCas, tmp_path):
    for name in ("one", "two"):
        messages = [(topic, t_ns, f"{name} {text}") for topic, t_ns, text in MESSAGES]
        import_bag(rosCas, write(tmp_path / f"{name}.bag", messages), nodeID="husky")
    export_bag(rosCas, tmp_path / "out.bag")
    report = verify_bag(rosCas, tmp_path / "out.bag")
    assert (report.differences, report.equal_messages) == (0, 100), report.first
    with BagReader(tmp_path / "out.bag") as reader:
        assert {c.robot for c in reader.connections.values()} == {None}


def test_robots_that_the_file_does_not_name_are_said(rosCas, tmp_path):
    path = write(tmp_path / "a.bag", MESSAGES)
    twice = write(tmp_path / "twice.bag", [m for m in MESSAGES for _ in range(2)])
    for node in ("husky", "jackal"):
        import_bag(rosCas, path, nodeID=node)
    report = verify_bag(rosCas, twice)
    assert report.equal, report.first
    assert report.mixed_robots == ["husky", "jackal"]
    assert verify_bag(rosCas, path, nodeID="husky").mixed_robots == []


def test_an_import_of_several_robots_says_that_they_become_one(
    rosCas, new_keyspace, connect, tmp_path
):
    path = write(tmp_path / "a.bag", MESSAGES)
    for node in ("husky", "jackal"):
        import_bag(rosCas, path, nodeID=node)
    export_bag(rosCas, tmp_path / "out.bag")
    with connect(keyspace=new_keyspace) as other:
        report = import_bag(other, tmp_path / "out.bag")
        assert "several robots (husky, jackal)" in report.warnings[0]
        assert verify_bag(other, tmp_path / "out.bag").equal
        export_bag(other, tmp_path / "again.bag")
        assert verify_bag(other, tmp_path / "again.bag").equal
