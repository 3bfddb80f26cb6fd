# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The rows of a page read at once, with their messages: not column by column."""

from __future__ import annotations

import struct
from itertools import repeat
from typing import Any, Iterable, Iterator, List, NamedTuple, Optional, Sequence

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.connection.raw_page import Places, RawPage
from cassandra_ros.errors import CorruptMessage
from cassandra_ros.tables.row_table import RowTable, TableRow

MIN_BYTES = 4096
"""Of an answer: the rows of a smaller one are quicker read one by one."""
_SIZED_AT = 40
"""Where in a listing the bytes of ``_size`` lie, behind three columns of eight bytes and its own
size."""
_BEGIN = struct.pack(">i", 8)
"""With which a listing begins: the size of ``_t``."""
_HEAD = np.dtype(
    [
        ("t_size", ">i4"),
        ("t", ">i8"),
        ("seq_size", ">i4"),
        ("seq", ">i8"),
        ("conn_size", ">i4"),
        ("conn", ">i8"),
        ("size_size", ">i4"),
        ("size", ">i4"),
        ("nchunks", ">i4"),
        ("crc", ">i4"),
        ("odd", ">i4"),
        ("raw", ">i4"),
    ]
)
"""A listing up to the columns of the format, where nothing is odd: each value behind its size."""
_RECEIVED = np.dtype([*_HEAD.descr, ("received_size", ">i4"), ("received", ">i8")])
_MARKS = {
    **dict.fromkeys(("t_size", "seq_size", "conn_size", "received_size"), 8),
    **dict.fromkeys(("nchunks", "crc", "odd", "raw"), -1),
    "size_size": 4,
}
"""What stands there then."""


class _Heads(NamedTuple):
    """Where the rows of a page lie, and what our own columns say."""

    starts: Places
    begins: Places
    """Where the columns of the format begin."""
    ends: Places
    fits: NDArray[np.bool_]
    """Whether nothing in it is odd."""
    values: NDArray[Any]
    received: Iterable[int]
    """When each message was received, -1 = at ``_t``."""

    def rows(
        self, node: str, table: str, wires: Sequence[Optional[bytes]]
    ) -> Iterator[Optional[TableRow]]:
        """Yield each row with its message; None where it is to be looked at by itself."""
        t, seq, conn, sizes = (self.values[name].tolist() for name in ("t", "seq", "conn", "size"))
        fixed = repeat(0), repeat(0), repeat(False), wires, repeat(()), repeat("")
        own = t, repeat(node), seq, repeat(table), conn, sizes
        every = zip(*own, *fixed, self.received, repeat(None), repeat(0))
        rows = map(tuple.__new__, repeat(TableRow), every)
        if self.fits.all() and None not in wires and list(map(len, wires)) == sizes:  # type: ignore[arg-type]
            return rows
        checked = zip(self.fits.tolist(), sizes, wires, rows)
        return (
            row if fine and wire is not None and len(wire) == size else None
            for fine, size, wire, row in checked
        )


def rows_of_page(table: RowTable, node: str, page: RawPage) -> Optional[Sequence[TableRow]]:
    """Read a page of listings of all columns of rows that lie by time.

    Rows have their message instead of its columns, where it could be made of them.

    Returns:
        None where they are to be read one by one, by row_from_values.
    """
    small = len(page.body) < MIN_BYTES
    heads = None if small else _read_heads(page, bool(table.metadata.received_columns))
    if heads is None:
        return None
    sizes = heads.values["size"].astype(np.int64)
    wires = table.decode_together(page.body, heads.begins, heads.ends, sizes)
    if wires.count(None) == len(wires):
        return None
    found: List[TableRow] = []
    for n, row in enumerate(heads.rows(node, table.name, wires)):
        if row is not None:
            found.append(row)
            continue
        at = int(heads.starts[n])
        if page.end(at) != heads.ends[n]:
            return None  # the guess was wrong, so it is for all that follow
        values = page.row(at)
        try:
            if not table.is_rest(values):
                found.append(table.row_from_values(node, values))
        except CorruptMessage:
            return None  # it is told when its turn comes
    return found


def _read_heads(page: RawPage, with_received: bool) -> Optional[_Heads]:
    """Read our own columns; None where rows cannot be told apart. See RawPage.bounds."""
    bounds, head = page.bounds(_SIZED_AT, _BEGIN), _RECEIVED if with_received else _HEAD
    if bounds is None:
        return None
    (starts, ends), data = bounds, np.frombuffer(page.body, np.uint8)
    fits = starts + head.itemsize <= ends
    shape = max(1, len(data) - head.itemsize + 1), head.itemsize
    views = np.lib.stride_tricks.as_strided(data, shape, (1, 1), writeable=False)
    values = views[np.where(fits, starts, 0)].view(head)[:, 0]
    for name, wanted in _MARKS.items():
        if name in (head.names or ()):
            fits &= values[name] == wanted
    received = values["received"].tolist() if with_received else repeat(-1)
    return _Heads(starts, starts + head.itemsize, ends, fits, values, received)
