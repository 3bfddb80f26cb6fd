# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A block as stored in its table, and its messages as rows."""

from __future__ import annotations

import struct
from functools import partial
from itertools import repeat
from typing import Iterable, NamedTuple, Sequence

import numpy as np

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.keys import writer_of
from cassandra_ros.store.blocks.codec import Longs, Unpacked, unpack_block
from cassandra_ros.store.connection.requests import PagedRead, RawRow
from cassandra_ros.store.tables.checksum import crc32
from cassandra_ros.store.tables.row_table import (
    ODD,
    BlockKey,
    Order,
    PartitionKey,
    RowTable,
    TableRow,
    bind,
    decode_long,
    encode_long,
    encode_orders,
)

HEADER_COLUMNS = (
    '"_t", "_seq", "_conn", "_size", "_last", "_n", "_crc", "_nchunks", "_odd", "_gone"'
)
"""Columns of a block that ``read_block`` reads, as CQL, without its bytes."""
WHOLE_BLOCK_COLUMNS = f'{HEADER_COLUMNS}, "_data"'
"""The same with its bytes."""
_FIXED = struct.Struct(">qqqiqi")
"""Values of the first six header columns, encoded, one after the other."""
_new_row = partial(tuple.__new__, TableRow)


class BlockRow(NamedTuple):
    """A block as stored, not unpacked."""

    t: int
    """Key time of its first message in the order (t, seq), ns."""
    seq: int
    conn: int
    size: int
    """Number of serialised bytes of all its messages."""
    last: int
    """Key time of its last message, ns."""
    messages: int
    crc: int
    nchunks: int
    """Number of chunks; 0 = the bytes are in the row."""
    odd: bool
    """Whether the zones of some field do not hold."""
    gone: Longs
    """Positions of deleted messages, each once."""
    data: bytes | None
    """Packed bytes; None if only the header was read, or if all bytes are in chunks."""

    @property
    def key(self) -> Order:
        """``_t`` and ``_seq`` of the block's row."""
        return self.t, self.seq

    @property
    def block_key(self) -> BlockKey:
        """Key of the block as its messages refer to it."""
        return BlockKey(self.t, self.seq, self.messages)

    @property
    def writer(self) -> int:
        """Writer id of all its messages."""
        return writer_of(self.seq)

    @property
    def left(self) -> int:
        """Number of its messages that were not deleted."""
        return self.messages - len(self.gone)


def read_block(table: RowTable, values: RawRow) -> BlockRow | None:
    """Return a block from the values of HEADER_COLUMNS or WHOLE_BLOCK_COLUMNS.

    Return None if the row is not a block: such a row remains when a message is deleted from a block
    that was deleted or has expired.

    Raises:
        CorruptMessage: The row has a connection but lacks another column of a block.
    """
    if values[2] is None:
        return None
    try:
        t, seq, conn, size, last, count = _FIXED.unpack(b"".join(values[:6]))  # type: ignore[arg-type]
    except TypeError as exc:
        raise CorruptMessage(
            f"a block of topic {table.metadata.topic} in table {table.name} at "
            f"{decode_long(values[0])} ns has no size, end or count: something else than this "
            "package wrote or updated it"
        ) from exc
    crc, nchunks, odd, gone, *data = values[6:]
    head = t, seq, conn, size, last, count, decode_long(crc), decode_long(nchunks), odd == ODD
    return BlockRow(*head, gone=_positions(gone, count), data=data[0] if data else None)


def read_blocks(
    table: RowTable, page: Iterable[RawRow], writers: frozenset[int] | None = None
) -> list[BlockRow]:
    """Return the blocks of a page that have one of these writers (None = all).

    Raises:
        CorruptMessage: See ``read_block``.
    """
    rows = (read_block(table, values) for values in page)
    blocks = [block for block in rows if block is not None]
    return blocks if writers is None else [b for b in blocks if b.writer in writers]


def _positions(gone: bytes | None, count: int) -> Longs:
    """Decode the positions of deleted messages in a block of ``count`` messages."""
    if gone is None:
        return _NONE
    # The number of positions as an int, then each position after its length.
    positions = np.frombuffer(gone, ">i4", offset=4).reshape(-1, 2)[:, 1].astype(np.int64)
    return positions[(positions >= 0) & (positions < count)]


_NONE: Longs = np.empty(0, np.int64)


def ask_blocks(
    table: RowTable,
    partition_key: PartitionKey,
    keys: Sequence[Order],
    names: str = WHOLE_BLOCK_COLUMNS,
) -> PagedRead:
    """Request rows by their keys, in one page; rows that are not there are left out.

    Args:
        names: Columns to read, as CQL.
    """
    orders = encode_orders([(encode_long(t), encode_long(seq)) for t, seq in keys])
    return table.send(bind(table.select_listed(names), (*partition_key, orders), len(keys)))


class Block:
    """A block, unpacked.

    Attributes:
        row: The row of the block.
        times, seqs, sizes: Key times (ns), ``_seq`` and serialised bytes of its messages, in the
            order (t, seq).
        unpacked: The messages; None if the only message is in the chunk table.

    Raises:
        CorruptMessage: The bytes are damaged; the text names the messages and the remedy.
    """

    def __init__(self, table: RowTable, node: str, row: BlockRow) -> None:
        self.row = row
        self._table = table
        self._node = node
        self.unpacked: Unpacked | None = None
        self._received: Longs | None = None
        if row.nchunks:
            self._open_chunked()
            return
        try:
            self.unpacked = unpacked = _unpack(row)
        except CorruptMessage as exc:
            raise CorruptMessage(_damage_text(table, node, row, str(exc))) from exc
        self.times, self.seqs, self.sizes = unpacked.times, unpacked.seqs, unpacked.sizes
        self._received = unpacked.received

    def _open_chunked(self) -> None:
        """Take the only message, whose bytes are in chunks, from the row."""
        row = self.row
        self.times, self.seqs, self.sizes = (
            np.array([value], np.int64) for value in (row.t, row.seq, row.size)
        )
        if row.data is not None:  # holds the receive time
            self._received = unpack_block(row.data, 1, 0).received

    def __len__(self) -> int:
        return len(self.times)

    def between(self, low: Order, high: Order) -> Longs:
        """Return the positions with keys from low to high, both included, but no deleted ones."""
        first, last = self._first_from(low), self.first_after(high)
        if not len(self.row.gone):
            return np.arange(first, last)
        stays = np.ones(len(self), bool)
        stays[self.row.gone] = False
        return np.flatnonzero(stays[first:last]) + first

    def first_after(self, order: Order) -> int:
        """Return the position of the first message with a later key than this."""
        return self._first_from((order[0], order[1] + 1))

    def _first_from(self, order: Order) -> int:
        """Return the position of the first message with this key or a later one."""
        t, seq = order
        first = int(self.times.searchsorted(t))
        if first == len(self) or self.times[first] > t:
            return first
        # Messages with equal times are in the order of seq.
        last = int(self.times.searchsorted(t, "right"))
        return first + sum(1 for other in self.seqs[first:last].tolist() if other < seq)

    def first(self, low: Order, high: Order) -> TableRow | None:
        """Return the row of the first message from low to high, both included, not deleted."""
        place = self._first_from(low)
        if len(self.row.gone):
            place = int(next(iter(self.between(low, high)), len(self)))
        if place == len(self):
            return None
        order = int(self.times[place]), int(self.seqs[place])
        return self._row(place, *order) if order <= high else None

    def _row(self, place: int, t: int, seq: int) -> TableRow:
        """Return the row of the message at a position, given its key."""
        # Like rows, without the parts that would take longer than all of this.
        row, wire = self.row, None if self.unpacked is None else self.unpacked.wire(place)
        tail = row.nchunks, row.crc if row.nchunks else 0, False, None, (wire,), ""
        received = -1 if self._received is None else int(self._received[place])
        head = t, self._node, seq, self._table.name, row.conn, int(self.sizes[place])
        return TableRow(*head, *tail, received, row.block_key, place)

    def rows(self, places: Longs, *, bare: bool = False) -> list[TableRow]:
        """Return the rows of some of its messages; bare: without their bytes.

        Args:
            places: Positions of the messages, ascending.
        """
        row, table = self.row, self._table
        whole = len(places) == len(self)
        times, seqs, sizes = (
            (values if whole else values[places]).tolist()
            for values in (self.times, self.seqs, self.sizes)
        )
        columns: Iterable[tuple[bytes | None, ...]] = repeat(())
        if self.unpacked is None:
            columns = repeat(() if bare else (None,))
        elif not bare:
            columns = zip(self.unpacked.wires(None if whole else places))
        arrivals = self._received
        received: Iterable[int] = repeat(-1) if arrivals is None else arrivals[places].tolist()
        rows = zip(
            times,
            repeat(self._node),
            seqs,
            repeat(table.name),
            repeat(row.conn),
            sizes,
            repeat(row.nchunks),
            repeat(row.crc if row.nchunks else 0),
            repeat(False),
            repeat(None),
            columns,
            repeat(""),
            received,
            repeat(row.block_key),
            places.tolist(),
        )
        return list(map(_new_row, rows))  # one call per row would cost more than their bytes


def _unpack(row: BlockRow) -> Unpacked:
    """Unpack a block and compare it with its row; raises CorruptMessage."""
    if row.data is None:
        raise CorruptMessage("its bytes are missing")
    if crc32(row.data) != row.crc:
        raise CorruptMessage("wrong checksum")
    block = unpack_block(row.data, row.messages, row.size)
    ends = (int(block.times[0]), int(block.seqs[0]), int(block.times[-1])) if len(block) else ()
    if ends != (row.t, row.seq, row.last):
        raise CorruptMessage("its messages are not those that its row names")
    return block


def _damage_text(table: RowTable, node: str, row: BlockRow, why: str) -> str:
    whose = f" of node {node}" if node else ""
    return (
        f"{row.messages} messages of topic {table.metadata.topic}{whose} from {row.t} to "
        f"{row.last} cannot be read: {why}; repair the cluster, or import or record them again; "
        f"removeData({row.t}, {row.last}) removes what lies between"
    )


def stand_in(table: RowTable, node: str, row: BlockRow) -> TableRow:
    """Return a row in place of a damaged block; reading its message raises the reason."""
    head = row.t, node, row.seq, table.name, row.conn, row.size
    return TableRow(*head, 0, 0, False, None, (), block=row.block_key)
