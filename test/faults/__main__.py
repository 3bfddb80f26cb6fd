# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Run the fault table: make faults ARGS="--only NAME … --messages N --short"."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import tempfile
from pathlib import Path

from cassandra_ros.errors import CassandraRosError
from faults import network, page
from faults.results import RESULTS, Results
from faults.table import FAULTS, LONG, SHORT, try_fault
from faults.world import HEAP, Failed, World


def main() -> int:
    """Run the faults, store a line of each, print the table; status 1 if a line is not clean."""
    parser = argparse.ArgumentParser(prog="make faults", description=__doc__)
    parser.add_argument("--only", nargs="+", choices=list(FAULTS), metavar="NAME", default=[])
    parser.add_argument("--group", choices=sorted({fault.group for fault in FAULTS.values()}))
    parser.add_argument("--short", action="store_true", help="some thousand messages of each")
    parser.add_argument("--messages", type=int, help="numbered messages (default: 1000000)")
    parser.add_argument("--rate", type=float, help="messages a second (default: 5000)")
    parser.add_argument("--heap", default=HEAP, help="Java heap of Cassandra (default: 512M)")
    parser.add_argument("--results", type=Path, default=RESULTS, help="(default: %(default)s)")
    parser.add_argument("--list", action="store_true", help="list the faults and end")
    options = parser.parse_args()
    names = [
        name
        for name, fault in FAULTS.items()
        if name in (options.only or FAULTS) and options.group in (None, fault.group)
    ]
    if options.list:
        for name in names:
            print(f"{name}: {FAULTS[name].done}")
        return 0
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # servers and mounts are ended
    messages, rate = SHORT if options.short else LONG
    if any(FAULTS[name].group == "cluster" for name in names):
        try:
            network.enter()
        except network.NoNetwork as exc:
            print(f"faults of the network between nodes are skipped: {exc}", flush=True)
    failed = []
    with tempfile.TemporaryDirectory(prefix="cassandra_ros_faults_") as folder:
        with World(Path(folder), dict(os.environ), options.heap) as world:
            for name in names:
                print(f"{name}: {FAULTS[name].done}", flush=True)
                try:
                    result = try_fault(
                        world,
                        name,
                        options.messages or messages,
                        options.rate or rate,
                        options.short,
                    )
                except (Failed, CassandraRosError) as exc:  # the latter from a server
                    print(f"  failed: {exc}", flush=True)
                    failed.append(name)
                    continue
                if options.heap != HEAP:
                    result.notes.append(f"Java heap {options.heap}")
                print(f"  {page.summary(result)}", flush=True)
                if not result.clean:
                    failed.append(name)
                Results.load(options.results).put(result).save(options.results)
    print(f"not clean: {', '.join(failed)}" if failed else "every message is accounted for")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
