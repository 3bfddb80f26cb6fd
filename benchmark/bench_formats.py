# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Compare the formats on messages of real bags: bytes on disk, time to encode and decode.

The messages of a topic are repeated at later times until there are enough that a table's own
files count little. Cassandra compresses 16 KiB at a time, and repeats lie further apart, so they
cost as much as new messages. Bytes on disk are all files of the topic's tables after Cassandra was
stopped, which writes everything to them; commit log and directory are not in them.

Times are of one thread's processor, so other work on the machine hardly counts; from the wire bytes
to the values of the columns and back, without message objects and without the server.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import tempfile
import time
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import Any, Callable, Iterator

import rosbag
from genpy import Time
from sensor_msgs.msg import LaserScan, MultiEchoLaserScan

from cassandra_ros import RosCassandra
from cassandra_ros.errors import CassandraRosError
from cassandra_ros.files.bag.bag_reader import BagReader
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.local_server import LocalCluster, free_port
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.messages.formats.cassandra_topic_ import CassandraTopic_
from cassandra_ros.messages.formats.table import format_class
from cassandra_ros.metadata import FORMAT_NAMES
from cassandra_ros.store.blocks.codec import pack_block, unpack_block

ROOT = Path(__file__).resolve().parent.parent
SHIPPED = ROOT / "examples/data"
BAGS = os.environ.get("CASSANDRA_ROS_BAGS") or str(ROOT.parent / "shared/data/bags")

TOPIC_BYTES = 16 * 1024 * 1024
SAMPLE_BYTES = 400_000
STEP_NS = 100_000_000
"""Between the repeats of a single message."""

ASKED = {
    "binary": "`KEY` and `NODE` on the server, fields on the client",
    "string": "the same; text in `cqlsh`",
    "yaml": "the same; text in `cqlsh`",
    "json": "the same; text in `cqlsh`",
    "ros": "the same; every field in `cqlsh`: arrays as blobs, arrays of messages as lists",
}

ROWS = tuple(name for name in FORMAT_NAMES if not format_class(name).PACKED)
"""Formats whose bytes on disk are measured. The messages are repeated, and a block of packed would
find in one repeat what stood in the one before: make bench measures it on whole bags."""


@dataclass(frozen=True)
class Kind:
    """What a column of the tables is about."""

    name: str
    bag: str
    topic: str
    first_echo: bool = False
    """Make a LaserScan of each MultiEchoLaserScan."""

    @property
    def stored(self) -> str:
        """Its topic in the store and in the bag beside it; the two scans are of one topic."""
        return f"/{self.name}"


KINDS = (
    Kind("Imu", "husky_gps_data.bag", "/imu/data"),
    Kind("tf", "husky_gps_data.bag", "/tf"),
    Kind("LaserScan", "backpack_multiecho_bz2.bag", "horizontal_laser_2d", first_echo=True),
    Kind("MultiEchoLaserScan", "backpack_multiecho_bz2.bag", "horizontal_laser_2d"),
    Kind("Image", "ros_numpy_types.bag", "/image"),
)


@dataclass
class Sample:
    """The messages of a kind as wire bytes, and what is measured of them."""

    kind: Kind
    msg_type: str
    md5sum: str
    definition: str
    messages: list[tuple[int, bytes]]
    """(time in ns, wire bytes), each once."""
    count: int
    """Number of messages that are stored."""
    bag_bytes: float = 0.0

    def repeated(self) -> Iterator[tuple[int, bytes]]:
        """Yield count messages: those of the bag again and again, at later and later times."""
        first, last = self.messages[0][0], self.messages[-1][0]
        period = last - first + max(STEP_NS, (last - first) // len(self.messages))
        for i in range(self.count):
            times, place = divmod(i, len(self.messages))
            t_ns, wire = self.messages[place]
            yield t_ns + times * period, wire

    @property
    def wireBytes(self) -> float:
        return sum(len(wire) for _, wire in self.repeated()) / self.count

    def format(self, name: str) -> CassandraTopic_:
        definition = parse_definition(self.msg_type, self.definition, self.md5sum)
        return format_class(name)(self.msg_type, self.md5sum, definition)


def readSamples(folder: Path, at_most: int) -> list[Sample]:
    """Read the messages of all kinds whose bag is there: shipped with us, or in the folder."""
    samples = []
    for kind in KINDS:
        paths = [path for path in (SHIPPED / kind.bag, folder / kind.bag) if path.is_file()]
        if paths:
            samples.append(readSample(kind, paths[0], at_most))
        else:
            say(f"formats: without {kind.name}, for there is no {kind.bag} in {folder}")
    return samples


def readSample(kind: Kind, path: Path, at_most: int) -> Sample:
    """Read the messages of a kind from its bag."""
    with BagReader(path) as reader:
        number, connection = next(
            (n, c) for n, c in reader.connections.items() if c.topic == kind.topic
        )
        messages = [(raw.t_ns, raw.data) for raw in reader.messages({number})]
    messages.sort(key=lambda message: message[0])
    what = (connection.type, connection.md5sum, connection.definition_text)
    if kind.first_echo:
        messages = [(t_ns, first_echoes(wire)) for t_ns, wire in messages]
        what = (LaserScan._type, LaserScan._md5sum, LaserScan._full_text)
    size = statistics.mean(len(wire) for _, wire in messages)
    return Sample(kind, *what, messages, max(1, min(at_most, int(TOPIC_BYTES / size))))


def first_echoes(wire: bytes) -> bytes:
    """Make the LaserScan that a driver publishes as the 'first' of a multi-echo laser."""
    multi, scan = MultiEchoLaserScan(), LaserScan()
    multi.deserialize(wire)
    for name in scan.__slots__:
        setattr(scan, name, getattr(multi, name))
    for name in ("ranges", "intensities"):
        setattr(scan, name, [echo.echoes[0] for echo in getattr(multi, name)])
    buffer = BytesIO()
    scan.serialize(buffer)
    return buffer.getvalue()


def writeBag(sample: Sample, path: Path) -> None:
    """Write the messages that are stored, uncompressed; note the bytes of one."""
    topic = sample.kind.stored
    header = {
        "topic": topic,
        "type": sample.msg_type,
        "md5sum": sample.md5sum,
        "message_definition": sample.definition,
    }
    with rosbag.Bag(str(path), "w") as bag:
        for t_ns, wire in sample.repeated():
            raw = (sample.msg_type, wire, sample.md5sum, 0, None)
            stamp = Time(*divmod(t_ns, 10**9))
            bag.write(topic, raw, stamp, raw=True, connection_header=header)
    sample.bag_bytes = path.stat().st_size / sample.count


def microseconds(work: Callable[[], object], messages: int) -> float:
    """Return the processor time of a message, µs."""
    start = time.thread_time()
    work()
    return (time.thread_time() - start) * 1e6 / messages


def coder(
    sample: Sample, name: str, wires: list[bytes]
) -> tuple[Callable[[], Any], Callable[[Any], list[bytes]]]:
    """Return what encodes the messages in a format, and what decodes the result."""
    if name == "packed":  # a block of them, as a row of its table
        count, size = len(wires), sum(map(len, wires))
        times = [sample.messages[0][0] + i * STEP_NS for i in range(count)]
        pack = partial(pack_block, times, list(range(count)), wires, None)
        return pack, lambda data: unpack_block(data, count, size).wires()
    codec = sample.format(name)
    return (
        lambda: [codec.encode_wire(wire) for wire in wires],
        lambda rows: [codec.decode_wire(row.columns, row.raw) for row in rows],
    )


def measureTimes(sample: Sample, rounds: int) -> dict[str, tuple[float, float]]:
    """Return (encode, decode) of each format in µs, medians of rounds in which they take turns."""
    size = max(1, min(200, int(SAMPLE_BYTES / sample.wireBytes)))
    wires = [wire for _, wire in islice(sample.messages, size)]
    codecs = {name: coder(sample, name, wires) for name in FORMAT_NAMES}
    for encode, decode in codecs.values():
        assert decode(encode()) == wires
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in FORMAT_NAMES}
    for _ in range(rounds):
        for name, (encode, decode) in codecs.items():
            encoded = encode()
            pair = (
                microseconds(encode, len(wires)),
                microseconds(lambda decode=decode, encoded=encoded: decode(encoded), len(wires)),
            )
            times[name].append(pair)
    return {
        name: (statistics.median(e for e, _ in pairs), statistics.median(d for _, d in pairs))
        for name, pairs in times.items()
    }


def measureDisk(samples: list[Sample], folder: Path) -> dict[str, list[float]]:
    """Store all samples in all formats; return bytes a message, by format, in samples' order."""
    for sample in samples:
        writeBag(sample, folder / f"{sample.kind.name}.bag")
    cluster = LocalCluster(folder / "server", port=free_port(), heap="1G")
    cluster.start(die_with_us=True)
    tables = {}
    try:
        with RosCassandra(cluster.settings.host, cluster.settings.port) as rosCas:
            for name in ROWS:
                rosCas.connectToKeyspace(name)
                tables[name] = [storeSample(rosCas, name, sample, folder) for sample in samples]
    finally:
        cluster.stop()
    data = cluster.nodes[0].directory / "data"
    return {
        name: [tableBytes(data / name, t) / s.count for t, s in zip(mine, samples)]
        for name, mine in tables.items()
    }


def storeSample(rosCas: RosCassandra, name: str, sample: Sample, folder: Path) -> str:
    """Import the bag of a sample in a format; return the table's name."""
    say(f"storing {sample.count} {sample.kind.name} as {name}")
    import_bag(rosCas, folder / f"{sample.kind.name}.bag", format=name)
    topic = rosCas.getTopic(sample.kind.stored)
    assert topic.countTopicData() == sample.count
    (table,) = topic.tables
    assert table.metadata.format == name
    return table.name


def tableBytes(keyspace: Path, table: str) -> int:
    """Sum the files of a table and of its chunks, in <table>-<id> and <table>_c-<id>."""
    folders = [*keyspace.glob(f"{table}-*"), *keyspace.glob(f"{table}_c-*")]
    files = [path for folder in folders for path in folder.rglob("*") if path.is_file()]
    assert any(path.name.endswith("-Data.db") for path in files), f"nothing of {table} on disk"
    return sum(path.stat().st_size for path in files)


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def printTables(
    samples: list[Sample],
    disk: dict[str, list[float]],
    times: list[dict[str, tuple[float, float]]],
    rounds: int,
) -> None:
    for s in samples:
        made = ", first echoes as LaserScan" if s.kind.first_echo else ""
        distinct = len({wire for _, wire in s.messages[: s.count]})
        print(
            f"{s.kind.name}: {s.kind.bag} {s.kind.topic}{made}: "
            f"{s.count:,} messages, {distinct:,} distinct"
        )
    names = [s.kind.name for s in samples]
    print("\nBytes a message\n")
    row("on disk", *names, "what can be asked")
    row("---", *["---:" for _ in names], "---")
    for name in ROWS:
        row(f"`{name}`", *[f"{b:,.0f}" for b in disk[name]], ASKED[name])
    row("uncompressed bag", *[f"{s.bag_bytes:,.0f}" for s in samples], "topic and time")
    row("the message alone", *[f"{s.wireBytes:,.0f}" for s in samples], "")
    print(f"\nProcessor time to encode / decode a message, µs, median of {rounds} rounds\n")
    row("", *names)
    row("---", *["---:" for _ in names])
    for name in FORMAT_NAMES:
        row(f"`{name}`", *["{:,.1f} / {:,.1f}".format(*t[name]) for t in times])


def row(*cells: str) -> None:
    print("|", " | ".join(cells), "|")


def main() -> int:
    """Parse the command line and run."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--bags", default=BAGS, help="folder of the test bags (%(default)s)")
    parser.add_argument("--messages", type=int, default=10_000, help="at most (%(default)s)")
    parser.add_argument("--rounds", type=int, default=5, help="of timing (%(default)s)")
    args = parser.parse_args()
    try:
        samples = readSamples(Path(args.bags), args.messages)
        times = []
        for sample in samples:
            say(f"timing {sample.kind.name}")
            times.append(measureTimes(sample, args.rounds))
        with tempfile.TemporaryDirectory(prefix="cassandra_ros_formats_") as folder:
            disk = measureDisk(samples, Path(folder))
    except CassandraRosError as exc:
        print(f"formats: {exc}", file=sys.stderr)
        return 1
    printTables(samples, disk, times, args.rounds)
    return 0


if __name__ == "__main__":
    sys.exit(main())
