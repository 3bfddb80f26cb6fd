# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The buckets of the target in which a copy puts rows, and their entries in its directory.

A bucket is marked as open before its first row is written. It is closed when its rows are
acknowledged, if no client was writing the bucket here, and only if its entry is still the one that
this object wrote. If another copy or a deletion has changed the entry, the bucket stays open, and a
reader counts it.
"""

from __future__ import annotations

import logging
import math
import time
from typing import Callable, Collection, Mapping, Tuple

from cassandra_ros.errors import StoreUnavailable, TopicNotFound
from cassandra_ros.store.rows.layouts import layout_of
from cassandra_ros.store.tables.directory import HEARTBEAT_SEC, BucketRow, BucketTotals
from cassandra_ros.stores.copying.table_pair import TablePair

_log = logging.getLogger(__name__)

_Place = Tuple[str, int]
"""Node and bucket."""
_Key = Tuple[str, int, int]
"""Node, bucket and writer id."""


class TargetBuckets:
    """Opens and closes buckets of one table of the target; a Destination of VerbatimCopy.

    For one thread.

    Args:
        filled: Writer id → shadow columns of the target that get values in all rows of the writer.
        sent: Called with each number of bytes before they are sent; it may wait.
    """

    def __init__(
        self,
        pair: TablePair,
        filled: Mapping[int, frozenset[str]],
        sent: Callable[[int], None],
    ) -> None:
        self._pair = pair
        self._filled = filled
        self.sent = sent
        self._opened: dict[_Key, BucketRow | None] = {}
        """The entries as they were marked last; None = messages with names, which have no entry."""
        self._marked: dict[_Key, float] = {}
        """Monotonic times at which they were marked, s."""
        self._new: set[_Key] = set()
        """Entries that were not there before: this copy sends all rows that they count."""

    def connect(self, conn: int) -> None:
        """Write the header of a connection, unless that was done."""
        self._pair.connect(conn)

    def open(self, node: str, bucket: int, writer: int) -> None:
        """Mark a bucket as open, before its first row is written, and then every HEARTBEAT_SEC.

        Raises:
            TopicNotFound: The table takes no rows any more.
        """
        key = (node, bucket, writer)
        now = time.monotonic()
        if now - self._marked.get(key, -math.inf) < HEARTBEAT_SEC:
            return
        directory, table = self._pair.there.directory, self._pair.target
        if not self._pair.there.schema.takes_rows(table.name):
            raise TopicNotFound(f"topic {self._pair.topic} is converted there; copy it again")
        self._marked[key] = now
        # So that readers find the node, and its slot.
        directory.note(table, node, bucket)
        if table.named:
            self._opened[key] = None
            return
        before = self._entry(key)
        filled = self._filled.get(writer, frozenset())
        if before is not None:  # its other rows have no more than these
            filled &= before.filled
        elif key not in self._opened:
            self._new.add(key)
        directory.mark((table.name, *key), table.metadata.ttl, filled)
        self._opened[key] = self._entry(key)

    def _entry(self, key: _Key) -> BucketRow | None:
        """Read an entry of the directory; None = it is not listed."""
        rows = self._pair.there.directory.find(self._pair.target.name, *key[:2])
        return next((row for row in rows if row.writer == key[2]), None)

    def close(self, final: Collection[int], totals: Mapping[_Key, BucketTotals]) -> None:
        """Close the opened buckets of some writers. All rows that were sent are acknowledged.

        Args:
            final: Writer ids of which all rows are there.
            totals: Counts of the rows that were copied by node, bucket there and writer, used only
                where the bucket had no other rows of the writer; {} unless all of their rows were
                sent. What is missing, as always for blocks, is counted in the target.
        """
        places: dict[_Place, list[tuple[_Key, BucketRow]]] = {}
        for key, row in self._opened.items():
            if row is not None and key[2] in final:
                places.setdefault(key[:2], []).append((key, row))
        for place, entries in places.items():
            try:
                self._close(place, entries, totals)
            except StoreUnavailable as exc:
                # Its rows are there. What is not closed is counted by each reader, until one of
                # them closes it; a store that is away is told by the next request.
                topic = self._pair.topic
                _log.warning("a bucket of topic %s was copied and stays open: %s", topic, exc)

    def _close(
        self,
        place: _Place,
        entries: Collection[tuple[_Key, BucketRow]],
        totals: Mapping[_Key, BucketTotals],
    ) -> None:
        """Close the entries of one bucket, which are of different writers.

        Args:
            entries: They were read by ``Directory.find`` before rows are counted here, as
                ``put_recount`` requires: it does not close one that has changed since. One that is
                ``cut``, from which rows were deleted since it was counted, stays open.
            totals: See ``close``. The rows of an entry in ``_new`` are those that this copy sent,
                and no others; all other entries are counted. It is {} unless this copy sends all
                rows that the buckets have here.
        """
        directory, table = self._pair.there.directory, self._pair.target
        counted: Mapping[int, BucketTotals] | None = None
        for key, row in entries:
            if row.cut:
                continue  # its counts may lack a deletion that goes on: a reader counts it later
            counts = totals.get(key) if key in self._new else None
            if counts is None:
                counted = layout_of(table).recount(*place) if counted is None else counted
                counts = counted.get(row.writer, BucketTotals())
            if not directory.put_recount(table.name, row, counts, table.metadata.ttl):
                # Another client has closed it, perhaps before our last row was there.
                directory.mark((table.name, *key), table.metadata.ttl, row.filled)
