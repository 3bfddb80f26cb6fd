# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Report of how an SQL statement was answered: what was read of each topic, and DuckDB's plan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Iterator

from cassandra_ros.client.sql.table_sources import TopicSource
from cassandra_ros.messages.stamps import iso_time
from cassandra_ros.read import LAST_NS


@dataclass(frozen=True)
class TopicReadReport:
    """What was read of one topic."""

    topic: str
    columns: tuple[str, ...]
    """Columns that were read, a field in a message by its dotted name."""
    first_ns: int | None
    """First time that was read, ns; None = not bounded."""
    last_ns: int | None
    robots: tuple[str, ...] | None
    """nodeIDs; None = all."""
    runs: tuple[str, ...] | None
    events: tuple[str, ...] | None
    """Names of events in whose time the messages lie; None = not bounded."""
    condition: str
    """Condition that bounded what was read; '' = no condition."""
    messages: int
    """Number of messages that DuckDB got, in all scans together."""
    blocks: int
    """Number of blocks that were unpacked for them, where a condition was checked."""
    skipped: int
    """Number of buckets that were not read, because no message in them can match."""

    def lines(self) -> Iterator[str]:
        """Yield the report as lines."""
        yield f"topic:      {self.topic}"
        yield f"  columns:  {', '.join(self.columns)}"
        first, last = (None if t is None else iso_time(t) for t in (self.first_ns, self.last_ns))
        if first or last:
            yield f"  times:    {first or 'the first'} to {last or 'the last'}"
        if self.robots is not None:
            yield f"  robots:   {', '.join(self.robots) or 'none'}"
        if self.runs is not None:
            yield f"  runs:     {', '.join(self.runs) or 'none'}"
        if self.events is not None:
            yield f"  events:   {', '.join(self.events)}"
        if self.condition:
            unread = f", {self.skipped} buckets not read" if self.skipped else ""
            yield f"  bounded:  {self.condition}"
            yield f"  blocks:   {self.blocks} unpacked{unread}"
        yield f"  messages: {self.messages} read"


@dataclass(frozen=True, repr=False)
class SqlExplanation:
    """Report of how a statement was answered; ``str()`` is for people."""

    statement: str
    topics: tuple[TopicReadReport, ...]
    rows_returned: int
    plan: str
    """DuckDB's plan, as it draws it."""

    def __repr__(self) -> str:
        reports = [line for topic in self.topics for line in topic.lines()]
        rows = f"rows returned: {self.rows_returned}"
        return "\n".join([self.statement.strip(), *reports, rows, self.plan])


def explain_source(source: TopicSource) -> TopicReadReport:
    """Return what was read of a topic."""
    pushed, choosers = source.pushed, source.choosers
    low, high = pushed.time_range
    names = (field_names(field.name, field.type) for field in source.columns)
    return TopicReadReport(
        topic=source.topic.name,
        columns=tuple(name for paths in names for name in paths),
        first_ns=low or None,
        last_ns=None if high == LAST_NS else high,
        robots=None if pushed.nodes is None else tuple(sorted(pushed.nodes)),
        runs=None if pushed.runs is None else tuple(sorted(pushed.runs)),
        events=None if pushed.events is None else tuple(sorted(pushed.events)),
        condition="" if pushed.condition is None else pushed.condition.text,
        messages=source.messages,
        blocks=sum(chooser.blocks for chooser in choosers),
        skipped=sum(chooser.skipped for chooser in choosers),
    )


def field_names(name: str, kind: object) -> Iterator[str]:
    """Yield the dotted names of the fields of a struct, or the name of another column."""
    fields = list(kind) if str(kind).startswith("struct<") else ()  # type: ignore[call-overload]
    if not fields:
        yield name
    for field in fields:
        yield from field_names(f"{name}.{field.name}", field.type)
