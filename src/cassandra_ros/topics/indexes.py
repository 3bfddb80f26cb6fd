# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The indexes of one topic: making them on any field, filling them with stored values, removal."""

from __future__ import annotations

import logging
from contextlib import suppress
from typing import Callable, Iterator, NamedTuple, Sequence

from cassandra_ros.errors import (
    CorruptMessage,
    InvalidName,
    InvalidOption,
    StoreUnavailable,
    TopicNotFound,
)
from cassandra_ros.keys import NAMED_FORMATS, split_seq
from cassandra_ros.messages.index_field import IndexField, nearest_fields
from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.store.rows.backfill import Backfill, ShadowUpdate, WrittenRow
from cassandra_ros.store.tables.directory import STALE_SEC, BucketRow, BucketTotals, Directory
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.message_adder import MessageAdder
from cassandra_ros.topics.stored_row import read_wire
from cassandra_ros.topics.stored_totals import buckets_of, group_by_bucket
from cassandra_ros.topics.topic_table import TopicTable, definition_in

_log = logging.getLogger(__name__)

Progress = Callable[[int, int], None]
"""Called with the number of rows that are done and the number of all rows."""
MAX_ROUNDS = 8
"""Maximum number of times that a topic is searched for buckets without values."""
MAX_TRIES = 3
"""Maximum number of attempts for a lightweight transaction that times out."""
UNKNOWN_ROW_BYTES = 32 * 1024
"""Assumed size of the rows of writers with an open bucket, bytes."""


def create_index(
    space: Keyspace, adder: MessageAdder, topic: str, field: str, progress: Progress | None
) -> int:
    """Make an index, or complete it; see CassandraTopic.createIndex."""
    space.schema.tables(fresh=True)
    check_indexable(topic, space.tables.of_topic(topic), field)
    space.indexes.add_index(topic, field, lambda metadata: _type_of(metadata, field))
    adder.close()  # its open buckets could not be filled
    return IndexFilling(space.directory, field, progress).fill(space.tables.of_topic(topic))


def has_index(tables: Sequence[TopicTable], field: str) -> bool:
    """Return whether every table whose type has the field has an index on it."""
    with_field = [table.metadata for table in tables if _type_of(table.metadata, field)]
    return bool(with_field) and all(field in metadata.indexes for metadata in with_field)


class IndexState(NamedTuple):
    """Coverage of an index of a topic."""

    topic: str
    field: str
    messages: int
    """Number of the topic's messages in tables whose type has the field."""
    missing: int
    """Number of these messages that are not in the index: conditions check them one by one."""


def list_indexes(
    directory: Directory, topic: str, tables: Sequence[TopicTable]
) -> list[IndexState]:
    """Return the coverage of each index of a topic; approximate while it is being recorded."""
    states: list[IndexState] = []
    for field in sorted({field for table in tables for field in table.metadata.indexes}):
        messages = missing = 0
        for table in tables:
            if _type_of(table.metadata, field) is None:
                continue
            index = table.index_fields.get(field)
            rows = buckets_of(directory, table)
            messages += sum(row.rows for row in rows)
            missing += sum(
                row.rows for row in rows if index is None or index.shadow not in row.filled
            )
        states.append(IndexState(topic, field, messages, missing))
    return states


def remove_index(space: Keyspace, topic: str, field: str) -> None:
    """Remove an index; see CassandraTopic.removeIndex."""
    space.schema.tables(fresh=True)
    tables = space.tables.of_topic(topic)
    if any(table.value_part is not None and table.value_part.field == field for table in tables):
        raise InvalidOption(
            f"the index on {field} cannot be removed: it is the key_part of topic {topic}, and "
            "getData finds messages by it"
        )
    fields = sorted({name for table in tables for name in table.metadata.indexes})
    if tables and field not in fields:
        check_indexable(topic, tables, field)
    if not space.indexes.drop_index(topic, field):
        hint = nearest_fields(field, fields) if fields else "it has none"
        raise InvalidName(f"topic {topic} has no index on {field!r}; {hint}")


def check_indexable(topic: str, tables: list[TopicTable], field: str) -> None:
    """Check that an index on a field can be made in at least one of a topic's tables.

    Raises:
        TopicNotFound: The topic has no tables.
        InvalidOption: Its messages have names, are in blocks, or have this index for whole arrays.
        InvalidName: No definition has the field, or it cannot be indexed.
    """
    if not tables:
        raise TopicNotFound(
            f"topic {topic} has no type yet: its first message fixes it; give index= to addTopic"
        )
    for table in tables:
        check_unnamed(topic, table.metadata.key_format)
        if table.digest is not None and table.digest.field == field:
            raise InvalidOption(
                f"field {field} is the key_part of topic {topic} and has an index for whole "
                "arrays; one for their elements cannot be made in addition"
            )
    if not any(table.metadata.takes_index for table in tables):
        raise no_index_in_blocks(topic)
    if not any(_type_of(table.metadata, field) for table in tables):
        for table in tables:
            if table.definition is not None:
                IndexField(table.definition, field, "")  # raises an error with similar names
        raise InvalidName(
            f"topic {topic} has no usable definition to find a field {field!r} in: an index "
            "cannot be made"
        )


def no_index_in_blocks(topic: str) -> InvalidOption:
    """Return the error for a topic whose messages are all in blocks."""
    return InvalidOption(
        f"topic {topic} takes no index: its messages are packed in blocks, with the minimum and "
        "the maximum of each field; conditions use these by themselves. For an "
        f"index keep it in another format: cassandra_bag convert {topic} --format ros"
    )


def check_unnamed(topic: str, key_format: str) -> None:
    """Raise InvalidOption if the messages of the topic have names."""
    if key_format in NAMED_FORMATS:
        raise InvalidOption(
            f"topic {topic} cannot have an index: its messages are kept under names (key_format "
            f"{key_format}), and which of them an index covers is only noted for time ranges"
        )


def _type_of(metadata: TopicMetadata, field: str) -> str | None:
    """Return the CQL type of the column of an index; None if the table cannot have the index."""
    if not metadata.takes_index:
        return None
    definition = definition_in(metadata)
    with suppress(InvalidName):
        return IndexField(definition, field, "").cql_type if definition else None
    return None


class IndexFilling:
    """Fills the index of a field in the tables of a topic."""

    def __init__(self, directory: Directory, field: str, progress: Progress | None) -> None:
        self._directory = directory
        self._field = field
        self._progress = progress or (lambda done, total: None)
        self._done = self._total = 0

    def fill(self, tables: Sequence[TopicTable]) -> int:
        """Fill the index for the rows of buckets that no writer has open.

        Returns:
            The number of rows of writers whose buckets are complete now.
        """
        filled = 0
        for _ in range(MAX_ROUNDS):
            # Buckets that were closed meanwhile are filled in another round.
            buckets = list(self._lacking(tables))
            self._total = self._done + sum(row.rows for _, _, rows in buckets for row in rows)
            results = [self._fill_bucket(*bucket) for bucket in buckets]
            filled += sum(rows for rows, _ in results)
            if not any(writer_count for _, writer_count in results):
                break
        self._progress(self._done, self._done)
        return filled

    def _lacking(
        self, tables: Sequence[TopicTable]
    ) -> Iterator[tuple[TopicTable, IndexField, list[BucketRow]]]:
        """Yield buckets to fill: table, index, entries of the writers whose rows lack values."""
        for table in tables:
            index = table.index_fields.get(self._field)
            if index is None:
                continue
            rows = buckets_of(self._directory, table)
            buckets = group_by_bucket(row for row in rows if _lacks(row, index))
            for key in sorted(buckets):
                yield table, index, buckets[key]

    def _fill_bucket(
        self, table: TopicTable, index: IndexField, listed: list[BucketRow]
    ) -> tuple[int, int]:
        """Fill the rows of one bucket, of which ``listed`` are entries of the directory.

        Returns:
            The number of rows of those writers whose rows are all filled, and of these writers.
        """
        backfill = Backfill(table, index.shadow)
        place = listed[0].node, listed[0].bucket
        # Read again before the rows: an entry is marked only if it has not changed since.
        entries = self._directory.find(table.name, *place)
        lacking = [row for row in entries if _lacks(row, index)]
        totals = {row.writer: BucketTotals() for row in lacking}
        largest = max((r.largest if r.closed else UNKNOWN_ROW_BYTES for r in entries), default=0)
        for page in backfill.pages(*place, largest):
            backfill.write(list(self._updates(table, index, page, totals)))
            self._progress(self._done, max(self._done, self._total))
        ids = [r.writer for r in lacking if self._mark(table, r, index.shadow, totals[r.writer])]
        return sum(totals[writer].rows for writer in ids), len(ids)

    def _updates(
        self,
        table: TopicTable,
        index: IndexField,
        page: list[WrittenRow],
        totals: dict[int, BucketTotals],
    ) -> Iterator[ShadowUpdate]:
        """Yield the updates of a page, and count its rows in the totals of their writers.

        Args:
            totals: Writer id → totals; rows of other writers are left out.
        """
        for written in page:
            row = written.row
            writer_totals = totals.get(split_seq(row.seq)[0])
            if writer_totals is None:
                continue
            try:
                value, odd = index.value(read_wire(table, row))
            except CorruptMessage as exc:
                topic = table.metadata.topic
                _log.warning("a message of topic %s cannot be indexed: %s", topic, exc)
                value, odd = None, True
            writer_totals.count(row.t, row.size, row.nchunks > 0, odd or row.odd)
            self._done += 1
            if value is not None or (odd and not row.odd):
                yield ShadowUpdate(written, value)

    def _mark(self, table: TopicTable, row: BucketRow, shadow: str, totals: BucketTotals) -> bool:
        """Note that all rows of a writer in a bucket have values; False if the entry changed."""
        marked = row._replace(filled=row.filled | {shadow})
        uncertain = False
        for _ in range(MAX_TRIES):
            try:
                put = self._directory.put_recount(table.name, marked, totals, table.metadata.ttl)
                return put or (uncertain and self._is_marked(table, row, shadow))
            except StoreUnavailable as exc:
                # Another transaction interfered; this one may have been applied or not.
                _log.debug("a bucket of topic %s is not marked: %s", table.metadata.topic, exc)
                uncertain = True
        return False

    def _is_marked(self, table: TopicTable, row: BucketRow, shadow: str) -> bool:
        entries = self._directory.find(table.name, row.node, row.bucket)
        return any(entry.writer == row.writer and shadow in entry.filled for entry in entries)


def _lacks(row: BucketRow, index: IndexField) -> bool:
    """Return whether the values of an index can be filled into the rows of a bucket."""
    # An open bucket belongs to its writer, until that is silent for a minute.
    return index.shadow not in row.filled and (row.closed or row.age_sec > STALE_SEC)
