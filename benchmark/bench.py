# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Measure the store beside rosbag, MCAP, SQLite and the bare driver, in one run on one machine.

Prints the samples' medians and quartiles as it goes, at the end the table of ratios with their
targets; writes all samples to benchmark/results/<size>.json, and plots beside it.
"""

from __future__ import annotations

import argparse
import signal
import sys
import tempfile
import time
from pathlib import Path

from suite import machine
from suite.context import Context, warn
from suite.experiments import EXPERIMENTS
from suite.plots import save_all
from suite.results import Results
from suite.server import Server
from suite.sizes import SIZES
from suite.targets import rows, text_table

RESULTS = Path(__file__).resolve().parent / "results"


def run(args: argparse.Namespace, folder: Path) -> Results:
    """Run the experiments."""
    results = Results(machine.describe())
    results.machine["size"] = args.size
    address = f"{args.host}:{args.port}" if args.host else None
    server = Server(folder / "server", address)
    server.start()
    try:
        found = server.store.cassandra.execute("SELECT release_version FROM system.local")
        results.machine["versions"]["cassandra"] = next(iter(found))[0]
        context = Context(SIZES[args.size], server, folder, results)
        for name in [n for n in EXPERIMENTS if not args.only or n in args.only]:
            context.say(name)
            context.experiment, start = name, time.perf_counter()
            with context.part(name):
                EXPERIMENTS[name](context)
            results.seconds[name] = round(time.perf_counter() - start, 1)
            context.say(f"{name}: {results.seconds[name]:,.0f} s\n")
    finally:
        server.end()
    return results


def parse() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("--size", choices=SIZES, default="full", help="how much (%(default)s)")
    parser.add_argument(
        "--only", nargs="+", choices=EXPERIMENTS, metavar="NAME", help=", ".join(EXPERIMENTS)
    )
    parser.add_argument(
        "--into",
        type=Path,
        metavar="FILE",
        help="results of an earlier run, in which those of --only take the place of its own",
    )
    parser.add_argument("--host", help="a running Cassandra (default: one of our own)")
    parser.add_argument("--port", type=int, default=9042, help="its port (%(default)s)")
    parser.add_argument(
        "--results", type=Path, help="folder of the results (%(default)s)", default=RESULTS
    )
    return parser.parse_args()


def main() -> int:
    """Run, print, save; the exit status tells whether everything ran."""
    args = parse()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with tempfile.TemporaryDirectory(prefix="cassandra_ros_bench_") as folder:
        results = run(args, Path(folder))
    # Part of the experiments is not a full run: it must not pass for one.
    name = "-".join(["part", args.size, *args.only]) if args.only else args.size
    path = args.results / f"{name}.json"
    if args.into is not None:
        path, later, results = args.into, results, Results.load(args.into)
        results.replace_experiments(later)
        name = path.stem
    results.save(path)
    print(text_table(rows(results)))
    for made in (path, *save_all(results, path.parent, name)):
        print(made)
    for failure in results.failures:
        warn("bench: {experiment}: {part}: {error}".format(**failure))
    return 1 if results.failures else 0


if __name__ == "__main__":
    sys.exit(main())
