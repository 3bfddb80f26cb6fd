# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Ask 1,000,000 stored messages for the 1,000 that satisfy a condition, beside a scan by rosbag.

Writes Imu messages into a bag, imports it in ``ros``, and measures, as medians of some rounds: the
scan of the bag with the condition in Python; the statement, filtered by the server; the same with
an index; ``count(*)``. Each is measured beside a scan of its own. Then the memory of processes
that only ask. An answer that differs from the scan's ends the benchmark.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import random
import statistics
import subprocess
import sys
import tempfile
import time
import uuid
from pathlib import Path
from typing import Any, Callable, Iterable, Iterator, List, Tuple

import rosbag
from bench import addStoreOptions, makeMessages, runAnywhere, writeBag
from genpy import Time
from sensor_msgs.msg import Imu

from cassandra_ros import RosCassandra
from cassandra_ros.bag.importer import import_bag

ONE_IN = 1000
LIMIT = 100.0
"""Far above the random values; what satisfies the condition is put there."""
FIELD = "linear_acceleration.x"
CONDITION = f"select KEY, header.seq, {FIELD} from /imu where {FIELD} > ?"
"""It gives what the scan gives."""
WARM = 10
"""Statements before the first that is measured, for the server's Java compiles meanwhile."""
ALL = "select * from /imu"
COUNT = "select count(*) from /imu"

ASKER = """
import hashlib, json, sys
from cassandra_ros import RosCassandra
host, port, keyspace, statement, params = sys.argv[1:]
digest, count = hashlib.md5(), 0
with RosCassandra(host, int(port), keyspace=keyspace) as rosCas:
    for row in rosCas.iterCQL(statement, json.loads(params)):
        digest.update(str(row[0]).encode())
        count += 1
with open("/proc/self/status") as status:
    peak = next(int(line.split()[1]) for line in status if line.startswith("VmHWM"))
print(count, digest.hexdigest(), peak)
"""
"""Prints rows, md5 of their keys and peak memory in KiB (not ru_maxrss, which knows its parent)."""

Answer = List[Tuple[int, int, float]]
"""Receive time in ns, header.seq and the field of each message found."""


def withHits(messages: Iterable[tuple[Imu, Time]]) -> Iterator[tuple[Imu, Time]]:
    """Let one message of each thousand, at a random place, satisfy the condition."""
    rand = random.Random(2)
    hit = 0
    for i, (msg, t) in enumerate(messages):
        if i % ONE_IN == 0:
            hit = i + rand.randrange(ONE_IN)
        if i == hit:
            msg.linear_acceleration.x = LIMIT + 1 + rand.random()
        yield msg, t


def scan(path: Path) -> Answer:
    """Find the messages as one does with rosbag."""
    with rosbag.Bag(str(path)) as bag:
        return [
            (t.to_nsec(), msg.header.seq, msg.linear_acceleration.x)
            for _, msg, t in bag.read_messages("/imu")
            if msg.linear_acceleration.x > LIMIT
        ]


def ask(rosCas: RosCassandra) -> Answer:
    """Find them with the statement."""
    rows = rosCas.executeCQL(CONDITION, [LIMIT])
    return [(key.to_nsec(), seq, field) for key, seq, field in rows]


def timed(work: Callable[[], Any]) -> tuple[float, Any]:
    """Return the seconds that something takes, and what it returns."""
    start = time.perf_counter()
    found = work()
    return time.perf_counter() - start, found


def check(what: str, found: object, wanted: object) -> None:
    """End the benchmark where an answer is wrong."""
    if found != wanted:
        sys.exit(f"queries: {what}: the answer is not that of the scan")


def compare(rosCas: RosCassandra, path: Path, rounds: int, what: str) -> Answer:
    """Measure scan and statement in turn, and print the medians; return the scan's answer."""
    print(rosCas.explainCQL(CONDITION, [LIMIT]))
    for _ in range(WARM):
        ask(rosCas)
    scans, asks = [], []
    for _ in range(rounds):
        seconds, wanted = timed(lambda: scan(path))
        scans.append(seconds)
        seconds, found = timed(lambda: ask(rosCas))
        asks.append(seconds)
        check(what, found, wanted)
    base, mine = statistics.median(scans), statistics.median(asks)
    print(f"{'rosbag scan':32} {base * 1e3:10,.0f} ms  {len(wanted):,} messages found")
    print(f"{what:32} {mine * 1e3:10,.1f} ms  1/{base / mine:,.1f} of the scan")
    whole = "select * from /imu" + CONDITION[CONDITION.index(" where") :]
    seconds = [timed(lambda: rosCas.executeCQL(whole, [LIMIT]))[0] for _ in range(rounds)]
    mine = statistics.median(seconds)
    print(f"{'  the same, all fields':32} {mine * 1e3:10,.1f} ms  1/{base / mine:,.1f} of the scan")
    return wanted


def memory(args: argparse.Namespace, keyspace: str, statement: str, times: list[int]) -> int:
    """Let a process of its own ask; return its peak memory, bytes."""
    params = json.dumps([LIMIT] * statement.count("?"))
    store = (args.host, str(args.port), keyspace)
    done = subprocess.run(
        [sys.executable, "-c", ASKER, *store, statement, params],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    count, digest, peak = done.stdout.split()
    wanted = hashlib.md5()
    for t in times:
        wanted.update(str(t).encode())
    check(statement, (int(count), digest), (len(times), wanted.hexdigest()))
    return int(peak) * 1024


def measure(args: argparse.Namespace, rosCas: RosCassandra, path: Path) -> None:
    """Measure and print, with the bag imported."""
    topic = rosCas.getTopic("/imu")
    found = compare(rosCas, path, args.rounds, "executeCQL, no index")
    check("hits", len(found), args.messages // ONE_IN)
    seconds, _ = timed(lambda: topic.createIndex(FIELD))
    print(f"{'createIndex':32} {seconds * 1e3:10,.0f} ms")
    compare(rosCas, path, args.rounds, "executeCQL, index")
    counts = [timed(lambda: rosCas.executeCQL(COUNT)[0][0]) for _ in range(max(9, args.rounds))]
    check(COUNT, {count for _, count in counts}, {args.messages})
    print(f"{'count(*)':32} {statistics.median(s for s, _ in counts) * 1e3:10,.1f} ms")
    step = 10**9 // args.hz
    first = found[0][0] - found[0][1] * step
    every = [first + i * step for i in range(args.messages)]
    for statement, times in ((CONDITION, [t for t, _, _ in found]), (ALL, every)):
        peak = memory(args, rosCas.keyspace, statement, times)
        print(f"{'peak memory of the process':32} {peak / 1e6:10,.0f} MB  {statement}")


def run(args: argparse.Namespace) -> None:
    """Make the bag, import it, measure."""
    keyspace = f"bench_queries_{uuid.uuid4().hex[:8]}"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "imu.bag"
        writeBag(path, withHits(makeMessages(args.messages, 10**9 // args.hz)))
        with RosCassandra(args.host, args.port) as rosCas:
            rosCas.connectToKeyspace(keyspace)
            try:
                seconds, _ = timed(lambda: import_bag(rosCas, path, format="ros"))
                (info,) = rosCas.info()
                print(
                    f"{args.messages:,} sensor_msgs/Imu at {args.hz} Hz, imported in "
                    f"{seconds:.1f} s into {info.buckets} buckets; median of {args.rounds} rounds"
                )
                measure(args, rosCas, path)
            finally:
                rosCas.cassandra.schema_change(
                    f'DROP KEYSPACE IF EXISTS "{keyspace}"', what="ending the benchmark"
                )


def main() -> int:
    """Parse the command line and run."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    addStoreOptions(parser)
    parser.add_argument("--messages", type=int, default=1_000_000, help="(%(default)s)")
    parser.add_argument("--hz", type=int, default=100, help="their rate (%(default)s)")
    parser.add_argument("--rounds", type=int, default=3, help="(%(default)s)")
    args = parser.parse_args()
    if args.messages <= 0 or args.messages % ONE_IN:
        parser.error(f"--messages: give a multiple of {ONE_IN}")
    return runAnywhere("queries", args, run)


if __name__ == "__main__":
    sys.exit(main())
