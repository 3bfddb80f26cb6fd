# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Import real bags: time, and bytes on disk beside the bag itself, compressed and not.

A small bag is repeated at later and later times until it has so many wire bytes that a table's own
files count little. What compresses does so in blocks, chunks and pages that are shorter than the
bag, so that repeats cost as much as new messages.
"""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Dict, List, Tuple

import rosbag
from genpy import Time
from mcap.writer import Writer

from cassandra_ros import RosCassandra
from cassandra_ros.bag.importer import import_bag
from cassandra_ros.bag.reader import BagReader
from suite.contenders import FORMAT_NAMES
from suite.context import Context, timed

ROOT = Path(__file__).resolve().parents[3]
FOLDERS = (
    ROOT / "examples/data",
    Path(os.environ.get("CASSANDRA_ROS_BAGS") or ROOT.parent / "shared/data/bags"),
)
BAGS = ("turtlesim_tf.bag", "husky_gps_data.bag", "backpack_multiecho_bz2.bag")
GAP_NS = 10**9
"""Between the repeats."""

Message = Tuple[int, Any, bytes]
"""Receive time in ns, connection, wire bytes."""


def run(context: Context) -> None:
    """Measure each bag that is there."""
    stored: Dict[Tuple[str, str], Tuple[str, int]] = {}
    names = BAGS if context.size.bag_bytes > 1 else BAGS[:1]
    for name in names:
        paths = [folder / name for folder in FOLDERS if (folder / name).is_file()]
        if not paths:
            context.say(f"  without {name}: it lies in none of {', '.join(map(str, FOLDERS))}")
            continue
        with context.part(name), context.new_folder(Path(name).stem) as folder:
            _one(context, paths[0], folder, stored)
    if context.server.ours:
        context.server.stop()
        for (name, format), (keyspace, wire_bytes) in stored.items():
            with context.part(f"size of {name}, {format}"):
                size = context.server.keyspace_bytes(keyspace)
                context.add("size", format, size / wire_bytes, "of wire bytes", kind=name)
        context.server.start()


def repeated(path: Path, least: int) -> List[Message]:
    """Return the messages of a bag, repeated until they have so many bytes."""
    with BagReader(path) as reader:
        of = reader.connections
        once = [(m.t_ns, of[m.number], bytes(m.data)) for m in reader.messages()]
    once.sort(key=lambda message: message[0])
    size = sum(len(wire) for _, _, wire in once)
    period = once[-1][0] - once[0][0] + GAP_NS
    return [
        (t_ns + number * period, connection, wire)
        for number in range(max(1, -(-least // size)))
        for t_ns, connection, wire in once
    ]


def write_bag(messages: List[Message], path: Path, compression: str) -> None:
    """Write them with rosbag."""
    headers: Dict[Any, Dict[str, str]] = {}
    with rosbag.Bag(str(path), "w", compression=compression) as bag:
        for t_ns, connection, wire in messages:
            if connection not in headers:
                headers[connection] = {n: v.decode() for n, v in connection.fields.items()}
            # The class need not be installed: what is written of it stands in the header.
            kind = SimpleNamespace(_type=connection.type, _md5sum=connection.md5sum)
            raw = (connection.type, wire, connection.md5sum, 0, kind)
            t = Time(*divmod(t_ns, 10**9))
            header = headers[connection]
            bag.write(connection.topic, raw, t, raw=True, connection_header=header)


def write_mcap(messages: List[Message], path: Path) -> None:
    """Write them as MCAP, compressed as it does by default."""
    channels: Dict[Any, int] = {}
    writer = Writer(str(path))
    writer.start(profile="ros1")
    for t_ns, connection, wire in messages:
        if connection not in channels:
            definition = connection.definition_text.encode()
            schema = writer.register_schema(connection.type, "ros1msg", definition)
            channels[connection] = writer.register_channel(connection.topic, "ros1", schema)
        writer.add_message(channels[connection], t_ns, wire, t_ns)
    writer.finish()


def _one(
    context: Context, path: Path, folder: Path, stored: Dict[Tuple[str, str], Tuple[str, int]]
) -> None:
    name, messages = path.name, repeated(path, context.size.bag_bytes)
    wire_bytes, count = sum(len(wire) for _, _, wire in messages), len(messages)
    context.say(f" {name}: {count:,} messages, {wire_bytes / 1e6:.1f} MB")
    for what, compression in (("rosbag", "none"), ("rosbag bz2", "bz2"), ("rosbag lz4", "lz4")):
        with context.part(f"{name}, {what}"):
            copy = folder / f"{compression}.bag"
            seconds = timed(lambda copy=copy, by=compression: write_bag(messages, copy, by))
            context.add("write", what, count / seconds, "msg/s", kind=name)
            context.add("size", what, copy.stat().st_size / wire_bytes, "of wire bytes", kind=name)
    with context.part(f"{name}, mcap"):
        copy = folder / "zstd.mcap"
        seconds = timed(lambda: write_mcap(messages, copy))
        context.add("write", "mcap", count / seconds, "msg/s", kind=name)
        context.add("size", "mcap", copy.stat().st_size / wire_bytes, "of wire bytes", kind=name)
    for format in FORMAT_NAMES:
        keyspace = f"{context.server.keyspace}_{BAGS.index(name)}_{format}"
        with context.part(f"{name}, {format}"):
            with RosCassandra(context.server.host, context.server.port, keyspace=keyspace) as store:
                store.addTopic("/first", msg_type="std_msgs/String")
                store.removeTopic("/first")
                work = _importing(store, folder / "none.bag", format)
                context.add("write", format, count / timed(work), "msg/s", kind=name)
                found = sum(info.count for info in store.info())
                assert found == count, f"{found:,} of {count:,} stored"
                if context.server.ours:
                    stored[name, format] = keyspace, wire_bytes
                else:
                    context.server.drop(keyspace)


def _importing(store: RosCassandra, path: Path, format: str) -> Any:
    return lambda: import_bag(store, path, format=format)
