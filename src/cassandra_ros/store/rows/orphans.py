# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Buckets that the directory does not list, and chunks of messages without a row.

A writer stores the chunks of a large message first and its row last. A writer that dies in between
leaves chunks without a row. A bucket is listed before its first row is written, so an unlisted
bucket has lost its entry in the directory.
"""

from __future__ import annotations

from itertools import islice
from typing import Iterable, NamedTuple, Sequence, Union

from cassandra_ros.store.blocks.block_row import ask_blocks
from cassandra_ros.store.connection.cassandra import Cassandra
from cassandra_ros.store.connection.cql_names import chunk_table_name
from cassandra_ros.store.connection.requests import RawRow
from cassandra_ros.store.tables.row_table import (
    COUNTED_COLUMNS,
    Order,
    PartitionKey,
    RowTable,
    bind,
    decode_long,
)

ORPHAN_SEC = 3600
"""Minimum age of chunks that count as left over, s. No message is retried for this long."""
_PAGE_ROWS = 5000
_PAGE_KEYS = 500
"""Number of messages with chunks that are looked at, or deleted, together."""

Where = Union[int, str]
"""A bucket, or the name of a row."""


class Orphan(NamedTuple):
    """The key of a message that has chunks but no row."""

    node: str
    where: Where
    t: int
    seq: int


def partitions(table: RowTable) -> set[tuple[str, Where]]:
    """Return the partitions that have rows: node, and bucket or name (a scan of keys)."""

    def read(rows: Iterable[RawRow]) -> set[tuple[str, Where]]:
        return {_partition_of(table, values) for values in rows}

    return table.collect(bind(table.select_partitions(), (), _PAGE_ROWS), read, "listing")


def old_us(cassandra: Cassandra) -> int:
    """Return the server time in us before which chunks without a row are left over."""
    return cassandra.server_time_us() - ORPHAN_SEC * 10**6


def orphans(cassandra: Cassandra, keyspace: str, table: RowTable, until_us: int) -> list[Orphan]:
    """Return the messages that have chunks, written before a time, but no row.

    The result is empty if the table's rows expire.
    """
    name = chunk_table_name(table.name)
    there = cassandra.system_schema("tables", "table_name", keyspace, name)
    if not there or table.metadata.ttl:
        return []

    def read(rows: Iterable[RawRow]) -> list[Orphan]:
        old = (values for values in rows if decode_long(values[4]) <= until_us)
        return [
            Orphan(*_partition_of(table, values), decode_long(values[2]), decode_long(values[3]))
            for values in old
            if not _has_row(table, values)
        ]

    statement = bind(table.select_chunked(), (), _PAGE_KEYS)
    return table.collect(statement, read, "looking for orphans of")


def rows_at(table: RowTable, partition_key: PartitionKey, key: Order) -> Sequence[RawRow]:
    """Return the counted columns of the row with a key, encoded; empty if there is no such row."""
    return list(ask_blocks(table, partition_key, [key], COUNTED_COLUMNS).page())


def _has_row(table: RowTable, values: RawRow) -> bool:
    """Return whether the message of some chunks has a row that refers to chunks."""
    partition_key = values[0] or b"", values[1] or b""
    key = decode_long(values[2]), decode_long(values[3])
    # The fourth column is the number of chunks.
    return any(row[3] is not None for row in rows_at(table, partition_key, key))


def remove_orphans(
    cassandra: Cassandra, table: RowTable, orphan_keys: Iterable[Orphan], until_us: int
) -> None:
    """Delete the chunks of messages without a row, if they were written before a time.

    So an import that is repeated at the same time, which writes new chunks and then the row, keeps
    them.
    """
    params = ((until_us, *orphan) for orphan in orphan_keys)
    what = f"removing orphans of topic {table.metadata.topic}"
    while some := list(islice(params, _PAGE_KEYS)):
        cassandra.execute_many(table.delete_one(chunks=True, older=True), some, what=what)


def _partition_of(table: RowTable, values: RawRow) -> tuple[str, Where]:
    """Return node, and bucket or name, of an encoded partition key."""
    node, where = (values[0] or b"").decode(), values[1] or b""
    return node, where.decode() if table.named else decode_long(where)
