# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Our reader beside the rosbag module, on real bags and on bags that rosbag wrote."""

from __future__ import annotations

import genpy
import pytest
import rosbag
from bag.truth import read_with_rosbag, string_connection, string_wire
from compiled import compiled
from std_msgs.msg import String
from suites import sparing

from cassandra_ros.errors import BagError, BagUnindexed
from cassandra_ros.files.bag.bag_reader import BagReader
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.bag.message_file import read_in_order

READABLE = (
    "backpack_multiecho_bz2",
    "big_occupancy_grid_bz2",
    "empty_message_definition",
    "grid_map_nan_year2100",
    "husky_gps_data",
    "luminar_stage_lz4",
    "primitive_arrays",
    "ros_numpy_types",
    "turtlesim_tf",
)


SMALL = [name for name in READABLE if name not in ("backpack_multiecho_bz2", "husky_gps_data")]


@pytest.mark.parametrize("name", sparing(READABLE, kept=SMALL))
def test_it_reads_what_rosbag_reads_in_the_same_order(bags, name):
    connections, messages = read_with_rosbag(bags / f"{name}.bag")
    with BagReader(bags / f"{name}.bag") as reader:
        ours = list(reader.messages())
        found = list(reader.connections.values())
        ordered = [ours[e.position] for e in read_in_order(reader, lambda message: b"")]
        assert reader.message_count == len(messages)
        assert reader.start_ns == min(m.t_ns for m in messages)
        assert reader.end_ns == max(m.t_ns for m in messages)
        by_number = reader.connections
    assert [(c.number, c.topic, c.fields) for c in found] == connections
    assert [m.position for m in ours] == list(range(len(messages)))
    assert [
        (by_number[m.number].topic, m.t_ns, by_number[m.number].fields, m.data) for m in ordered
    ] == [(m.topic, m.t_ns, m.header, m.data) for m in messages]
    assert [(by_number[m.number].type, by_number[m.number].md5sum) for m in ordered] == [
        (m.type, m.md5sum) for m in messages
    ]


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_chunks_of_any_size_written_by_rosbag(tmp_path, compression):
    if compression == "lz4":
        compiled("roslz4")
    path = tmp_path / "a.bag"
    with rosbag.Bag(str(path), "w", compression=compression, chunk_threshold=2000) as bag:
        for i in range(500):
            # Times go back within and between chunks, and repeat.
            bag.write(f"/t{i % 3}", String(f"text {i}"), genpy.Time(100 + (i * 7) % 40, i % 2))
    with BagReader(path) as reader:
        assert reader.chunk_count > 5
        ours = list(reader.messages())
        ordered = [ours[e.position] for e in read_in_order(reader, lambda message: b"")]
    # rosbag merges unsorted lists here; the order by time, connection, position is the defined one.
    assert [(m.t_ns, m.number, m.position) for m in ordered] == sorted(
        (m.t_ns, m.number, m.position) for m in ours
    )
    assert [m.data for m in ours] == [string_wire(f"text {i}") for i in range(500)]


def test_messages_of_some_connections_keep_their_positions(bags):
    with BagReader(bags / "husky_gps_data.bag") as reader:
        wanted = {n for n, c in reader.connections.items() if c.topic in ("/fix", "/tf")}
        some = list(reader.messages(wanted))
        assert some == [m for m in reader.messages() if m.number in wanted]
        assert reader.message_count == 12_303


def test_an_empty_bag_has_no_messages(tmp_path):
    rosbag.Bag(str(tmp_path / "a.bag"), "w").close()
    with BagReader(tmp_path / "a.bag") as reader:
        assert (reader.message_count, reader.connections, list(reader.messages())) == (0, {}, [])
        assert (reader.start_ns, reader.end_ns) == (0, 0)


def test_connections_without_messages_are_left_out_as_rosbag_does(tmp_path):
    path = tmp_path / "a.bag"
    with BagWriter(path) as writer:
        first = writer.connection(string_connection())
        writer.connection(string_connection("/never"))
        writer.write(first, 5, string_wire("x"))
    with BagReader(path) as reader:
        assert [c.topic for c in reader.connections.values()] == ["/chatter"]
    assert [topic for _, topic, _ in read_with_rosbag(path)[0]] == ["/chatter"]


def test_the_truncated_bag_is_refused_with_the_remedy(bags):
    path = bags / "truncated_header_only.bag"
    with pytest.raises(BagUnindexed, match=f"cut short after 3072 bytes.*rosbag reindex {path}"):
        BagReader(path)


def test_a_bag_that_is_still_recorded_is_refused(tmp_path):
    path = tmp_path / "a.bag"
    writer = BagWriter(path)
    writer.write(writer.connection(string_connection()), 5, string_wire("x"))
    writer._file.flush()
    with pytest.raises(BagUnindexed, match="has no index: it is still being recorded.*reindex"):
        BagReader(f"{path}.active")
    writer.discard()
    assert not list(tmp_path.iterdir())


def test_files_that_are_no_bags_say_what_they_are(tmp_path):
    path = tmp_path / "a.bag"
    for content, text in (
        (b"", "is empty"),
        (b"\x89PNG\r\n\x1a\n" + bytes(100), "is not a bag of format 2.0"),
        (b"#ROSBAG V1.2\n" + bytes(100), "old format 1.2; convert.*rosbag filter"),
        (b"#ROSRECORD V1.1\n" + bytes(100), "old format 1.1"),
        (b"#ROSBAG V2.0\n", "cut short"),
    ):
        path.write_bytes(content)
        with pytest.raises(BagError, match=text):
            BagReader(path)
    with pytest.raises(BagError, match="No such file"):
        BagReader(tmp_path / "missing.bag")
    with pytest.raises(BagError, match="directory"):
        BagReader(tmp_path)


def test_an_encrypted_bag_is_named_as_such(tmp_path):
    from cassandra_ros.files.bag import format as bagformat

    header = (
        (b"op", b"\x03"),
        (b"encryptor", b"rosbag/AesCbcEncryptor"),
        (b"index_pos", 5000),
        (b"conn_count", bagformat.U32.pack(1)),
        (b"chunk_count", bagformat.U32.pack(1)),
    )
    path = tmp_path / "a.bag"
    path.write_bytes(bagformat.MAGIC + bagformat.pack_record(header, bytes(4000)) + bytes(2000))
    with pytest.raises(BagError, match="encrypted.*rosbag decrypt"):
        BagReader(path)
