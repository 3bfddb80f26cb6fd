# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Files of the spool: what is written is read, and damage costs only what it hits."""

from __future__ import annotations

import errno
import json
import resource
import shutil
import subprocess
import zlib
from collections import Counter
from contextlib import contextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st
from suites import search

from cassandra_ros.errors import SpoolError
from cassandra_ros.files.bag.mcap_format import MAGIC
from cassandra_ros.files.bag.mcap_reader import McapReader
from cassandra_ros.files.spool.segment_reader import SegmentReader
from cassandra_ros.files.spool.segment_writer import UNCOPIED_PART_BYTES, SegmentWriter
from cassandra_ros.files.spool.spool_folder import SpoolFolder
from cassandra_ros.files.spool.spool_label import (
    VERSION,
    RunEnd,
    SpoolLabel,
    as_metadata,
    from_metadata,
    is_whole,
)
from cassandra_ros.messages.connection_header import live_connection

LABELLED = SpoolLabel(5, 5, "ros", "robot:9042", 7, node="husky", labels={"site": "lab"})
ENDED = RunEnd(9, {"/t0": 1}, {"/t1": 2}, [("/t1", "buffer full", 1, 2, 2)])
CHUNKS, EACH = 10, 30


def connection(n):
    header = {"topic": f"/t{n}", "type": "std_msgs/String", "md5sum": "992ce8a1687cec8c8bd883ec7"}
    return live_connection(f"/t{n}", {**header, "message_definition": "string data\n"})


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A file, the messages in it, and the number of bytes after each chunk."""
    path = tmp_path_factory.mktemp("spool") / "000001.mcap"
    connections = [connection(n) for n in range(3)]
    writer = SegmentWriter(path, LABELLED)
    messages, ends = [], []
    for chunk in range(CHUNKS):
        numbers = range(chunk * EACH, (chunk + 1) * EACH)
        mine = [(connections[n % 3], 10**18 + n, n, b"\4\0\0\0%04d" % n) for n in numbers]
        writer.append(mine)
        messages += mine
        ends.append(writer.size)
    writer.finish(ENDED)
    writer.sync()
    writer.close()
    return path, messages, ends


def read(path):
    parts = list(SegmentReader(path).parts())
    return [message for part in parts for message in part.messages], parts


def test_what_is_written_is_read(written):
    path, messages, _ = written
    reader = SegmentReader(path)
    assert (reader.label(), reader.end().stored) == (LABELLED, ENDED.stored)
    assert read(path)[0] == messages
    assert sum(total.count for total in reader.totals().values()) == len(messages)
    assert path.stat().st_mode & 0o777 == 0o600


def test_a_connection_is_one_object_in_all_chunks(tmp_path):
    """Who knows a connection by its id would take a new object at a freed place for an old one."""
    path = tmp_path / "000001.mcap"
    writer = SegmentWriter(path, LABELLED)
    connections = [connection(n) for n in range(CHUNKS)]
    for chunk in range(CHUNKS):  # each connection begins in a chunk of its own
        writer.append([(each, 1, chunk, b"") for each in connections[: chunk + 1]])
    writer.close()
    seen = {}
    for part in SegmentReader(path).parts():
        for each, *_ in part.messages:
            assert seen.setdefault(each.topic, each) is each
    assert len(seen) == CHUNKS


@pytest.mark.parametrize(
    "odd", [{"md5sum": ""}, {"type": ""}, {"type": "caf\udce9/String"}], ids=["md5", "none", "type"]
)
def test_a_publisher_with_an_odd_header_harms_no_other(tmp_path, odd):
    path = tmp_path / "000001.mcap"
    writer = SegmentWriter(path, LABELLED)
    header = {"topic": "/odd", "type": "std_msgs/String", "md5sum": "992ce8a1687cec8c8bd883ec7"}
    strange = live_connection("/odd", {**header, "message_definition": "string data\n", **odd})
    messages = [(each, 1, 0, b"\0\0\0\0") for each in (connection(0), strange)]
    for _ in range(3):
        writer.append(messages)
    writer.close()
    assert read(path)[0] == 3 * messages


def test_a_damaged_label_is_none(tmp_path):
    path = tmp_path / "000001.mcap"
    SegmentWriter(path, LABELLED).close()
    data = bytearray(path.read_bytes())
    data[data.index(b"robot:9042")] ^= 1
    path.write_bytes(data)
    assert SegmentReader(path).label() is None


def test_other_readers_of_mcap_take_it(written, tmp_path):
    path, messages, ends = written
    with McapReader(path) as reader:
        assert [message.data for message in reader.messages()] == [wire for *_, wire in messages]
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[: ends[4] + 10])
    with McapReader(cut, salvage=True) as reader:
        assert reader.message_count == 5 * EACH


def test_mcap_recover_takes_a_file_that_was_cut(written, tmp_path):
    command = shutil.which("mcap")
    if command is None:
        pytest.skip("the command mcap is not installed")
    path, _, ends = written
    cut, whole = tmp_path / "cut.mcap", tmp_path / "whole.mcap"
    cut.write_bytes(path.read_bytes()[: ends[4] + 10])
    subprocess.run([command, "recover", cut, "-o", whole], check=True, capture_output=True)
    with McapReader(whole) as reader:
        assert reader.message_count == 5 * EACH


@search(300)
@given(data=st.data())
def test_a_damaged_byte_costs_one_chunk_and_is_told(written, tmp_path_factory, data):
    path, messages, _ = written
    content = bytearray(path.read_bytes())
    at = data.draw(st.integers(0, len(content) - 1))
    content[at] ^= 1 << data.draw(st.integers(0, 7))
    broken = tmp_path_factory.mktemp("spool") / "000001.mcap"
    broken.write_bytes(content)
    found, parts = read(broken)
    missing = sum(each.messages for part in parts for each in part.missing)
    assert all(message in messages for message in found)
    assert len(found) in (len(messages), len(messages) - EACH)
    if len(found) < len(messages):
        assert missing == EACH
        assert any("is damaged from byte" in part.damage for part in parts)
        assert {each.topic for part in parts for each in part.missing} == {"/t0", "/t1", "/t2"}


def test_damage_before_the_first_chunk_costs_no_message(written, tmp_path):
    """A length that a damaged byte makes larger does not take the records after it along."""
    path, messages, _ = written
    content, broken = path.read_bytes(), tmp_path / "000001.mcap"
    first_chunk = content.index(b"\x06", content.index(b"cassandra_ros."))
    for at in range(len(MAGIC), first_chunk):
        damaged = bytearray(content)
        damaged[at] ^= 1 << 4
        broken.write_bytes(damaged)
        found, _ = read(broken)
        assert found == messages, f"byte {at}"


@search(100)
@given(data=st.data())
def test_a_file_that_ends_anywhere_is_read_up_to_there(written, tmp_path_factory, data):
    path, messages, ends = written
    stop = data.draw(st.integers(0, path.stat().st_size))
    cut = tmp_path_factory.mktemp("spool") / "000001.mcap"
    cut.write_bytes(path.read_bytes()[:stop])
    found, parts = read(cut)
    whole = sum(end <= stop for end in ends)
    assert len(found) - whole * EACH in (0, EACH)  # the indexes of the last chunk may be cut
    assert found == messages[: len(found)]


@pytest.mark.parametrize("version", [VERSION - 1, VERSION + 1, None])
def test_a_label_of_another_version_is_refused(version):
    values = {**as_metadata(LABELLED)}
    text = json.dumps({**json.loads(values["text"]), "version": version})
    other = {"text": text, "crc": f"{zlib.crc32(text.encode()):08x}"}
    words = f"a.mcap has version {version}, .* only version {VERSION}: .* the release that wrote it"
    with pytest.raises(SpoolError, match=words):
        from_metadata(SpoolLabel, other, "a.mcap")
    assert is_whole(other)
    assert not is_whole({**values, "crc": "0"})


def test_a_full_disk_leaves_the_file_as_it_was(tmp_path):
    """/dev/full refuses to write; a file that refused once goes on where it was."""
    writer = SegmentWriter(tmp_path / "000001.mcap", LABELLED)
    one = connection(0)
    writer.append([(one, 1, 0, b"a")])
    good, writer._file = writer._file, open("/dev/full", "wb", buffering=0)  # noqa: SIM115
    with pytest.raises(OSError):
        writer.append([(connection(1), 2, 1, b"b")])
    writer._file.close()
    writer._file = good
    writer.append([(one, 3, 2, b"c")])
    writer.close()
    assert [wire for *_, wire in read(tmp_path / "000001.mcap")[0]] == [b"a", b"c"]


@contextmanager
def room_for(nbytes):
    """No file of this process may become larger meanwhile."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (nbytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("wire_bytes", [5, 3 * UNCOPIED_PART_BYTES], ids=["small", "large"])
def test_a_disk_that_fills_within_a_chunk_leaves_the_file_as_it_was(tmp_path, wire_bytes):
    """What was written of the chunk is taken back, and the next chunk stands in its place."""
    path = tmp_path / "000001.mcap"
    writer = SegmentWriter(path, LABELLED)
    connections, expected = [], []

    def append():
        # Each chunk begins a connection: if it is refused, a later chunk has its definition.
        number = len(connections)
        connections.append(connection(number))
        wire = bytes([number]) * wire_bytes
        messages = [(each, 10**18 + number, number, wire) for each in connections]
        writer.append(messages)
        expected.extend(messages)

    append()
    for room in (0, 1, 9, 60, 150, wire_bytes, 2 * wire_bytes):
        with room_for(writer.size + room), pytest.raises(OSError) as caught:
            append()
        assert caught.value.errno == errno.EFBIG
        assert path.stat().st_size == writer.size
        append()
    with room_for(writer.size + 40), pytest.raises(OSError):
        writer.finish(ENDED)
    writer.finish(ENDED)
    with room_for(writer.size + 10):
        writer.close()
    found, parts = read(path)
    assert found == expected
    assert not any(part.damage or part.missing for part in parts)
    assert SegmentReader(path).end().stored == ENDED.stored
    with McapReader(path, salvage=True) as reader:
        assert [message.data for message in reader.messages()] == [wire for *_, wire in expected]
    *_, totals = [part.totals for part in parts if part.totals is not None]
    counts = Counter(each.topic for each, *_ in expected)
    assert {topic: total.count for topic, total in totals.items()} == counts


def test_two_processes_do_not_touch_each_others_files(tmp_path):
    folder, other = SpoolFolder(tmp_path / "spool"), SpoolFolder(tmp_path / "spool")
    mine = folder.begin(7)
    assert (tmp_path / "spool").stat().st_mode & 0o777 == 0o700
    assert list(other.left()) == []
    theirs = other.begin(8)
    mine.release()
    (left,) = other.left()
    assert left.path.name == "7"
    assert list(folder.left()) == []  # it is locked again
    left.remove()
    theirs.remove()
    assert folder.runs() == []


def test_a_folder_that_cannot_be_made_is_an_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(SpoolError, match="cannot be used"):
        SpoolFolder(tmp_path / "file").begin(1)
