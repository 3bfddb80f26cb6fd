# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Measure a copy into another keyspace beside export and import, and beside writing the messages.

Imu messages are stored in one format, and come into a new keyspace in three ways: by Replicator, by
export into a bag and import of that, and by the writer from serialised messages in memory. Then the
bytes are counted that a copy receives and sends. At last a process follows a keyspace into which
small messages are written all the time; its processor time is what a robot pays, beside that of its
Cassandra. Prints medians and ratios with what must be reached; writes the samples to
benchmark/results/copy.json.
"""

from __future__ import annotations

import argparse
import itertools
import multiprocessing
import os
import signal
import socket
import statistics
import struct
import sys
import tempfile
import threading
import time
from contextlib import closing
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Callable, Iterator

import psutil
from std_msgs.msg import Float64
from suite import machine
from suite.messages import Batch, imu, serialized
from suite.results import Results
from suite.server import Server

from cassandra_ros import Replicator, RosCassandra
from cassandra_ros.files.bag.exporter import export_bag
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.stores.copying.follower import Follower

ROOT = Path(__file__).resolve().parents[1]
EXPERIMENT = "copy"
TOPIC = "/imu"
HZ = 100.0
FOLLOWED_HZ = 2000.0
FOLLOW_SEC = 30.0
SETTLE_SEC = 15.0
"""Time until the follower has connected and made its tables, s."""
TARGETS = {("packed", "export and import"): 3.0, ("packed", "writing"): 1.0}
"""Ratio of a copy's messages a second to those of another way that must be reached."""
BYTES_ACKED_AT = 120
"""Place of tcpi_bytes_acked, and after it tcpi_bytes_received, in struct tcp_info of Linux."""
MOST_CPU = 0.1
"""Largest share of a core that a follower may use."""


def say(text: str) -> None:
    print(text, flush=True)


def write(store: RosCassandra, batch: Batch, form: str) -> None:
    """Store serialised messages."""
    with store.messageWriter(nodeID="husky", format=form) as writer:
        handle = writer.connect(api_connection(TOPIC, definition_of(batch.cls), "/imu"))
        for number, (t, wire) in enumerate(zip(batch.times, batch.wires)):
            writer.write(handle, t, number, wire)


class Ways:
    """The ways in which the messages of one keyspace come into another one."""

    def __init__(self, server: Server, folder: Path, batch: Batch, form: str) -> None:
        self._server, self._folder, self._batch, self._form = server, folder, batch, form
        self.source = f"{server.keyspace}_{form}"
        with self.open(self.source) as store:
            write(store, batch, form)
        self.ways: dict[str, Callable[[RosCassandra, RosCassandra], None]] = {
            "copy": self._copy,
            "export and import": self._by_bag,
            "writing": self._write,
        }

    def open(self, keyspace: str) -> RosCassandra:
        """Open a keyspace."""
        return RosCassandra(self._server.host, self._server.port, keyspace=keyspace)

    def _copy(self, source: RosCassandra, target: RosCassandra) -> None:
        assert Replicator(source, target).copy().complete

    def _by_bag(self, source: RosCassandra, target: RosCassandra) -> None:
        path = self._folder / "copy.bag"
        export_bag(source, path, force=True)
        import_bag(target, path, self._form, nodeID="husky")

    def _write(self, source: RosCassandra, target: RosCassandra) -> None:
        write(target, self._batch, self._form)

    def seconds(self, way: str) -> float:
        """Return how long a way takes into a new keyspace, s."""
        space = f"{self.source}_target"
        try:
            with self.open(self.source) as source, self.open(space) as target:
                begin = time.perf_counter()
                self.ways[way](source, target)
                seconds = time.perf_counter() - begin
                assert target.getTopic(TOPIC).countTopicData() == len(self._batch.times)
        finally:
            self._server.drop(space)
        return seconds

    def traffic(self) -> tuple[int, int]:
        """Return the bytes that this process receives and sends while it copies."""
        space, counter = f"{self.source}_target", SocketBytes(self._server.port)
        try:
            with self.open(self.source) as source, self.open(space) as target:
                with counter:
                    self._copy(source, target)
        finally:
            self._server.drop(space)
        return counter.received, counter.sent


class SocketBytes:
    """Counts the bytes that go over this process's connections to a port (a context manager).

    The kernel counts them for each connection; those that are made meanwhile count as well.
    """

    received = sent = 0

    def __init__(self, port: int) -> None:
        self._port = port

    def __enter__(self) -> SocketBytes:
        self._before = self._now()
        return self

    def __exit__(self, *exc_info: object) -> None:
        after = self._now()
        self.sent, self.received = (b - a for a, b in zip(self._before, after))

    def _now(self) -> tuple[int, int]:
        sent = received = 0
        for each in psutil.Process().net_connections("tcp"):
            if each.raddr and each.raddr.port == self._port and each.fd >= 0:
                with socket.socket(fileno=os.dup(each.fd)) as copy:
                    info = copy.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 136)
                acked, got = struct.unpack_from("=QQ", info, BYTES_ACKED_AT)
                sent, received = sent + acked, received + got
        return sent, received


def follow(host: str, port: int, source: str, target: str, pipe: Connection) -> None:
    """Follow a keyspace until the pipe says so; the body of the follower's process."""
    opened = [lambda s=space: RosCassandra(host, port, keyspace=s) for space in (source, target)]
    with Follower(*opened, Replicator):
        pipe.recv()
    pipe.send(None)


def followed(server: Server, seconds: float) -> float:
    """Return the share of a core that a follower uses while messages are written."""
    spaces = [f"{server.keyspace}_{name}" for name in ("robot", "home")]
    ours, theirs = multiprocessing.get_context("spawn").Pipe()
    ends = threading.Event()
    writing = threading.Thread(target=write_live, args=(server, spaces[0], ends))
    process = multiprocessing.get_context("spawn").Process(
        target=follow, args=(server.host, server.port, *spaces, theirs)
    )
    writing.start()
    process.start()
    try:
        time.sleep(SETTLE_SEC)
        before = cpu_sec(process.pid)
        time.sleep(seconds)
        used = cpu_sec(process.pid) - before
        with closing(RosCassandra(server.host, server.port, keyspace=spaces[1])) as home:
            count = home.getTopic("/n").countTopicData()
        assert count > FOLLOWED_HZ * seconds / 2, f"only {count} messages were copied"
    finally:
        ends.set()
        writing.join()
        ours.send(None)
        process.join()
        for space in spaces:
            server.drop(space)
    return used / seconds


def write_live(server: Server, space: str, ends: threading.Event) -> None:
    """Write small messages at their rate, each at its time."""
    wire, connection = serialized(Float64(1.5)), api_connection("/n", definition_of(Float64), "/n")
    with closing(RosCassandra(server.host, server.port, keyspace=space)) as store:
        with store.messageWriter(nodeID="husky", format="packed") as writer:
            handle = writer.connect(connection)
            begin = time.time_ns()
            for number in paced(ends):
                writer.write(handle, begin + int(number * 1e9 / FOLLOWED_HZ), number, wire)


def paced(ends: threading.Event) -> Iterator[int]:
    """Yield the numbers of messages when they are due."""
    begin = time.monotonic()
    for number in itertools.count():
        while time.monotonic() < begin + number / FOLLOWED_HZ:
            time.sleep(0.001)
        if ends.is_set():
            return
        yield number


def cpu_sec(pid: int | None) -> float:
    return sum(psutil.Process(pid).cpu_times()[:2])


def measure(results: Results, server: Server, folder: Path, args: argparse.Namespace) -> list[str]:
    """Measure each format; return what was missed."""
    batch, missed = imu(args.messages, HZ), []
    for form in args.formats:
        ways = Ways(server, folder, batch, form)
        samples: dict[str, list[float]] = {way: [] for way in ways.ways}
        for _ in range(args.rounds):
            for way, found in samples.items():
                found.append(args.messages / ways.seconds(way))
        for way, found in samples.items():
            results.add(EXPERIMENT, way, form, found, "msg/s", x=args.messages)
            say(f"{form:8}{way:20}{statistics.median(found) / 1e3:8.0f} thousand messages/s")
        for way in list(samples)[1:]:
            ratio = statistics.median(a / b for a, b in zip(samples["copy"], samples[way]))
            bound = TARGETS.get((form, way))
            text = f"{form}: a copy is {ratio:.2f} times as fast as {way}"
            say(text + (f", must be {bound}" if bound else ""))
            if bound and ratio < bound:
                missed.append(text)
        wire = sum(map(len, batch.wires)) / args.messages
        received, sent = (total / args.messages for total in ways.traffic())
        say(f"{form}: of {wire:.0f} bytes a copy receives {received:.0f} and sends {sent:.0f}")
        for what, each in (("bytes received", received), ("bytes sent", sent)):
            results.add(EXPERIMENT, what, form, [each], "bytes", x=args.messages)
        server.drop(ways.source)
    share = followed(server, args.seconds)
    say(f"following {FOLLOWED_HZ:.0f} messages/s: {share:.1%} of a core, must be {MOST_CPU:.0%}")
    results.add(EXPERIMENT, "following", "packed", [share], "cores", x=FOLLOWED_HZ)
    if share > MOST_CPU:
        missed.append("following")
    return missed


def main() -> int:
    """Parse the command line, run, save."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("--host", help="a running Cassandra (default: one of our own)")
    parser.add_argument("--port", type=int, default=9042, help="its port (%(default)s)")
    parser.add_argument("--messages", type=int, default=100_000, help="(%(default)s)")
    parser.add_argument("--formats", nargs="+", default=["packed", "ros"], help="(%(default)s)")
    parser.add_argument("--rounds", type=int, default=5, help="(%(default)s)")
    text = "how long the follower is measured, s (%(default)s)"
    parser.add_argument("--seconds", type=float, default=FOLLOW_SEC, help=text)
    default = ROOT / "benchmark/results/copy.json"
    parser.add_argument("--results", type=Path, default=default, help="(%(default)s)")
    args = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    address = f"{args.host}:{args.port}" if args.host else None
    results = Results(machine.describe())
    results.machine["size"] = args.messages
    with tempfile.TemporaryDirectory(prefix="cassandra_ros_bench_") as folder:
        server = Server(Path(folder) / "server", address)
        try:
            server.start()
            missed = measure(results, server, Path(folder), args)
        finally:
            server.end()
    results.save(args.results)
    say(f"missed: {'; '.join(missed)}" if missed else "all is reached that was measured")
    return 0


if __name__ == "__main__":
    sys.exit(main())
