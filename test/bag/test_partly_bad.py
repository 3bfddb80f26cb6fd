# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Files of which a connection or a message cannot be stored: all others are, and it is told."""

from __future__ import annotations

import pytest
from bag.truth import string_connection, string_wire
from mcap.writer import CompressionType, IndexType, Writer

from cassandra_ros.errors import TopicNotFound
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.bag.comparison import verify_bag
from cassandra_ros.files.bag.exporter import export_bag
from cassandra_ros.files.bag.file_formats import open_file
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.files.bag.mcap_channel import HEADER_FIELD
from cassandra_ros.keys import MAX_NS
from cassandra_ros.messages.connection_header import Connection

T0 = 1_500_000_000 * 10**9
COUNT = 40
"""Number of messages of each topic: some chunks, each with enough messages to read them at once."""
SOUND = string_connection("/bad").header
FAULTS = {
    "empty md5sum": ("/bad", string_connection("/bad", md5sum="").header, "states no md5sum"),
    "empty type": ("/bad", string_connection("/bad", type="").header, "states no type"),
    "header cut short": ("/bad", SOUND[:-1], "runs over the end"),
    "no topic": ("", SOUND, "names no topic"),
    "topic not UTF-8": ("/b\udcffd", SOUND, "is not UTF-8"),
}
"""Name -> topic and header of a connection, and a part of what is told of it."""


@pytest.fixture(params=FAULTS)
def bad_bag(request, tmp_path):
    """A bag of three topics, whose second connection has a fault, and what is told of it."""
    topic, header, told = FAULTS[request.param]
    sound = [string_connection(name) for name in ("/good", "/fine")]
    with BagWriter(tmp_path / "a.bag", chunk_bytes=4000) as writer:
        each = [sound[0], Connection(topic, header), sound[1]]
        numbers = [writer.connection(connection, n) for n, connection in enumerate(each)]
        for n in range(COUNT):
            for number in numbers:
                writer.write(number, T0 + 3 * n + number, string_wire(f"{number} {n}"))
    return tmp_path / "a.bag", told


def test_each_name_that_is_refused_is_told_once(rosCas, tmp_path):
    path = tmp_path / "a.bag"
    with BagWriter(path) as writer:
        for topic, callerid in (("/b\0ad", "/one"), ("/b\0ad", "/two"), ("/w\0rse", "/one")):
            number = writer.connection(string_connection(topic, callerid=callerid))
            writer.write(number, T0, string_wire(topic))
    report = import_bag(rosCas, path)
    assert report.lost == {"/b\0ad": 2, "/w\0rse": 1}
    assert [text.split(": ")[1] for text in report.warnings] == [
        "2 messages are not stored",
        "1 messages are not stored",
    ]


@pytest.mark.parametrize("salvage", [False, True])
def test_a_bad_connection_does_not_hide_the_others(bad_bag, salvage):
    path, told = bad_bag
    with open_file(path, salvage=salvage) as reader:
        assert [c.topic for c in reader.connections.values()] == ["/good", "/fine"]
        assert list(reader.counts.values()) == [COUNT, COUNT]
        assert [(m.position, m.t_ns, m.data) for m in reader.messages()] == [
            (n, T0 + 3 * (n // 2) + n % 2 * 2, string_wire(f"{n % 2 * 2} {n // 2}"))
            for n in range(2 * COUNT)
        ]
        ((count, why),) = reader.left_out.values()
        assert count == COUNT and told in why
        assert reader.salvaged.why == ""


def test_a_bad_connection_of_a_bag_that_was_not_closed(bad_bag):
    path, told = bad_bag
    raw = path.read_bytes()
    path.write_bytes(raw[: raw.rindex(b"\x04\0\0\0op=\x04")])  # before the last record of an index
    with open_file(path, salvage=True) as reader:
        assert reader.salvaged.messages == reader.message_count == 2 * COUNT
        ((count, why),) = reader.left_out.values()
        assert count == COUNT and told in why


def test_what_is_right_is_imported_and_what_is_not_is_named(rosCas, bad_bag):
    path, told = bad_bag
    report = import_bag(rosCas, path)
    assert set(report.topics) == {"/good", "/fine"}
    assert report.messages == 2 * COUNT
    assert list(report.lost.values()) == [COUNT]
    (warning,) = report.warnings
    assert f"{COUNT} messages of topic " in warning and told in warning
    compared = verify_bag(rosCas, path)
    assert (compared.differences, compared.missing, compared.equal_messages) == (40, 40, 80)
    good = import_bag(rosCas, path, topics=["/good"])
    assert (good.warnings, good.lost, good.messages) == ([], {}, COUNT)
    assert verify_bag(rosCas, path, ["/good"]).equal
    for name in report.lost:  # which is a topic of the file, but nothing of it can be stored
        assert import_bag(rosCas, path, topics=[name]).lost == report.lost
    with pytest.raises(TopicNotFound):
        import_bag(rosCas, path, topics=["/none"])


def mcap_of(path, metadata=None, times=(), sent=None, **options):
    """Write an MCAP with the topics /good and /late; the latter has messages of these times."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=2000, **options)
        writer.start("ros1")
        schema = writer.register_schema("std_msgs/String", "ros1msg", b"string data\n")
        good = writer.register_channel("/good", "ros1", schema)
        late = writer.register_channel("/late", "ros1", schema, metadata or {})
        for n in range(COUNT):
            writer.add_message(good, T0 + n, string_wire(f"good {n}"), T0 + n)
            if n < len(times):
                publish = times[n] if sent is None else sent
                writer.add_message(late, times[n], string_wire(f"late {n}"), publish)
        writer.finish()
    return path


LAYOUTS = {
    "usual": {},
    "one by one": {"use_chunking": False},
    "without indexes": {"index_types": IndexType.NONE, "compression": CompressionType.NONE},
    "without repetition": {"repeat_channels": False, "repeat_schemas": False},
}
TIMES = [T0, MAX_NS, MAX_NS + 1, 2**63, 2**64 - 1]


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("salvage", [False, True])
def test_a_message_that_is_too_late_does_not_hide_the_others(tmp_path, layout, salvage):
    path = mcap_of(tmp_path / "a.mcap", times=TIMES, **LAYOUTS[layout])
    with open_file(path, salvage=salvage) as reader:
        assert reader.salvaged.why == ""
        assert (reader.message_count, reader.start_ns, reader.end_ns) == (COUNT + 2, T0, MAX_NS)
        assert len(list(reader.messages())) == COUNT + 2
        late = [m for m in reader.messages() if m.data.startswith(string_wire("late 0")[:9])]
        assert [(m.t_ns, m.data) for m in late] == [
            (T0, string_wire("late 0")),
            (MAX_NS, string_wire("late 1")),
        ]
        assert list(reader.left_out) == ["/late"]
        count, why = reader.left_out["/late"]
        assert count == 3 and "2106" in why


@pytest.mark.parametrize("sent", [0, 2**63 - 1, 2**63, 2**64 - 1])
def test_any_publish_time_comes_back(rosCas, tmp_path, sent):
    path = mcap_of(tmp_path / "a.mcap", times=[T0, T0 + 5], sent=sent)
    report = import_bag(rosCas, path)
    assert (report.messages, report.lost, report.warnings) == (COUNT + 2, {}, [])
    assert verify_bag(rosCas, path).equal
    export_bag(rosCas, tmp_path / "out.mcap")
    told = []
    for name in ("a.mcap", "out.mcap"):
        with open_file(tmp_path / name) as reader:
            parts = [reader.chunk_publish_times(n) for n in range(reader.chunk_count)]
            delays = [delay for part in parts if part for delay in part.delays.tolist()]
            told.append(sorted(delay for delay in delays if delay))
    assert told[0] == told[1]
    assert {(T0 + delay) % 2**64 for delay in told[0]} >= {sent}


@pytest.mark.parametrize(
    "metadata", [{"md5sum": ""}, {HEADER_FIELD: "x"}, {HEADER_FIELD: "0:AAAA"}]
)
def test_a_bad_channel_does_not_hide_the_others(rosCas, tmp_path, metadata):
    path = mcap_of(tmp_path / "a.mcap", metadata, [T0] * 3)
    report = import_bag(rosCas, path)
    assert (report.messages, report.lost, set(report.topics)) == (COUNT, {"/late": 3}, {"/good"})
    (warning,) = report.warnings
    assert "3 messages of topic /late are not stored: channel 2" in warning
    assert import_bag(rosCas, path, topics=["/good"]).warnings == []


def test_a_file_of_which_nothing_can_be_stored(rosCas, tmp_path):
    path = mcap_of(tmp_path / "a.mcap", {"md5sum": ""}, [T0] * 3)
    report = import_bag(rosCas, path, topics=["/late"])
    assert (report.messages, report.lost) == (0, {"/late": 3})
