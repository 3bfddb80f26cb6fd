# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Small files that unpack to very much, and records of absurd lengths: refused in little memory."""

from __future__ import annotations

import bz2
import os
import subprocess
import sys
from functools import lru_cache
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from bag.truth import string_connection, string_wire
from hostile.inputs import INPUT_SEC
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, Footer, Header, Schema
from suites import sparing

from cassandra_ros.errors import BagError, BagTooLarge
from cassandra_ros.files.bag import format as bagformat
from cassandra_ros.files.bag import message_file
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.bag.file_formats import open_file
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.files.bag.mcap_format import MAGIC, MESSAGE, RECORD
from cassandra_ros.files.bag.message_file import MAX_BATCH

ROOT = Path(__file__).resolve().parents[2]
MIB = 1 << 20
READ = """
import re, sys, time
from cassandra_ros.files.bag.identity import read_content
from cassandra_ros.files.bag.file_formats import open_file
from cassandra_ros.errors import BagError
count = nbytes = 0
error = ""
try:
    with open_file(sys.argv[1], *map(bool, map(int, sys.argv[2:]))) as reader:
        read_content(reader)
        for message in reader.messages():
            count += 1
            nbytes += len(message.data)
except BagError as exc:
    error = f"{type(exc).__name__}: {exc}"
peak = re.search(r"VmHWM:\\s+(\\d+) kB", open("/proc/self/status").read())[1]
print(count, nbytes, int(peak) // 1024, time.process_time(), error)
"""


def read_in_process(path, salvage=False, large=False, soon=False):
    """Read a file twice, as an import does; return messages, bytes, memory in MiB, the error.

    Args:
        soon: It may take the processor time that SECURITY.md names.
    """
    done = subprocess.run(
        [sys.executable, "-c", READ, str(path), str(int(salvage)), str(int(large))],
        env={**os.environ, "PYTHONPATH": str(ROOT / "src")},
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
    )
    count, nbytes, peak, seconds, error = done.stdout.rstrip("\n").split(" ", 4)
    assert not soon or float(seconds) < INPUT_SEC
    return int(count), int(nbytes), int(peak), error


PACK = {
    "none": lambda data: data,
    "bz2": bz2.compress,
    "lz4": lambda data: bagformat.compress_chunk("lz4", data),
    "zstd": zstandard.compress,
    "lz4 frame": lz4.frame.compress,
}


@lru_cache(maxsize=None)
def packed(compression, size, messages=1, mcap=False):
    """Return a packed chunk whose messages, together of some bytes, are all zeros."""
    if mcap:
        body = size // messages - 31
        head = RECORD.pack(Opcode.MESSAGE, body + 22) + (1).to_bytes(2, "little") + bytes(20)
    else:
        body = size // messages - len(bagformat.message_head(0, 10, 0))
        head = bagformat.message_head(0, 10, body)
    return PACK[compression]((head + bytes(body)) * messages)


def make_bag(path, chunks):
    """Write a bag with a connection, and chunks: of each compression, stated size, bytes and
    number of messages."""
    header = string_connection().header
    parts = [bagformat.MAGIC, b""]
    connection = bagformat.pack_record([(b"op", 7), (b"conn", 0), (b"topic", b"/chatter")], header)
    position, infos = len(bagformat.MAGIC) + bagformat.FILE_HEADER_BYTES, []
    for compression, size, data, messages in chunks:
        fields = [(b"op", 5), (b"compression", compression.encode()), (b"size", size)]
        parts.append(bagformat.pack_record(fields, data))
        time = bagformat.pack_time(10)
        infos.append(
            bagformat.pack_record(
                [
                    (b"op", 6),
                    (b"ver", 1),
                    (b"chunk_pos", position),
                    (b"start_time", time),
                    (b"end_time", time),
                    (b"count", 1),
                ],
                bagformat.COUNT.pack(0, messages),
            )
        )
        position += len(parts[-1])
    fields = [(b"op", 3), (b"index_pos", position), (b"conn_count", 1)]
    head = bagformat.pack_fields([*fields, (b"chunk_count", len(chunks))])
    padding = bagformat.FILE_HEADER_BYTES - len(head) - 8
    parts[1] = b"".join(
        (
            bagformat.U32.pack(len(head)),
            head,
            bagformat.U32.pack(padding),
            b" " * padding,
        )
    )
    path.write_bytes(b"".join([*parts, connection, *infos]))
    return path


def make_mcap(path, chunks):
    """Write an MCAP with a channel, and chunks: of each compression, stated size and bytes."""
    out = RecordBuilder()
    out.write(MAGIC)
    Header("ros1", "").write(out)
    Schema(1, b"string data\n", "ros1msg", "std_msgs/String").write(out)
    Channel(1, "/chatter", "ros1", {}, 1).write(out)
    for compression, size, data in chunks:
        Chunk(compression, data, 10, 0, 0, size).write(out)
    DataEnd(0).write(out)
    Footer(0, 0, 0).write(out)
    out.write(MAGIC)
    path.write_bytes(out.end())
    return path


SIZE = 320 * MIB
BOMBS = {
    # More than a chunk may have, stated honestly.
    "bag bz2": lambda path: make_bag(path, [("bz2", SIZE, packed("bz2", SIZE), 1)]),
    "mcap zstd": lambda path: make_mcap(path, [("zstd", SIZE, packed("zstd", SIZE, 1, True))]),
    "mcap lz4": lambda path: make_mcap(path, [("lz4", SIZE, packed("lz4 frame", SIZE, 1, True))]),
    # The same, and the size is a lie. test_damage.py has those of bags.
    "mcap zstd lie": lambda path: make_mcap(path, [("zstd", 1000, packed("zstd", SIZE, 1, True))]),
    "mcap lz4 lie": lambda path: make_mcap(
        path, [("lz4", 1000, packed("lz4 frame", SIZE, 1, True))]
    ),
    # Each chunk is small, all of them together are more than a file of this size has.
    "bag many": lambda path: make_bag(path, [("bz2", 64 * MIB, packed("bz2", 64 * MIB), 1)] * 5),
    "mcap many": lambda path: make_mcap(
        path, [("zstd", 64 * MIB, packed("zstd", 64 * MIB, 1, True))] * 5
    ),
}


FEW = ("bag bz2", "mcap zstd lie", "mcap many")
"""Those of make test."""


@pytest.mark.suite("test", "a process of its own, to see its memory")
@pytest.mark.parametrize("bomb", sparing(BOMBS, FEW))
def test_a_bomb_is_refused_in_little_memory(tmp_path, bomb):
    path = BOMBS[bomb](tmp_path / "a")
    limit = 2 * MIB if "lz4" in bomb else 100_000
    assert path.stat().st_size < limit
    count, _, peak, error = read_in_process(path)
    assert count == 0
    if "lie" in bomb:
        assert "BagError: " in error
        assert "is damaged" in error
    else:
        assert "BagTooLarge: " in error
        assert error.endswith("if you trust this one: --allow-large-chunks")
    assert peak < (500 if "many" in bomb else 250), "MiB"


def record_bytes(record):
    out = RecordBuilder()
    record.write(out)
    return out.end()


CONNECTION = bagformat.pack_record([(b"op", 7), (b"conn", 0)], b"")
TINY = {
    "mcap zeros": bytes(RECORD.size),
    "mcap unknown": RECORD.pack(200, 0),
    "mcap schema": record_bytes(Schema(2, b"", "", "")),
    "mcap channel": record_bytes(Channel(1, "/chatter", "ros1", {}, 1)),
    "mcap message": MESSAGE.pack(Opcode.MESSAGE, MESSAGE.size - RECORD.size, 1, 0, 10, 10),
    "bag connection": CONNECTION,
    "bag message": bagformat.message_head(0, 10, 0),
}
"""Records that take time and almost no bytes."""


def full_of(path, kind, count):
    """Write a file whose one chunk has so many records of a kind; the bag also has a message."""
    data = TINY[kind] * count
    if kind.startswith("mcap"):
        return make_mcap(path, [("zstd", len(data), zstandard.compress(data))])
    data += TINY["bag message"]
    messages = 1 + count * (kind == "bag message")
    return make_bag(path, [("lz4", len(data), PACK["lz4"](data), messages)])


@pytest.mark.parametrize("salvage", [False, True])
@pytest.mark.parametrize("kind", sparing(TINY, ["mcap zeros"]))
def test_millions_of_records_in_a_small_file_are_refused_soon(tmp_path, kind, salvage):
    """They took minutes of processor time."""
    path = full_of(tmp_path / "a", kind, 250 * MIB // len(TINY[kind]))
    assert path.stat().st_size < 1.1 * MIB
    count, _, _, error = read_in_process(path, salvage, soon=True)
    assert count == 0
    assert "records up to here" in error or "no message that can be salvaged" in error
    assert "--allow-large-chunks" in error or kind.startswith("bag")


@pytest.mark.suite("all", "make test asks others of its kind")
@pytest.mark.parametrize("kind", TINY)
def test_as_many_records_as_are_allowed_are_read_soon(tmp_path, kind):
    path = full_of(tmp_path / "a", kind, message_file.MAX_RECORDS - 2)
    assert path.stat().st_size < message_file.MAX_RECORDS
    for salvage in (False, True):
        count, _, _, error = read_in_process(path, salvage, soon=True)
        messages = message_file.MAX_RECORDS - 2 if kind.endswith("message") else 0
        assert (count, error) == (messages + kind.startswith("bag"), "")


def test_records_are_counted_in_all_chunks_once(tmp_path, monkeypatch):
    monkeypatch.setattr(message_file, "MAX_RECORDS", 20000)
    size = 5000 * len(TINY["mcap message"])
    data = zstandard.compress(TINY["mcap message"] * 5000)
    for chunks, large, expected in ((4, False, 20000), (5, True, 25000)):
        path = make_mcap(tmp_path / "a.mcap", [("zstd", size, data)] * chunks)
        assert path.stat().st_size < 20000
        with open_file(path, False, large) as reader:
            for _ in range(2):
                assert sum(1 for _ in reader.messages()) == expected
    with pytest.raises(BagTooLarge, match="over 20000 records up to here.* --allow-large-chunks"):
        open_file(path)
    size, data = 5000 * len(TINY["bag message"]), PACK["lz4"](TINY["bag message"] * 5000)
    with open_file(make_bag(tmp_path / "a.bag", [("lz4", size, data, 5000)] * 4)) as reader:
        for _ in range(2):
            assert sum(1 for _ in reader.messages()) == 20000
    with open_file(make_bag(tmp_path / "a.bag", [("lz4", size, data, 5000)] * 5)) as reader:
        for _ in range(2):
            with pytest.raises(BagTooLarge, match="over 20000 records up to here"):
                sum(1 for _ in reader.messages())


@pytest.mark.suite("all", "large messages, to see how much memory they take")
@pytest.mark.parametrize("bomb", sparing(["bag bz2", "mcap zstd", "bag many"], ["mcap zstd"]))
def test_a_file_that_the_user_trusts_is_read(tmp_path, bomb):
    count, nbytes, _, error = read_in_process(BOMBS[bomb](tmp_path / "a"), large=True)
    assert error == ""
    assert nbytes > SIZE - 100 * count > 0


@pytest.mark.parametrize("bomb", sparing(["bag bz2", "mcap zstd"], ["mcap zstd"]))
def test_salvage_ends_at_what_is_too_large(tmp_path, bomb):
    path = BOMBS[bomb](tmp_path / "a")
    count, _, peak, error = read_in_process(path, salvage=True)
    assert count == 0
    assert "--allow-large-chunks" in error or "no message that can be salvaged" in error
    assert peak < 450, "MiB"


@pytest.mark.suite("all", "make test asks others of its kind")
def test_millions_of_tiny_messages_take_little_more_than_their_bytes(tmp_path):
    """One of them takes some 300 bytes as Python objects, 46 in the chunk."""
    each, messages = len(bagformat.message_head(0, 10, 0)), 500_000
    data, size = packed("lz4", each * messages, messages), each * messages
    path = make_bag(tmp_path / "a", [("lz4", size, data, messages)])
    count, nbytes, peak, error = read_in_process(path)
    assert (count, nbytes, error) == (messages, 0, "")
    assert peak < 220, "MiB"


def test_millions_of_tiny_messages_come_in_parts(tmp_path):
    """What stores them makes some hundred bytes of each that it is given at once."""
    messages = 2 * MAX_BATCH + 5
    size = messages * len(bagformat.message_head(0, 10, 0))
    path = make_bag(tmp_path / "a", [("lz4", size, packed("lz4", size, messages), messages)])
    with open_file(path) as reader:
        batches = list(reader.batches(0, {0}))
        assert list(reader.batches(0, {1})) == []
    assert [len(batch.wires) for batch in batches] == [MAX_BATCH, MAX_BATCH, 5]
    positions = [position for batch in batches for position in batch.positions.tolist()]
    assert positions == list(range(messages))
    assert all(len(batch.times) == len(batch.wires) for batch in batches)


@pytest.mark.suite("all", "large messages, to see how much memory they take")
@pytest.mark.parametrize("compression", sparing(["none", "bz2", "lz4"], ["lz4"]))
def test_a_large_message_is_no_bomb(tmp_path, compression):
    """rosbag closes a chunk after the message that fills it: a cloud of 200 MB makes one chunk."""
    size = 200 * 10**6
    path, wire = tmp_path / "a.bag", string_wire(bytes(size))
    with BagWriter(path, compression) as writer:
        writer.write(writer.connection(string_connection()), 10, wire)
    count, nbytes, peak, error = read_in_process(path)
    assert (count, nbytes, error) == (1, len(wire), "")
    assert peak < 1000, "MiB"


def test_a_plain_chunk_may_be_as_large_as_before(tmp_path):
    """rosbag record --chunksize makes them: the file is as large as its content."""
    most = message_file.Allowance(10**9)
    most.count_chunk("none", 10**9, 10**9, "")
    with pytest.raises(BagTooLarge, match="chunks of over 268435456 bytes are not read"):
        most.count_chunk("bz2", 2**28 + 1, 100, "")
    with pytest.raises(BagTooLarge, match="chunks of over 268435456 bytes are not read"):
        most.count_chunk("lz4", 100, 2**28 + 1, "")  # what is packed takes memory, too


def test_the_ratio_counts_all_chunks_once(tmp_path, monkeypatch):
    most = message_file.Allowance(400_000)
    for _ in range(4):
        most.count_chunk("bz2", 10**8, 50, "")
    with pytest.raises(BagTooLarge, match=r"x.bag: chunk 5 makes 400000001 bytes .* 1000 times"):
        most.count_chunk("bz2", 1, 50, "x.bag: chunk 5")
    monkeypatch.setattr(message_file, "MAX_CHUNK_BYTES", 4 * MIB)
    monkeypatch.setattr(message_file, "MAX_RATIO", 1)
    path = make_bag(tmp_path / "a", [("bz2", MIB, packed("bz2", MIB), 1)] * 4)
    with open_file(path) as reader:
        for _ in range(2):
            assert sum(1 for _ in reader.messages()) == 4


@pytest.mark.suite("all", "make test asks others of its kind")
def test_nothing_of_a_bomb_is_stored(rosCas, tmp_path):
    with pytest.raises(BagTooLarge, match="--allow-large-chunks"):
        import_bag(rosCas, BOMBS["bag many"](tmp_path / "a.bag"))
    assert rosCas.getAllTopics() == []
    assert list(rosCas.catalog.keyspace.registry.runs()) == []


def changed(path, begin, found, new):
    """Replace four bytes of a file, after the first occurrence of a marker, by a number."""
    whole = bytearray(path.read_bytes())
    at = whole.index(found, begin) + len(found)
    whole[at : at + 4] = new.to_bytes(4, "little")
    path.write_bytes(whole)


def extended(path, size):
    """Make a file large without writing all of it."""
    with open(path, "r+b") as file:
        file.truncate(size)


def test_records_of_absurd_lengths_are_refused_in_little_memory(tmp_path):
    path = make_bag(tmp_path / "a.bag", [("none", 1000, packed("none", 1000), 1)])
    whole = path.read_bytes()
    index = int.from_bytes(whole[whole.index(b"index_pos=") + 10 :][:8], "little")
    changed(path, index, b"topic=/chatter", 2**31)  # of the connection
    extended(path, 2**32)
    _, _, peak, error = read_in_process(path)
    assert "a connection in the index is damaged: it has 2147483648 bytes" in error
    assert peak < 200, "MiB"
    path.write_bytes(whole)
    info = whole.index(b"chunk_pos=", index)
    end = whole.index(bagformat.COUNT.pack(0, 1), info)
    path.write_bytes(whole[: end - 4] + (2**31).to_bytes(4, "little") + whole[end:])
    extended(path, 2**32)
    _, _, peak, error = read_in_process(path)
    assert "a chunk info in the index is damaged: it has 2147483648 bytes" in error
    assert peak < 200, "MiB"


KINDS = [Opcode.SCHEMA, Opcode.CHANNEL, Opcode.HEADER, Opcode.STATISTICS, Opcode.MESSAGE]


@pytest.mark.parametrize("kind", sparing(KINDS, [Opcode.MESSAGE]))
def test_records_of_an_mcap_of_absurd_lengths_are_refused_in_little_memory(tmp_path, kind):
    path = tmp_path / "a.mcap"
    path.write_bytes(MAGIC + RECORD.pack(kind, 2**31))
    size = len(MAGIC) + RECORD.size + 2**31
    extended(path, size)
    out = RecordBuilder()
    Footer(0, 0, 0).write(out)
    with open(path, "ab") as file:
        file.write(out.end() + MAGIC)
    _, _, peak, error = read_in_process(path)
    assert "2147483" in error
    assert peak < 200, "MiB"


def test_the_option_reaches_the_reader(rosCas, tmp_path, monkeypatch):
    """The option of import and verify in Python; test/cli tests that of the commands."""
    path = make_bag(tmp_path / "a.bag", [("bz2", MIB, packed("bz2", MIB), 1)])
    monkeypatch.setattr(message_file, "MAX_CHUNK_BYTES", MIB - 1)
    with pytest.raises(BagTooLarge):
        import_bag(rosCas, path)
    assert import_bag(rosCas, path, large_chunks=True).messages == 1


def test_the_error_is_one_of_bags():
    assert issubclass(BagTooLarge, BagError)
