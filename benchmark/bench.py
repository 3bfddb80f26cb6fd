# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Compare the store with rosbag on the same Imu messages, side by side in one run.

Prints, as medians of some rounds: the rate of ``rosbag.Bag.write`` (from message objects, and
from bytes with ``raw=True``), of importing that bag in ``binary`` and in ``ros``, of reading all
of it back as messages, and the time of one key lookup beside a bare prepared SELECT.

A first round that warms the server up does not count. Absolute figures of a shared machine mean
little; the ratios of one run are what counts.
"""

from __future__ import annotations

import argparse
import random
import statistics
import sys
import tempfile
import time
import uuid
from pathlib import Path
from typing import Any, Callable, Iterable, Iterator

import rosbag
from genpy import Time
from sensor_msgs.msg import Imu

from cassandra_ros import RosCassandra
from cassandra_ros.bag.importer import import_bag
from cassandra_ros.errors import CassandraRosError
from cassandra_ros.local_server import LocalCluster, free_port

START_SEC = 1_600_000_000
STEP_NS = 1_000_000


def makeMessages(count: int, step_ns: int = STEP_NS) -> Iterator[tuple[Imu, Time]]:
    """Make Imu messages with random values, so many nanoseconds apart."""
    rand = random.Random(1)
    for i in range(count):
        stamp = Time(START_SEC + i * step_ns // 10**9, i * step_ns % 10**9)
        msg = Imu()
        msg.header.seq, msg.header.stamp, msg.header.frame_id = i, stamp, "imu_link"
        for part in (msg.orientation, msg.angular_velocity, msg.linear_acceleration):
            for name in part.__slots__:
                setattr(part, name, rand.gauss(0, 1))
        msg.orientation_covariance = [rand.random() for _ in range(9)]
        yield msg, stamp


def writeBag(path: Path, messages: Iterable[tuple[Any, Time]], raw: bool = False) -> float:
    """Write a bag with rosbag; return the seconds that the writing took."""
    if raw:
        messages = [(_raw(msg), t) for msg, t in messages]
    with rosbag.Bag(str(path), "w") as bag:
        start = time.perf_counter()
        for msg, t in messages:
            bag.write("/imu", msg, t, raw=raw)
    return time.perf_counter() - start


def _raw(msg: Any) -> Any:
    from io import BytesIO

    buffer = BytesIO()
    msg.serialize(buffer)
    return (msg._type, buffer.getvalue(), msg._md5sum, None, type(msg))


def timed(work: Callable[[], Any]) -> float:
    """Return the seconds that something takes."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def readBag(path: Path) -> None:
    """Read all messages with rosbag."""
    with rosbag.Bag(str(path)) as bag:
        for _ in bag.read_messages():
            pass


def lookups(rosCas: RosCassandra, keys: list[int]) -> dict[str, list[float]]:
    """Time getData by row key and by bare time, and a bare prepared SELECT, in turn."""
    topic = rosCas.getTopic("/imu")
    table = topic.tables[0]
    session = rosCas.cassandra._session
    names = ", ".join(f'"{c}"' for c in ("_t", "_seq", *table.columns))
    bare = rosCas.cassandra.prepare(
        f'SELECT {names} FROM "{rosCas.keyspace}"."{table.name}" '
        'WHERE "_node" = ? AND "_bucket" = ? AND "_t" = ?'
    )
    times: dict[str, list[float]] = {"row key": [], "bare time": [], "bare SELECT": []}
    for key in keys:
        stamp = topic.getRow(key).key
        values = ("", key // table.metadata.bucket_ns, key)
        times["row key"].append(timed(lambda stamp=stamp: topic.getData(stamp)))
        times["bare time"].append(timed(lambda key=key: topic.getData(key)))
        times["bare SELECT"].append(
            timed(lambda values=values: session.execute(bare, values).one())
        )
    return times


def run(args: argparse.Namespace) -> None:
    """Measure and print."""
    messages = list(makeMessages(args.messages))
    figures: dict[str, list[float]] = {}

    def note(name: str, seconds: float) -> None:
        figures.setdefault(name, []).append(args.messages / seconds)

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "imu.bag"
        with RosCassandra(args.host, args.port) as rosCas:
            for number in range(-1, args.rounds):
                if number == 0:
                    figures.clear()  # the first round only warms the server's Java up
                note("rosbag.Bag.write, raw=True", writeBag(path, messages, raw=True))
                note("rosbag.Bag.write", writeBag(path, messages))
                note("rosbag read_messages", timed(lambda: readBag(path)))
                for name in ("binary", "ros"):
                    keyspace = f"bench_{name}_{uuid.uuid4().hex[:8]}"
                    rosCas.connectToKeyspace(keyspace)
                    # What first writes makes our own tables; they are not what is measured.
                    rosCas.addTopic("/first", msg_type="std_msgs/String")
                    try:
                        note(
                            f"import, {name}",
                            timed(lambda name=name: import_bag(rosCas, path, format=name)),
                        )
                        topic = rosCas.getTopic("/imu")
                        note(
                            f"items() as messages, {name}",
                            timed(lambda topic=topic: sum(1 for _ in topic.items())),
                        )
                        if number == args.rounds - 1:
                            _printLookups(rosCas, name, args.lookups, len(messages))
                    finally:
                        rosCas.cassandra.schema_change(
                            f'DROP KEYSPACE IF EXISTS "{keyspace}"', what="ending the benchmark"
                        )
    base = statistics.median(figures["rosbag.Bag.write"])
    read = statistics.median(figures["rosbag read_messages"])
    print(f"\n{args.messages} sensor_msgs/Imu, median of {args.rounds} rounds")
    for name, rates in figures.items():
        reading = "items" in name or "read" in name
        ratio = statistics.median(rates) / (read if reading else base)
        of = "read_messages" if reading else "Bag.write"
        print(f"{name:32} {statistics.median(rates):10,.0f} msg/s  {ratio:5.2f} x {of}")


def _printLookups(rosCas: RosCassandra, name: str, count: int, total: int) -> None:
    rand = random.Random(2)
    keys = [START_SEC * 10**9 + rand.randrange(total) * STEP_NS for _ in range(count)]
    medians = {what: statistics.median(v) * 1e3 for what, v in lookups(rosCas, keys).items()}
    bare = medians.pop("bare SELECT")
    parts = [f"{ms:.2f} ms by {what} ({ms / bare:.2f} x)" for what, ms in medians.items()]
    print(f"lookup, {name}: median {', '.join(parts)}; {bare:.2f} ms a bare prepared SELECT")


def main() -> int:
    """Parse the command line and run."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    addStoreOptions(parser)
    parser.add_argument("--messages", type=int, default=100_000, help="a round (%(default)s)")
    parser.add_argument("--rounds", type=int, default=3, help="(%(default)s)")
    parser.add_argument("--lookups", type=int, default=1000, help="(%(default)s)")
    args = parser.parse_args()
    return runAnywhere("bench", args, run)


def addStoreOptions(parser: argparse.ArgumentParser) -> None:
    """Let the user name a running Cassandra."""
    parser.add_argument("--host", help="a running Cassandra (default: one of our own)")
    parser.add_argument("--port", type=int, default=9042, help="its port (%(default)s)")


def runAnywhere(
    name: str, args: argparse.Namespace, measure: Callable[[argparse.Namespace], None]
) -> int:
    """Measure on the Cassandra that the user named, else on our own; return the exit status."""
    try:
        if args.host:
            measure(args)
        else:
            runOnOwnServer(args, measure)
    except CassandraRosError as exc:
        print(f"{name}: {exc}", file=sys.stderr)
        return 1
    return 0


def runOnOwnServer(args: argparse.Namespace, measure: Callable[[argparse.Namespace], None]) -> None:
    """Start a Cassandra in a folder of its own, measure, stop it."""
    with tempfile.TemporaryDirectory(prefix="cassandra_ros_bench_") as folder:
        cluster = LocalCluster(folder, port=free_port(), heap="1G")
        cluster.start(die_with_us=True)
        try:
            args.host, args.port = cluster.settings.host, cluster.settings.port
            measure(args)
        finally:
            cluster.stop()


if __name__ == "__main__":
    sys.exit(main())
