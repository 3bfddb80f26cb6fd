# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Measure how questions grow with the number of robots of which few are active at any time.

For each number of robots a keyspace is filled by the writer of this package: each robot writes some
messages of each topic, within one hour, and ten robots share an hour. Then questions about one
topic are asked without naming a robot, and `info` about one topic and about all. Prints medians,
their ratios to one robot's, and what must be reached; writes the samples to
benchmark/results/fleet.json.
"""

from __future__ import annotations

import argparse
import random
import signal
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Callable

from std_msgs.msg import Float64
from suite import machine
from suite.day import Topic
from suite.messages import START_NS, serialized
from suite.results import Results
from suite.server import Server

from cassandra_ros import RosCassandra

ROOT = Path(__file__).resolve().parents[1]
EXPERIMENT = "fleet"
HOUR_NS = 3600 * 10**9
AT_ONCE = 10
"""Number of robots that are active in the same hour."""
RATIO = 3.0
TARGETS_SEC = {"count": 0.02, "count of an hour": 0.01, "info, one topic": 0.3, "info": 1.0}
"""What must be reached, s; the other questions take at most RATIO times as long as one robot's."""


def say(text: str) -> None:
    print(text, flush=True)


def topic_name(number: int) -> str:
    return f"/fleet/{number}"


def times_of(robot: int, topic: int, messages: int) -> list[int]:
    """Return the times of the messages of a robot in a topic, ns, the same in each run."""
    some = random.Random(f"{robot} {topic}")  # noqa: S311 - the same in each run
    hour = START_NS + robot // AT_ONCE * HOUR_NS
    return sorted(hour + some.randrange(HOUR_NS) for _ in range(messages))


def fill(store: RosCassandra, robots: int, topics: int, messages: int) -> list[float]:
    """Write the messages of all robots; return how long the making of each table took, s."""
    wire = serialized(Float64(1.5))
    connections = [Topic(topic_name(n), Float64(), 1.0).connection for n in range(topics)]
    made: list[float] = []
    for robot in range(robots):
        with store.messageWriter(nodeID=f"robot_{robot:04}", format="binary") as writer:
            counter = 0
            for number, connection in enumerate(connections):
                begin = time.perf_counter()
                handle = writer.connect(connection)
                made += [time.perf_counter() - begin] if robot == 0 else []
                for t in times_of(robot, number, messages):
                    writer.write(handle, t, counter, wire)
                    counter += 1
    return made


def questions(store: RosCassandra, robots: int, messages: int) -> dict[str, Callable[[], Any]]:
    """Return the questions by name; each call asks about another time."""
    topic, some = store.getTopic(topic_name(0)), random.Random(1)  # noqa: S311 - as above
    every = [t for robot in range(robots) for t in times_of(robot, 0, messages)]

    def hour() -> Any:
        low = START_NS + some.randrange(-(-robots // AT_ONCE)) * HOUR_NS
        return topic.countTopicData(low, low + HOUR_NS - 1)

    return {
        "lookup": lambda: topic.getData(some.choice(every)),
        "nearest before": lambda: topic.getData(some.choice(every) + 1, nearest="before"),
        "nearest after": lambda: topic.getData(some.choice(every) - 1, nearest="after"),
        "first": topic.first,
        "last": topic.last,
        "limit 10": lambda: list(topic.items(limit=10)),
        "count": topic.countTopicData,
        "count of an hour": hour,
        "info, one topic": lambda: store.info([topic.name]),
        "info": store.info,
    }


def measure(results: Results, store: RosCassandra, robots: int, args: argparse.Namespace) -> None:
    """Ask each question some times; keep the samples."""
    assert store.getTopic(topic_name(0)).countTopicData() == robots * args.messages
    for what, ask in questions(store, robots, args.messages).items():
        samples = []
        for _ in range(args.rounds + 2):
            begin = time.perf_counter()
            ask()
            samples.append(time.perf_counter() - begin)
        results.add(EXPERIMENT, what, "store", samples[2:], "s", x=robots)


def report(results: Results, numbers: list[int]) -> list[str]:
    """Print the medians; return the questions that took too long."""
    medians = {
        (series.what, series.x): statistics.median(series.values) for series in results.series
    }
    missed = []
    say(f"{'':20}" + "".join(f"{n:>9} robots" for n in numbers) + "   must be")
    for what in dict.fromkeys(what for what, _ in medians):
        cells = [medians[what, n] for n in numbers]
        bound = TARGETS_SEC.get(what, RATIO * cells[0])
        say(
            f"{what:20}"
            + "".join(f"{1e3 * s:>13.1f} ms" for s in cells)
            + f"{1e3 * bound:>7.1f} ms"
        )
        if cells[-1] > bound:
            missed.append(what)
    return missed


def main() -> int:
    """Parse the command line, run, save."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("--host", help="a running Cassandra (default: one of our own)")
    parser.add_argument("--port", type=int, default=9042, help="its port (%(default)s)")
    parser.add_argument(
        "--robots", type=int, nargs="+", default=[1, 10, 100, 1000], help="(%(default)s)"
    )
    parser.add_argument("--topics", type=int, default=30, help="(%(default)s)")
    parser.add_argument(
        "--messages", type=int, default=40, help="of each robot in each topic (%(default)s)"
    )
    parser.add_argument("--rounds", type=int, default=30, help="(%(default)s)")
    default = ROOT / "benchmark/results/fleet.json"
    parser.add_argument("--results", type=Path, default=default, help="(%(default)s)")
    args = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    address = f"{args.host}:{args.port}" if args.host else None
    results = Results(machine.describe())
    results.machine["size"] = args.messages
    with tempfile.TemporaryDirectory(prefix="cassandra_ros_bench_") as name:
        server = Server(Path(name), address)
        try:
            server.start()
            for robots in args.robots:
                begin = time.perf_counter()
                with RosCassandra(
                    server.host, server.port, keyspace=f"{server.keyspace}_{robots}"
                ) as store:
                    made = fill(store, robots, args.topics, args.messages)
                    results.add(EXPERIMENT, "make a table", "store", made, "s", x=robots)
                    say(f"{robots} robots stored in {time.perf_counter() - begin:.0f} s")
                    measure(results, store, robots, args)
                server.drop(f"{server.keyspace}_{robots}")
        finally:
            server.end()
    results.save(args.results)
    missed = report(results, args.robots)
    say(f"missed: {', '.join(missed)}" if missed else "all is reached that was measured")
    return 0


if __name__ == "__main__":
    sys.exit(main())
