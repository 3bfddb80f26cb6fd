# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Real bags and MCAP files with changed bytes and cut ends: read, salvaged, and sampled."""

from __future__ import annotations

import os
import re
import struct
from pathlib import Path

import pytest
from hostile.mutate import changed_bytes

from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.bag.file_formats import open_file
from cassandra_ros.files.bag.identity import read_content
from cassandra_ros.files.bag.mcap_format import MAGIC
from cassandra_ros.files.bag.mcap_writer import McapWriter
from cassandra_ros.files.bag.message_file import read_in_order

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = ROOT / "examples/data"
LARGEST = 400_000
"""Size of the largest bag that is taken whole, bytes; larger ones are shortened."""
SHORT = 60
"""Number of messages that are taken of a larger bag."""
_FIELD = re.compile(
    rb"(?:op|conn|time|size|ver|count|index_pos|chunk_pos|start_time|end_time|chunk_count|"
    rb"conn_count|compression|topic|type|md5sum|message_definition)="
)
_CHUNK, _FOOTER, _DATA_END = 0x06, 0x02, 0x0F
_CHUNK_CRC = 24
"""Offset of the checksum in the body of a chunk of an MCAP."""


def messages_of(path):
    """The connections and the first messages of a bag."""
    with open_file(str(path)) as reader:
        found = []
        for message in reader.messages():
            found.append(message)
            if len(found) == SHORT and path.stat().st_size > LARGEST:
                break
        return dict(reader.connections), found


def bags():
    """Real bags, those that are shipped with us and those of the folder of test bags."""
    folders = [SHIPPED, Path(os.environ.get("CASSANDRA_ROS_BAGS") or SHIPPED)]
    paths = {path.name: path for folder in folders for path in sorted(folder.glob("*.bag"))}
    return list(paths.values())


def written(writer, connections, messages):
    with writer:
        numbers = {}
        for message in messages:
            if message.number not in numbers:
                numbers[message.number] = writer.connection(connections[message.number])
            writer.write(numbers[message.number], message.t_ns, message.data)


def real_bags(folder):
    """The bytes of bags, each with the places where its structure is."""
    found = [path.read_bytes() for path in bags() if path.stat().st_size <= LARGEST]
    for path in bags():
        try:
            connections, messages = messages_of(path)
        except Exception:  # noqa: S112, BLE001 - damaged ones are taken as they are
            continue
        for compression in ("none", "bz2", "lz4"):
            other = folder / "real.bag"
            written(BagWriter(other, compression, chunk_bytes=5000), connections, messages)
            found.append(other.read_bytes())
            other.unlink()
    return [(data, [match.end() for match in _FIELD.finditer(data)]) for data in found]


def real_mcaps(folder):
    """The bytes of MCAP files; those without compression have no checksums, so changes go deep."""
    found = []
    for path in bags():
        try:
            connections, messages = messages_of(path)
        except Exception:  # noqa: S112, BLE001 - damaged ones are no source
            continue
        for compression in ("none", "zstd", "lz4"):
            other = folder / "real.mcap"
            written(McapWriter(other, compression, chunk_bytes=5000), connections, messages)
            data = bytearray(other.read_bytes())
            other.unlink()
            places = places_of(data, compression == "none")
            found.append((bytes(data), places))
    return found


def places_of(data, plain, begin=8, end=None):
    """Return the places of an MCAP's records; without compression unset their checksums."""
    at, places = begin, []
    end = len(data) - len(MAGIC) if end is None else end
    while at + 9 <= end:
        (size,) = struct.unpack_from("<Q", data, at + 1)
        body = at + 9
        places += [at, at + 1, body, body + min(8, size), body + size // 2]
        if plain and data[at] == _CHUNK:
            data[body + _CHUNK_CRC : body + _CHUNK_CRC + 4] = bytes(4)
            (name,) = struct.unpack_from("<I", data, body + 28)
            inside = body + 28 + 4 + name + 8
            places += places_of(data, False, inside, body + size)
        elif plain and data[at] == _DATA_END:
            data[body : body + 4] = bytes(4)
        elif plain and data[at] == _FOOTER:
            data[body + 16 : body + 20] = bytes(4)
        at = body + size
    return places


def read_all(path, chance):
    """Read a file as an import and as a comparison do, perhaps as a damaged one."""
    with open_file(str(path), salvage=chance.random() < 0.4) as reader:
        content = read_content(reader)
        count = sum(1 for _ in reader.messages())
        assert count == reader.message_count
        content.writer_id("robot")
        for connection in reader.connections.values():
            assert isinstance(connection.header, bytes)
        assert sum(1 for _ in read_in_order(reader, lambda message: message.data)) == count
        for chunk in range(min(3, reader.chunk_count)):
            list(reader.batches(chunk, set(reader.connections)))


def changed_file(chance, real, path):
    data, places = chance.choice(real)
    changed = changed_bytes(chance, data, places, [other for other, _ in real[:5]])
    if chance.random() < 0.2:
        changed = changed[: chance.randrange(len(changed) + 1)]
    path.write_bytes(changed)


@pytest.mark.suite("all", "a search over changed inputs")
def test_bags(give, tmp_path):
    real = real_bags(tmp_path)

    def attempt(chance):
        path = tmp_path / "changed.bag"
        changed_file(chance, real, path)
        read_all(path, chance)

    give("bags", 250, attempt)


@pytest.mark.suite("all", "a search over changed inputs")
def test_mcaps(give, tmp_path):
    real = real_mcaps(tmp_path)

    def attempt(chance):
        path = tmp_path / "changed.mcap"
        changed_file(chance, real, path)
        read_all(path, chance)

    give("MCAP files", 250, attempt)
