# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Conversion of many messages of one type to the columns of their rows and back, in batches."""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.wire.layout import layout
from cassandra_ros.messages.wire.message_stacks import Int64Array, Stack, by_size, stacker, windows
from cassandra_ros.messages.wire.permutation import NoPermutation, Permutation
from cassandra_ros.messages.wire.segment_permuter import SegmentPermuter, split_rows
from cassandra_ros.messages.wire.wire_plan import wire_plan

MIN_ROWS = 8
"""Minimum number of messages of one layout that are permuted. Fewer are faster one by one."""
MAX_BYTES = 2048
"""Maximum size of a permuted message, bytes. A larger one is mostly an array, which is copied."""
MAX_CACHED = 64
"""Maximum number of permutations cached for one type."""
MAX_LAYOUTS_TRIED = 8
"""Maximum number of layouts tried for rows of one size."""


class Permuter:
    """Converts messages of one type to columns and back, those of one layout at once.

    Messages of different layouts are converted at once too, if only texts and arrays of numbers
    vary.
    """

    def __init__(self, definition: Definition) -> None:
        self._plan = wire_plan(definition)
        self._stacker = stacker(definition)
        self._segments = layout(definition.type, definition.specs)
        try:
            self._by_segment: Optional[SegmentPermuter] = SegmentPermuter(self._segments)
        except NoPermutation:
            self._by_segment = None
        self._cache: Dict[Tuple[int, bytes], Optional[Permutation]] = {}
        self._row_cache: Dict[Tuple[int, int], List[Permutation]] = {}
        """Permutations by row size and message size, bytes."""

    def rows(self, wires: Sequence[bytes]) -> List[Optional[bytes]]:
        """Return for each message its columns, each after its size; None: convert it by ``walk``.

        None is also returned for messages whose columns are inexact.
        """
        found: List[Optional[bytes]] = [None] * len(wires)
        if len(wires) < MIN_ROWS:
            return found
        if self._by_segment is not None:
            return self._by_segment.rows(wires)
        for members, planes in by_size(wires):
            if len(members) < MIN_ROWS or len(planes) > MAX_BYTES:
                continue
            for stack in self._stacker.stacks(planes, members)[0]:
                permutation = self._permutation(stack)
                if permutation is None or len(stack.members) < MIN_ROWS:
                    continue
                rows, good = permutation.rows(np.ascontiguousarray(stack.planes.T))
                every = zip(stack.members.tolist(), split_rows(rows), good.tolist())
                for at, row, fine in every:
                    if fine:
                        found[at] = row
        return found

    def _permutation(self, stack: Stack) -> Optional[Permutation]:
        key = len(stack.planes), stack.layout.lengths.tobytes()
        kept = self._cache  # another thread may replace the cache meanwhile
        if key in kept:
            return kept[key]
        made = self._make(stack.planes[:, 0].tobytes())
        if len(kept) >= MAX_CACHED:
            kept = self._cache = {}
        kept[key] = made
        return made

    def _make(self, wire: bytes) -> Optional[Permutation]:
        try:
            return Permutation(self._segments, wire)
        except (NoPermutation, struct.error):
            return None

    def wires(
        self, data: bytes, starts: Int64Array, ends: Int64Array, sizes: Int64Array
    ) -> List[Optional[bytes]]:
        """Return the messages of rows; a row is its columns, each after its size.

        Args:
            data: Buffer with the rows.
            starts: Offset of each row.
            ends: Offset after each row.
            sizes: Size of each message, bytes.

        Returns:
            The messages; None for each that must be built alone, and whose row may be malformed.
        """
        found: List[Optional[bytes]] = [None] * len(starts)
        if len(starts) < MIN_ROWS:
            return found
        if self._by_segment is not None:
            return self._by_segment.wires(data, starts, ends)
        lengths = ends - starts
        order = np.lexsort((sizes, lengths))
        changes = np.diff(lengths[order]).astype(bool) | np.diff(sizes[order]).astype(bool)
        for members in np.split(order, np.flatnonzero(changes) + 1):
            length = int(lengths[members[0]])
            # The rest of an expired row ends before its columns.
            if len(members) >= MIN_ROWS and length > 0 and sizes[members[0]] <= MAX_BYTES:
                self._built(data, starts, length, sizes, members, found)
        return found

    def _built(
        self,
        data: bytes,
        starts: Int64Array,
        length: int,
        sizes: Int64Array,
        members: Int64Array,
        found: List[Optional[bytes]],
    ) -> None:
        """Set the messages of rows of equal size."""
        key = length, int(sizes[members[0]])
        known = self._row_cache.get(key, [])
        rows = windows(np.frombuffer(data, np.uint8), length)[starts[members]]
        for n in range(MAX_LAYOUTS_TRIED):
            if n == len(known):
                made = self._learn(key, rows[0].tobytes()) if len(members) >= MIN_ROWS else None
                if made is None:
                    return
                known = [*known, made]
                self._keep(key, known)
            wires, good = known[n].wires(rows)
            for at, wire in zip(members[good].tolist(), split_rows(wires[good])):
                found[at] = wire
            members, rows = members[~good], rows[~good]
            if not len(members):
                return

    def _learn(self, key: Tuple[int, int], row: bytes) -> Optional[Permutation]:
        """Return the permutation for the layout of a row; None if there is no permutation."""
        try:
            made = self._make(self._plan.build(_columns(row)))
        except (CorruptMessage, struct.error):
            return None
        fits = made is not None and (made.row_size, made.wire_size) == key
        return made if fits else None

    def _keep(self, key: Tuple[int, int], known: List[Permutation]) -> None:
        kept = self._row_cache  # another thread may replace the cache meanwhile
        if key not in kept and len(kept) >= MAX_CACHED:
            kept = self._row_cache = {}
        kept[key] = known


def _columns(row: bytes) -> List[Optional[bytes]]:
    """Split a row into its columns; raises struct.error."""
    found: List[Optional[bytes]] = []
    at = 0
    while at < len(row):
        (size,) = _size(row, at)
        at += 4
        found.append(row[at : at + size] if size >= 0 else None)
        at += max(0, size)
    return found


_size = struct.Struct(">i").unpack_from
permuter = lru_cache(maxsize=512)(Permuter)
"""Returns the permuter of a definition, made once per type and md5."""
