# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What must be reached: the ratios of a run beside their targets."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable, Iterable, Iterator, Optional, Sequence, Tuple

from suite.messages import LARGE, SMALL
from suite.results import Results, quartiles

FORMATS = ("packed", "binary", "ros")
MEMORY_MB = 256 + 150
"""The recorder's buffer, and what it may take beside it."""
SMALL_READS = ("nearest before", "nearest after", "first", "last", "limit 10")
STATEMENTS = ("statement limit 10", "desc limit 1")
Cases = Iterable[Tuple[str, Optional[float]]]


@dataclass(frozen=True)
class Target:
    """One thing to reach, and how far it was."""

    work: str
    unit: str
    """What the numbers are multiples of, or their unit."""
    wanted: float
    at_least: bool
    reached: float | None
    """The worst of its cases; None where nothing was measured."""
    case: str = ""
    """Which case that was."""

    @property
    def ok(self) -> bool | None:
        """Whether it was reached; None where nothing was measured."""
        if self.reached is None:
            return None
        return self.reached >= self.wanted if self.at_least else self.reached <= self.wanted

    @property
    def verdict(self) -> str:
        """Say whether it was reached, or by how much not."""
        if self.reached is None:
            return "not measured"
        if self.ok:
            return "reached"
        if self.at_least:
            return f"missed: {_part(self.reached / self.wanted)} of it"
        return f"missed: {self.reached / self.wanted - 1:.0%} above it"


def _part(ratio: float) -> str:
    """Write what is less than the whole, never as 100%."""
    return f"{ratio:.0%}" if ratio < 0.995 else f"{math.floor(ratio * 1000) / 10}%"


def targets(results: Results) -> list[Target]:
    """Return all targets of the issue with what a run has reached."""
    return [
        *_importing(results),
        *_large(results),
        *_reading(results),
        *_conditions(results),
        *_lookups(results),
        *_disk(results),
        *_sql(results),
        *_live(results),
        *_start(results),
    ]


def at_least(work: str, unit: str, wanted: float, cases: Cases) -> Target:
    """Make a target of the smallest of its cases."""
    return Target(work, unit, wanted, True, *_worst(cases, min))


def at_most(work: str, unit: str, wanted: float, cases: Cases) -> Target:
    """Make a target of the largest of its cases."""
    return Target(work, unit, wanted, False, *_worst(cases, max))


def _worst(cases: Cases, worst: Callable[..., tuple[float, str]]) -> tuple[float | None, str]:
    """Return the worst case and its name; a case that failed is named, too."""
    cases = list(cases)
    found = [(value, case) for case, value in cases if value is not None]
    if not found:
        return None, ""
    value, name = worst(found)
    missing = [case for case, value in cases if value is None]
    return value, name + f"; without {', '.join(missing)}" * bool(missing)


def ratio(value: float | None, base: float | None) -> float | None:
    """Return value / base; None where one is missing."""
    return None if value is None or not base else value / base


def _against(
    results: Results, what: str, mine: str, other: str, kinds: Sequence[str]
) -> Iterator[tuple[str, float | None]]:
    for kind in kinds:
        value = results.median("writing", what, mine, kind)
        yield kind, ratio(value, results.median("writing", what, other, kind))


def _importing(results: Results) -> Iterator[Target]:
    for name, other, wanted in (
        ("packed", "mcap", 1.0),
        ("packed", "rosbag", 2.0),
        ("binary", "rosbag", 1.3),
        ("ros", "rosbag", 1.0),
    ):
        cases = _against(results, "write", f"{name} import", other, SMALL)
        yield at_least(f"import {name}, small messages", f"x {other}", wanted, cases)
        # As the others are measured: from memory, not out of a bag that is read twice.
        cases = _against(results, "write", name, other, SMALL)
        yield at_least(f"write {name}, small messages", f"x {other}", wanted, cases)
    for name in FORMATS:
        cases = _against(results, "write", name, "rosbag", ["scan"])
        yield at_least(f"write scans, {name}", "x rosbag", 0.5, cases)
        cases = _against(results, "read", name, "rosbag", ["scan"])
        yield at_least(f"read scans, {name}", "x rosbag", 0.6, cases)


def _large(results: Results) -> Iterator[Target]:
    for name in FORMATS:
        for what, done, rate in (("write", "written", 100.0), ("read", "read", 250.0)):
            cases: list[tuple[str, float | None]] = [
                (kind, results.median("writing", f"{what} MB", name, kind)) for kind in LARGE
            ]
            yield at_least(f"images, clouds {done}, {name}", "MB/s", rate, cases)
            beside = _against(results, what, name, "bare driver", LARGE)
            yield at_least(f"images, clouds {done}, {name}", "x bare driver", 0.8, beside)


def _reading(results: Results) -> Iterator[Target]:
    for name, wanted in (("packed", 1.5), ("binary", 1.2), ("ros", 0.8)):
        cases = _against(results, "read", name, "rosbag", SMALL)
        yield at_least(f"read back as messages, {name}", "x rosbag", wanted, cases)


def _conditions(results: Results) -> Iterator[Target]:
    found = {
        (one.kind, one.contender): results.median(
            "conditions", "condition", one.contender, one.kind, one.x
        )
        for one in results.of("conditions", "condition")
    }

    def speed(kind: str, name: str) -> list[tuple[str, float | None]]:
        scan = found.get((kind.replace(", index", ""), "rosbag"))
        return [(kind, ratio(scan, found.get((kind, name))))]

    for name, wanted in (("packed", 50.0), ("ros", 10.0)):
        cases = speed("1,000 spread", name)
        yield at_least(f"condition, 1,000 hits, {name}", "x bag scan", wanted, cases)
    cases = speed("1,000 spread, index", "ros")
    yield at_least("condition, 1,000 hits, ros, index", "x bag scan", 100.0, cases)
    for name in ("packed", "ros"):
        yield at_least(f"half of all, {name}", "x bag scan", 2.0, speed("half of all", name))


def _lookups(results: Results) -> Iterator[Target]:
    steps = sorted({one.x for one in results.of("lookups", "lookup") if one.x is not None})
    for name in FORMATS:
        bare = f"bare SELECT, {'binary' if name == 'packed' else name}"
        medians = {x: results.median("lookups", "lookup", name, x=x) for x in steps}
        cases = [
            (f"{x:,.0f}", ratio(medians[x], results.median("lookups", "lookup", bare, x=x)))
            for x in steps
        ]
        yield at_most(f"lookup by key, {name}", "x bare SELECT", 1.15, cases)
        grown = (
            [(f"{steps[-1]:,.0f}", ratio(medians[steps[-1]], medians[steps[0]]))] if steps else []
        )
        yield at_most(f"lookup by key, {name}", "x that at 100", 1.2, grown)
    for name in FORMATS:
        last = steps[-1] if steps else None
        exact = results.median("lookups", "small read: exact", name, x=last)
        reads = [
            (what, ratio(results.median("lookups", f"small read: {what}", name, x=last), exact))
            for what in (*SMALL_READS, *STATEMENTS)
        ]
        yield at_most(f"nearest, first, last, limit, {name}", "x exact lookup", 3.0, reads)


def _disk(results: Results) -> Iterator[Target]:
    bags = sorted({one.kind for one in results.of("bags", "size")})
    for name, other, wanted in (
        ("packed", "rosbag bz2", 0.8),
        ("packed", "rosbag", 0.25),
        ("ros", "rosbag", 1.0),
    ):
        cases = [
            (
                bag,
                ratio(
                    results.median("bags", "size", name, bag),
                    results.median("bags", "size", other, bag),
                ),
            )
            for bag in bags
        ]
        yield at_most(f"size on disk, real bags, {name}", f"x {other}", wanted, cases)


def _middle(values: list[float]) -> float | None:
    return quartiles(values)[1] if values else None


def _sql(results: Results) -> Iterator[Target]:
    found = {
        (one.what, one.contender): results.median("sql", one.what, one.contender, one.kind, one.x)
        for one in results.of("sql")
    }
    for name, wanted in (("packed", 500_000.0), ("ros", 150_000.0)):
        rate = found.get(("toArrow", name))
        yield at_least(f"toArrow, all columns, {name}", "msg/s", wanted, [("", rate)])
    mine = found.get(("join", "packed"))
    times = ratio(mine, found.get(("join", "DuckDB, Parquet")))
    yield at_most("SQL, join by time", "x DuckDB over Parquet", 4.0, [("", times)])
    faster = ratio(found.get(("join", "bags, pandas")), mine)
    yield at_least("SQL, join by time", "x bags and pandas", 20.0, [("", faster)])
    kinds = sorted({one.kind for one in results.of("sql", "condition")})
    asked = {
        (kind, name): [
            v
            for one in results.of("sql", "condition")
            if (one.kind, one.contender) == (kind, name)
            for v in one.values
        ]
        for kind in kinds
        for name in ("whole table", "pushdown")
    }
    cases = [
        (kind, ratio(_middle(asked[kind, "whole table"]), _middle(asked[kind, "pushdown"])))
        for kind in kinds
    ]
    yield at_least("SQL, condition", "x whole table", 3.0, cases)
    memory = [(f"{one.x:,.0f}", max(one.values)) for one in results.of("sql", "memory")]
    yield at_most("memory of an SQL join", "MB", 1024.0, memory)


def _live(results: Results) -> Iterator[Target]:
    for name, kind, wanted in (
        ("packed", "small", 20_000.0),
        ("ros", "small", 10_000.0),
        ("ros", "images of 2 MB", 30.0),
    ):
        held = results.median("live", "held", f"recorder, {name}", kind)
        yield at_least(f"recorded without loss, {name}, {kind}", "msg/s", wanted, [("", held)])
    memory = [
        (f"{one.contender}, {one.kind}, {one.x:,.0f}/s", max(one.values))
        for one in results.of("live", "memory")
        if one.contender.startswith("recorder") and one.x is not None
    ]
    yield at_most("memory of the recorder", "MB", MEMORY_MB, memory)


def _start(results: Results) -> Iterator[Target]:
    def beside(names: Sequence[str], base: str) -> list[tuple[str, float | None]]:
        other = results.median("start", "wall", base)
        return [(name, ratio(results.median("start", "wall", name), other)) for name in names]

    yield at_most(
        "start of a program",
        "x rosbag --help",
        1.2,
        beside(["cassandra_bag --help"], "rosbag --help"),
    )
    asked = [f"cassandra_bag {verb}" for verb in ("info", "query")]
    yield at_most("answer of a small store", "x rosbag info", 2.0, beside(asked, "rosbag info"))
    for work, name, wanted in (
        ("recorder subscribed", "recorder, until it is subscribed", 1.0),
        ("new keyspace with side tables", "new keyspace, side tables", 0.3),
        ("the Husky's bag by command", "cassandra_bag import, Husky", 2.0),
        ("start of Cassandra", "local_cassandra start", 5.0),
        ("make setup, all there", "make setup", 1.0),
    ):
        yield at_most(work, "s", wanted, [("", results.median("start", "wall", name))])
    tables = [
        (f"{one.x:,.0f}", results.median("start", "table", "together", x=one.x))
        for one in results.of("start", "table")
        if one.contender == "together"
    ]
    yield at_most("tables of topics made together", "ms a table", 40.0, tables)


def rows(results: Results) -> list[list[str]]:
    """Return the table as text: work, target, reached, verdict; the head first."""
    found = [["work", "must reach", "reached", ""]]
    for one in targets(results):
        sign = "≥" if one.at_least else "≤"
        reached = "-" if one.reached is None else _short(one.reached)
        if one.reached is not None and one.case:
            reached += f" ({one.case})"
        found.append([one.work, f"{sign} {_short(one.wanted)} {one.unit}", reached, one.verdict])
    return found


def _short(value: float) -> str:
    return f"{value:,.0f}" if value >= 1000 else f"{value:.3g}"


def text_table(table: list[list[str]]) -> str:
    """Lay a table out in columns."""
    widths = [max(map(len, column)) for column in zip(*table)]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths)) for row in table]
    return "\n".join(line.rstrip() for line in lines)
