# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The window of time that Look opens, and how much of each topic lies in it: by the directory."""

from __future__ import annotations

from typing import NamedTuple, Sequence

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.topics.following import followed
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.selection import LAST_NS, Stretch, Whose
from cassandra_ros.topics.topic_table import TopicTable
from cassandra_ros.topics.totals import buckets_of

DAY_NS = 24 * 3600 * SECOND_NS


class Held(NamedTuple):
    """What some tables hold in a stretch of time, to the accuracy of a bucket."""

    messages: int = 0
    size: int = 0
    """Bytes of the messages."""
    first: int = LAST_NS
    last: int = -1
    """When the first and the last of them came, ns; what is being recorded reaches to the end of
    its bucket."""

    def with_(self, other: Held) -> Held:
        """Return what both hold together."""
        first, last = min(self.first, other.first), max(self.last, other.last)
        return Held(self.messages + other.messages, self.size + other.size, first, last)


def held(keyspace: Keyspace, table: TopicTable, stretch: Stretch, whose: Whose) -> Held:
    """Say what a table holds in the buckets of a stretch; no message is read."""

    def look(now: Sequence[TopicTable]) -> Held:
        found = Held()
        for each in now:
            ends = each.bucket_of(stretch.low), each.bucket_of(stretch.high)
            length = each.metadata.bucket_ns
            for row in buckets_of(keyspace.directory, each, whose, ends):
                first, last = row.t_min, row.t_max
                if not row.closed:
                    first, last = row.bucket * length, (row.bucket + 1) * length - 1
                elif not row.rows:
                    continue
                if first <= stretch.high and last >= stretch.low:
                    found = found.with_(Held(row.rows, row.bytes, first, last))
        return found

    return Held() if table.named else followed([table], look)


def default_window(
    keyspace: Keyspace,
    tables: Sequence[TopicTable],
    whose: Whose,
    start: int | None,
    end: int | None,
    time: int | None,
) -> Stretch:
    """Return the window that is meant where an end of it is missing: a day.

    Half a day on both sides of the moment that is looked at, else a day from its one end on, else
    the last day that there is.
    """
    if start is not None and end is not None:
        return Stretch(start, end)
    if time is not None:
        half = DAY_NS // 2
        return Stretch(
            max(0, time - half) if start is None else start,
            min(LAST_NS, time + half) if end is None else end,
        )
    if start is not None:
        return Stretch(start, min(LAST_NS, start + DAY_NS))
    if end is None:
        end = _newest(keyspace, tables, whose)
    return Stretch(max(0, end - DAY_NS), end)


def _newest(keyspace: Keyspace, tables: Sequence[TopicTable], whose: Whose) -> int:
    timed = [table for table in tables if not table.named]
    rows = keyspace.rows.read(
        timed, Stretch(), whose=whose, reverse=True, columns=lambda table: (), wanted=1
    )
    return next((row.t for row in rows), 0) if timed else 0
