# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""cr_copy, cr_copied and cr_copied_beat: the books of what was copied to other stores.

A row of cr_copy names, for a target and a table of ours, the table there that takes its rows, or
why no table takes them. A row of cr_copied says what the target has acknowledged of the rows of one
writer in one bucket. It is written after that acknowledgement, so the books may say less than what
is true, and never more. A row of cr_copied_beat has the heartbeat of the target's bucket when all
rows of the writer were there: as long as it is the same, nothing was deleted there. A target is
known by the id of its table of runs: a keyspace that was dropped and made again under the same name
is another target, of which nothing is confirmed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import datetime
from typing import Iterable, NamedTuple
from uuid import UUID

from cassandra_ros.store.connection.cassandra import Cassandra, CqlRow
from cassandra_ros.store.tables.directory import BucketRow, slot_of
from cassandra_ros.store.tables.side_tables import SideTables

_TABLES, _BUCKETS, _BEATS = "cr_copy", "cr_copied", "cr_copied_beat"
_KEY = ("target", "tbl", "node", "slot", "bucket", "writer")
_VALUES = ("there", "heartbeat", "seen", "final", "rule", "rows", "n", "bytes", "t_max")
"""Columns of cr_copied that put_bucket writes: fields of CopiedBucket."""
_SLOT = "target = ? AND tbl = ? AND node = ? AND slot = ?"
_READ = ", ".join(("node", "bucket", "writer", *_VALUES, "released"))
_WHAT, _READING = "writing the books of copies", "reading the books of copies"
_GONE = "another keyspace was made in its place"
"""Stored in the books, and recognised by this text there: it must not change."""


@dataclass(frozen=True)
class CopiedTable:
    """A table of ours in the books of a target."""

    target: UUID
    table: str
    place: str
    """Address and keyspace of the target, as they were given last."""
    topic: str
    there: str = ""
    """Name of the table there that takes the rows; '' = no table."""
    refused: str = ""
    """Why the topic was not copied the last time; '' = it was."""

    @property
    def gone(self) -> bool:
        """Whether the target is not there any more: what it confirmed counts no longer."""
        return self.refused == _GONE


class CopiedBucket(NamedTuple):
    """What a target has acknowledged of the rows of one writer in one bucket: nothing at first."""

    node: str
    bucket: int
    writer: int
    there: str = ""
    """Name of the table there that took the rows."""
    heartbeat: datetime | None = None
    """Heartbeat of the bucket in our directory when its rows were read."""
    seen: int = 0
    """Server time before the rows were read, us: all rows written before it are there."""
    final: bool = False
    """Whether no writer had the bucket open: if the heartbeat is still the same, all is there."""
    rule: str = ""
    """What left out some of the messages; '' = all were copied."""
    rows: int = 0
    """Number of messages that the bucket had here at least when it was copied."""
    n: int = 0
    """Number of these messages that are there; fewer if a rule left some out."""
    bytes: int = 0
    t_max: int = 0
    """Last key time of these messages, ns."""
    released: bool = False
    """Whether rows were deleted here for room: not a deletion to repeat there. Only ``release``
    writes it, and it stays."""

    def confirms(self, row: BucketRow, tables: Iterable[str], rule: str = "") -> bool:
        """Return whether one of some tables has all rows of a bucket as the directory lists it now.

        Args:
            tables: Names of tables of the target.
            rule: What may leave out messages now; '' = all of them must be there.
        """
        same = self.final and self.heartbeat == row.heartbeat
        return same and self.there in tables and self.rule in ("", rule)


def target_id(cassandra: Cassandra, keyspace: str) -> UUID | None:
    """Return the id by which books know a keyspace; None if it has no table of runs yet."""
    rows = cassandra.system_schema("tables", "id", keyspace, "cr_run")
    return UUID(str(rows[0][0])) if rows else None


class CopyBooks:
    """Reads and writes the books of one keyspace."""

    def __init__(self, side_tables: SideTables) -> None:
        self._tables = side_tables

    def make(self) -> None:
        """Make the tables of the books if they are missing."""
        self._tables.make(_TABLES, _BUCKETS, _BEATS)

    def put_table(self, entry: CopiedTable) -> None:
        """Write the entry of a table."""
        row = {
            "target": entry.target,
            "tbl": entry.table,
            "place": entry.place,
            "topic": entry.topic,
            "there": entry.there,
            "refused": entry.refused,
        }
        self._tables.insert(_TABLES, row, _WHAT)

    def tables(self, target: UUID | None = None) -> list[CopiedTable]:
        """Return the entries of all tables of a target; None = of all targets (a full scan)."""
        names = "target, tbl, place, topic, there, refused"
        if target is None:
            rows = self._tables.select(_TABLES, names, what=_READING)
        else:
            rows = self._tables.select(_TABLES, names, "target = ?", (target,), what=_READING)
        return [CopiedTable(*row[:2], *(text or "" for text in row[2:])) for row in rows]

    def put_bucket(self, target: UUID, table: str, entry: CopiedBucket) -> None:
        """Write what is confirmed of the rows of a writer in a bucket, but not ``released``."""
        self._write(target, table, entry, {name: getattr(entry, name) for name in _VALUES})

    def put_beat(
        self, target: UUID, table: str, entry: CopiedBucket, heartbeat: datetime | None
    ) -> None:
        """Write the heartbeat of a bucket when all rows were in the target; None = unknown."""
        self._write(target, table, entry, {"heartbeat": heartbeat}, _BEATS)

    def release(self, target: UUID, table: str, entry: CopiedBucket) -> None:
        """Note that rows of a bucket are deleted here for room, and not to be deleted there."""
        self._write(target, table, entry, {"released": True})

    def _write(
        self,
        target: UUID,
        table: str,
        entry: CopiedBucket,
        values: dict[str, object],
        books: str = _BUCKETS,
    ) -> None:
        key = (target, table, entry.node, slot_of(entry.bucket), entry.bucket, entry.writer)
        self._tables.insert(books, {**dict(zip(_KEY, key)), **values}, _WHAT)

    def buckets(
        self, target: UUID, table: str, slots: Iterable[tuple[int, str]]
    ) -> list[CopiedBucket]:
        """Return what is confirmed of a table, in some slots of its nodes."""
        params = [(target, table, node, slot) for slot, node in slots]
        answers = self._tables.select_many(_BUCKETS, _READ, _SLOT, params, _READING)
        return [_bucket(row) for rows in answers for row in rows]

    def beats(
        self, target: UUID, table: str, slot: int, node: str
    ) -> dict[tuple[int, int], datetime]:
        """Return the heartbeats of a slot, (bucket, writer) → what put_beat wrote, if not None."""
        names, slot_key = "bucket, writer, heartbeat", (target, table, node, slot)
        rows = self._tables.select(_BEATS, names, _SLOT, slot_key, what=_READING)
        return {(bucket, writer): beat for bucket, writer, beat in rows if beat is not None}

    def slots(self, target: UUID, table: str) -> list[tuple[int, str]]:
        """Return the (slot, node) pairs of a table in the books of a target (a scan of keys)."""
        names, what = "DISTINCT target, tbl, node, slot", "listing the books of copies"
        rows = self._tables.select(_BUCKETS, names, what=what)
        return [(slot, node) for t, tbl, node, slot in rows if (t, tbl) == (target, table)]

    def bury(self, entry: CopiedTable) -> None:
        """Note that a target is gone: another keyspace was made in its place."""
        self.put_table(replace(entry, there="", refused=_GONE))

    def doubt(self, target: UUID, table: str, names: Iterable[str]) -> None:
        """Note that rows which the target took into other tables than these are confirmed no more.

        Args:
            table: Table of ours.
            names: Tables of the target.
        """
        for book in self.buckets(target, table, self.slots(target, table)):
            if book.there not in names and (book.final or book.n):
                nothing = book._replace(final=False, seen=0, rows=0, n=0, bytes=0)
                self.put_bucket(target, table, nothing)

    def forget_table(self, target: UUID, table: str) -> None:
        """Delete the entries of a table that is no longer here; may be repeated after an error."""
        keys = [(target, table, node, slot) for slot, node in self.slots(target, table)]
        what = "clearing the books of copies"
        for books in (_BUCKETS, _BEATS):
            self._tables.delete(books, ("target", "tbl", "node", "slot"), keys, what)
        self._tables.delete(_TABLES, ("target", "tbl"), [(target, table)], what)


def _bucket(row: CqlRow) -> CopiedBucket:
    node, bucket, writer, there, heartbeat, seen, final, rule, *numbers, released = row
    rows, n, nbytes, t_max = (number or 0 for number in numbers)
    head = (node, bucket, writer, there or "")
    state = (heartbeat, seen or 0, bool(final), rule or "")
    return CopiedBucket(*head, *state, rows, n, nbytes, t_max, bool(released))
