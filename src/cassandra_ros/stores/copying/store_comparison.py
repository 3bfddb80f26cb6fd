# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Two stores compared, bucket by bucket, by digests of the messages of the same writers.

Blocks that are stored alike are compared by their headers, which have a checksum of their bytes.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace
from typing import Iterable, Iterator

from cassandra_ros.errors import CorruptMessage, DefinitionError, SchemaConflict
from cassandra_ros.read import Read, TimeRange, Whose
from cassandra_ros.store.blocks.block_counts import headers
from cassandra_ros.store.tables.row_table import encode_long
from cassandra_ros.stores.copying.table_pair import TablePair, find_existing
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.stored_totals import buckets_of
from cassandra_ros.topics.topic_table import TopicTable
from cassandra_ros.topics.upkeep.table_copy import Progress


@dataclass(frozen=True)
class Digest:
    """Number and digest of messages in the order of their positions."""

    messages: int
    hash: str
    """Hexadecimal; '' = nothing was read."""


_NO_MESSAGES = Digest(0, "")


@dataclass(frozen=True)
class BucketComparison:
    """A bucket, or all messages with names of one node, in both stores."""

    topic: str
    node: str
    first_ns: int
    """Begin of the bucket, ns; 0 for messages with names."""
    last_ns: int
    """End of the bucket, ns, included; LAST_NS for messages with names."""
    here: Digest = _NO_MESSAGES
    there: Digest = _NO_MESSAGES
    """Messages of the same writers there."""
    writers: frozenset[int] = frozenset()
    """Writers whose messages were compared; empty = all, of messages with names."""


@dataclass
class StoreComparison:
    """Result of a comparison."""

    place: str
    """Address and keyspace of the other store."""
    buckets: int = 0
    """Number of buckets that were compared."""
    messages: int = 0
    """Number of messages that are the same."""
    differences: list[BucketComparison] = field(default_factory=list)
    """Buckets whose messages are not the same."""
    refused: dict[str, str] = field(default_factory=dict)
    """Topic → why it cannot be compared."""

    @property
    def equal(self) -> bool:
        """Whether all messages here are there, and no others of the same writers."""
        return not (self.differences or self.refused)

    def add(self, bucket: BucketComparison) -> None:
        """Count a bucket."""
        self.buckets += 1
        if bucket.here == bucket.there:
            self.messages += bucket.here.messages
        else:
            self.differences.append(bucket)


def compare_stores(
    here: Keyspace,
    there: Keyspace,
    tables: Iterable[TopicTable],
    whose: Whose,
    place: str,
    progress: Progress = None,
) -> StoreComparison:
    """Compare the messages of tables here with those of the same topics there.

    Messages there of writers that are not here, other robots' for example, do not matter.

    Args:
        tables: The tables here.
        whose: Robots and writers whose messages are compared.
        place: Address and keyspace of the other store, for the result.
        progress: Called with the number of buckets that were compared, and of all.
    """
    result = StoreComparison(place)
    pieces = [(table, *piece) for table in tables for piece in _pieces(here, table, whose)]
    for number, (table, node, bucket, writers) in enumerate(pieces):
        topic = table.metadata.topic
        try:
            pair = find_existing(here, there, table)
            result.add(_compare(here, pair, table, node, bucket, writers))
        except (SchemaConflict, CorruptMessage, DefinitionError) as exc:
            result.refused.setdefault(topic, str(exc))
        if progress is not None:
            progress(number + 1, len(pieces))
    return result


def _pieces(
    here: Keyspace, table: TopicTable, whose: Whose
) -> Iterator[tuple[str, int, frozenset[int]]]:
    """Yield node, bucket and writers of the messages of a table.

    Messages with names are one bucket of each node; no writers stand for all of them.
    """
    if table.named:
        for node in here.nodes([table]):
            if whose.nodes is None or node in whose.nodes:
                yield node, 0, whose.writers or frozenset()
        return
    writers_of: dict[tuple[str, int], set[int]] = {}
    for row in buckets_of(here.directory, table, whose):
        writers_of.setdefault((row.node, row.bucket), set()).add(row.writer)
    for (node, bucket), writers in sorted(writers_of.items()):
        yield node, bucket, frozenset(writers)


def _compare(
    here: Keyspace,
    pair: TablePair | None,
    table: TopicTable,
    node: str,
    bucket: int,
    writers: frozenset[int],
) -> BucketComparison:
    """Compare the messages of one of _pieces.

    Args:
        pair: The table and its counterpart; None = no counterpart: all are missing.
    """
    length = table.bucket_ns
    low, high = bucket * length, (bucket + 1) * length - 1
    time_range = TimeRange() if table.named else TimeRange(low, high)
    read = Read(time_range, Whose((node,), writers or None))
    place = BucketComparison(table.metadata.topic, node, *time_range, writers=writers)
    if pair is not None and pair.columns is not None:
        # shared_columns has checked that the bucket lies in one bucket there. Rows of single
        # messages have no headers.
        digest_here = _digest_of_headers(table, node, bucket, read)
        digest_there = _digest_of_headers(pair.target, node, pair.target.bucket_of(low), read)
        if digest_here.messages and digest_here == digest_there:
            return replace(place, here=digest_here, there=digest_there)
    # The same messages may be in other blocks there.
    digest_here = _digest(here.rows.read([table], read))
    digest_there = _digest(() if pair is None else pair.there.rows.read([pair.target], read))
    return replace(place, here=digest_here, there=digest_there)


def _digest(rows: Iterable[StoredRow]) -> Digest:
    """Return the digest of messages: their places, connections, receive times and bytes."""
    digest, count = hashlib.blake2b(digest_size=16), 0
    for row in rows:
        name, wire = row.name.encode("utf-8"), row.wire
        for value in (row.t, row.seq, row.conn, row.received, len(name), len(wire)):
            digest.update(encode_long(value))
        digest.update(name)
        digest.update(wire)
        count += 1
    return Digest(count, digest.hexdigest())


def _digest_of_headers(table: TopicTable, node: str, bucket: int, read: Read) -> Digest:
    """Return the digest of the headers of blocks, which have checksums of their bytes."""
    digest, count = hashlib.blake2b(digest_size=16), 0
    for block in headers(table, node, bucket, *read.time_range, read.whose.writers):
        header = (block.t, block.seq, block.conn, block.size, block.last, block.messages, block.crc)
        for value in (*header, block.nchunks, block.odd, len(block.gone), *block.gone.tolist()):
            digest.update(encode_long(int(value)))
        count += block.left
    return Digest(count, digest.hexdigest())
