# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The envelope of a statement's columns over many buckets, as many as there is time for.

Buckets are read in an order that is spread over the whole time from the beginning, so early results
show all of it, with few values. The envelopes of closed buckets are cached.
"""

from __future__ import annotations

import threading
import time
from collections import OrderedDict, deque
from typing import Iterator, NamedTuple, Sequence

from cassandra_ros.query.arrays.envelope import Envelope, Grid
from cassandra_ros.query.plan.pushdown import Watch
from cassandra_ros.store.tables.directory import BucketRow
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.overview.bucket_envelope import (
    BucketPiece,
    EnvelopeRequest,
    PieceEnvelope,
    PieceReader,
    ZoneRead,
)
from cassandra_ros.topics.stored_totals import buckets_of, group_by_bucket
from cassandra_ros.topics.topic_table import TopicTable

TILE_PIXELS = 1024
"""Number of pixels of one piece. A longer bucket is read in such pieces, because a close view needs
only a small part of it."""
ZONE_PIECES_AHEAD = 8
"""Number of pieces whose zones are requested at the same time."""
CACHE_BYTES = 64 * 1024 * 1024
"""Maximum size of a cache in memory, approximate bytes."""


class EnvelopeCache:
    """Envelopes of pieces of closed buckets that were read before. Thread-safe.

    If it is full, the pieces that have not been used for the longest time are dropped.

    Args:
        most_bytes: Maximum size in memory, approximate bytes.
    """

    def __init__(self, most_bytes: int = CACHE_BYTES) -> None:
        self._most = most_bytes
        self._entries: OrderedDict[object, tuple[PieceEnvelope, int]] = OrderedDict()
        """Envelopes and their sizes, the one that was used last at the end."""
        self._bytes = 0
        self._lock = threading.Lock()

    def get(self, key: object) -> PieceEnvelope | None:
        """Return an envelope, which must not be changed; None if it is not in the cache."""
        with self._lock:
            entry = self._entries.get(key)
            if entry is None:
                return None
            self._entries.move_to_end(key)
            return entry[0]

    def put(self, key: object, envelope: PieceEnvelope) -> None:
        """Add an envelope, or replace it; it must not be changed afterwards."""
        with self._lock:
            earlier = self._entries.pop(key, None)
            self._bytes -= earlier[1] if earlier else 0
            self._entries[key] = envelope, envelope.nbytes
            self._bytes += envelope.nbytes
            while self._bytes > self._most:
                _, (_, nbytes) = self._entries.popitem(last=False)
                self._bytes -= nbytes


class _PieceEntry(NamedTuple):
    """A piece, and what the directory says of it."""

    piece: BucketPiece
    rows: float
    """Approximate number of messages in the piece."""
    state: tuple[object, ...] | None
    """Counts of its writers in the directory; None while a robot writes, after a deletion, or where
    the condition takes only a part of the piece."""


class Envelopes(NamedTuple):
    """Result of EnvelopeReader."""

    envelope: Envelope
    share: float
    """Share of the messages that was read, 0 to 1; 1.0 = all."""
    edges: int
    """Number of blocks across the edges of pixels of which only the zones were read. Their pixels
    may show larger ranges of values than they have."""


class EnvelopeReader:
    """Reads the envelopes of columns of a topic.

    Args:
        keyspace: Keyspace of the topic.
        tables: Tables of the topic, none of them with names as keys.
        request: Columns and condition to read.
        cache: Cache to use; None = nothing is cached.
        watch: See Watch.
    """

    def __init__(
        self,
        keyspace: Keyspace,
        tables: Sequence[TopicTable],
        request: EnvelopeRequest,
        cache: EnvelopeCache | None,
        watch: Watch,
    ) -> None:
        self._keyspace, self._tables = keyspace, tables
        self._bounds = request.bounds
        self._columns = len(request.columns)
        self._cache, self._watch = cache, watch
        self._pieces = PieceReader(keyspace, request, watch)
        self._request_key = request.key

    def read(self, grid: Grid, seconds: float | None = None) -> Envelopes:
        """Read the envelope of the messages in a grid.

        Args:
            seconds: Time limit, s; then the result so far is returned. Each call reads at least one
                more piece. Buckets that are being written are read last, all together. None = read
                everything.
        """
        deadline = None if seconds is None else time.monotonic() + seconds
        entries = list(self._list(grid))
        entries = [entries[n] for n in spread(len(entries))]
        envelopes: dict[int, PieceEnvelope] = {}
        for n, entry in enumerate(entries):
            cached_envelope = self._get_cached(entry, grid)
            if cached_envelope is not None:
                envelopes[n] = cached_envelope
        rest = [n for n in range(len(entries)) if n not in envelopes]
        cacheable = [n for n in rest if self._keeps(entries[n])]
        has_read = False  # in each call something is read, however little time there is
        for n, envelope in self._new(entries, cacheable, grid):
            envelopes[n], has_read = envelope, True
            if _is_over(deadline):
                break
        for n in list(envelopes):
            while envelopes[n].edges and not (has_read and _is_over(deadline)):
                envelopes[n], has_read = self._refine(entries[n], grid, envelopes[n]), True
        has_all = len(envelopes) == len(entries) - len(rest) + len(cacheable)
        has_edges = any(envelope.edges for envelope in envelopes.values())
        if has_all and not (has_read and _is_over(deadline) and has_edges):
            # These pieces are not cached: a read that began with them would never get further.
            envelopes.update(self._at_once(entries, [n for n in rest if n not in envelopes], grid))
        return self._join(grid, entries, envelopes)

    def _list(self, grid: Grid) -> Iterator[_PieceEntry]:
        """Yield the pieces with messages in the grid that the condition may take."""
        bounds = self._bounds
        low, high = bounds.read.time_range
        low, high = max(grid.low, low), min(grid.high, high)
        if bounds.empty or low > high:
            return
        whose = bounds.read.whose
        for table in self._tables:
            ends = table.bucket_of(low), table.bucket_of(high)
            rows = buckets_of(self._keyspace.directory, table, whose, ends)
            for (node, bucket), group in sorted(group_by_bucket(rows).items()):
                writers = [row for row in group if _reaches(row, low, high)]
                if writers:
                    yield from self._tiles(table, node, bucket, writers, grid)

    def _tiles(
        self, table: TopicTable, node: str, bucket: int, writers: Sequence[BucketRow], grid: Grid
    ) -> Iterator[_PieceEntry]:
        """Yield a bucket, or the pieces of a long one that meet the grid.

        A piece is not cut at the ends of the grid, because a view moved a little needs the whole
        piece.
        """
        length, tile = table.metadata.bucket_ns, TILE_PIXELS << grid.shift
        begin, end = bucket * length, (bucket + 1) * length - 1
        rows = sum(row.rows for row in writers)
        state = None
        if all(row.closed for row in writers):
            state = tuple((r.writer, r.rows, r.bytes, r.t_min, r.t_max) for r in writers)
        first_ns, last_ns = self._bounds.read.time_range
        cuts = [begin, end + 1]
        if length > tile:
            first, last = max(begin, grid.low) // tile, min(end, grid.high) // tile + 1
            cuts = [min(max(begin, n * tile), end + 1) for n in range(first, last + 1)]
        for low, high in zip(cuts, cuts[1:]):
            share = rows * (high - low) / length
            begins, ends = max(low, first_ns), min(high - 1, last_ns)
            if begins <= ends and any(_reaches(row, begins, ends) for row in writers):
                # One that is cut by the condition is not cached: the cut may move with now().
                piece = BucketPiece(table, node, bucket, begins, ends)
                is_whole = (begins, ends) == (low, high - 1)
                yield _PieceEntry(piece, share, state if is_whole else None)

    def _key(self, entry: _PieceEntry, grid: Grid) -> object:
        """Return the key of a piece in the cache; with other counts in the directory it is new."""
        piece = entry.piece
        where = self._keyspace.name, piece.table.name, *piece[1:], entry.state
        return self._request_key, grid.shift, where

    def _keeps(self, entry: _PieceEntry) -> bool:
        """Return whether the envelope of a piece is cached for the next time."""
        return self._cache is not None and entry.state is not None

    def _get_cached(self, entry: _PieceEntry, grid: Grid) -> PieceEnvelope | None:
        if self._cache is None or not self._keeps(entry):
            return None
        return self._cache.get(self._key(entry, grid))

    def _keep(self, entry: _PieceEntry, grid: Grid, envelope: PieceEnvelope) -> None:
        if self._cache is not None and self._keeps(entry):
            self._cache.put(self._key(entry, grid), envelope)

    def _new(
        self, entries: Sequence[_PieceEntry], places: Sequence[int], grid: Grid
    ) -> Iterator[tuple[int, PieceEnvelope]]:
        """Read pieces that are not in the cache; the zones of some are requested ahead.

        Yields:
            Number of the piece in ``entries``, and its envelope.
        """
        coming: deque[tuple[int, ZoneRead]] = deque()
        rest = iter(places)
        while True:
            for n in rest:
                coming.append((n, self._pieces.ask(entries[n].piece)))
                if len(coming) >= ZONE_PIECES_AHEAD:
                    break
            if not coming:
                return
            n, zones = coming.popleft()
            self._watch()
            envelope = self._pieces.read(entries[n].piece, grid.shift, zones)
            self._keep(entries[n], grid, envelope)
            yield n, envelope

    def _refine(self, entry: _PieceEntry, grid: Grid, earlier: PieceEnvelope) -> PieceEnvelope:
        """Unpack some more edges of a piece, and cache the new envelope."""
        envelope = self._pieces.refined(entry.piece, earlier)
        self._keep(entry, grid, envelope)
        return envelope

    def _at_once(
        self, entries: Sequence[_PieceEntry], places: Sequence[int], grid: Grid
    ) -> Iterator[tuple[int, PieceEnvelope]]:
        """Read pieces in full, without a time limit."""
        for n, envelope in self._new(entries, places, grid):
            while envelope.edges:
                envelope = self._refine(entries[n], grid, envelope)
            yield n, envelope

    def _join(
        self, grid: Grid, entries: Sequence[_PieceEntry], envelopes: dict[int, PieceEnvelope]
    ) -> Envelopes:
        """Return the envelope of all pieces that were read, by their numbers in ``entries``."""
        envelope, edges = Envelope(grid, self._columns), 0
        # Each piece counts as one message more: of some the directory knows no number.
        read_rows = 0.0
        for n, piece_envelope in envelopes.items():
            envelope.merge(piece_envelope.sure)
            if piece_envelope.edges:
                envelope.merge(piece_envelope.around)
                edges += len(piece_envelope.edges)
            read_rows += entries[n].rows + 1
        all_rows = sum(entry.rows + 1 for entry in entries)
        share = 1.0 if len(envelopes) == len(entries) else min(read_rows / all_rows, 0.999)
        return Envelopes(envelope, share, edges)


def _reaches(row: BucketRow, low: int, high: int) -> bool:
    """Return whether a writer may have messages of a time range in a bucket."""
    return not row.closed or bool(row.rows and row.t_min <= high and row.t_max >= low)


def _is_over(deadline: float | None) -> bool:
    return deadline is not None and time.monotonic() >= deadline


def spread(count: int) -> Sequence[int]:
    """Return the numbers below count in an order in which the first few are far apart."""
    bits = max(1, (count - 1).bit_length())
    return sorted(range(count), key=lambda n: int(f"{n:0{bits}b}"[::-1], 2))
