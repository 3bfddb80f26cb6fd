# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rows of a whole page made together with their messages, not column by column."""

from __future__ import annotations

import struct
from itertools import repeat
from typing import Any, Iterable, Iterator, NamedTuple, Sequence

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.store.connection.protocol import Offsets, RawPage
from cassandra_ros.store.tables.row_table import RowTable, TableRow

MIN_BYTES = 4096
"""Minimum size of an answer, bytes. The rows of a smaller one are read faster one by one."""
_SIZED_AT = 40
"""Offset of the bytes of ``_size`` in a listing: after three columns of eight bytes, all with their
sizes, and its own size."""
_BEGIN = struct.pack(">i", 8)
"""Beginning of each listing: the size of ``_t``."""
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
"""A listing up to the columns of the format, if no value is unusual; each value after its size."""
_RECEIVED = np.dtype([*_HEAD.descr, ("received_size", ">i4"), ("received", ">i8")])
"""The same for tables whose rows have the receive time in a column."""
_MARKS = {
    **dict.fromkeys(("t_size", "seq_size", "conn_size", "received_size"), 8),
    **dict.fromkeys(("nchunks", "crc", "odd", "raw"), -1),
    "size_size": 4,
}
"""Sizes in such a listing; -1 = null."""


class _Heads(NamedTuple):
    """Places of the rows of a page, and the values of our own columns."""

    starts: Offsets
    begins: Offsets
    """Offsets at which the columns of the format begin."""
    ends: Offsets
    fits: NDArray[np.bool_]
    """Whether all sizes are as in _MARKS."""
    values: NDArray[Any]
    """Records of _HEAD or _RECEIVED; of rows that do not fit they are of no use."""
    received: Iterable[int]
    """Receive time of each message, ns; -1 = it equals ``_t``."""

    def rows(
        self, node: str, table: str, wires: Sequence[bytes | None]
    ) -> Iterator[TableRow | None]:
        """Yield each row with its message; None if the row has to be read by itself."""
        t, seq, conn, sizes = (self.values[name].tolist() for name in ("t", "seq", "conn", "size"))
        fixed = repeat(0), repeat(0), repeat(False), wires, repeat(()), repeat("")
        head = t, repeat(node), seq, repeat(table), conn, sizes
        # The fields of a TableRow in their order.
        fields = zip(*head, *fixed, self.received, repeat(None), repeat(0))
        rows = map(tuple.__new__, repeat(TableRow), fields)
        if self.fits.all() and None not in wires and list(map(len, wires)) == sizes:  # type: ignore[arg-type]
            return rows
        checked = zip(self.fits.tolist(), sizes, wires, rows)
        return (
            row if fits and wire is not None and len(wire) == size else None
            for fits, size, wire, row in checked
        )


def rows_of_page(table: RowTable, node: str, page: RawPage) -> Sequence[TableRow] | None:
    """Read a page of listings of all columns of a table with a time key.

    A row has its message in place of the columns, if that could be made of them.

    Returns:
        The rows; None = the page has to be read row by row, by row_from_values.
    """
    small = len(page.body) < MIN_BYTES
    heads = None if small else _read_heads(page, bool(table.metadata.received_columns))
    if heads is None:
        return None
    sizes = heads.values["size"].astype(np.int64)
    wires = table.encoder.decode_together(page.body, heads.begins, heads.ends, sizes)
    if wires.count(None) == len(wires):
        return None
    rows: list[TableRow] = []
    for n, row in enumerate(heads.rows(node, table.name, wires)):
        if row is not None:
            rows.append(row)
            continue
        at = int(heads.starts[n])
        if page.end(at) != heads.ends[n]:
            return None  # the guess of the places was wrong, so it is for all later rows
        values = page.row(at)
        try:
            if not table.is_rest(values):
                rows.append(table.row_from_values(node, values))
        except CorruptMessage:
            return None  # the error is raised when the row is read by itself
    return rows


def _read_heads(page: RawPage, with_received: bool) -> _Heads | None:
    """Read our own columns; None if the rows cannot be told apart. See RawPage.bounds."""
    bounds, head = page.bounds(_SIZED_AT, _BEGIN), _RECEIVED if with_received else _HEAD
    if bounds is None:
        return None
    (starts, ends), data = bounds, np.frombuffer(page.body, np.uint8)
    fits = starts + head.itemsize <= ends
    shape = max(1, len(data) - head.itemsize + 1), head.itemsize
    views = np.lib.stride_tricks.as_strided(data, shape, (1, 1), writeable=False)
    values = views[np.where(fits, starts, 0)].view(head)[:, 0]
    for name, mark in _MARKS.items():
        if name in (head.names or ()):
            fits &= values[name] == mark
    received = values["received"].tolist() if with_received else repeat(-1)
    return _Heads(starts, starts + head.itemsize, ends, fits, values, received)
