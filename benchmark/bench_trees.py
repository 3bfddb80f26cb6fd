# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Compare two checkouts of this package: is the later one slower?

Each checkout runs in its own process, against the same Cassandra. Both do each piece of work in
turn, so that what else the machine does slows both alike. Printed are the client's processor time
and wall time in the earlier checkout, and the ratios later / earlier: the median of the pairs, and
the ratio of the shortest times. `make setup` must have run in both checkouts.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Callable, Dict, Tuple

SCRIPT = Path(__file__).resolve()
ROUNDS = {"write": 8, "import": 8, "read": 12, "arrays": 12, "ask": 40}
COUNTS = {"imu": 5_000, "tf": 2_500, "joints": 4_000, "scan": 400, "image": 12, "cloud": 10}
"""Messages of each kind in one piece of work."""
FORMATS = ("packed", "binary", "ros")
CALLS = 10
"""Calls of a small read in one piece of work."""
Work = Dict[str, Tuple[Callable[[], Any], Callable[[], Any]]]
"""By name: what is done before, and what is measured."""
Times = Tuple[float, float]
"""Processor time and wall time, s."""


class Side:
    """One of the two checkouts: a process that does what it is told.

    Args:
        tree: Root of the checkout.
        address: host:port of the Cassandra.
        kinds: Kinds of messages.
    """

    def __init__(self, tree: Path, address: str, kinds: list[str]) -> None:
        command = 'source .ws/devel/setup.bash && exec .venv/bin/python "$@"'
        arguments = [str(SCRIPT), "--serve", address, str(tree), *kinds]
        self._process = subprocess.Popen(
            ["bash", "-c", command, "bash", *arguments],
            cwd=tree,
            env={k: v for k, v in os.environ.items() if k != "PYTHONPATH"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def answer(self) -> Any:
        """Return its next line.

        Raises:
            RuntimeError: The process has ended.
        """
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f"the other process ended with {self._process.wait()}")
        return json.loads(line)

    def do(self, name: str) -> Times:
        """Have one piece of work done; return its times."""
        assert self._process.stdin is not None
        self._process.stdin.write(name + "\n")
        self._process.stdin.flush()
        cpu, wall = self.answer()
        return cpu, wall

    def end(self) -> None:
        """Let it delete its keyspace and end."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()


def serve(address: str, tree: Path, kinds: list[str]) -> None:
    """Be one side: say which work there is, then do what each line names."""
    sys.path.insert(0, str(tree / "benchmark"))
    from suite.server import Server

    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    server = Server(tree, address)
    with tempfile.TemporaryDirectory() as folder:
        try:
            work: Work = {}
            for kind in kinds:
                work.update(make_work(server, Path(folder), kind))
            print(json.dumps(list(work)), file=answers, flush=True)
            for line in sys.stdin:
                prepare, do = work[line.strip()]
                prepare()
                cpu, wall = time.process_time(), time.perf_counter()
                do()
                times = time.process_time() - cpu, time.perf_counter() - wall
                print(json.dumps(times), file=answers, flush=True)
        finally:
            server.end()


def make_work(server: Any, folder: Path, kind: str) -> Work:
    """Return the pieces of work with messages of a kind, by name; store what they read."""
    from suite.contenders.store import Store, StoreImport
    from suite.experiments.writing import ARRAYS, read_arrays
    from suite.messages import KINDS

    batch, work = KINDS[kind](COUNTS[kind]), {}
    for format in FORMATS:
        stored = Store(batch.first(len(batch), f"/{kind}_{format}"), folder, server, format)
        stored.open()
        stored.extend(0, len(batch))
        stored.finish()
        stored.open_reading()
        source = folder / kind / format
        source.mkdir(parents=True)
        bag = StoreImport(batch.first(len(batch), f"/{kind}_{format}_bag"), source, server, format)
        fresh = Store(batch.first(len(batch), f"/{kind}_{format}_new"), folder, server, format)
        # No table is made or dropped from one piece of work to the next.
        work[f"write {kind} {format}"] = fresh.open, lambda one=fresh: _write(one)
        work[f"import {kind} {format}"] = lambda one=bag: _renew(one), lambda one=bag: _write(one)
        work[f"read {kind} {format}"] = _nothing, lambda one=stored: sum(1 for _ in one.objects())
        if kind in ARRAYS:
            fields = ARRAYS[kind]
            work[f"arrays {kind} {format}"] = (
                _nothing,
                lambda one=stored, names=fields: read_arrays(one, names),
            )
        if kind == "imu":
            for name, ask in small_reads(server, stored).items():
                work[f"ask {name} {format}"] = _nothing, ask
    return work


def _nothing() -> None:
    pass


def _renew(one: Any) -> None:
    one.discard()
    one.open()


def _write(one: Any) -> None:
    one.extend(0, len(one.batch))
    one.finish()


def small_reads(server: Any, stored: Any) -> dict[str, Callable[[], Any]]:
    """Return reads of few messages of a topic of Imu messages, by name."""
    topic, times, ask = stored.topic, stored.batch.times, server.store.executeCQL
    keys = [topic.getRow(times[i * len(times) // CALLS]).key for i in range(CALLS)]
    name, low, high = topic.name, times[100], times[200]
    statements = {
        "limit": f"SELECT KEY, header.seq FROM {name} LIMIT 10",
        "last": f"SELECT KEY, header.seq FROM {name} ORDER BY KEY DESC LIMIT 1",
        "range": f"SELECT KEY, header.seq FROM {name} WHERE KEY >= {low} AND KEY < {high}",
        "condition": f"SELECT KEY FROM {name} WHERE orientation.x > 2.5",
        "count": f"SELECT COUNT(*) FROM {name} WHERE orientation.x > 0",
    }
    asked: dict[str, Callable[[], Any]] = {
        "exact": lambda: [topic.getData(key) for key in keys],
        "before": lambda: [topic.getData(k.to_nsec() + 1, nearest="before") for k in keys],
        "after": lambda: [topic.getData(k.to_nsec() - 1, nearest="after") for k in keys],
        "first": lambda: [topic.first() for _ in keys],
        "last": lambda: [topic.last() for _ in keys],
        "limit 10": lambda: [list(topic.items(limit=10)) for _ in keys],
    }
    for what, statement in statements.items():
        asked[f"statement {what}"] = lambda one=statement: [list(ask(one)) for _ in range(3)]
    return asked


def compare(sides: dict[str, Side], names: list[str], rounds: int) -> None:
    """Have both do each piece of work in turn; print the ratios."""
    head = f"{'earlier ms':>11} {'median':>7} {'least':>6}"
    print(f"{'':34}{'processor time':>26}{'wall time':>26}\n{'':34}{head}{head}")
    medians = []
    for name in names:
        samples: dict[str, list[Times]] = {side: [] for side in sides}
        for number in range(ROUNDS[name.split()[0]] * rounds + 1):
            for side in sorted(sides, reverse=number % 2 == 1):
                samples[side].append(sides[side].do(name))
        cells = []
        for i in (0, 1):
            before = [times[i] for times in samples["earlier"][1:]]
            after = [times[i] for times in samples["later"][1:]]
            median = statistics.median(a / b for a, b in zip(after, before))
            least = min(after) / min(before)
            cells.append(f"{statistics.median(before) * 1e3:11.1f} {median:7.3f} {least:6.3f}")
            if i == 0:
                medians.append((median, name))
        print(f"{name:34}{''.join(cells)}", flush=True)
    medians.sort(reverse=True)
    print("largest medians:", ", ".join(f"{name} {ratio:.3f}" for ratio, name in medians[:5]))


def main() -> None:
    """Run as one side, or compare."""
    if sys.argv[1:2] == ["--serve"]:
        serve(sys.argv[2], Path(sys.argv[3]), sys.argv[4:])
        return
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("earlier", type=Path, help="root of the earlier checkout")
    parser.add_argument("later", type=Path, help="root of the later checkout")
    parser.add_argument("--kinds", nargs="+", choices=COUNTS, default=list(COUNTS))
    parser.add_argument("--only", nargs="+", metavar="TEXT", help="work whose name contains it")
    parser.add_argument("--rounds", type=int, default=1, help="multiplies them (%(default)s)")
    parser.add_argument("--server", metavar="HOST:PORT", help="a Cassandra that runs")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        from suite.server import Server

        server = Server(Path(folder), args.server)
        server.start()
        try:
            address = f"{server.host}:{server.port}"
            trees = {"earlier": args.earlier.resolve(), "later": args.later.resolve()}
            sides = {name: Side(tree, address, args.kinds) for name, tree in trees.items()}
            try:
                earlier, later = (side.answer() for side in sides.values())
                names = [n for n in earlier if n in later]
                if args.only:
                    names = [n for n in names if any(text in n for text in args.only)]
                compare(sides, names, args.rounds)
            finally:
                for side in sides.values():
                    side.end()
        finally:
            server.end()


if __name__ == "__main__":
    main()
