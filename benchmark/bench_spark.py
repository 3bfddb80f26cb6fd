# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Measure how fast Spark reads Imu messages of format packed, with one executor and with two.

Each executor is a process of Java with one core, and one of Python that reads the store. Two
questions: the mean of one field, for which only its column is made, and a digest of all columns.
Beside it, toArrow makes the same columns in one process. Printed are the medians, and the processor
time of one question: all processes share the machine's cores, so that two executors can be twice as
fast only where there are cores for them.
"""

from __future__ import annotations

import argparse
import os
import signal
import statistics
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, Callable

import psutil
from pyspark.sql import SparkSession
from suite import machine
from suite.messages import imu_batch, imu_rows
from suite.results import Results
from suite.server import Server

from cassandra_ros.client.spark import topic
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.store.tables.lengths import bucket_for

ROOT = Path(__file__).resolve().parents[1]
EXPERIMENT = "spark"
NAME = "/imu"
HZ = 100.0
AT_ONCE = 100_000
"""Number of messages that are made and stored together."""
TARGET = 1.6
"""Ratio that two executors must reach, on a machine that has cores for them."""
FIELDS = {
    "one column": ["linear_acceleration.z"],
    "all columns": None,
}


def say(text: str) -> None:
    print(text, flush=True)


def fill(server: Server, messages: int) -> None:
    """Store the messages."""
    times, rows = imu_rows(AT_ONCE, HZ)
    bucket_ns = bucket_for(HZ, HZ * rows.dtype.itemsize)
    with server.store.messageWriter(nodeID="robot", format="packed") as writer:
        batch = imu_batch(times, rows, HZ)
        connection = api_connection(NAME, definition_of(batch.cls), "/imu")
        handle = writer.connect(connection, bucket_ns=bucket_ns)
        step = int(times[-1] - times[0]) + int(1e9 / HZ)
        for number in range(messages):
            again, n = divmod(number, AT_ONCE)
            writer.write(handle, batch.times[n] + again * step, number, batch.wires[n])


def mean(frame: Any) -> float:
    """Return the mean of the field."""
    [(found,)] = frame.selectExpr("avg(linear_acceleration.z)").collect()
    return float(found)


def processor_sec(server: Server) -> dict[str, float]:
    """Return the processor time so far of Cassandra, of Spark's Java and of all Python, s."""
    ours = psutil.Process()
    found = {"Cassandra": server.cpu() or 0.0, "Java": 0.0, "Python": sum(ours.cpu_times()[:2])}
    for child in ours.children(recursive=True):
        with suppress(psutil.NoSuchProcess):
            java = child.name() == "java"
            if not (java and "CassandraDaemon" in " ".join(child.cmdline())):
                found["Java" if java else "Python"] += sum(child.cpu_times()[:2])
    return found


def measured(
    server: Server, ask: Callable[[], Any], rounds: int
) -> tuple[list[float], dict[str, float]]:
    """Ask once, then some times; return how long each took, and the processor time of one, s."""
    ask()
    seconds, before = [], processor_sec(server)
    for _ in range(rounds):
        start = time.perf_counter()
        ask()
        seconds.append(time.perf_counter() - start)
    after = processor_sec(server)
    return seconds, {name: (after[name] - before[name]) / rounds for name in after}


def session(executors: int, folder: str) -> Any:
    """Start a Spark with this number of executors of one core each."""
    options = {
        "spark.ui.enabled": "false",
        "spark.ui.showConsoleProgress": "false",
        "spark.local.dir": folder,
        "spark.executor.memory": "1g",
        "spark.scheduler.minRegisteredResourcesRatio": "1.0",
        "spark.scheduler.maxRegisteredResourcesWaitingTime": "300s",
    }
    builder = SparkSession.builder.master(f"local-cluster[{executors},1,1024]")
    return builder.config(map=options).getOrCreate()


def measure(results: Results, server: Server, args: argparse.Namespace, folder: str) -> None:
    """Ask with each number of executors; keep and print the samples."""
    place = {"host": server.host, "port": server.port, "keyspace": server.keyspace}
    arrow = server.store.getTopic(NAME)

    def keep(what: str, contender: str, ask: Callable[[], Any]) -> None:
        seconds, cpu = measured(server, ask, args.rounds)
        rates = [args.messages / each for each in seconds]
        results.add(EXPERIMENT, what, contender, rates, "msg/s", x=args.messages)
        rate = statistics.median(rates)
        used = ", ".join(f"{name} {sec:.1f} s" for name, sec in cpu.items())
        say(f"{what:12} {contender:14} {rate / 1e3:6.0f} thousand messages/s; processor: {used}")

    for what, fields in FIELDS.items():
        keep(what, "toArrow", lambda f=fields: sum(b.num_rows for b in arrow.toArrow(f)))
    for executors in args.executors:
        spark = session(executors, folder)
        try:
            for what, fields in FIELDS.items():
                frame = topic(spark, NAME, fields=fields, **place)
                if fields is None:
                    # Spark would drop the columns that nothing needs; a digest needs all.
                    ask = lambda f=frame: f.selectExpr("sum(hash(*))").collect()  # noqa: E731
                else:
                    ask = lambda f=frame: mean(f)  # noqa: E731
                keep(what, f"executors: {executors}", ask)
        finally:
            spark.stop()


def report(results: Results, executors: list[int]) -> list[str]:
    """Print the ratios; return those that were missed."""
    medians = {(s.what, s.contender): statistics.median(s.values) for s in results.series}
    missed = []
    few, many = executors[0], executors[-1]
    for what in FIELDS:
        ratio = medians[what, f"executors: {many}"] / medians[what, f"executors: {few}"]
        say(f"{what}: {many} executors are {ratio:.2f} times as fast as {few}")
        if ratio < TARGET:
            missed.append(f"{what}, must be {TARGET}")
    return missed


def main() -> int:
    """Parse the command line, run, save."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("--host", help="a running Cassandra (default: one of our own)")
    parser.add_argument("--port", type=int, default=9042, help="its port (%(default)s)")
    parser.add_argument("--messages", type=int, default=10**6, help="(%(default)s)")
    parser.add_argument("--executors", type=int, nargs="+", default=[1, 2], help="(%(default)s)")
    parser.add_argument("--rounds", type=int, default=3, help="(%(default)s)")
    default = ROOT / "benchmark/results/spark.json"
    parser.add_argument("--results", type=Path, default=default, help="(%(default)s)")
    args = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    address = f"{args.host}:{args.port}" if args.host else None
    results = Results(machine.describe())
    results.machine["size"] = args.messages
    os.environ.setdefault("PYSPARK_PYTHON", sys.executable)
    os.environ.setdefault("SPARK_LOCAL_IP", "127.0.0.1")
    with tempfile.TemporaryDirectory(prefix="cassandra_ros_bench_") as folder:
        server = Server(Path(folder), address)
        try:
            server.start()
            begin = time.perf_counter()
            fill(server, args.messages)
            say(f"{args.messages} messages stored in {time.perf_counter() - begin:.0f} s")
            measure(results, server, args, folder)
        finally:
            server.end()
    results.save(args.results)
    missed = report(results, args.executors)
    say(f"missed: {'; '.join(missed)}" if missed else "all is reached that was measured")
    return 0


if __name__ == "__main__":
    sys.exit(main())
