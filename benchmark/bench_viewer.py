# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Measure the viewer on a recording of a day: ten million messages of an IMU and others beside.

Stores it, starts the viewer, and asks as its pages do: Home's timeline, a moment in Look, plots.
With chromium and the Studio a browser opens a moment, too. At the end a year of a thousand million
messages is noted in the directory, as it would be had somebody recorded them. Prints medians and
quartiles with what must be reached; writes the samples to benchmark/results/viewer.json, of which
make bench PAGE=1 makes a table of doc/performance.md.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Iterator

from suite import machine
from suite.day import store_day
from suite.messages import START_NS
from suite.results import Results
from suite.server import Server
from suite.viewer import (
    EXPERIMENT,
    NOON_NS,
    TARGETS,
    Client,
    measure,
    measure_plot,
    timed,
    timeline,
    told,
)

from cassandra_ros import RosCassandra
from cassandra_ros.store.tables.directory import BucketTotals

ROOT = Path(__file__).resolve().parents[1]
YEAR_TOPICS, YEAR_HOURS, YEAR_RATE_HZ = 4, 365 * 24, 8
HOUR_NS = 3600 * 10**9
YEAR_NS = YEAR_HOURS * HOUR_NS


def say(text: str) -> None:
    print(text, flush=True)


@contextlib.contextmanager
def running_viewer(server: Server, folder: Path) -> Iterator[tuple[str, int]]:
    """Start the program; yield its address and port."""
    command = [sys.executable, str(ROOT / "scripts/viewer"), "--port", "0", "--cache", str(folder)]
    command += ["--store-host", server.host, "--store-port", str(server.port)]
    command += ["--keyspace", server.keyspace, "--no-token"]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        found = re.search(r"http://\S+?:(\d+)\S*", process.stdout.readline())
        if found is None:
            raise RuntimeError("the viewer did not start")
        yield found[0], int(found[1])
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(60)


def note_year(store: RosCassandra) -> int:
    """Note in the directory a year of topics before the day; return how many messages."""
    totals_of_hour = YEAR_RATE_HZ * 3600
    first_hour = START_NS // HOUR_NS - 2 * YEAR_HOURS
    for n in range(YEAR_TOPICS):
        with store.messageWriter(nodeID="year") as writer:
            wire, connection = year_message(f"/year/{n}")
            handle = writer.connect(connection, HOUR_NS)
            writer.write(handle, first_hour * HOUR_NS, 0, wire)
        directory, table = store.catalog.keyspace.directory, handle.table
        for hour in range(first_hour, first_hour + YEAR_HOURS):
            totals = BucketTotals()
            ends = hour * HOUR_NS, (hour + 1) * HOUR_NS - 10**8
            totals.add(totals_of_hour, totals_of_hour * 16, 16, ends, False)
            directory.note(table, "year", hour)
            directory.mark((table.name, "year", hour, 7), 0, (), totals, closed=True)
    return YEAR_TOPICS * YEAR_HOURS * totals_of_hour


def year_message(topic: str):
    from std_msgs.msg import String
    from suite.day import Topic
    from suite.messages import serialized

    return serialized(String("one of many")), Topic(topic, String(), 1.0).connection


def measure_year(results: Results, client: Client, rounds: int) -> None:
    what = "timeline of a year with 10⁹ messages"
    start = (START_NS // HOUR_NS - 2 * YEAR_HOURS) * HOUR_NS
    for n in range(rounds + 1):
        # Another stretch each time: what was read is kept for some seconds.
        timed(results, what, lambda n=n: timeline(client, start + n, YEAR_NS - n), counts=n > 0)
        time.sleep(6)
    told(results, what, say)


def measure_browser(results: Results, address: str, rounds: int) -> None:
    """Open a moment in Look, until the Studio says that it plays."""
    from cassandra_ros.viewing.studio import studio_folder, studio_installed

    sys.path.insert(0, str(ROOT / "examples"))
    try:
        from chromium import chromium, missing_programs
    except ImportError as exc:
        say(f"  no browser: {exc}")
        return
    if missing_programs() or not studio_installed(studio_folder()):
        say("  no browser: chromium or the Studio is not installed")
        return
    what = "open at hour 12, in a browser"
    with chromium() as browser:
        for n in range(rounds + 1):
            url = f"{address.split('?')[0]}look.html?time={NOON_NS + n * 10**9}"
            browser.driver.get("about:blank")
            begin = time.perf_counter()
            browser.driver.get(url)
            browser.wait_for("return document.querySelector('#studio')?.dataset.ready === 'true'")
            if n:  # the first one fills the browser's cache
                results.add(EXPERIMENT, what, "viewer", [time.perf_counter() - begin], "s")
    told(results, what, say)


def run(args: argparse.Namespace, folder: Path, server: Server) -> Results:
    results = Results(machine.describe())
    results.machine["size"] = args.messages
    begin = time.perf_counter()
    counts = store_day(server.store, args.messages)
    took = time.perf_counter() - begin
    total = sum(counts.values())
    say(f"a day of {total:,} messages of {len(counts)} topics stored in {took:,.0f} s")
    with running_viewer(server, folder) as (address, port):
        client = Client(port)
        measure_plot(results, client, say)
        measure(results, client, args.rounds, say)
        measure_browser(results, address, args.rounds)
        say(f"a year of {note_year(server.store):,} messages noted in the directory")
        measure_year(results, client, args.rounds)
    results.seconds[EXPERIMENT] = round(time.perf_counter() - begin, 1)
    return results


def main() -> int:
    """Parse the command line, run, save."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("--host", help="a running Cassandra (default: one of our own)")
    parser.add_argument("--port", type=int, default=9042, help="its port (%(default)s)")
    parser.add_argument(
        "--messages", type=int, default=10_000_000, help="of the IMU's topic (%(default)s)"
    )
    parser.add_argument("--rounds", type=int, default=5, help="(%(default)s)")
    default = ROOT / "benchmark/results/viewer.json"
    parser.add_argument("--results", type=Path, default=default, help="(%(default)s)")
    args = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    os.environ.setdefault("PYTHONUNBUFFERED", "1")
    address = f"{args.host}:{args.port}" if args.host else None
    with tempfile.TemporaryDirectory(prefix="cassandra_ros_bench_") as name:
        server = Server(Path(name) / "server", address)
        try:
            server.start()
            results = run(args, Path(name) / "cache", server)
        finally:
            server.end()
    results.save(args.results)
    say(str(args.results))
    missed = [
        what
        for what, wanted in TARGETS.items()
        if wanted is not None and (results.median(EXPERIMENT, what, "viewer") or 0) > wanted
    ]
    say(f"missed: {', '.join(missed)}" if missed else "all is reached that was measured")
    return 0


if __name__ == "__main__":
    sys.exit(main())
