#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Ask home and the robots as one store: what each robot has, its drive, and what an event shows.

Exit status 3 if a store did not answer: it is named, and what only it has is missing.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter

from cassandra_ros import Fleet

SEC = 10**9


def totals(fleet):
    """How many messages of each robot there are, each counted once, and who did not answer."""
    infos, counts = fleet.info(), Counter()
    for info in infos:
        if info.count:
            counts[info.node] += info.count
    for robot, count in sorted(counts.items()):
        print(f"{robot}: {count} messages")
    return infos.missing


def drives(fleet):
    """When each robot moved, by the transforms of all of them."""
    stmt = "SELECT NODE, count(*), min(KEY), max(KEY) FROM /tf GROUP BY NODE"
    answer = fleet.executeCQL(stmt)
    for robot, count, first, last in answer:
        print(f"{robot}: {count} messages of /tf in {(last - first).to_sec():.1f} s")
    return answer.missing


def events(fleet, name):
    """What the robots sent during each event of a name, and a second before and after."""
    answer = fleet.events(name)
    for event in answer:
        end = event.start_ns if event.end_ns is None else event.end_ns
        print(f"event {event.name} of {event.node}: {(end - event.start_ns) / 1e9:.2f} s", end="")
        rows = fleet.readMessages(key=event.start_ns - SEC, to_key=end + SEC, nodeID=event.node)
        topics = Counter(row.topic for row in rows)
        print(f", {sum(topics.values())} messages of {len(topics)} topics around it")
    return answer.missing


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("stores", metavar="STORE", nargs="+", help="HOST[:PORT][/KEYSPACE], or")
    parser.add_argument("--file", help="a section of this file of stores, see doc/fleet.md")
    parser.add_argument("--event", help="name of events to look for")
    args = parser.parse_args()

    with Fleet(args.stores, file=args.file) as fleet:
        missing = {**totals(fleet), **drives(fleet)}
        if args.event:
            missing.update(events(fleet, args.event))
    for store, reason in missing.items():
        print(f"missing: {store}: {reason}")
    return 3 if missing else 0


if __name__ == "__main__":
    sys.exit(main())
