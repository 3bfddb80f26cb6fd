# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rows of an answer as received: one byte string in which each column follows its size."""

from __future__ import annotations

import struct
from typing import Callable, Dict, Iterator, List, Optional, Sequence, Tuple, Union, cast, overload

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.connection.paging import RawRow

Offsets = NDArray[np.int64]
_size = struct.Struct(">i").unpack_from
_FOUR = struct.pack(">i", 4)

WIDE = 64 * 1024
"""Average size of a row in bytes from which this module cuts the rows itself."""
FEW = 4
"""Pages with at most this many rows are cut here too: starting the compiled parser would take as
long."""


class RawPage(Sequence[RawRow]):
    """Rows of an answer, which are cut into columns when they are first accessed.

    Args:
        body: Bytes of the answer.
        at: Offset of the number of rows, which stands before the first row.
        width: Number of columns of a row.
        cut: Cuts all rows by the driver's parser.

    Attributes:
        body: Bytes of the answer; empty after the rows were cut.
    """

    def __init__(
        self, body: bytes, at: int, width: int, cut: Callable[[], Sequence[RawRow]]
    ) -> None:
        self.body = body
        self._count, self._at = _size(body, at)[0], at + 4
        self._width = width
        self._cut: Optional[Callable[[], Sequence[RawRow]]] = cut
        self._rows: Sequence[RawRow] = ()
        self._last: Optional[int] = None

    def __len__(self) -> int:
        return int(self._count)

    def __iter__(self) -> Iterator[RawRow]:
        yield from self._every()  # on first use: the driver only tests whether there is an iterator

    @overload
    def __getitem__(self, place: int) -> RawRow: ...

    @overload
    def __getitem__(self, place: slice) -> Sequence[RawRow]: ...

    def __getitem__(self, place: Union[int, slice]) -> Union[RawRow, Sequence[RawRow]]:
        if place == -1 and self._cut is not None and self._last is not None:
            return self.row(self._last)
        return self._every()[place]

    def _every(self) -> Sequence[RawRow]:
        if self._cut is not None:
            here = self._count <= FEW or self._wide
            self._rows = self._cut_here() if here else self._cut()
            self.body, self._cut = b"", None  # or the rows would be in memory twice
        return self._rows

    @property
    def _wide(self) -> bool:
        return bool(len(self.body) >= WIDE * self._count)

    def views(self) -> Iterator[RawRow]:
        """Yield the rows once; columns of wide rows are views of the answer instead of copies."""
        if self._cut is None or not self._wide:
            yield from self._every()
            return
        body, at = cast(bytes, memoryview(self.body)), self._at  # callers read it like bytes
        for _ in range(self._count):
            self._last = at
            yield self._cut_row(body, at)
            at = self.end(at)

    def _cut_here(self) -> Sequence[RawRow]:
        # The compiled parser would copy all columns once more.
        rows, at = [], self._at
        for _ in range(self._count):
            rows.append(self.row(at))
            at = self.end(at)
        return rows

    def bounds(self, sized_at: int, mark: bytes) -> Optional[Tuple[Offsets, Offsets]]:
        """Guess where the rows begin and end; None if that is not possible.

        Rows with the same value in one column of four bytes are taken to be equally long, unless
        the bytes after such a row cannot be the beginning of a row. So the result is a guess. A
        caller who checks every size in a row that begins at its place, and finds that this row ends
        at the place of the next one, has checked the place of the next row too.

        Args:
            sized_at: Offset of that column in a row.
            mark: Bytes with which each row begins.
        """
        body, at, ends = self.body, self._at, []
        lengths: Dict[int, int] = {}
        try:
            offsets = self._alike(mark)
            if offsets is not None:
                self._last = int(offsets[-2])
                return offsets[:-1], offsets[1:]
            for _ in range(self._count):
                (value,) = _size(body, at + sized_at)
                end = at + lengths.get(value, 0)
                begins = body.startswith(mark, end) and body.startswith(_FOUR, end + sized_at - 4)
                if end == at or not (begins or end == len(body)):
                    end = self.end(at)
                    lengths[value] = end - at
                at = end
                ends.append(at)
        except struct.error:
            return None
        if at != len(body) or not ends:
            return None
        offsets = np.array([self._at, *ends], np.int64)
        self._last = int(offsets[-2])
        return offsets[:-1], offsets[1:]

    def _alike(self, mark: bytes) -> Optional[Offsets]:
        """Return where rows of one length begin, and the end of the last.

        None if lengths differ.
        """
        at, size = self._at, len(self.body)
        length = self.end(at) - at
        if not self._count or at + self._count * length != size:
            return None
        found = np.arange(at, size + 1, length)
        begins = found[:-1, None] + np.arange(len(mark))
        data = np.frombuffer(self.body, np.uint8)
        return found if (data[begins] == np.frombuffer(mark, np.uint8)).all() else None

    def end(self, at: int) -> int:
        """Return the end of the row that begins at ``at``; raises struct.error."""
        for _ in range(self._width):
            at += 4 + max(0, _size(self.body, at)[0])
        return at

    def row(self, at: int) -> RawRow:
        """Return the columns of the row that begins at ``at``."""
        return self._cut_row(self.body, at)

    def _cut_row(self, body: bytes, at: int) -> RawRow:
        found: List[Optional[bytes]] = []
        for _ in range(self._width):
            (size,) = _size(body, at)
            at += 4
            found.append(None if size < 0 else body[at : at + size])
            at += max(0, size)
        return tuple(found)
