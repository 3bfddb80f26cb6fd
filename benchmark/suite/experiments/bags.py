# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Import real bags: time, and bytes on disk beside the bag itself, compressed and not.

Sizes are those of the bag as it is: where it is repeated, a block of a slow topic, and Cassandra's
compression of blocks that are the same, find in one repeat what stood in the one before, and a
longer recording seems to compress better than it would. For the times a small bag is repeated, at
later and later times.
"""

from __future__ import annotations

import functools
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Callable, Dict, Tuple

import rosbag
from genpy import Time
from mcap.writer import Writer

from cassandra_ros import RosCassandra
from cassandra_ros.files.bag.bag_reader import BagReader
from cassandra_ros.files.bag.importer import import_bag
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


Stored = Dict[Tuple[str, str], Tuple[str, int]]
"""By bag and format the keyspace that has it, and its wire bytes."""


def run(context: Context) -> None:
    """Measure each bag that is there."""
    stored: Stored = {}
    names = BAGS if context.size.bag_messages is None else BAGS[:1]
    for name in names:
        path = find_bag(name)
        if path is None:
            context.say(f"  without {name}: it lies in none of {', '.join(map(str, FOLDERS))}")
            continue
        with context.part(name), context.new_folder(Path(name).stem) as folder:
            _one(context, path, folder, stored)
    if context.server.ours:
        context.server.stop()
        for (name, format), (keyspace, wire_bytes) in stored.items():
            with context.part(f"size of {name}, {format}"):
                for what, pattern in (("size", "*"), ("size of data alone", "*-Data.db")):
                    size = context.server.keyspace_bytes(keyspace, pattern)
                    context.add(what, format, size / wire_bytes, "of wire bytes", kind=name)
        context.server.start()


def find_bag(name: str) -> Path | None:
    """Return the path of a real bag; None if it is not on this machine."""
    paths = (folder / name for folder in FOLDERS)
    return next((path for path in paths if path.is_file()), None)


def messages_of(path: Path) -> list[Message]:
    """Return the messages of a bag in the order of their times."""
    with BagReader(path) as reader:
        of = reader.connections
        found = [(m.t_ns, of[m.number], bytes(m.data)) for m in reader.messages()]
    return sorted(found, key=lambda message: message[0])


def bytes_of(messages: list[Message]) -> int:
    """Return their serialised bytes together."""
    return sum(len(wire) for _, _, wire in messages)


def repeated(once: list[Message], least: int) -> list[Message]:
    """Return messages, repeated until they have so many bytes."""
    size = bytes_of(once)
    period = once[-1][0] - once[0][0] + GAP_NS
    return [
        (t_ns + number * period, connection, wire)
        for number in range(max(1, -(-least // size)))
        for t_ns, connection, wire in once
    ]


def write_bag(messages: list[Message], path: Path, compression: str) -> None:
    """Write them with rosbag."""
    headers: dict[Any, dict[str, str]] = {}
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


def write_mcap(messages: list[Message], path: Path) -> None:
    """Write them as MCAP, compressed as it does by default."""
    channels: dict[Any, int] = {}
    writer = Writer(str(path))
    writer.start(profile="ros1")
    for t_ns, connection, wire in messages:
        if connection not in channels:
            definition = connection.definition_text.encode()
            schema = writer.register_schema(connection.type, "ros1msg", definition)
            channels[connection] = writer.register_channel(connection.topic, "ros1", schema)
        writer.add_message(channels[connection], t_ns, wire, t_ns)
    writer.finish()


def _one(context: Context, path: Path, folder: Path, stored: Stored) -> None:
    name, once = path.name, messages_of(path)[: context.size.bag_messages]
    messages = repeated(once, context.size.bag_bytes)
    context.say(f" {name}: {len(messages):,} messages, {bytes_of(messages) / 1e6:.1f} MB")
    files: dict[str, Callable[[list[Message], Path], None]] = {
        "rosbag": functools.partial(write_bag, compression="none"),
        "rosbag bz2": functools.partial(write_bag, compression="bz2"),
        "rosbag lz4": functools.partial(write_bag, compression="lz4"),
        "mcap": write_mcap,
    }
    for what, write in files.items():
        with context.part(f"{name}, {what}"):
            copy = folder / what.replace(" ", "_")
            seconds = timed(lambda write=write, copy=copy: write(messages, copy))
            context.add("write", what, len(messages) / seconds, "msg/s", kind=name)
            write(once, copy.with_suffix(".once"))
            size = copy.with_suffix(".once").stat().st_size / bytes_of(once)
            context.add("size", what, size, "of wire bytes", kind=name)
    for format in FORMAT_NAMES:
        keyspace = f"{context.server.keyspace}_{BAGS.index(name)}_{format}"
        with context.part(f"{name}, {format}"):
            seconds = _import(context, keyspace, folder / "rosbag", format, len(messages))
            context.add("write", format, len(messages) / seconds, "msg/s", kind=name)
            context.server.drop(keyspace)
            if context.server.ours:
                keyspace += "_once"
                _import(context, keyspace, folder / "rosbag.once", format, len(once))
                stored[name, format] = keyspace, bytes_of(once)


def _import(context: Context, keyspace: str, bag: Path, format: str, count: int) -> float:
    """Import a bag of so many messages into a keyspace of its own; return the seconds."""
    server = context.server
    with RosCassandra(server.host, server.port, keyspace=keyspace) as store:
        store.addTopic("/first", msg_type="std_msgs/String")
        store.removeTopic("/first")
        seconds = timed(lambda: import_bag(store, bag, format=format))
        found = sum(info.count for info in store.info())
        assert found == count, f"{found:,} of {count:,} stored"
    return seconds
