# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""MCAP files, read and written; judged by the mcap packages and by the bags they were made of."""

from __future__ import annotations

import io
from contextlib import suppress
from random import Random
from time import process_time

import pytest
from bag.truth import string_connection, string_wire
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Schema
from mcap.writer import CompressionType, IndexType, Writer
from mcap_ros1.decoder import DecoderFactory
from suites import search

from cassandra_ros.errors import BagError, BagUnindexed
from cassandra_ros.files.bag.file_formats import make_file, open_file
from cassandra_ros.files.bag.identity import read_content
from cassandra_ros.files.bag.mcap_channel import HEADER_FIELD, NUMBER, to_channel, to_connection
from cassandra_ros.files.bag.mcap_format import RECORD, find_messages, walk
from cassandra_ros.files.bag.mcap_writer import McapWriter
from cassandra_ros.messages.connection_header import Connection, live_connection

BAGS = ("turtlesim_tf", "primitive_arrays", "empty_message_definition", "ros_numpy_types")


def copy(source, target, **options):
    """Write the messages of a file into another one."""
    with open_file(source) as reader, McapWriter(target, chunk_bytes=50_000, **options) as writer:
        for number, connection in reader.connections.items():
            writer.connection(connection, number)
        for message in reader.messages():
            writer.write(message.number, message.t_ns, message.data)
    return target


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
@pytest.mark.parametrize("name", BAGS)
def test_mcap_holds_what_the_bag_holds(bags, tmp_path, name, compression):
    source = bags / f"{name}.bag"
    path = copy(source, tmp_path / "a.mcap", compression=compression)
    with open_file(source) as bag, open_file(path) as mcap:
        assert {chunk.head.compression for chunk in mcap._chunks} == {compression}
        assert mcap.connections == bag.connections
        assert (mcap.counts, mcap.start_ns, mcap.end_ns) == (bag.counts, bag.start_ns, bag.end_ns)
        assert list(mcap.messages()) == list(bag.messages())
        assert read_content(mcap).digest == read_content(bag).digest


def test_the_packages_of_mcap_read_it(bags, tmp_path):
    path = copy(bags / "turtlesim_tf.bag", tmp_path / "a.mcap")
    with open_file(path) as ours, open(path, "rb") as file:
        expected = {(m.t_ns, ours.connections[m.number].topic, m.data) for m in ours.messages()}
        count = ours.message_count
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros1"
        summary = reader.get_summary()
        assert summary.statistics.message_count == count
        found, poses = set(), 0
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            found.add((message.log_time, channel.topic, message.data))
            assert message.publish_time == message.log_time
            if schema.name == "turtlesim/Pose":
                poses += decoded.x > 0
        assert found == expected
        assert poses > 100
        rosout = [c.metadata for c in summary.channels.values() if c.topic == "/rosout"]
        assert {"callerid": "/sim", "latching": "true"}.items() <= rosout[1].items()


def foreign(path, messages=40, **options):
    """Write what another program might: no header but the type, several channels."""
    compression = options.pop("compression", CompressionType.ZSTD)
    size = options.pop("chunk_size", 200)
    with open(path, "wb") as file:
        writer = Writer(file, size, compression, **options)
        writer.start("ros1")
        schema = writer.register_schema("std_msgs/String", "ros1msg", b"string data\n")
        channels = [writer.register_channel(f"/c{n}", "ros1", schema) for n in range(3)]
        channels.append(
            writer.register_channel("/latched", "ros1", schema, {"latching": "true", "x": "y"})
        )
        for n in range(messages):
            writer.add_message(channels[n % 4], 10 + n, string_wire(str(n)), 10 + n)
        writer.finish()
    return path


LAYOUTS = {
    "whole": {},
    "no chunks": {"use_chunking": False},
    "no indexes": {"index_types": IndexType.NONE},
    "no summary": {"repeat_channels": False, "repeat_schemas": False, "use_statistics": False},
    "nothing": {
        "repeat_channels": False,
        "repeat_schemas": False,
        "use_statistics": False,
        "use_summary_offsets": False,
        "index_types": IndexType.NONE,
        "enable_crcs": False,
    },
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_of_other_writers_is_read(tmp_path, layout):
    with open_file(foreign(tmp_path / "a", **LAYOUTS[layout])) as reader:  # whatever its name
        assert [(m.t_ns, m.position, m.data) for m in reader.messages()] == [
            (10 + n, n, string_wire(str(n))) for n in range(40)
        ]
        assert (reader.start_ns, reader.end_ns) == (10, 49)
        latched = reader.connections[4]
        assert latched.topic == "/latched"
        assert latched.latching
        assert latched.fields["x"] == b"y"
        assert latched.fields["topic"] == b"/latched"
        # Computed, because the file does not state it.
        assert {c.md5sum for c in reader.connections.values()} == {string_connection().md5sum}
        assert {c.type for c in reader.connections.values()} == {"std_msgs/String"}
        assert latched.definition_text == "string data\n"


def test_a_file_that_is_cut_says_so(tmp_path):
    whole = foreign(tmp_path / "a.mcap").read_bytes()
    path = tmp_path / "b.mcap"
    for length in (*range(8, len(whole), 97), len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(BagUnindexed, match=f"mcap recover {path} -o") as caught:
            open_file(path)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("compression", CompressionType)
@pytest.mark.parametrize("chunks", [True, False])
def test_a_cut_file_is_salvaged_up_to_the_cut(tmp_path, compression, chunks):
    options = {"compression": compression, "use_chunking": chunks, "chunk_size": 2000}
    whole = foreign(tmp_path / "a.mcap", 200, **options).read_bytes()
    expected, path, counts = [string_wire(str(n)) for n in range(200)], tmp_path / "b.mcap", [0]
    for length in range(100, len(whole), 131):
        path.write_bytes(whole[:length])
        try:
            with open_file(path, salvage=True) as reader:
                assert [m.data for m in reader.messages()] == expected[: reader.message_count]
                counts.append(reader.message_count)
                assert {c.type for c in reader.connections.values()} == {"std_msgs/String"}
                text = reader.salvaged.told(reader.path)
                assert text.startswith(f"{path} is cut short or damaged ")
                assert f": {reader.message_count} messages up to there are read" in text
        except BagError as exc:
            assert "no message that can be salvaged" in str(exc)
            assert counts[-1] == 0
    assert counts == sorted(counts)
    assert counts[-1] == 200
    if compression == CompressionType.NONE or not chunks:
        assert len(set(counts)) > 50  # also the messages of a part of a chunk
    with open_file(tmp_path / "a.mcap", salvage=True) as reader:
        assert (reader.salvaged.why, reader.message_count) == ("", 200)


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_of_a_cut_chunk_the_messages_before_the_cut_are_kept(tmp_path, compression):
    path, random = tmp_path / "a.mcap", Random(1)
    wires = [string_wire(random.getrandbits(120_000).to_bytes(15_000, "little")) for _ in range(60)]
    with McapWriter(path, compression) as writer:
        number = writer.connection(string_connection())
        for n, wire in enumerate(wires):
            writer.write(number, n, wire)
    path.write_bytes(path.read_bytes()[:600_000])
    with open_file(path, salvage=True) as reader:
        assert 20 < reader.message_count < 40
        assert [m.data for m in reader.messages()] == wires[: reader.message_count]
        text = reader.salvaged.told(reader.path)
        assert " is cut short or damaged in the chunk at byte " in text  # what is read lies in it
        assert 0 < reader.salvaged.lost_bytes < (15_100 if compression == "none" else 600_000)


def test_of_a_cut_chunk_of_unknown_compression_nothing_is_kept(tmp_path):
    path, lz4 = tmp_path / "a.mcap", b"\3\0\0\0lz4"
    with McapWriter(path, "lz4") as writer:
        number = writer.connection(string_connection())
        for n in range(400):
            writer.write(number, n, string_wire(bytes([n % 100 + 1]) * 20_000))
    whole = path.read_bytes()
    last = whole.rindex(lz4, 0, len(whole) // 2)
    path.write_bytes(whole[:last] + b"\3\0\0\0lz5" + whole[last + len(lz4) :][:500])
    with open_file(path, salvage=True) as reader:
        assert 100 < reader.message_count < 200
        assert " is cut short or damaged in the chunk at byte " in reader.salvaged.told("a.mcap")


@pytest.mark.suite("all", "a search over damage")
def test_damage_is_found_or_changes_nothing(tmp_path):
    """The bytes of each message come back, or BagError says where the damage is."""
    whole = foreign(tmp_path / "a.mcap").read_bytes()
    path = tmp_path / "b.mcap"
    with open_file(tmp_path / "a.mcap") as reader:
        expected = [m.data for m in reader.messages()]
    refused = salvaged = 0
    for at in range(8, len(whole), 11):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x55]) + whole[at + 1 :])
        try:
            with open_file(path) as reader:
                assert [m.data for m in reader.messages()] == expected
        except BagError as exc:
            assert str(path) in str(exc)
            refused += 1
            with suppress(BagError), open_file(path, salvage=True) as reader:
                rest = iter(expected)
                assert all(m.data in rest for m in reader.messages())
                salvaged += 1
    assert refused > 100
    assert salvaged > 50


def test_a_chunk_that_is_passed_over_is_missed(tmp_path):
    """A record of unknown kind, as after damage or from a later version of the format."""
    whole = bytearray(foreign(tmp_path / "a.mcap").read_bytes())
    with open(tmp_path / "a.mcap", "rb") as file:
        first = next(r for r in walk(file) if r.kind == Opcode.CHUNK)
    whole[first.start - RECORD.size] = 0x7F
    (tmp_path / "a.mcap").write_bytes(whole)
    with pytest.raises(BagError, match=r"of the 40 messages that it should hold \d+ are found"):
        open_file(tmp_path / "a.mcap")
    with open_file(tmp_path / "a.mcap", salvage=True) as reader:
        assert 0 < reader.message_count < 40
        assert reader.salvaged.lost_bytes == first.stop - first.start
        assert "of the 40 messages that it should hold" in reader.salvaged.told("a")


@pytest.mark.parametrize("layout", LAYOUTS)
def test_salvage_of_a_sound_file_changes_nothing(tmp_path, layout):
    path = foreign(tmp_path / "a.mcap", **LAYOUTS[layout])
    with open_file(path) as whole, open_file(path, salvage=True) as salvaged:
        assert salvaged.salvaged.why == ""
        assert (salvaged.start_ns, salvaged.end_ns) == (whole.start_ns, whole.end_ns)
        assert read_content(salvaged).digest == read_content(whole).digest
        assert list(salvaged.messages()) == list(whole.messages())


def test_channels_of_merged_files_may_state_the_same_number(tmp_path):
    path = tmp_path / "merged.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros1")
        schema = writer.register_schema("std_msgs/String", "ros1msg", b"string data\n")
        for name in ("/a", "/b"):  # each was the first connection of an export
            channel = writer.register_channel(name, "ros1", schema, {NUMBER: "0"})
            writer.add_message(channel, 10, string_wire(name), 10)
        writer.finish()
    with open_file(path) as reader:
        topics = {n: connection.topic for n, connection in reader.connections.items()}
        assert topics == {1: "/a", 2: "/b"}
        assert [(topics[m.number], m.data) for m in reader.messages()] == [
            (name, string_wire(name)) for name in ("/a", "/b")
        ]


@pytest.mark.parametrize("place", [1, 2**40, 2**63, 2**64 - 1])
def test_a_footer_that_points_nowhere_is_damage(tmp_path, place):
    path = foreign(tmp_path / "a.mcap")
    whole = bytearray(path.read_bytes())
    with open(path, "rb") as file:
        footer = next(r for r in walk(file) if r.kind == Opcode.FOOTER)
    whole[footer.start : footer.start + 8] = place.to_bytes(8, "little")
    path.write_bytes(whole)
    with pytest.raises(BagError, match="the crc of its summary is wrong"):
        open_file(path)
    with open_file(path, salvage=True) as reader:
        assert reader.salvaged.why == "has a damaged summary"
        assert reader.message_count == 40


def test_a_chunk_of_unknown_records_is_read_once(tmp_path):
    """Each record is skipped without copying the bytes that follow it."""
    content = RECORD.pack(0x7F, 0) * 300_000
    before = process_time()
    assert not len(find_messages(content, "").times)
    assert process_time() - before < 10


TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
NAMES = st.sampled_from(["callerid", "latching", "x", "type", "topic", "message_definition", "é"])


@given(
    st.lists(st.tuples(NAMES, st.one_of(TEXTS, st.binary(max_size=6), st.just("1"))), max_size=8),
    st.binary(max_size=9),
)
@search(300)
def test_any_header_comes_back_to_the_bit(fields, definition):
    """Whatever a publisher writes into its header, in whatever order, twice too."""
    base = {"type": "std_msgs/String", "md5sum": "*", "message_definition": definition}
    # The last of several equal names counts, and a bag has a type and an md5sum.
    header = b"".join(live_connection("/a", {name: value}).header for name, value in fields)
    header += live_connection("/a", base).header
    connection = Connection("/a", header, 7)
    text = to_channel(connection)
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start()
    schema = writer.register_schema(text.type, "ros1msg", text.definition)
    writer.register_channel("/a", "ros1", schema, text.metadata)
    writer.finish()
    summary = make_reader(io.BytesIO(stream.getvalue())).get_summary()
    channel, schema = summary.channels[1], summary.schemas[1]
    channel.id = 7
    assert to_connection(channel, schema) == connection


def test_hostile_metadata_is_refused():
    for text in ("x", "1:=", "99999999999999999999999:AAAA", ":"):
        channel = Channel(1, "/a", "ros1", {HEADER_FIELD: text}, 1)
        with pytest.raises(BagError, match=r"^channel 1 \(topic /a\) is damaged: "):
            to_connection(channel, Schema(1, b"", "ros1msg", "std_msgs/String"))


def test_what_cannot_be_written_is_an_error(tmp_path):
    with pytest.raises(BagError, match="'bz2' is not a compression of MCAP"):
        make_file(tmp_path / "a.mcap", "bz2")
    with pytest.raises(BagError, match="'zstd' is not a compression of bags"):
        make_file(tmp_path / "a.bag", "zstd")
    with pytest.raises(BagError, match="cannot be written"):
        make_file(tmp_path / "no" / "a.mcap")
    with pytest.raises(ZeroDivisionError), make_file(tmp_path / "A.MCAP") as writer:
        writer.write(writer.connection(string_connection()), 1, b"")
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []
