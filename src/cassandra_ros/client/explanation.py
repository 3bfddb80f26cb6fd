# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Report of how a statement was answered: the work of the server, and the work of the client."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain
from typing import Iterator

from cassandra_ros.query.protocols import Row, Source
from cassandra_ros.query.tree.syntax import (
    Expression,
    FieldPath,
    Leaf,
    conjuncts,
    inside,
    leaves,
    terms_of,
)
from cassandra_ros.topics.query_result import QueryResult


@dataclass(frozen=True, repr=False)
class Explanation:
    """Report of how a statement was answered; ``str()`` is for people.

    A bucket is a partition: a time range of one node in one table.
    """

    statement: str
    topic: str
    buckets: int
    """Number of buckets of the topic."""
    indexed: int
    """Number of buckets read by an index, of those that KEY, NODE and RUN select."""
    filtered: int
    """Number of buckets filtered by the server."""
    whole: int
    """Number of buckets read whole and filtered by the client."""
    skipped: int
    """Number of buckets not read, because no row in them can match."""
    server: tuple[str, ...]
    """Comparisons that the server checked; the client checks every row again."""
    client: tuple[str, ...]
    """Comparisons that only the client checked."""
    rows_read: int
    """Number of rows that the client checked one by one; in format packed those messages of the
    unpacked blocks that numpy did not filter out. See ``unpacked`` and ``sifted``."""
    rows_returned: int
    blocks: int = 0
    """Number of blocks of packed messages that were read and unpacked."""
    unpacked: int = 0
    """Number of messages in these blocks."""
    sifted: int = 0
    """Number of these messages that numpy filtered out before they became rows."""
    unread: int = 0
    """Number of messages in the unread blocks of the buckets that were read, as the directory
    counts."""
    counted: bool = False
    """Whether the directory of buckets had the answer, so that no row was read."""
    time_ranges: int | None = None
    """Number of time ranges selected by NEAR and EVENT; None: neither limits the time."""

    def __repr__(self) -> str:
        read = self.indexed + self.filtered + self.whole
        counts = {
            "by an index": self.indexed,
            "filtered by the server": self.filtered,
            "whole": self.whole,
            "known to hold nothing": self.skipped,
        }
        blocks = [
            f"blocks:        {self.blocks} of {self.unpacked} messages unpacked, of which "
            f"{self.sifted} were sifted out; not read: those of {self.unread} messages"
        ]
        of = "of" if self.time_ranges is None else "reads, of"
        times = [f"times:         read in {self.time_ranges} time ranges"]
        ways = [f"{count} {how}" for how, count in counts.items() if count]
        return "\n".join(
            [
                self.statement.strip(),
                f"topic:         {self.topic}",
                f"buckets:       {read} {of} {self.buckets}"
                + (f": {', '.join(ways)}" * bool(ways)),
                *(blocks if self.blocks or self.unread else ()),
                f"server:        {'; '.join(self.server) or 'checks nothing'}",
                f"client alone:  {'; '.join(self.client) or 'nothing'}",
                *(times if self.time_ranges is not None else ()),
                f"rows read:     {self.rows_read}" + ", the directory counts" * self.counted,
                f"rows returned: {self.rows_returned}",
            ]
        )


def explain(result: QueryResult, source: Source[Row]) -> Explanation:
    """Read a result to its end without keeping rows, and return how it was answered."""
    with result:
        returned = sum(1 for _ in result)
    pushed = result.pushdown
    ways: dict[Leaf, list[str]] = {}
    for (_, way), leaf in pushed.used.items():  # way: 'index', 'filter' or 'zones'
        ways.setdefault(leaf, []).append(way)
    return Explanation(
        statement=result.select.text,
        topic=source.name,
        buckets=source.countBuckets(),
        indexed=pushed.indexed,
        filtered=pushed.filtered,
        whole=pushed.whole,
        skipped=pushed.skipped,
        server=tuple(f"{leaf.text} ({' and '.join(how)})" for leaf, how in ways.items()),
        client=tuple(_unpushed(result.select.condition, set(ways))),
        rows_read=result.read,
        rows_returned=returned,
        blocks=pushed.blocks,
        unpacked=pushed.unpacked,
        sifted=pushed.unpacked - pushed.kept,
        unread=max(0, pushed.held - pushed.unpacked),
        counted=result.counted,
        time_ranges=result.time_ranges if result.bounded_by_place else None,
    )


def _unpushed(condition: Expression | None, pushed: set[Leaf]) -> Iterator[str]:
    """Yield the texts of the conjuncts about fields of which the server checked nothing.

    Those about KEY, NODE, RUN and the like only are left out: they choose what is read.
    """
    for conjunct in conjuncts(condition):
        terms = chain.from_iterable(map(terms_of, leaves(conjunct)))
        has_fields = any(isinstance(inner, FieldPath) for term in terms for inner in inside(term))
        if has_fields and not pushed.intersection(leaves(conjunct)):
            yield conjunct.text
