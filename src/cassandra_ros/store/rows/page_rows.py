# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rows of a whole page made together with their messages, not column by column."""

from __future__ import annotations

import struct
from itertools import repeat
from typing import Any, Iterable, Iterator, Mapping, NamedTuple, Sequence, cast

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.store.blocks.codec import members_by_size
from cassandra_ros.store.connection.protocol import Offsets, RawPage
from cassandra_ros.store.tables.row_table import Order, RowTable, TableRow
from cassandra_ros.store.tables.table_layout import Portion, StackedMessages, StoredPlanes

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
    received: Sequence[int] | None
    """Receive time of each message, ns; None = it equals ``_t``."""


class PageRows(Portion):
    """Consecutive rows of a page whose messages were made together.

    Args:
        table, node: Table and robot.
        heads: The heads of all rows of the page.
        wires: The messages of all rows of the page; those of these rows are not None.
        between: Numbers of these rows.
    """

    def __init__(
        self, table: RowTable, node: str, heads: _Heads, wires: Sequence[bytes], between: slice
    ) -> None:
        self.table, self.node = table, node
        self._heads, self._wires, self._between = heads, wires, between
        self._values = values = heads.values[between]
        times, seqs = values["t"], values["seq"]
        self.ends = (int(times[0]), int(seqs[0])), (int(times[-1]), int(seqs[-1]))
        self.most, self.nbytes = len(values), int(values["size"].sum())

    def __len__(self) -> int:
        return self.most

    def _cut(self, last: Order) -> tuple[Portion, Portion]:
        """Return the messages up to a key, included, and the others."""
        times, seqs, between = self._values["t"], self._values["seq"], self._between
        head = (times < last[0]) | ((times == last[0]) & (seqs <= last[1]))
        cut = between.start + int(head.sum())
        parts = slice(between.start, cut), slice(cut, between.stop)
        before, after = (
            PageRows(self.table, self.node, self._heads, self._wires, part) for part in parts
        )
        return before, after

    def rows(self) -> Iterable[TableRow]:
        """Return the rows in their order; a row has its message in place of the columns."""
        values, wires = self._values, self._wires[self._between]
        t, seq, conn, sizes = (values[name].tolist() for name in ("t", "seq", "conn", "size"))
        received = self._heads.received
        arrivals: Iterable[int] = repeat(-1) if received is None else received[self._between]
        fixed = repeat(0), repeat(0), repeat(False), wires, repeat(()), repeat("")
        head = t, repeat(self.node), seq, repeat(self.table.name), conn, sizes
        # The fields of a TableRow in their order.
        fields = zip(*head, *fixed, arrivals, repeat(None), repeat(0))
        return map(tuple.__new__, repeat(TableRow), fields)

    def stacked(self) -> StackedMessages | None:
        """Return the bytes of the messages."""
        times, seqs = (self._values[name].astype(np.int64) for name in ("t", "seq"))
        groups = _planes(self._wires[self._between])
        return StackedMessages(self.table, self.node, times, seqs, groups)


def rows_of_page(table: RowTable, node: str, page: RawPage) -> Sequence[TableRow | PageRows] | None:
    """Read a page of listings of all columns of a table with a time key.

    Returns:
        The rows in their order, without those that expired; a row is read by itself if its message
        cannot be made together with others. None = the page has to be read row by row, by
        row_from_values.
    """
    small = len(page.body) < MIN_BYTES
    heads = None if small else _read_heads(page, bool(table.metadata.received_columns))
    if heads is None:
        return None
    sizes = heads.values["size"].astype(np.int64)
    wires = table.encoder.decode_together(page.body, heads.begins, heads.ends, sizes)
    if wires.count(None) == len(wires):
        return None
    wires = _checked(heads.fits, sizes, wires)
    others: dict[int, TableRow] = {}
    for n in [n for n, wire in enumerate(wires) if wire is None]:
        at = int(heads.starts[n])
        if page.end(at) != heads.ends[n]:
            return None  # the guess of the places was wrong, so it is for all later rows
        values = page.row(at)
        try:
            if not table.is_rest(values):
                others[n] = table.row_from_values(node, values)
        except CorruptMessage:
            return None  # the error is raised when the row is read by itself
    return list(_pieces(table, node, heads, wires, others))


def _pieces(
    table: RowTable,
    node: str,
    heads: _Heads,
    wires: Sequence[bytes | None],
    others: Mapping[int, TableRow],
) -> Iterator[TableRow | PageRows]:
    """Yield the rows of a page in their order.

    Args:
        table, node: Table and robot.
        heads: The heads of all rows.
        wires: Their messages; None = the row was read by itself.
        others: The rows that were read by themselves, by their number, without expired ones.
    """
    made = cast(Sequence[bytes], wires)
    begin = 0
    for n in [*(n for n, wire in enumerate(wires) if wire is None), len(wires)]:
        if n > begin:
            yield PageRows(table, node, heads, made, slice(begin, n))
        if n in others:
            yield others[n]
        begin = n + 1


def _checked(
    fits: NDArray[np.bool_], sizes: Offsets, wires: Sequence[bytes | None]
) -> Sequence[bytes | None]:
    """Return the messages of rows, with None for each whose row has to be read by itself."""
    made = None not in wires and fits.all()
    if made and list(map(len, wires)) == sizes.tolist():  # type: ignore[arg-type]
        return wires
    return [
        wire if fit and wire is not None and len(wire) == size else None
        for fit, size, wire in zip(fits.tolist(), sizes.tolist(), wires)
    ]


def _planes(wires: Sequence[bytes]) -> list[StoredPlanes]:
    """Return messages by size."""
    planes: list[StoredPlanes] = []
    for members in members_by_size(np.fromiter(map(len, wires), np.int64, len(wires))):
        same = wires if len(members) == len(wires) else [wires[n] for n in members.tolist()]
        data = np.frombuffer(b"".join(same), np.uint8)
        planes.append((members, data.reshape(len(same), len(same[0])).T, None))
    return planes


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
    received = values["received"].tolist() if with_received else None
    return _Heads(starts, starts + head.itemsize, ends, fits, values, received)
