# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rows found by their keys: one by one, by a name, or by the value of an indexed field.

Names have no order in Cassandra. A read of all rows in order first lists their keys: a scan of the
whole table, and some 300 bytes of memory a message.
"""

from __future__ import annotations

import heapq
from typing import Callable, Collection, Iterable, Iterator, NamedTuple, Sequence

from cassandra.cluster import ResultSet
from cassandra.query import BoundStatement

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.keys import Position
from cassandra_ros.store.connection.protocol import RawPage
from cassandra_ros.store.connection.requests import RawRow, sent_ahead
from cassandra_ros.store.rows.layouts import layout_of
from cassandra_ros.store.tables.checksum import crc32
from cassandra_ros.store.tables.directory import FEW_NODES, BucketRow, Directory, slot_of
from cassandra_ros.store.tables.row_table import (
    FIRST,
    LAST,
    RowTable,
    SentRequest,
    TableRow,
    bind,
    decode_long,
    encode_int,
)
from cassandra_ros.store.tables.table_layout import Answer, Finder, Side

FETCHED_ROWS_AHEAD = 16
"""Number of rows that are requested ahead when rows are fetched by their keys."""
KEY_PAGE_ROWS = 5000
"""Maximum number of keys in a page."""
_PAGE_CHUNKS = 8
VERSION_PAGE_ROWS = 16
"""Maximum number of rows of one name in a page."""
ONE_QUERY_KEYS = 1000
"""Maximum number of keys that are fetched by one query over the whole table and sorted here."""


class RowKey(NamedTuple):
    """Table and position of a row to be fetched."""

    table: RowTable
    position: Position


def fetch_rows(keys: Iterable[RowKey]) -> Iterator[TableRow]:
    """Yield rows in the given order; rows that were deleted meanwhile are left out.

    Raises:
        CorruptMessage: A row, or the block that holds it, is damaged.
    """
    finders: dict[str, Finder] = {}

    def sent(key: RowKey) -> Answer:
        name = key.table.name
        if name not in finders:
            finders[name] = layout_of(key.table).finder()
        return finders[name](key.position)

    for answer in sent_ahead(map(sent, keys), FETCHED_ROWS_AHEAD):
        row = answer()
        if row is not None:
            yield row


def fetch_row(table: RowTable, position: Position) -> TableRow | None:
    """Return one row by its position, None if there is no such row: one SELECT.

    Raises:
        CorruptMessage: The row, or the block that holds it, is damaged.
    """
    return layout_of(table).ask(position)()


def first_at(
    directory: Directory, tables: Sequence[RowTable], t: int, nodes: Sequence[str] | None
) -> TableRow | None:
    """Return the first row with exactly this key time, ns, in the order (node, seq, table).

    First the nodes that are known to write to a table are asked: one round trip. If they have no
    row, the directory is asked for other nodes, so no row is missed. If two nodes have a row with
    this time, one that this process has not met yet is not preferred, even if it is first in order.
    Of a table that many nodes write to, the directory is asked first.
    """
    probable = [
        (table, node)
        for table in tables
        for node in sorted(_probable(table) if nodes is None else nodes)
    ]
    row = _best(probable, t)
    if row is not None or nodes is not None:
        return row
    others: list[tuple[RowTable, str]] = []
    for table, list_nodes in [(table, _begin_listing(directory, table, t)) for table in tables]:
        all_nodes = list_nodes()
        asked_nodes = {node for other, node in probable if other is table}
        others.extend((table, node) for node in sorted(all_nodes - asked_nodes))
        table.known_nodes.update(all_nodes)
    return _best(others, t)


def _probable(table: RowTable) -> Collection[str]:
    """Return the nodes that are asked before the directory tells which have rows."""
    return table.known_nodes if len(table.known_nodes) <= FEW_NODES else ()


def _begin_listing(directory: Directory, table: RowTable, t: int) -> Callable[[], set[str]]:
    """Request the nodes that may have rows with a key time; return what waits for the answer."""
    bucket = table.bucket_of(t)
    rows = directory.begin_active(table.name, slot_of(bucket), bucket, bucket)
    return lambda: {r.node for r in rows() if not r.closed or r.t_min <= t <= r.t_max}


def _best(table_nodes: list[tuple[RowTable, str]], t: int) -> TableRow | None:
    """Return the first row with a key time of some tables and nodes, asked at the same time."""
    answers = [
        layout_of(table).ask(Position(t, node, 0, table.name), any_seq=True)
        for table, node in table_nodes
    ]
    rows = [row for row in [answer() for answer in answers] if row is not None]
    return min(rows, key=lambda row: row[:4], default=None)


def beside(
    directory: Directory,
    tables: Sequence[RowTable],
    t: int,
    nodes: Sequence[str] | None,
    ways: Sequence[bool],
) -> list[TableRow] | None:
    """Return the rows nearest to a time, ns, in one or two round trips; None if that did not work.

    The nodes that were writing at this time are asked for rows of the bucket of this time, while
    the directory is asked whether there are other nodes.

    Args:
        nodes: nodeIDs of the robots; None = all.
        ways: Directions, one for each row: False = at or after the time, True = at or before it.

    Returns:
        One row for each way; of several rows with the same time the first. None if a nearer row may
        lie in another bucket, or the nodes in the cache were not all.
    """
    sides_of_way: list[list[Side]] = [[] for _ in ways]

    def ask(table: RowTable, some_nodes: Iterable[str], way: int) -> None:
        layout = layout_of(table)
        sides_of_way[way] += [layout.ask_side(node, t, reverse=ways[way]) for node in some_nodes]

    # The nodes that were asked, and what waits for those that the directory lists.
    slots: list[tuple[Sequence[str], Callable[[], Sequence[str]]]] = []
    # Tables of which the directory is asked first.
    buckets: list[tuple[RowTable, Callable[[], list[BucketRow]]]] = []
    for table in tables:
        bucket = table.bucket_of(t)
        cached_nodes = nodes or ()
        if nodes is None:
            if not directory.has_few_nodes(table.name, slot_of(bucket)):
                buckets.append((table, directory.begin_bucket(table.name, bucket)))
                continue
            cached_nodes, answer = directory.begin_slot(table.name, slot_of(bucket))
            slots.append((cached_nodes, answer))
        for way in range(len(ways)):
            ask(table, cached_nodes, way)
    for table, answer_rows in buckets:
        rows = answer_rows()
        for way, reverse in enumerate(ways):
            ask(table, sorted(_nearest(table, rows, t, reverse)), way)
    if any(set(cached_nodes) != set(answer()) for cached_nodes, answer in slots):
        return None
    nearest_rows = [_best_side(*pair) for pair in zip(sides_of_way, ways)]
    low = max(table.bucket_of(t) * table.metadata.bucket_ns for table in tables)
    high = min((table.bucket_of(t) + 1) * table.metadata.bucket_ns for table in tables)
    # Outside of this range another table may have a nearer row in its next bucket.
    sure_rows = [row for row in nearest_rows if row is not None and low <= row.t < high]
    return sure_rows if len(sure_rows) == len(ways) else None


def _nearest(table: RowTable, rows: Sequence[BucketRow], t: int, reverse: bool) -> set[str]:
    """Return the nodes of which one has the nearest row to a time, by the rows of one bucket.

    Args:
        reverse: False = at or after the time, True = at or before it.
    """
    sign = -1 if reverse else 1
    # Near end, far end and node of each entry, times counted in the direction of reading. A closed
    # bucket has a message between both ends, so a node whose near end is beyond the least far end
    # of all has no nearer one.
    ends: list[tuple[int, int, str]] = []
    for row in rows:
        first, last = sorted((sign * row.t_min, sign * row.t_max))
        if not row.closed or table.metadata.ttl:
            ends.append((sign * t, 2**63, row.node))  # where its messages are is not known
        elif row.rows and last >= sign * t:
            ends.append((max(first, sign * t), first if first >= sign * t else last, row.node))
    least_far = min((far for _, far, _ in ends), default=0)
    return {node for near, _, node in ends if near <= least_far}


def _best_side(sides: Sequence[Side], reverse: bool) -> TableRow | None:
    """Return the nearest row of all nodes; None if there is no row, or the first is not known."""
    rows: list[TableRow] = []
    for side in sides:
        first = side()
        if first is None:
            return None
        rows += first
    return min(rows, key=lambda r: (-r.t if reverse else r.t, *r[1:4]), default=None)


def _select_chunks(table: RowTable, row: TableRow) -> BoundStatement:
    return bind(table.select_chunks(), table.key_of(row), _PAGE_CHUNKS)


def ask_chunks(table: RowTable, row: TableRow) -> SentRequest:
    """Request the chunks of a large message, for read_chunks."""
    return table.begin(_select_chunks(table, row))


def read_chunks(table: RowTable, row: TableRow, sent: SentRequest | None = None) -> bytes:
    """Return the bytes of a large message.

    Args:
        sent: Result of ask_chunks; None = the chunks have not been requested yet.

    Raises:
        CorruptMessage: They do not match its row.
    """

    def data_of(rows: ResultSet) -> list[bytes]:
        """Return the chunks up to the first that is missing."""
        chunks: list[bytes] = []
        for number, data in _views(rows):
            if number != encode_int(len(chunks)) or len(chunks) >= row.nchunks:
                break
            chunks.append(data or b"")
        return chunks

    what = "reading a large message of"
    chunks = table.collect(_select_chunks(table, row), data_of, what, sent=sent)
    wire = b"".join(chunks)
    if len(chunks) != row.nchunks or len(wire) != row.size or crc32(wire) != row.crc:
        raise CorruptMessage(
            f"the message of topic {table.metadata.topic} at {row.t} is incomplete: "
            f"{len(chunks)} of {row.nchunks} chunks, {len(wire)} of {row.size} bytes"
            f"{'' if len(wire) != row.size else ', wrong checksum'}; repair the cluster, or "
            "import or record it again"
        )
    return wire


def _views(rows: ResultSet) -> Iterator[RawRow]:
    """Yield the rows of all pages; the bytes of wide rows are not copied."""
    while True:
        page = rows.current_rows
        yield from page.views() if isinstance(page, RawPage) else page
        if not rows.has_more_pages:
            return
        rows.fetch_next_page()


class NamedKey(NamedTuple):
    """Key of a row with a name, and what a count needs of the row."""

    position: Position
    size: int
    chunked: bool
    odd: bool


def list_names(table: RowTable, nodes: Sequence[str] | None) -> list[NamedKey]:
    """Return the keys of all rows of a table whose rows have names, in no order.

    Args:
        nodes: The nodeIDs; None = all.
    """

    def keys(rows: Iterable[RawRow]) -> list[NamedKey]:
        named_keys = (_named_key(values, table.name) for values in rows)
        return [key for key in named_keys if nodes is None or key.position.node in nodes]

    statement = bind(table.select_names(), (), KEY_PAGE_ROWS)
    return table.collect(statement, keys, "listing the names of")


def some_names(table: RowTable, count: int) -> tuple[list[NamedKey], bool]:
    """Return the keys of some rows of a table whose rows have names, and whether there are no more.

    Args:
        count: Maximum number of keys, from 1.
    """
    request = table.send(bind(table.select_names(), (), count), "listing some names of")
    rows = request.page()
    return [_named_key(values, table.name) for values in rows], not request.more


def _named_key(values: RawRow, table: str) -> NamedKey:
    """Return a key from the values of select_names."""
    node, name, t, seq, size, nchunks, odd, *received = values
    # Two columns where equal messages are stored once, whose ``_t`` and ``_seq`` are 0.
    t, seq = received or (t, seq)
    texts = (node or b"").decode(), (name or b"").decode()
    position = Position(decode_long(t), texts[0], decode_long(seq), table, texts[1])
    return NamedKey(position, decode_long(size), nchunks is not None, odd is not None)


def versions(
    table: RowTable, name: str, nodes: Sequence[str], *, reverse: bool = False
) -> Iterator[TableRow]:
    """Yield the rows of one name and several nodes in order of time, or newest first."""
    streams = [_versions_of(table, name, node, reverse) for node in nodes]
    return heapq.merge(*streams, key=lambda row: row.position, reverse=reverse)


def _versions_of(table: RowTable, name: str, node: str, reverse: bool) -> Iterator[TableRow]:
    request = table.select_range(
        table.listing(),
        table.partition_key(node, name),
        page_rows=VERSION_PAGE_ROWS,
        reverse=reverse,
    )
    for values in request.rows(ahead=False):
        yield table.row_from_values(node, values, name)


def keys_by_shadow(
    directory: Directory, table: RowTable, shadow: str, value: bytes, nodes: Sequence[str] | None
) -> Iterator[RowKey]:
    """Yield the keys of the rows with an encoded value in a shadow column, in order of time."""

    def keys(rows: Iterable[RawRow]) -> list[RowKey]:
        return [_row_key(table, values) for values in rows]

    request = table.send(bind(table.select_shadow(shadow, bucket=False), (value,), ONE_QUERY_KEYS))
    row_keys = keys(request.page())
    if not request.more:
        row_keys = [key for key in row_keys if nodes is None or key.position.node in nodes]
        yield from sorted(row_keys, key=lambda key: key.position)
        return
    buckets: dict[int, set[str]] = {}
    for row in directory.buckets(table.name, table.metadata, FIRST[0], LAST[0], nodes):
        buckets.setdefault(row.bucket, set()).add(row.node)
    statement = table.select_shadow(shadow, bucket=True)
    for bucket in sorted(buckets):
        row_keys = []
        for node in buckets[bucket]:
            values = (*table.partition_key(node, bucket), value)
            row_keys += table.collect(bind(statement, values, KEY_PAGE_ROWS), keys)
        yield from sorted(row_keys, key=lambda key: key.position)


def _row_key(table: RowTable, values: RawRow) -> RowKey:
    """Return a key from the values of select_shadow."""
    node, t, seq = values
    position = Position(decode_long(t), (node or b"").decode(), decode_long(seq), table.name)
    return RowKey(table, position)
