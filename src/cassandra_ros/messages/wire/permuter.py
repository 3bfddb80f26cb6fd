# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Conversion of many messages of one type to the columns of their rows and back, in batches.

If only texts and arrays of numbers vary in size, a message consists of a few segments: bytes of
fixed size, then a text or array with the same bytes in message and row. The fixed bytes of all
messages are permuted together, the rest is copied. Of other types the messages of one layout are
permuted together.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import NamedTuple, Sequence

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.wire.layout import Segment, layout
from cassandra_ros.messages.wire.message_stacks import (
    ByteArray,
    Int64Array,
    Stack,
    by_size,
    stacker,
)
from cassandra_ros.messages.wire.permutation import NoPermutation, Permutation
from cassandra_ros.messages.wire.wire_plan import wire_plan

MIN_ROWS = 8
"""Minimum number of messages of one layout that are permuted. Fewer are faster one by one."""
MAX_PERMUTED_BYTES = 2048
"""Maximum size of a permuted message, bytes. A larger one is mostly an array, which is copied."""
MAX_CACHED = 64
"""Maximum number of permutations cached for one type."""
MAX_LAYOUTS_TRIED = 8
"""Maximum number of layouts tried for rows of one size."""

_Good = NDArray[np.bool_]
"""For each message or row whether it was converted exactly."""


class _WireSegment(NamedTuple):
    """One segment: its fixed bytes, and the variable field after them."""

    permutation: Permutation | None
    """Permutation of the fixed bytes; None if there are no fixed bytes."""
    unit: int
    """Size of an element of the variable field, bytes; 0 = no variable field."""
    is_text: bool

    def convert(self, data: ByteArray, ats: Int64Array, back: bool) -> tuple[ByteArray, _Good, int]:
        """Permute the fixed bytes at some offsets; return also the number of bytes read at each.

        ``back``: from rows to messages; so everywhere here.
        """
        if self.permutation is None:
            return np.zeros((len(ats), 0), np.uint8), np.ones(len(ats), np.bool_), 0
        size = self.permutation.row_size if back else self.permutation.wire_size
        cells = windows(data, size)[ats]
        return (*(self.permutation.wires if back else self.permutation.rows)(cells), size)

    def size(self, back: bool) -> int:
        """Return the number of bytes before the variable data, length prefix included."""
        fixed = self.permutation
        fixed_size = 0 if fixed is None else fixed.row_size if back else fixed.wire_size
        return fixed_size + (4 if self.unit else 0)


class SegmentPermuter:
    """Converts messages of one type to rows, and rows to messages.

    Raises:
        NoPermutation: Fields other than texts and arrays of numbers vary in size.
    """

    def __init__(self, segments: Sequence[Segment]) -> None:
        self._segments: list[_WireSegment] = []
        for fixed, tail in segments:
            if tail is not None and (tail.kind not in ("text", "bytes") or not tail.has_count):
                raise NoPermutation
            size = sum(struct.calcsize("<" + field.little) for field in fixed)
            permutation = Permutation((Segment(fixed, None),), bytes(size)) if fixed else None
            unit = 0 if tail is None else tail.unit
            self._segments.append(
                _WireSegment(permutation, unit, tail is not None and tail.kind == "text")
            )
        if not self._segments:
            raise NoPermutation

    def rows(self, wires: Sequence[bytes]) -> list[bytes | None]:
        """Return for each message its columns, each after its size.

        None: convert it by ``walk``.
        """
        sizes = np.fromiter(map(len, wires), np.int64, len(wires))
        ends = np.cumsum(sizes)
        return self._convert(b"".join(wires), ends - sizes, ends, back=False)

    def wires(self, data: bytes, starts: Int64Array, ends: Int64Array) -> list[bytes | None]:
        """Return the messages of rows from ``starts`` to ``ends``; None for a malformed row."""
        return self._convert(data, starts, ends, back=True)

    def _convert(
        self, data: bytes, starts: Int64Array, ends: Int64Array, back: bool
    ) -> list[bytes | None]:
        """Convert messages to rows or (back) rows to messages, segment by segment."""
        buffer, ats, good = np.frombuffer(data, np.uint8), starts, np.ones(len(starts), np.bool_)
        parts: list[list[bytes]] = []
        for segment in self._segments:
            good &= ats + segment.size(back) <= ends
            if not good.any():
                return [None] * len(starts)
            # A malformed message is not read further, but keeps its index.
            ats = np.where(good, ats, ats[good][0])
            converted, fine, size = segment.convert(buffer, ats, back)
            good &= fine
            ats = ats + size
            if segment.unit:
                prefixes, sizes, fine = _lengths(buffer, ats, segment.unit, back)
                good &= fine
                converted = np.concatenate((converted, prefixes), axis=1)
                froms = ats + 4
                ats = froms + sizes
            if converted.shape[1]:
                parts.append(split_rows(converted))
            if segment.unit:
                places = zip(froms.tolist(), np.minimum(ats, ends).tolist())
                parts.append([data[at:to] for at, to in places])
                if segment.is_text and not back:
                    good &= np.fromiter(map(bytes.isascii, parts[-1]), np.bool_, len(good))
        good &= ats == ends
        rows = map(b"".join, zip(*parts))
        return [output if fine else None for output, fine in zip(rows, good.tolist())]


def _lengths(
    data: ByteArray, ats: Int64Array, unit: int, back: bool
) -> tuple[ByteArray, Int64Array, _Good]:
    """Read the length prefixes at some offsets.

    On the wire a length prefix counts elements, in a row bytes.

    Returns:
        The prefixes converted, the sizes of the variable fields in bytes, and which are possible.
    """
    lengths = np.ascontiguousarray(windows(data, 4)[ats])
    if back:
        sizes = lengths.view(">i4")[:, 0].astype(np.int64)
        good = (sizes >= 0) & (sizes % unit == 0)
        prefixes = (sizes // unit).astype("<u4")
    else:
        sizes = lengths.view("<u4")[:, 0].astype(np.int64) * unit
        good = sizes < 2**31
        prefixes = sizes.astype(">u4")
    return prefixes.view(np.uint8).reshape(len(ats), 4), sizes, good


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
            self._by_segment: SegmentPermuter | None = SegmentPermuter(self._segments)
        except NoPermutation:
            self._by_segment = None
        self._cache: dict[tuple[int, bytes], Permutation | None] = {}
        self._row_cache: dict[tuple[int, int], list[Permutation]] = {}
        """Permutations by row size and message size, bytes."""

    def rows(self, wires: Sequence[bytes]) -> list[bytes | None]:
        """Return for each message its columns, each after its size; None: convert it by ``walk``.

        None is also returned for messages whose columns are inexact.
        """
        all_rows: list[bytes | None] = [None] * len(wires)
        if len(wires) < MIN_ROWS:
            return all_rows
        if self._by_segment is not None:
            return self._by_segment.rows(wires)
        for members, planes in by_size(wires):
            if len(members) < MIN_ROWS or len(planes) > MAX_PERMUTED_BYTES:
                continue
            for stack in self._stacker.stacks(planes, members)[0]:
                permutation = self._permutation(stack)
                if permutation is None or len(stack.members) < MIN_ROWS:
                    continue
                rows, good = permutation.rows(np.ascontiguousarray(stack.planes.T))
                converted = zip(stack.members.tolist(), split_rows(rows), good.tolist())
                for n, row, is_good in converted:
                    if is_good:
                        all_rows[n] = row
        return all_rows

    def _permutation(self, stack: Stack) -> Permutation | None:
        """Return the permutation of a stack's layout, made once; None = it has none."""
        key = len(stack.planes), stack.layout.lengths.tobytes()
        cache = self._cache  # another thread may replace the cache meanwhile
        if key in cache:
            return cache[key]
        permutation = self._make(stack.planes[:, 0].tobytes())
        if len(cache) >= MAX_CACHED:
            cache = self._cache = {}
        cache[key] = permutation
        return permutation

    def _make(self, wire: bytes) -> Permutation | None:
        """Return the permutation for the layout of a message; None = it has none."""
        try:
            return Permutation(self._segments, wire)
        except (NoPermutation, struct.error):
            return None

    def wires(
        self, data: bytes, starts: Int64Array, ends: Int64Array, sizes: Int64Array
    ) -> list[bytes | None]:
        """Return the messages of rows; a row is its columns, each after its size.

        Args:
            data: Buffer with the rows.
            starts: Offset of each row.
            ends: Offset after each row.
            sizes: Size of each message, bytes.

        Returns:
            The messages; None for each that must be built alone, and whose row may be malformed.
        """
        messages: list[bytes | None] = [None] * len(starts)
        if len(starts) < MIN_ROWS:
            return messages
        if self._by_segment is not None:
            return self._by_segment.wires(data, starts, ends)
        lengths = ends - starts
        order = np.lexsort((sizes, lengths))
        changes = np.diff(lengths[order]).astype(bool) | np.diff(sizes[order]).astype(bool)
        for members in np.split(order, np.flatnonzero(changes) + 1):
            length = int(lengths[members[0]])
            # The rest of an expired row ends before its columns.
            if len(members) >= MIN_ROWS and length > 0 and sizes[members[0]] <= MAX_PERMUTED_BYTES:
                self._build(data, starts, length, sizes, members, messages)
        return messages

    def _build(
        self,
        data: bytes,
        starts: Int64Array,
        length: int,
        sizes: Int64Array,
        members: Int64Array,
        messages: list[bytes | None],
    ) -> None:
        """Set the messages of rows of equal size, by the permutations of the layouts tried so far.

        Args:
            length: Size of each row, bytes.
            members: Indices of these rows.
            messages: Messages of all rows, of which some are set.
        """
        key = length, int(sizes[members[0]])
        builders = self._row_cache.get(key, [])
        rows = windows(np.frombuffer(data, np.uint8), length)[starts[members]]
        for n in range(MAX_LAYOUTS_TRIED):
            if n == len(builders):
                builder = self._learn(key, rows[0].tobytes()) if len(members) >= MIN_ROWS else None
                if builder is None:
                    return
                builders = [*builders, builder]
                self._keep(key, builders)
            wires, good = builders[n].wires(rows)
            for at, wire in zip(members[good].tolist(), split_rows(wires[good])):
                messages[at] = wire
            members, rows = members[~good], rows[~good]
            if not len(members):
                return

    def _learn(self, key: tuple[int, int], row: bytes) -> Permutation | None:
        """Return the permutation for the layout of a row; None if there is no permutation."""
        try:
            permutation = self._make(self._plan.build(_columns(row)))
        except (CorruptMessage, struct.error):
            return None
        fits = permutation is not None and (permutation.row_size, permutation.wire_size) == key
        return permutation if fits else None

    def _keep(self, key: tuple[int, int], permutations: list[Permutation]) -> None:
        """Cache the permutations for a row size and message size."""
        cache = self._row_cache  # another thread may replace the cache meanwhile
        if key not in cache and len(cache) >= MAX_CACHED:
            cache = self._row_cache = {}
        cache[key] = permutations


def _columns(row: bytes) -> list[bytes | None]:
    """Split a row into its columns; raises struct.error."""
    columns: list[bytes | None] = []
    at = 0
    while at < len(row):
        (size,) = _size(row, at)
        at += 4
        columns.append(row[at : at + size] if size >= 0 else None)
        at += max(0, size)
    return columns


def split_rows(rows: ByteArray) -> list[bytes]:
    """Return the bytes of each row as a list."""
    size, data = rows.shape[1], rows.tobytes()
    return [data[at : at + size] for at in range(0, len(data), size)]


def windows(data: ByteArray, size: int) -> ByteArray:
    """Return a view of ``size`` bytes from each offset on: (offsets, size)."""
    shape = max(0, len(data) - size + 1), size
    return np.lib.stride_tricks.as_strided(data, shape, (1, 1), writeable=False)


_size = struct.Struct(">i").unpack_from
permuter = lru_cache(maxsize=512)(Permuter)
"""Returns the permuter of a definition, made once per type and md5."""
