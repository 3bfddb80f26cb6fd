# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Messages of one connection, gathered until they make a block.

Where a block ends follows from the messages alone, in the order in which they come, unless they
are sealed by their age: so an import that is repeated ends in the same rows. The key of a block is
that of its first message, also while it grows: what a killed import left is written over.
"""

from __future__ import annotations

import math
import threading
import time
from functools import partial
from typing import AbstractSet, Callable, List, NamedTuple, Optional, Sequence, Tuple
from weakref import WeakValueDictionary

import numpy as np

from cassandra_ros.blocks.codec import Longs, pack_block
from cassandra_ros.tables.block_limits import ALONE_BYTES, Limits
from cassandra_ros.tables.checksum import crc32
from cassandra_ros.tables.row_table import CHUNK_BYTES, RowTable

Again = Callable[[int, int, bytes], object]
"""Writes a message anew, from its time of reception, ns, its ``_seq`` and its bytes."""
KeyTime = Callable[[int, bytes], int]
"""From the time of reception, ns, and the serialised message to the key time."""


class Block(NamedTuple):
    """Messages of one connection as a row, sorted by (time, ``_seq``)."""

    times: Sequence[int]
    """Key times, ns."""
    seqs: Sequence[int]
    received: Optional[Sequence[int]]
    """Times of reception, ns, where those are not the key times."""
    wires: Sequence[bytes]
    conn: int
    data: bytes
    """Packed; of a message that goes to chunks no more than its times, b'' where the row has
    those."""
    crc: int
    """Of the data, or of the one message that goes to chunks."""
    zones: Sequence[Optional[bytes]]
    """Encoded bounds, in the order of the table's zone columns."""
    nan: Tuple[str, ...]
    """Fields of which a value is NaN."""
    odd: bool
    """The bounds do not hold for some field."""
    again: Optional[Again] = None

    @property
    def t(self) -> int:
        """Key time of the first message, ns."""
        return self.times[0]

    @property
    def seq(self) -> int:
        """``_seq`` of the first message."""
        return self.seqs[0]

    @property
    def wire(self) -> bytes:
        """The only message of one that goes to chunks."""
        return self.wires[0]

    @property
    def in_chunks(self) -> bool:
        """Whether it is one message that is too large for a row."""
        return len(self.wires[0]) > CHUNK_BYTES

    def rewriters(self) -> List[Optional[Callable[[], object]]]:
        """Return for each message what writes it anew, None where nobody can."""
        if self.again is None:
            return [None] * len(self.wires)
        arrivals = self.times if self.received is None else self.received
        every = zip(arrivals, self.seqs, self.wires)
        return [partial(self.again, *message) for message in every]


def make_block(
    table: RowTable,
    conn: int,
    times: Sequence[int],
    seqs: Sequence[int],
    wires: Sequence[bytes],
    received: Optional[Sequence[int]] = None,
    again: Optional[Again] = None,
) -> Block:
    """Make the row of at least one message, in any order."""
    order = None if len(times) == 1 else _order(times, seqs)
    if order is not None:
        times, seqs = [times[n] for n in order], [seqs[n] for n in order]
        wires = [wires[n] for n in order]
        received = None if received is None else [received[n] for n in order]
    zones, nan, odd = table.zones(wires)
    if len(wires[0]) <= CHUNK_BYTES:
        data = pack_block(times, seqs, wires, received)
        crc = crc32(data)
    else:
        data = b"" if received is None else pack_block(times, seqs, [b""], received)
        crc = crc32(wires[0])
    return Block(times, seqs, received, wires, conn, data, crc, zones, nan, odd, again)


def _order(times: Sequence[int], seqs: Sequence[int]) -> Optional[List[int]]:
    """Return in which order messages lie; None: in theirs."""
    t, s = np.array(times, np.int64), np.array(seqs, np.int64)
    if ((t[1:] > t[:-1]) | ((t[1:] == t[:-1]) & (s[1:] > s[:-1]))).all():
        return None
    found: List[int] = np.lexsort((s, t)).tolist()
    return found


class BlockBuilder:
    """The block that one connection of one writer fills. Thread-safe.

    Args:
        table: It has blocks.
        node: The robot or entity that produced the messages.
        conn: Number of the connection.
        builders: Knows what all of one writer share.

    Attributes:
        nbytes: Serialised bytes that wait here.
        since: When the oldest of what waits came; monotonic.
        key_time: Finds the key time where that is not the time of reception.
        again: Writes a message anew where the table is gone.
    """

    def __init__(
        self,
        table: RowTable,
        node: str,
        conn: int,
        builders: Builders,
    ) -> None:
        self.table, self.node, self.conn = table, node, conn
        self._all = builders
        self._span_ns, self._bucket_ns = table.metadata.span_ns, table.metadata.bucket_ns
        self._most, self._most_bytes = builders.limits
        self.key_time: Optional[KeyTime] = None
        self.again: Optional[Again] = None
        # Held while a block is packed and handed on: so blocks leave in their order.
        self._lock = threading.RLock()
        self._clear()

    def _clear(self) -> None:
        self.nbytes = 0
        self.since = 0.0
        # Nothing lies between them: whatever comes begins a block.
        self._first, self._latest = 0, -1
        self._times: List[int] = []
        self._seqs: List[int] = []
        self._wires: List[bytes] = []
        self._received: List[int] = []

    def take(self, received: int, seq: int, wire: bytes) -> bool:
        """Take a message; says whether it was taken, for the table may be gone.

        Args:
            received: When it was received, ns.
            seq: Writer id << 32 | counter.
        """
        key_time, size = self.key_time, len(wire)
        t = received if key_time is None else key_time(received, wire)
        with self._lock:
            nbytes = self.nbytes + size
            # This is passed for every message of a recording: nothing here is for beauty.
            if (
                not self._first <= t <= self._latest
                or nbytes > self._most_bytes
                or size > ALONE_BYTES
            ):
                if not self._begin(t):
                    return False
                nbytes = size
            self.nbytes = nbytes
            times = self._times
            times.append(t)
            self._seqs.append(seq)
            self._wires.append(wire)
            if key_time is not None:
                self._received.append(received)
            if len(times) >= self._most or size > ALONE_BYTES:
                self.seal()
        return True

    def take_run(self, received: Longs, seqs: Longs, wires: Sequence[bytes]) -> int:
        """Take messages as if one by one; return how many: fewer where the table is gone."""
        nbytes = np.cumsum(np.fromiter(map(len, wires), np.int64, len(wires)))
        alone = np.diff(nbytes, prepend=0).max(initial=0) > ALONE_BYTES
        times, numbers = received.tolist(), seqs.tolist()
        if alone or self.key_time is not None:
            every = zip(times, numbers, wires)
            return next((n for n, each in enumerate(every) if not self.take(*each)), len(wires))
        at = 0
        with self._lock:
            while at < len(wires):
                stop = self._room(received, nbytes, at)
                if stop == at:
                    if not self._begin(times[at]):
                        return at
                    stop = max(at + 1, self._room(received, nbytes, at))
                self.nbytes += int(nbytes[stop - 1] - (nbytes[at - 1] if at else 0))
                self._times += times[at:stop]
                self._seqs += numbers[at:stop]
                self._wires += wires[at:stop]
                at = stop
                if len(self._times) >= self._most:
                    self.seal()
        return at

    def _room(self, times: Longs, nbytes: Longs, at: int) -> int:
        """Return before which message, of those from one on, the block that is filled must end.

        Args:
            nbytes: Serialised bytes of all messages up to and with each.
        """
        most = self._most_bytes - self.nbytes + (int(nbytes[at - 1]) if at else 0)
        room = int(np.searchsorted(nbytes, most, "right"))
        stop = max(at, min(room, at + self._most - len(self._times)))
        beyond = (times[at:stop] < self._first) | (times[at:stop] > self._latest)
        return at + int(beyond.argmax()) if beyond.any() else stop

    def _begin(self, t: int) -> bool:
        """Seal what is here, and begin a block with a message of this time; False: it may not."""
        self._all.check()
        self.seal()
        if self.table.name in self._all.gone:
            return False
        bucket_end = (t // self._bucket_ns + 1) * self._bucket_ns
        self._first, self._latest = t, min(t + self._span_ns, bucket_end - 1)
        self.since = time.monotonic()
        self._all.filling[id(self)] = self
        return True

    def seal(self) -> None:
        """Hand on what waits here as a block, if anything does."""
        with self._lock:
            if not self._times:
                return
            received = self._received if self.key_time is not None else None
            block = make_block(
                self.table, self.conn, self._times, self._seqs, self._wires, received, self.again
            )
            try:
                self._all.put(self, block)
            finally:  # whatever happens there, its messages are stored or counted as lost
                self._clear()
                self._all.filling.pop(id(self), None)

    def seal_older(self, than: float) -> None:
        """Seal what began before a time, monotonic."""
        if self.since < than:
            with self._lock:
                if self.since < than:
                    self.seal()


class Builders:
    """The builders of one writer. Thread-safe.

    Args:
        limits: Most of what a block holds.
        put: Takes a block that is complete; it may wait, and tells others what fails.
        check: Called before a block is begun; raises what became of earlier ones where nobody
            else is told.
        gone: Names of tables that were dropped: nothing is taken for them any more.
    """

    def __init__(
        self,
        limits: Limits,
        put: Callable[[BlockBuilder, Block], None],
        check: Callable[[], None],
        gone: AbstractSet[str],
    ) -> None:
        self.limits, self.put, self.check, self.gone = limits, put, check, gone
        self.filling: dict[int, BlockBuilder] = {}
        """Those that hold messages, by their id; each adds and removes itself."""
        # The others live as long as those who write through them.
        self._known: WeakValueDictionary[tuple[str, str, int], BlockBuilder] = WeakValueDictionary()
        self._mutex = threading.Lock()

    def get(self, table: RowTable, node: str, conn: int) -> BlockBuilder:
        """Return the one that takes the messages of a connection."""
        key = (table.name, node, conn)
        with self._mutex:
            found = self._known.get(key)
            if found is None:
                found = self._known[key] = BlockBuilder(table, node, conn, self)
            return found

    def seal(self, older_than: float = math.inf) -> None:
        """Hand on all blocks that began before a time, monotonic."""
        for builder in list(self.filling.values()):
            builder.seal_older(older_than)

    @property
    def nbytes(self) -> int:
        """Serialised bytes that wait in blocks."""
        return sum(builder.nbytes for builder in list(self.filling.values()))
