# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Check of the store: everything is read back and compared.

The check reads the messages of each bucket, with the checksums of blocks and of large messages, the
zones of blocks, and the connections and definitions to which rows refer. Counts and times are
compared with the directory if no client is writing. A row that cannot come from any message is
damage. A changed number in a column of the formats ``ros``, ``json`` or ``yaml`` cannot be told
from a stored one.
"""

from __future__ import annotations

import logging
from collections import Counter
from dataclasses import dataclass, field
from enum import Enum
from typing import Callable, NamedTuple, Sequence
from typing import Counter as Counts

from cassandra_ros.errors import CorruptMessage, DefinitionError, MessageNotFound, TopicNotFound
from cassandra_ros.read import TimeRange
from cassandra_ros.store.blocks.block_row import WHOLE_BLOCK_COLUMNS, Block, BlockRow, read_block
from cassandra_ros.store.connection.cql_names import quote_name
from cassandra_ros.store.connection.requests import RawRow
from cassandra_ros.store.rows.fetch import fetch_row, list_names
from cassandra_ros.store.rows.layouts import layout_of
from cassandra_ros.store.rows.orphans import old_us, orphans, partitions, remove_orphans, rows_at
from cassandra_ros.store.tables.directory import (
    STALE_SEC,
    BucketKey,
    BucketRow,
    BucketTotals,
    slot_of,
)
from cassandra_ros.store.tables.row_table import ALL, TableRow, Zones, decode_long, encode_texts
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.stored_row import read_wire
from cassandra_ros.topics.stored_totals import group_by_bucket
from cassandra_ros.topics.topic_table import TopicTable
from cassandra_ros.topics.upkeep.table_copy import Progress

_log = logging.getLogger(__name__)

PAGE_BYTES = 2 * 1024 * 1024
"""Approximate size of a page of rows, bytes."""
MAX_PAGE_ROWS = 1000
BLOCKS_AT_ONCE = 8
"""Number of blocks of a page."""
_ZONES_AT = WHOLE_BLOCK_COLUMNS.count(",") + 1
"""Index of the first column after those of WHOLE_BLOCK_COLUMNS."""
MAX_DAMAGES = 10_000
"""Maximum number of damages that are listed. Further ones are only counted."""


class DamageKind(str, Enum):
    """Kind of a damage."""

    MESSAGE = "message"
    """A message, or a block, cannot be read."""
    CONNECTION = "connection"
    """The connection of messages is missing."""
    DEFINITION = "definition"
    """A definition, or the comment of a table, was changed by hand."""
    COUNT = "count"
    """The directory has other counts or times than the rows."""
    BOUNDS = "bounds"
    """The zones of a block do not hold for its messages."""
    UNLISTED = "not listed"
    """Messages are in no directory."""
    ORPHAN = "orphan"
    """Chunks have no message."""
    LEFTOVER = "leftover"
    """The directory lists a table that does not exist."""


@dataclass(frozen=True)
class Damage:
    """One thing that is not as it was stored, or not as the directory says."""

    kind: DamageKind
    topic: str
    """Name of the topic; '' = no existing topic."""
    table: str
    node: str
    first_ns: int | None
    """Key times between which the damage is, both included; None = no time range."""
    last_ns: int | None
    messages: int
    """Number of affected messages, as far as it is known."""
    text: str
    """What is wrong, and what to do if it was not mended."""
    mended: bool = False


@dataclass
class CheckReport:
    """Numbers of what was read, and the damages."""

    messages: int = 0
    """Number of messages that could be read."""
    bytes: int = 0
    buckets: int = 0
    writing: int = 0
    """Buckets that are open, or in which messages were deleted, for less than a minute: the
    directory has no final counts of them to compare."""
    unsummed: int = 0
    """Messages in rows of their own, which have no checksum and were only decoded."""
    damages: list[Damage] = field(default_factory=list)
    """The first MAX_DAMAGES damages."""
    found: int = 0
    """Number of all damages."""
    mended: int = 0

    @property
    def left(self) -> int:
        """Number of damages that were not mended."""
        return self.found - self.mended

    def count(self, messages: int, nbytes: int) -> None:
        """Count messages that could be read."""
        self.messages += messages
        self.bytes += nbytes

    def add(self, damage: Damage) -> None:
        """Add a damage."""
        self.found += 1
        self.mended += damage.mended
        if len(self.damages) < MAX_DAMAGES:
            self.damages.append(damage)


def check_store(
    catalog: Catalog,
    topics: Sequence[str] | None,
    time_range: TimeRange,
    repair: bool = False,
    progress: Progress = None,
) -> CheckReport:
    """Read topics back, None = the whole keyspace; see Upkeep.check."""
    work = _Check(catalog, time_range, repair, progress)
    names = [topic.name for topic in catalog.all(None)] if topics is None else topics
    for name in dict.fromkeys(catalog.get(topic).name for topic in names):
        work.topic(name)
    work.definitions({table.metadata.md5sum for table in work.tables}, everything=topics is None)
    if topics is None and time_range == TimeRange():
        work.leftovers()
    return work.report


class _Pages(NamedTuple):
    """How the rows of a bucket are read and checked."""

    names: str
    """Columns to read, as CQL, beginning with those of the key."""
    rows: int
    """Number of rows of a page."""
    check: Callable[[RawRow], None]
    """Checks a row; raises CorruptMessage."""
    extent: Callable[[RawRow], tuple[int, int, int]]
    """Returns the first and the last key time of a damaged row, ns, and its number of messages."""


class _Check:
    """Reads topics back, one after the other."""

    def __init__(
        self, catalog: Catalog, time_range: TimeRange, repair: bool, progress: Progress
    ) -> None:
        self._catalog = catalog
        self._space = catalog.keyspace
        self._time_range = time_range
        self._repair = repair
        self._progress = progress
        self.report = CheckReport()
        self.tables: list[TopicTable] = []
        self._conns: Counts[int] = Counter()
        """Connection → number of its messages in the table that is being read."""

    def topic(self, name: str) -> None:
        """Read all tables of a topic."""
        try:
            tables = self._catalog.get(name).tables
        except DefinitionError as exc:
            self._note_general(DamageKind.DEFINITION, name, "", str(exc))
            return
        for table in tables:
            self.tables.append(table)
            try:
                self._table(table)
            except TopicNotFound:
                _log.warning("topic %s was removed or converted while it was checked", name)

    def _table(self, table: TopicTable) -> None:
        self._conns = Counter()
        if table.named:
            self._names(table)
        else:
            self._buckets(table)
        self._connections(table)
        self._orphans(table)

    def _buckets(self, table: TopicTable) -> None:
        """Read the buckets of a table, those that the directory does not list too."""
        low, high = (table.bucket_of(t) for t in self._time_range)
        entries = self._space.directory.buckets_by_robot(table.name, low, high)  # see _by_time
        groups = group_by_bucket(entries)
        for node, where in partitions(table):
            if low <= int(where) <= high:
                groups.setdefault((node, int(where)), [])
        total = sum(row.rows for row in entries)
        for (node, bucket), rows in sorted(groups.items()):
            self.report.buckets += 1
            self._read(table, node, bucket, rows, total)
            self._compare(table, node, bucket)
        self._slots(table, set(groups))
        self._by_time(table, low, high)

    def _read(
        self, table: TopicTable, node: str, bucket: int, rows: list[BucketRow], total: int
    ) -> None:
        """Read the messages of a bucket.

        Args:
            rows: Its entries in the directory, from which the size of a page is estimated.
            total: Number of messages of the table by the directory, for the progress.
        """
        if table.packed:
            pages = self._block_pages(table, node)
        else:
            pages = self._message_pages(table, node, rows)
        request = table.select_range(
            pages.names,
            table.partition_key(node, bucket),
            page_rows=min(pages.rows, MAX_PAGE_ROWS),
            what="checking",
        )
        for values in request.rows():
            if table.is_rest(values):
                continue
            try:
                pages.check(values)
            except CorruptMessage as exc:
                t, last, lost = pages.extent(values)
                key = t, decode_long(values[1])
                # Otherwise it was deleted meanwhile.
                if rows_at(table, table.partition_key(node, bucket), key):
                    ends = t, max(t, last)
                    self._note(DamageKind.MESSAGE, table, node, ends, lost, str(exc))
            self._tell(total)

    def _message_pages(self, table: TopicTable, node: str, rows: list[BucketRow]) -> _Pages:
        """Return how the rows of a bucket are read, each of which holds a message."""
        count, size = sum(row.rows for row in rows), sum(row.bytes for row in rows)

        def extent(values: RawRow) -> tuple[int, int, int]:
            t = decode_long(values[0])
            return t, t, 1

        return _Pages(
            table.listing(),
            PAGE_BYTES * count // (size + 1) + 1,
            lambda values: self._message(table, table.row_from_values(node, values)),
            extent,
        )

    def _block_pages(self, table: TopicTable, node: str) -> _Pages:
        """Return how the rows of a bucket are read, each of which holds a block."""
        return _Pages(
            ", ".join([WHOLE_BLOCK_COLUMNS, '"_nan"', *map(quote_name, table.zone_columns)]),
            BLOCKS_AT_ONCE,
            lambda values: self._block(table, node, read_block(table, values), values[_ZONES_AT:]),
            lambda values: (decode_long(values[0]), decode_long(values[4]), decode_long(values[5])),
        )

    def _message(self, table: TopicTable, row: TableRow) -> None:
        """Read a message that has its own row; raises CorruptMessage."""
        self._conns[row.conn] += 1
        try:
            wire = read_wire(table, row)
        except MessageNotFound:
            return  # removed meanwhile
        if not row.nchunks:
            self.report.unsummed += 1
        self.report.count(1, len(wire))

    def _block(self, table: TopicTable, node: str, row: BlockRow | None, bounds: RawRow) -> None:
        """Read a block, and compute its zones again; raises CorruptMessage.

        Args:
            bounds: Values of ``_nan`` and of the zone columns.
        """
        if row is None or not row.left:
            return
        self._conns[row.conn] += row.left
        block = Block(table, node, row)
        places = block.between(*ALL)
        if block.unpacked is None:
            (only,) = block.rows(places)
            wires: Sequence[bytes] = [read_wire(table, only)]
        else:
            wires = block.unpacked.wires()
        self.report.count(len(places), int(block.sizes[places].sum()))
        self._bounds(table, node, row, bounds, table.format.zones(wires))

    def _bounds(
        self, table: TopicTable, node: str, row: BlockRow, row_values: RawRow, measured: Zones
    ) -> None:
        """Report zones that differ from the messages, because conditions skip blocks by them."""
        values, nan, odd = measured
        block_values = (encode_texts(nan) if nan else None, *values)
        if row.odd or (row_values == block_values and not odd):
            return  # conditions do not skip an odd block
        names = ("_nan", *table.zone_columns)
        wrong = [name for name, *pair in zip(names, row_values, block_values) if pair[0] != pair[1]]
        self._note(
            DamageKind.BOUNDS,
            table,
            node,
            (row.t, max(row.t, row.last)),
            row.messages,
            f"{', '.join(wrong) or '_odd'} of a block of {row.messages} messages is not what they "
            "hold, so conditions may leave them out; cassandra_bag convert to another format and "
            "back measures it anew",
        )

    def _tell(self, total: int) -> None:
        """Call the progress function; the total is that of the present table."""
        if self._progress is not None:
            self._progress(self.report.messages, max(total, self.report.messages))

    def _compare(self, table: TopicTable, node: str, bucket: int) -> None:
        """Compare the rows of a bucket with the directory."""
        directory = self._space.directory
        before = directory.find(table.name, node, bucket)
        try:
            recounts = layout_of(table).recount(node, bucket)
        except CorruptMessage:
            return  # reported when the bucket was read
        after = directory.find(table.name, node, bucket)
        if list(map(_sign, after)) != list(map(_sign, before)):  # a client changed it meanwhile
            self.report.writing += 1
            return
        by_writer = {row.writer: row for row in before}
        for writer in sorted({*recounts, *by_writer}):
            totals, row = recounts.get(writer, BucketTotals()), by_writer.get(writer)
            if row is None:
                self._report_unlisted(table, (table.name, node, bucket, writer), totals)
            elif not row.closed:
                self._count_open_bucket(table, row, totals)
            elif not table.metadata.ttl and not _agrees(row, totals):
                self._report_count(table, row, totals)

    def _slots(self, table: TopicTable, places: set[tuple[str, int]]) -> None:
        """Report robots whose buckets no reader finds, because cr_node does not list them.

        Args:
            places: Node and number of each bucket that was read.
        """
        directory, length = self._space.directory, table.metadata.bucket_ns
        buckets_of_slots: dict[tuple[int, str], list[int]] = {}
        for node, bucket in places:
            buckets_of_slots.setdefault((slot_of(bucket), node), []).append(bucket)
        slots = [slot for slot, _ in buckets_of_slots]
        slots_of_nodes = directory.nodes(table.name, min(slots), max(slots)) if slots else []
        for slot, node in sorted(set(buckets_of_slots).difference(slots_of_nodes)):
            buckets = buckets_of_slots[slot, node]
            if self._repair:
                directory.add_node(table.name, slot, node)
            self._note(
                DamageKind.UNLISTED,
                table,
                node,
                (min(buckets) * length, (max(buckets) + 1) * length - 1),
                0,
                f"{len(buckets)} buckets of node {node!r} are in no directory, so no reader finds "
                "them; --repair lists them",
                mended=self._repair,
            )

    def _by_time(self, table: TopicTable, low: int, high: int) -> None:
        """Report buckets that cr_active does not list as cr_bucket does.

        They have been compared with the rows, so what differs is wrong in cr_active.
        """
        directory, ends, ttl = self._space.directory, (table.name, low, high), table.metadata.ttl
        active = {_entry(row): row for row in directory.buckets_by_time(*ends)}
        for entry in directory.buckets_by_robot(*ends):
            if entry.expired(ttl) or not _differs(entry, active.get(_entry(entry))):
                continue
            # A client may have opened or closed the bucket between the two reads.
            place = table.name, entry.node, entry.bucket
            since_us = self._space.cassandra.server_time_us()
            before = {row.writer: row for row in directory.find_active(*place)}
            now = [row for row in directory.find(*place) if row.writer == entry.writer]
            after = {row.writer: row for row in directory.find_active(*place)}
            for row in now:
                if all(_differs(row, rows.get(row.writer)) for rows in (before, after)):
                    self._put_by_time(table, row, since_us, listed=row.writer in after)

    def _put_by_time(
        self, table: TopicTable, row: BucketRow, since_us: int, *, listed: bool
    ) -> None:
        """Report, and repair, an entry of cr_active that is missing or (listed) has other counts.

        Args:
            row: The entry of cr_bucket.
            since_us: Server time before it was read, us.
        """
        directory, mended = self._space.directory, False
        if self._repair:
            directory.put_by_time(table.name, row, table.metadata.ttl, since_us)
            entries = directory.find_active(table.name, row.node, row.bucket)
            mended = not _differs(row, next((r for r in entries if r.writer == row.writer), None))
        fault = "has other counts" if listed else "is missing"
        self._note(
            DamageKind.COUNT if listed else DamageKind.UNLISTED,
            table,
            row.node,
            (row.t_min, row.t_max) if row.rows else None,
            row.rows,
            f"the entry of {row.rows} messages of writer {row.writer} {fault} in the directory by "
            "time, so reads of all robots may miss them; --repair puts the directory right",
            mended=mended,
        )

    def _count_open_bucket(self, table: TopicTable, row: BucketRow, totals: BucketTotals) -> None:
        """Count a bucket that is not closed; that its counts are estimates is not damage.

        With --repair one without a living writer is closed with its true counts.
        """
        if row.age_sec <= STALE_SEC:
            self.report.writing += 1
        elif self._repair:
            self._space.directory.put_recount(table.name, row, totals, table.metadata.ttl)

    def _report_unlisted(self, table: TopicTable, key: BucketKey, totals: BucketTotals) -> None:
        """Report messages that the directory does not list, so that no reader finds them."""
        _, node, _, writer = key
        if self._repair:
            self._space.directory.mark(key, table.metadata.ttl, (), totals, closed=True)
        self._note(
            DamageKind.UNLISTED,
            table,
            node,
            (totals.t_min, totals.t_max),
            totals.rows,
            f"{totals.rows} messages of writer {writer} are in no directory, so no reader finds "
            "them; --repair lists them",
            mended=self._repair,
        )

    def _report_count(self, table: TopicTable, row: BucketRow, totals: BucketTotals) -> None:
        """Report, and repair, counts of a closed bucket that differ from its rows."""
        directory, ttl = self._space.directory, table.metadata.ttl
        mended = self._repair and directory.put_recount(table.name, row, totals, ttl)
        length = table.metadata.bucket_ns
        self._note(
            DamageKind.COUNT,
            table,
            row.node,
            (row.bucket * length, (row.bucket + 1) * length - 1),
            abs(row.rows - totals.rows),
            f"the directory says {_counts(row.rows, row.bytes, row.t_min, row.t_max)} of writer "
            f"{row.writer}, and there are {_counts(totals.rows, totals.bytes, *_ends(totals))}; "
            "--repair puts the directory right. Were there more, import or record them again",
            mended=mended,
        )

    def _names(self, table: TopicTable) -> None:
        """Read the messages of a topic whose messages have names."""
        keys = [k for k in list_names(table, None) if _within(k.position.t, self._time_range)]
        nodes = {node for _, node in self._space.directory.nodes(table.name, 0, 0)}
        missing: Counts[str] = Counter()
        for key in sorted(keys, key=lambda key: key.position):
            t, node = key.position.t, key.position.node
            missing[node] += node not in nodes
            # As in ``_read``: what cannot be read is damage only if it is still there.
            try:
                row = fetch_row(table, key.position)
                if row is not None:
                    self._message(table, row)
            except CorruptMessage as exc:
                place = table.partition_key(node, key.position.name)
                if rows_at(table, place, table.stored_order(t, key.position.seq)):
                    self._note(DamageKind.MESSAGE, table, node, (t, t), 1, str(exc))
            self._tell(len(keys))
        for node, count in sorted((+missing).items()):
            if self._repair:
                self._space.directory.add_node(table.name, 0, node)
            text = f"{count} messages of node {node!r} are in no directory; --repair lists it"
            self._note(DamageKind.UNLISTED, table, node, None, count, text, mended=self._repair)

    def _connections(self, table: TopicTable) -> None:
        """Report connections to which messages refer, and which are missing."""
        for conn, count in sorted(self._conns.items()):
            try:
                self._space.connections.get(table.name, conn)
            except CorruptMessage as exc:
                self._note(DamageKind.CONNECTION, table, "", None, count, str(exc))

    def _orphans(self, table: TopicTable) -> None:
        """Report chunks without a message, which a client left that died."""
        space = self._space
        until_us = old_us(space.cassandra)
        all_orphans = orphans(space.cassandra, space.name, table, until_us)
        in_range = [o for o in all_orphans if table.named or _within(o.t, self._time_range)]
        if not in_range:
            return
        if self._repair:
            remove_orphans(space.cassandra, table, in_range, until_us)
        times = [orphan.t for orphan in in_range]
        self._note(
            DamageKind.ORPHAN,
            table,
            "",
            None if table.named else (min(times), max(times)),
            len(in_range),
            f"pieces of {len(in_range)} large messages lie there without a message: the "
            "client that wrote them died; --repair deletes them",
            mended=self._repair,
        )

    def definitions(self, md5sums: set[str], *, everything: bool) -> None:
        """Compare the texts of the definitions with their checksums.

        Args:
            md5sums: Definitions of the tables that were read; only these are reported, unless
                ``everything`` is set.
        """
        for md5sum in self._space.registry.damaged_definitions():
            if everything or md5sum in md5sums:
                topics = {t.metadata.topic for t in self.tables if t.metadata.md5sum == md5sum}
                text = (
                    f"the definition with md5sum {md5sum} was changed by hand; import or record "
                    "again what uses it"
                )
                self._note_general(DamageKind.DEFINITION, ", ".join(sorted(topics)), "", text)

    def leftovers(self) -> None:
        """Report entries of tables that do not exist, and tables whose comment is not readable."""
        space = self._space
        names = space.directory.tables() | space.registry.tables()
        # A node that has just started may not have heard of a new table yet.
        space.cassandra.await_same_schema("checking the list of tables")
        listing = space.schema.listing(fresh=True)
        rows = space.cassandra.system_schema("tables", "table_name", space.name)
        existing = {name for (name,) in rows}
        # Entries of tables that a conversion has replaced stay until the next conversion.
        replaced = {old for metadata in listing.every.values() for old in metadata.replaces}
        for table in sorted(names.difference(listing.every, replaced)):
            if table in existing:
                text = (
                    f"the comment of table {table} was changed by hand or by another program: put "
                    "it right to read its messages again"
                )
                self._note_general(DamageKind.DEFINITION, "", table, text)
                continue
            if self._repair:
                space.delete_entries(table)
            text = (
                f"the directory knows a table {table} that was dropped: the "
                "client that removed its topic died; --repair forgets it"
            )
            self._note_general(DamageKind.LEFTOVER, "", table, text, mended=self._repair)

    def _note(
        self,
        kind: DamageKind,
        table: TopicTable,
        node: str,
        ends: tuple[int, int] | None,
        messages: int,
        text: str,
        mended: bool = False,
    ) -> None:
        """Add a damage of a table to the report."""
        topic, (first, last) = table.metadata.topic, ends or (None, None)
        damage = Damage(kind, topic, table.name, node, first, last, messages, text, mended)
        self.report.add(damage)

    def _note_general(
        self, kind: DamageKind, topic: str, table: str, text: str, mended: bool = False
    ) -> None:
        """Add a damage that does not concern messages of one table."""
        self.report.add(Damage(kind, topic, table, "", None, None, 0, text, mended))


def _within(t: int, time_range: TimeRange) -> bool:
    return time_range.low <= t <= time_range.high


def _entry(row: BucketRow) -> tuple[str, int, int]:
    """Return the key of an entry of the directory in its table."""
    return row.node, row.bucket, row.writer


def _differs(row: BucketRow, active: BucketRow | None) -> bool:
    """Return whether an entry by time is missing, or has other final counts."""
    return active is None or (active.closed and (not row.closed or row.counts != active.counts))


def _sign(row: BucketRow) -> tuple[int, bool, object]:
    """Return what changes in the directory when a client writes to a bucket or deletes in it."""
    return row.writer, row.closed, row.heartbeat


def _agrees(row: BucketRow, totals: BucketTotals) -> bool:
    """Return whether an entry of the directory has the counts of its rows."""
    if not (row.rows or totals.rows):
        return True
    counts, ends = (row.rows, row.bytes, row.t_min, row.t_max), _ends(totals)
    # A higher number of odd messages is harmless: readers only check more of them.
    return counts == (totals.rows, totals.bytes, *ends) and row.odd >= totals.odd


def _ends(totals: BucketTotals) -> tuple[int, int]:
    return (totals.t_min, totals.t_max) if totals.rows else (0, 0)


def _counts(rows: int, size: int, first: int, last: int) -> str:
    return f"{rows} messages, {size} bytes" + (f" from {first} to {last}" if rows else "")
