# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The directory: the list of a table's buckets by robot, with counts and times.

A bucket is a partition with the rows of one time range. A writer adds it to the directory as *open*
before its first data row, so the directory lists every bucket that has rows, and perhaps some that
have none. The counts of a *closed* bucket are final, those of an open one are estimates. Heartbeats
have the server's time, because clocks of robots are wrong.

Each entry is kept twice. ``cr_bucket`` lists the buckets of one robot, and is what a recount
compares itself with. ``cr_active`` lists the buckets of all robots in the order of time: of a
thousand robots few are active at any time, and a question about a time reads only their entries.
Both are written by one request, so the rules above hold for each of them. The two heartbeats of an
entry may differ by milliseconds: compare those of cr_bucket.

A topic that was recorded for a year has half a million buckets of a minute, and a read of its last
message needs one of them. So a read goes through the directory slot by slot, in windows that grow
(``BucketWalk``). A read of all rows gets a whole slot at once.
"""

from __future__ import annotations

import struct
import time
from copy import copy
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from itertools import chain, groupby
from typing import (
    Callable,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    Sequence,
    Tuple,
)

from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.store.connection.cassandra import REQUESTS_AT_ONCE, Cassandra, CqlRow
from cassandra_ros.store.connection.requests import Seconds, sent_ahead
from cassandra_ros.store.tables.bucket_columns import (
    BucketColumns,
    SlotRange,
    count_closed,
    read_columns,
)
from cassandra_ros.store.tables.row_table import RowTable
from cassandra_ros.store.tables.side_tables import SideTables

SLOT_BUCKETS = 4096
"""Number of buckets in one partition of the directory."""
ALL_ROWS = 2**31 - 1
"""LIMIT of a request for all rows."""
STALE_SEC = 60.0
"""Age of the heartbeat from which an open bucket has no living writer, s."""
HEARTBEAT_SEC = 10.0
"""Interval at which a writer marks again the open buckets in which it has stored rows, s."""
TTL_MARGIN_SEC = 900
"""How much longer than its rows a bucket is listed, s: a row may be retried for this time."""
CLOCKS_SEC = 2.0
"""Maximum difference between the clocks of two servers, s."""
NOTE_SEC = 3600.0
"""Age at which a row of cr_node that expires with its data is renewed, while rows are written,
s."""
NOTE_MARGIN_SEC = 7200
"""How much longer than a data row that is written now its row of cr_node must stay, s."""
FEW_BUCKETS = 8
"""Number of rows in the first window of buckets, for each node."""
FEW_NODES = 4
"""Maximum number of nodes that are asked before the directory tells who was active. Of more, most
had nothing to tell."""
FEW_SLOTS = 64
"""Number of rows in the first window of slots and their nodes."""
MANY_NODES = 8
"""Maximum number of nodes for which the first window of the buckets of all nodes has rows."""
MANY_SLOTS = 1024
"""Number of slots cached for one table from which they are forgotten when further ones come."""
WIDER = 4
"""Ratio between the sizes of two consecutive windows."""


def slot_of(bucket: int) -> int:
    """Return the slot in which a bucket is listed."""
    return bucket // SLOT_BUCKETS


_OWN_TABLES = ("cr_node", "cr_bucket", "cr_active")
_COLUMNS = "bucket, writer, state, deleted, heartbeat, n, bytes, largest, t_min, t_max, odd, filled"
_ACTIVE_COLUMNS = "bucket, node, writer, entry, deleted, heartbeat, toTimestamp(now())"
_EVER = (-(2**63), 2**63 - 1)
"""First and last slot that there can be."""
UNLISTED_SLOTS = 16
"""Maximum number of slots that are read without a list of those that have buckets."""
BucketKey = Tuple[str, str, int, int]
"""Table, node, bucket and writer: the key of a row of cr_bucket."""


class BucketRow(NamedTuple):
    """Counts of the rows that one writer put into one bucket."""

    node: str
    bucket: int
    writer: int
    closed: bool
    """Whether the counts are final."""
    heartbeat: datetime | None
    """Server time of the last mark; None = no mark yet."""
    rows: int
    """Number of messages, of blocks too."""
    bytes: int
    """Number of serialised bytes of the messages."""
    largest: int
    """Size of the largest message that is stored in its row (not in chunks), bytes."""
    t_min: int
    """Key time of the first message, ns; 0 = unknown."""
    t_max: int
    """Key time of the last message, ns; -1 = unknown."""
    odd: int
    """Number of messages with a field that the server cannot check. A block with one such message
    counts with all its messages."""
    age_sec: float
    """Time since the heartbeat, by the server's clock, s."""
    filled: frozenset[str] = frozenset()
    """Shadow columns that have values in all rows of this writer in the bucket."""
    writing: bool = False
    """Whether the writer has not closed the bucket. If rows were deleted, ``closed`` and
    ``writing`` may both be false."""
    cut: bool = False
    """Whether rows were deleted since the bucket was counted."""
    marked_us: int = 0
    """When the server wrote the heartbeat, us; 0 = the row was read from cr_active."""

    @property
    def counts(self) -> tuple[int, ...]:
        """Messages, bytes, largest, t_min, t_max and odd."""
        return self[5:11]

    def expired(self, ttl: int) -> bool:
        """Return whether all rows of this writer in the bucket have expired.

        Args:
            ttl: Lifetime of the table's rows, s; 0 = for ever.
        """
        # A bucket is closed after its last row. While it is open, a row may come that was retried
        # for minutes.
        margin = CLOCKS_SEC if self.closed else TTL_MARGIN_SEC
        return bool(ttl) and self.age_sec > ttl + margin


@dataclass
class BucketTotals:
    """Counts with which a writer closes a bucket."""

    rows: int = 0
    bytes: int = 0
    largest: int = 0
    t_min: int = 2**63 - 1
    t_max: int = -1
    odd: int = 0

    def count(self, t: int, size: int, chunked: bool, odd: bool) -> None:
        """Add one row to the counts."""
        self.rows += 1
        self.bytes += size
        self.t_min = min(self.t_min, t)
        self.t_max = max(self.t_max, t)
        self.odd += odd
        if not chunked:
            self.largest = max(self.largest, size)

    def add(self, rows: int, nbytes: int, largest: int, ends: tuple[int, int], odd: bool) -> None:
        """Add a block.

        Args:
            rows: Number of its messages.
            nbytes: Number of their serialised bytes.
            largest: Size of the largest one, bytes; 0 = it is in chunks.
            ends: First and last key time, ns.
            odd: Whether the block is marked odd.
        """
        self.rows += rows
        self.bytes += nbytes
        self.largest = max(self.largest, largest)
        self.t_min, self.t_max = min(self.t_min, ends[0]), max(self.t_max, ends[1])
        self.odd += rows * odd

    def columns(self) -> dict[str, int]:
        """Return the counts by the names of their columns in cr_bucket, in the order of UNKNOWN."""
        return {"n": self.rows, **{name: v for name, v in vars(self).items() if name != "rows"}}


_ENTRY = struct.Struct(">?6q")
"""Bytes of an ActiveEntry before the names."""
UNKNOWN = (0, 0, 0, 0, -1, 0)
"""Counts of a bucket of which none were noted yet: messages, bytes, largest, t_min, t_max, odd."""


class ActiveEntry(NamedTuple):
    """Counts of one writer in one bucket, the column ``entry`` of cr_active.

    As bytes: 1 if the counts are final; number of messages, bytes, size of the largest, first and
    last time, number of odd messages, as big-endian integers of eight bytes; then the names of the
    filled shadow columns, with commas between them. ``bucket_columns`` reads these bytes, too.
    """

    closed: bool
    """Whether the counts are final."""
    counts: Sequence[int] = UNKNOWN
    """In the order of UNKNOWN; see BucketRow."""
    filled: Iterable[str] = ()
    """Shadow columns that have values in all rows of the writer in the bucket."""

    def encoded(self) -> bytes:
        """Return the value of the column."""
        return _ENTRY.pack(self.closed, *self.counts) + ",".join(sorted(self.filled)).encode()


def decode_entry(entry: bytes) -> ActiveEntry:
    """Return what a value of the column says."""
    closed, *counts = _ENTRY.unpack_from(entry)
    names = entry[_ENTRY.size :]
    return ActiveEntry(closed, counts, names.decode().split(",") if names else ())


Group = List[BucketRow]
"""Rows of the directory of all writers for one bucket and node."""
BucketGroup = Tuple[int, Group]
"""A bucket and its group. An empty group means that the directory was read up to here."""
_Slot = Tuple[int, Tuple[str, ...]]
"""A slot, and the nodes that have buckets in it."""
_Request = Tuple[Iterator[Callable[[], List[BucketRow]]], int]
"""Functions that wait for the buckets of one node each, or of all; maximum number of rows of each
answer."""


class Directory:
    """Reads and writes cr_node, cr_bucket and cr_active of one keyspace. Thread-safe.

    In ranges of buckets or slots both ends are included. The values in the caches ``seen`` and
    ``first`` are replaced, not changed, because several threads read them.
    """

    def __init__(self, cassandra: Cassandra, side_tables: SideTables) -> None:
        self._cassandra = cassandra
        self._tables = side_tables
        names = map(side_tables.qualified, _OWN_TABLES)
        self._node_table, self._bucket_table, self._active_table = names
        self._made = False
        """Whether the tables of the directory are known to exist."""
        self._noted: dict[tuple[str, int, str], float] = {}
        """Table, slot and node → monotonic time at which ``note`` wrote them last, s."""
        self.seen: dict[str, dict[int, tuple[str, ...]]] = {}
        """Table → slot → nodes, as listed last; may be out of date, or only some of many."""
        self.first: dict[tuple[str, bool], tuple[Sequence[str], Sequence[Sequence[BucketRow]]]] = {}
        """Table and whether newest rows come first → nodes and buckets in which the last read of
        few rows began; see ``foresee`` in store/rows/reader.py."""

    def patient(self, retry_sec: Seconds) -> Directory:
        """Return a copy for one writer, which retries each request for ``retry_sec``.

        It shares the caches, but notes its slots itself.
        """
        directory = copy(self)
        directory._tables = self._tables.patient(retry_sec)
        directory._noted = {}
        return directory

    def _is_made(self) -> bool:
        """Return whether the tables of the directory exist; the server is asked until they do."""
        self._made = self._made or all(map(self._tables.has, _OWN_TABLES))
        return self._made

    def nodes(self, table: str, first_slot: int, last_slot: int) -> list[tuple[int, str]]:
        """Return the (slot, node) pairs of a table for slots in [first_slot, last_slot]."""
        return self.begin_nodes(table, (first_slot, last_slot))()

    def begin_nodes(
        self, table: str, slots: tuple[int, int], limit: int = ALL_ROWS, *, reverse: bool = False
    ) -> Callable[[], list[CqlRow]]:
        """Request the first (slot, node) pairs of a table in [first, last]; see Cassandra.begin."""
        if not self._is_made():
            return list
        cql = (
            f"SELECT slot, node FROM {self._node_table} "
            f"WHERE tbl = ? AND slot >= ? AND slot <= ?{' ORDER BY slot DESC' * reverse} LIMIT ?"
        )
        what, retry_sec = "reading the directory of nodes", self._tables.retry_sec
        return self._cassandra.begin(cql, (table, *slots, limit), what=what, retry_sec=retry_sec)

    def buckets(
        self,
        table: str,
        metadata: TopicMetadata,
        first: int,
        last: int,
        nodes: Sequence[str] | None = None,
    ) -> list[BucketRow]:
        """Return the buckets of a table in [first, last] whose rows have not all expired.

        Args:
            nodes: The nodeIDs to read; None = all.

        Returns:
            One row for each bucket, node and writer. The heartbeats are those of cr_bucket if
            ``nodes`` is given, otherwise those of cr_active: compare them with no others.
        """
        if nodes is None:
            rows = self.buckets_by_time(table, first, last)
        else:
            rows = self.buckets_by_robot(table, first, last, nodes)
        return [row for row in rows if not row.expired(metadata.ttl)]

    def buckets_by_time(self, table: str, first: int, last: int) -> list[BucketRow]:
        """Return the buckets of all robots in [first, last] that cr_active lists."""
        slots = self._slots_between(table, slot_of(first), slot_of(last))
        requests = (self.begin_active(table, slot, first, last) for slot in slots)
        return [row for answer in sent_ahead(requests, REQUESTS_AT_ONCE) for row in answer()]

    def buckets_by_robot(
        self, table: str, first: int, last: int, nodes: Sequence[str] | None = None
    ) -> list[BucketRow]:
        """Return the buckets in [first, last] that cr_bucket lists, with its heartbeats.

        Args:
            nodes: The nodeIDs to read; None = all.
        """
        all_slots = self.nodes(table, slot_of(first), slot_of(last))
        slots = [(slot, node) for slot, node in all_slots if nodes is None or node in nodes]
        requests = self.begin_buckets((table, node, slot, first, last) for slot, node in slots)
        return [row for answer in sent_ahead(requests, REQUESTS_AT_ONCE) for row in answer()]

    def _slots_between(self, table: str, first: int, last: int) -> Iterable[int]:
        """Return the slots in [first, last] that may have buckets of a table, ascending."""
        if last - first < UNLISTED_SLOTS:
            return range(first, last + 1)
        if not self._is_made():
            return ()
        cql = (
            f"SELECT slot FROM {self._node_table} "
            "WHERE tbl = ? AND slot >= ? AND slot <= ? GROUP BY tbl, slot"
        )
        what, retry_sec = "reading the directory of nodes", self._tables.retry_sec
        params = (table, first, last)
        rows = self._cassandra.execute(cql, params, what=what, retry_sec=retry_sec)
        return [slot for (slot,) in rows]

    def begin_active(
        self,
        table: str,
        slot: int,
        first: int,
        last: int,
        limit: int = ALL_ROWS,
        *,
        reverse: bool = False,
    ) -> Callable[[], list[BucketRow]]:
        """Request the buckets of all robots of a slot in [first, last] in the order of time.

        The answer has at most ``limit`` rows, from the first bucket on or (reverse) from the last.
        """
        if not self._is_made():
            return list
        order = " ORDER BY bucket DESC, node DESC, writer DESC" * reverse
        cql = (
            f"SELECT {_ACTIVE_COLUMNS} FROM {self._active_table} "
            f"WHERE tbl = ? AND slot = ? AND bucket >= ? AND bucket <= ?{order} LIMIT ?"
        )
        what, retry_sec = "reading the directory of buckets by time", self._tables.retry_sec
        params = (table, slot, first, last, limit)
        answer = self._cassandra.begin(cql, params, what=what, retry_sec=retry_sec)
        return lambda: list(map(_active_row, answer()))

    def count_closed(self, table: str, first: int, last: int) -> tuple[int, list[BucketRow]]:
        """Count the messages of all robots in the closed buckets in [first, last].

        Returns:
            The number of messages, and the rows of the buckets that are not counted: in these some
            writer's counts were not final. Meanwhile they may be.
        """
        if not self._is_made():
            return 0, []
        slots = self._slots_between(table, slot_of(first), slot_of(last))
        ranges = ((table, slot, first, last) for slot in slots)
        count, uncounted = count_closed(self._cassandra, self._active_table, ranges)
        # Read again: of the first read only their keys were taken.
        requests = (
            self.begin_active(table, slot_of(bucket), bucket, bucket)
            for bucket in sorted({bucket for _, bucket in uncounted})
        )
        rows = (row for answer in sent_ahead(requests, REQUESTS_AT_ONCE) for row in answer())
        return count, [row for row in rows if (row.node, row.bucket) in uncounted]

    def find_active(self, table: str, node: str, bucket: int) -> list[BucketRow]:
        """Return the rows of all writers for one bucket and node, from cr_active."""
        where = "tbl = ? AND slot = ? AND bucket = ? AND node = ?"
        params, what = (table, slot_of(bucket), bucket, node), "reading the directory by time"
        rows = self._tables.select("cr_active", _ACTIVE_COLUMNS, where, params, what=what)
        return list(map(_active_row, rows))

    def find(self, table: str, node: str, bucket: int) -> list[BucketRow]:
        """Return the rows of all writers for one bucket and node, from cr_bucket."""
        requests = self.begin_buckets([(table, node, slot_of(bucket), bucket, bucket)])
        return [row for answer in requests for row in answer()]

    def begin_buckets(
        self,
        params: Iterable[tuple[str, str, int, int, int]],
        limit: int = ALL_ROWS,
        *,
        reverse: bool = False,
    ) -> Iterator[Callable[[], list[BucketRow]]]:
        """Request buckets by (table, node, slot, first, last), one request when each is taken.

        Each answer has at most ``limit`` rows, from the first bucket on or (reverse) from the last.
        """
        if not self._is_made():
            return
        cql = (
            f"SELECT {_COLUMNS}, toTimestamp(now()), WRITETIME(heartbeat) "
            f"FROM {self._bucket_table} "
            "WHERE tbl = ? AND node = ? AND slot = ? AND bucket >= ? AND bucket <= ?"
            f"{' ORDER BY bucket DESC' * reverse} LIMIT ?"
        )
        what, retry_sec = "reading the directory of buckets", self._tables.retry_sec
        for bounds in params:
            request = self._cassandra.begin(cql, (*bounds, limit), what=what, retry_sec=retry_sec)
            yield partial(_bucket_rows, bounds[1], request)

    def keep_slots(self, table: str, span: range, slots: Sequence[_Slot]) -> None:
        """Cache the listed nodes of some slots for the next read.

        Args:
            span: The slots that were asked for: what was cached of them is replaced.
            slots: Those that have nodes, with these.
        """
        others = {s: n for s, n in self.seen.get(table, {}).items() if s not in span}
        self.seen[table] = {**(others if len(others) < MANY_SLOTS else {}), **dict(slots)}

    def begin_slot(
        self, table: str, slot: int
    ) -> tuple[tuple[str, ...], Callable[[], tuple[str, ...]]]:
        """Request the nodes of a slot.

        Return the cached ones, and a function that waits for the answer.
        """
        answer = self.begin_nodes(table, (slot, slot))

        def nodes() -> tuple[str, ...]:
            names = tuple(node for _, node in answer())
            self.keep_slots(table, range(slot, slot + 1), [(slot, names)] if names else [])
            return names

        return self.seen.get(table, {}).get(slot, ()), nodes

    def has_few_nodes(self, table: str, slot: int) -> bool:
        """Return whether the last listing of a slot found between 1 and FEW_NODES nodes.

        If so, the caller asks all of them at once and lists them again by ``begin_slot``, which
        takes less time than listing the rows of one bucket.
        """
        return 0 < len(self.seen.get(table, {}).get(slot, ())) <= FEW_NODES

    def begin_bucket(self, table: str, bucket: int) -> Callable[[], list[BucketRow]]:
        """Request one bucket of all nodes from cr_active; note the nodes that have it."""
        slot = slot_of(bucket)
        answer = self.begin_active(table, slot, bucket, bucket)

        def rows() -> list[BucketRow]:
            entries = answer()
            old_nodes = self.seen.get(table, {}).get(slot, ())
            nodes = {*old_nodes, *(row.node for row in entries)}
            if len(nodes) > len(old_nodes):
                self.keep_slots(table, range(slot, slot + 1), [(slot, tuple(sorted(nodes)))])
            return entries

        return rows

    def columns(
        self, slot_ranges: Iterable[SlotRange], *, single: bool = False
    ) -> Iterator[BucketColumns]:
        """Read many buckets as columns, several partitions at once; see read_columns."""
        if not self._is_made():
            return iter(())
        return read_columns(self._cassandra, self._bucket_table, slot_ranges, single=single)

    def add_node(self, table: str, slot: int, node: str, ttl: int = 0) -> None:
        """Add a slot of a node, before its first bucket, for ``ttl`` seconds (0 = for ever)."""
        columns, what = {"tbl": table, "slot": slot, "node": node}, "writing the directory of nodes"
        self._tables.insert("cr_node", columns, what, ttl=_ttl(ttl))

    def note(self, table: RowTable, node: str, bucket: int) -> None:
        """Add the slot of a bucket to cr_node, before rows are written.

        If rows of the table expire, so does the entry, and it is written again every NOTE_SEC.
        Otherwise it is written once by each writer.
        """
        slot = (table.name, slot_of(bucket), node)
        # Rows found by name have no other entry in the directory, so this one never expires.
        ttl = 0 if table.named else table.metadata.ttl
        latest, now = self._noted.get(slot), time.monotonic()
        if latest is None or (ttl and now - latest > NOTE_SEC):
            self.add_node(*slot, ttl and ttl + NOTE_MARGIN_SEC)
            self._noted[slot] = now

    def mark(
        self,
        key: BucketKey,
        ttl: int,
        filled: Iterable[str] = (),
        totals: BucketTotals | None = None,
        *,
        closed: bool = False,
        deleted: bool = False,
    ) -> None:
        """Write a writer's counts of a bucket, with a new heartbeat, to cr_bucket and cr_active.

        Args:
            ttl: Lifetime of the table's rows, seconds; 0 = for ever.
            filled: Shadow columns that all of the writer's rows in the bucket have and will have.
            totals: Counts, final if closed, otherwise estimates. None = leave those of cr_bucket as
                they are, and write UNKNOWN to cr_active, which has all counts in one column.
            deleted: Only note that rows were deleted, so no count is final until the next recount.
                It is a separate column because a living writer closes the bucket with its own
                counts.
        """
        columns, active = _key_columns(key), _key_columns(key)
        if deleted:
            columns["deleted"] = active["deleted"] = True
        else:
            columns.update(state="closed" if closed else "open", filled=set(filled))
            columns.update(totals.columns() if totals is not None else {})
            counts = UNKNOWN if totals is None else tuple(totals.columns().values())
            active["entry"] = ActiveEntry(closed, counts, filled).encoded()
        entries = ((self._bucket_table, columns), (self._active_table, active))
        # One request, which is acknowledged when both are written; both get one write time.
        inserts = "; ".join(
            f"INSERT INTO {listing} ({', '.join(values)}, heartbeat) "
            f"VALUES ({', '.join('?' * len(values))}, toTimestamp(now())) USING TTL ?"
            for listing, values in entries
        )
        params = [value for _, values in entries for value in (*values.values(), _ttl(ttl))]
        what, retry_sec = "writing the directory of buckets", self._tables.retry_sec
        cql = f"BEGIN UNLOGGED BATCH {inserts}; APPLY BATCH"
        self._cassandra.execute(cql, params, what=what, retry_sec=retry_sec)

    def put_recount(self, table: str, row: BucketRow, totals: BucketTotals, ttl: int) -> bool:
        """Close a bucket that has no living writer; return whether that was done.

        It is not done if the bucket has changed since ``row`` was read, which must be by ``find``
        and before its data rows are counted: the heartbeat of cr_bucket tells.
        """
        columns = {"filled": set(row.filled), **totals.columns()}
        key = _key_columns((table, row.node, row.bucket, row.writer))
        rest = (
            "deleted = false, heartbeat = toTimestamp(now()) "
            f"WHERE {' AND '.join(f'{name} = ?' for name in key)}"
        )
        what = "closing a bucket in the directory"
        answer = self._cassandra.execute_once(
            f"UPDATE {self._bucket_table} USING TTL ? SET state = 'closed', "
            f"{''.join(f'{name} = ?, ' for name in columns)}{rest} IF heartbeat = ?",
            (_ttl(ttl), *columns.values(), *key.values(), row.heartbeat),
            what=what,
        )
        is_done = bool(answer[0][0])
        if is_done:
            entry = ActiveEntry(True, tuple(totals.columns().values()), row.filled).encoded()
            # Later than what was read, and earlier than each mark since, whose values then stay.
            self._cassandra.execute(
                f"UPDATE {self._active_table} USING TIMESTAMP ? AND TTL ? SET entry = ?, {rest}",
                (row.marked_us + 1, _ttl(ttl), entry, *key.values()),
                what=what,
                retry_sec=self._tables.retry_sec,
            )
        return is_done

    def put_by_time(self, table: str, row: BucketRow, ttl: int, since_us: int) -> None:
        """Write a row that was read from cr_bucket into cr_active, where it is missing or wrong.

        Args:
            ttl: Lifetime of the table's rows, seconds; 0 = for ever.
            since_us: Server time before the row was read, us: what was marked later stays.
        """
        columns = {
            **_key_columns((table, row.node, row.bucket, row.writer)),
            "entry": ActiveEntry(not row.writing, row.counts, row.filled).encoded(),
            "deleted": row.cut,
            "heartbeat": row.heartbeat,
        }
        self._cassandra.execute(
            f"INSERT INTO {self._active_table} ({', '.join(columns)}) "
            f"VALUES ({', '.join('?' * len(columns))}) USING TIMESTAMP ? AND TTL ?",
            (*columns.values(), since_us - int(CLOCKS_SEC * 10**6), _ttl(ttl)),
            what="writing the directory by time",
            retry_sec=self._tables.retry_sec,
        )

    def tables(self) -> set[str]:
        """Return the names of the tables with buckets, including dropped tables (a full scan)."""
        rows = self._tables.select("cr_node", "DISTINCT tbl", what="listing the directory")
        return {table for (table,) in rows}

    def delete_entries(self, table: str) -> None:
        """Delete all entries of a table that was dropped; may be repeated after an error."""
        slots = [(table, node, slot) for slot, node in self.nodes(table, *_EVER)]
        key = ("tbl", "node", "slot")
        self._tables.delete("cr_bucket", key, slots, "clearing the directory of buckets")
        by_time = sorted({(table, slot) for _, _, slot in slots})
        self._tables.delete("cr_active", ("tbl", "slot"), by_time, "clearing the directory")
        self.seen.pop(table, None)
        for reverse in (False, True):
            self.first.pop((table, reverse), None)
        # Last, because a repetition finds the slots by them.
        self._tables.delete("cr_node", ("tbl",), [(table,)], "clearing the directory")


class BucketWalk:
    """The buckets of one table in [first, last], in order of time, or newest first.

    Args:
        nodes: nodeIDs to read; None = all. With None it reads cr_active, otherwise cr_bucket.
        few: Whether probably only few of the buckets are needed.

    Attributes:
        met: Nodes found so far that have buckets; of a slot with many nodes perhaps only some.
    """

    def __init__(
        self,
        directory: Directory,
        table: str,
        metadata: TopicMetadata,
        first: int,
        last: int,
        nodes: Sequence[str] | None = None,
        *,
        reverse: bool = False,
        few: bool = False,
    ) -> None:
        self._directory = directory
        self._table = table
        self._ends = first, last
        self._nodes = nodes
        self._ttl = metadata.ttl
        self._reverse = reverse
        self._few = few
        self._by_time = nodes is None
        self.met: set[str] = set()

    def groups(self) -> Iterator[BucketGroup]:
        """Yield the buckets of all nodes in order of time, and in each those of its nodes.

        Buckets whose rows have all expired are left out. If few are needed, an empty group is
        yielded before each further request, so that the caller can stop without waiting for it.
        """
        limit = FEW_BUCKETS if self._few else ALL_ROWS
        slots = self._slots()
        next(slots, None)  # sends the request; an empty range has no slots
        # The first slot is mostly the same as last time: its buckets are requested at once.
        guess = self._guess_slot()
        early = None if guess is None else self._ask(guess, self._inside(guess), limit)
        has_begun = False
        for slot in slots:
            if slot is None:
                continue
            low, high = self._inside(slot)
            # Only for the first slot: later ones need a larger window.
            is_guessed = not has_begun and guess is not None and self._same(slot, guess)
            request = early if is_guessed else None
            while low <= high:
                if has_begun and self._few:
                    yield (high if self._reverse else low), []
                request = self._ask(slot, (low, high), limit) if request is None else request
                groups, end = self._window(request, low, high)
                yield from ((group[0].bucket, group) for group in groups)
                low, high = (low, end - 1) if self._reverse else (end + 1, high)
                limit, request, has_begun = min(ALL_ROWS, WIDER * limit), None, True

    def _same(self, slot: _Slot, other: _Slot) -> bool:
        """Return whether the buckets of two slots are requested in the same way."""
        return slot[0] == other[0] if self._by_time else slot == other

    def _inside(self, slot: _Slot) -> tuple[int, int]:
        """Return the first and the last bucket of a slot in the range of this walk."""
        begin = slot[0] * SLOT_BUCKETS
        return max(self._ends[0], begin), min(self._ends[1], begin + SLOT_BUCKETS - 1)

    def _slots(self) -> Iterator[_Slot | None]:
        """Yield None when the request was sent, then the slots in which the nodes have buckets."""
        first, last = slot_of(self._ends[0]), slot_of(self._ends[1])
        limit = FEW_SLOTS if self._few else ALL_ROWS
        while first <= last:
            ask = self._directory.begin_nodes
            answer = ask(self._table, (first, last), limit, reverse=self._reverse)
            yield None
            span, rows = range(first, last + 1), answer()
            slots = [(s, tuple(n for _, n in g)) for s, g in groupby(rows, lambda row: row[0])]
            if len(rows) < limit:
                first, last = 1, 0
            else:
                # Further nodes of the last slot may follow. By time its buckets are read without
                # them; otherwise it is listed again, from its first node on.
                cut, step = (slots[-1][0], 1) if self._by_time else (slots.pop()[0], 0)
                first, last = (first, cut - step) if self._reverse else (cut + step, last)
                limit = min(ALL_ROWS, WIDER * limit)
            if self._few:
                self._directory.keep_slots(self._table, span, slots)
            yield from [slot for slot in map(self._restrict, slots) if slot is not None]

    def _restrict(self, slot: _Slot) -> _Slot | None:
        """Leave out the nodes that are not to be read; return None if no node is left."""
        nodes = tuple(n for n in slot[1] if self._nodes is None or n in self._nodes)
        self.met.update(nodes)
        return (slot[0], nodes) if nodes else None

    def _guess_slot(self) -> _Slot | None:
        """Return the slot that is probably the first; None = unknown, or too many nodes to try."""
        first, last = slot_of(self._ends[0]), slot_of(self._ends[1])
        cache = self._directory.seen.get(self._table, {}) if self._few else {}
        inside = [(s, nodes) for s, nodes in cache.items() if first <= s <= last]
        if not inside:
            return None
        slot = self._restrict(max(inside) if self._reverse else min(inside))
        few = self._by_time or (slot is not None and len(slot[1]) <= REQUESTS_AT_ONCE)
        return slot if few else None

    def _ask(self, slot: _Slot, ends: tuple[int, int], limit: int) -> _Request:
        """Request the buckets of the nodes of a slot, several at once; ``limit`` for each node."""
        if self._by_time:
            limit = min(ALL_ROWS, limit * min(len(slot[1]), MANY_NODES))
            ask = self._directory.begin_active
            return iter([ask(self._table, slot[0], *ends, limit, reverse=self._reverse)]), limit
        params = [(self._table, node, slot[0], *ends) for node in slot[1]]
        requests = sent_ahead(
            self._directory.begin_buckets(params, limit, reverse=self._reverse), REQUESTS_AT_ONCE
        )
        first = next(requests, None)  # sends the requests
        return (iter(()) if first is None else chain((first,), requests)), limit

    def _window(self, request: _Request, low: int, high: int) -> tuple[list[Group], int]:
        """Return the next buckets, and the last bucket (included) up to which they are complete.

        That one lies outside of the range if the answer was cut off in the first bucket: then there
        are no buckets, and a larger answer is needed.
        """
        end = low if self._reverse else high
        answers, limit = request
        entries: list[BucketRow] = []
        for answer in answers:
            rows = answer()
            entries += rows
            if len(rows) == limit:
                # The answer was cut off, and further writers of its last bucket may follow.
                cut = rows[-1].bucket
                end = max(end, cut + 1) if self._reverse else min(end, cut - 1)
        groups: dict[tuple[int, str], Group] = {}
        for row in entries:
            inside = row.bucket >= end if self._reverse else row.bucket <= end
            if inside and not row.expired(self._ttl):
                groups.setdefault((row.bucket, row.node), []).append(row)
        return [groups[key] for key in sorted(groups, reverse=self._reverse)], end


def _key_columns(key: BucketKey) -> dict[str, object]:
    """Return the primary key of a row of cr_bucket: column → value."""
    table, node, bucket, writer = key
    slot = slot_of(bucket)
    return {"tbl": table, "node": node, "slot": slot, "bucket": bucket, "writer": writer}


def _ttl(ttl: int) -> int:
    """Return how long an entry stays, s: longer than the rows that it lists; 0 = for ever."""
    return ttl + TTL_MARGIN_SEC if ttl else 0


def _bucket_rows(node: str, answer: Callable[[], list[CqlRow]]) -> list[BucketRow]:
    """Wait for rows of cr_bucket of one node and return them."""
    return [_bucket_row(node, row) for row in answer()]


def _bucket_row(node: str, row: CqlRow) -> BucketRow:
    """Return a row of cr_bucket."""
    bucket, writer, state, deleted, beat, n, size, largest, t_min, t_max, odd, filled, *times = row
    closed = state == "closed" and not deleted
    latest = -1 if t_max is None else t_max
    counts = (n or 0, size or 0, largest or 0, t_min or 0, latest, odd or 0)
    now, marked_us = times
    head = node, bucket, writer, closed, beat, *counts, _age(beat, now), frozenset(filled or ())
    return BucketRow(*head, state == "open", bool(deleted), marked_us or 0)


def _active_row(row: CqlRow) -> BucketRow:
    """Return a row of cr_active."""
    bucket, node, writer, entry, deleted, beat, now = row
    closed, counts, filled = ActiveEntry(False) if entry is None else decode_entry(entry)
    n, size, largest, t_min, t_max, odd = counts
    head = node, bucket, writer, closed and not deleted, beat, n, size, largest, t_min, t_max, odd
    writing = entry is not None and not closed
    return BucketRow(*head, _age(beat, now), frozenset(filled), writing, bool(deleted))


def _age(heartbeat: datetime | None, now: datetime) -> float:
    """Return the time since a heartbeat, s; without a heartbeat one that counts as stale."""
    return STALE_SEC + 1 if heartbeat is None else (now - heartbeat).total_seconds()
