# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Gathers messages of one connection until they make a block.

The messages alone, in the order of their arrival, decide where a block ends, unless a block is
closed because of its age. So a repeated import writes the same rows. The key of a block is that of
its first message, which does not change while the block grows. So a repeated import also replaces
what a killed import has left.
"""

from __future__ import annotations

import math
import threading
import time
from functools import partial
from typing import AbstractSet, Callable, NamedTuple, Sequence
from weakref import WeakValueDictionary

import numpy as np

from cassandra_ros.store.blocks.codec import Longs, pack_block
from cassandra_ros.store.tables.checksum import crc32
from cassandra_ros.store.tables.lengths import MAX_BLOCK_BYTES, MAX_BLOCK_MESSAGES
from cassandra_ros.store.tables.row_table import LARGE_MESSAGE_CHUNK_BYTES, RowTable

MIN_BYTES = 16 * 1024
"""Minimum limit of the bytes of a block, however many are filled at the same time."""
ALL_BYTES = 64 * 1024 * 1024
"""Maximum number of bytes in all blocks of a bag together while they are being filled."""
ALONE_BYTES = 64 * 1024
"""Size from which a message gets a block of its own, bytes."""


class BlockLimits(NamedTuple):
    """Maximum number of messages and of serialised bytes in one block."""

    messages: int = MAX_BLOCK_MESSAGES
    bytes: int = MAX_BLOCK_BYTES


FULL = BlockLimits()
"""The limits if few blocks are filled at the same time."""


def limits_for(connections: int) -> BlockLimits:
    """Return the limits of blocks for ``connections`` blocks that are filled at the same time."""
    nbytes = max(MIN_BYTES, min(MAX_BLOCK_BYTES, ALL_BYTES // max(connections, 1)))
    # Each message takes some memory in addition to its bytes.
    return BlockLimits(nbytes * MAX_BLOCK_MESSAGES // MAX_BLOCK_BYTES, nbytes)


MessageAgain = Callable[[int, int, bytes], object]
"""Writes a message again, given its receive time (ns), its ``_seq`` and its bytes."""
KeyTime = Callable[[int, bytes], int]
"""Returns the key time (ns) for a receive time (ns) and a serialised message."""


class NewBlock(NamedTuple):
    """Messages of one connection as a row, sorted by (time, ``_seq``)."""

    times: Sequence[int]
    """Key times, ns."""
    seqs: Sequence[int]
    received: Sequence[int] | None
    """Receive times, ns; None = they equal the key times."""
    wires: Sequence[bytes]
    conn: int
    data: bytes
    """Packed messages. For a message in chunks only its times, or b'' if the row has these."""
    crc: int
    """Checksum of ``data``, or of the message in chunks."""
    zones: Sequence[bytes | None]
    """Encoded minimum and maximum values, in the order of the table's zone columns."""
    nan: tuple[str, ...]
    """Names of the fields with a NaN value."""
    odd: bool
    """Whether the zones of some field do not hold."""
    again: MessageAgain | None = None
    """Writes one of the messages again, if the block is not stored; None = not possible."""

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
        """The message of a block that goes to chunks."""
        return self.wires[0]

    @property
    def in_chunks(self) -> bool:
        """Whether the block is one message that is too large for a row."""
        return len(self.wires[0]) > LARGE_MESSAGE_CHUNK_BYTES

    def rewriters(self) -> list[Callable[[], object] | None]:
        """Return for each message a function that writes it again.

        None if there is no such function.
        """
        if self.again is None:
            return [None] * len(self.wires)
        arrivals = self.times if self.received is None else self.received
        messages = zip(arrivals, self.seqs, self.wires)
        return [partial(self.again, *message) for message in messages]


def make_block(
    table: RowTable,
    conn: int,
    times: Sequence[int],
    seqs: Sequence[int],
    wires: Sequence[bytes],
    received: Sequence[int] | None = None,
    again: MessageAgain | None = None,
) -> NewBlock:
    """Return the block of one or more messages, given in any order.

    A message that is too large for a row must be the only one; see NewBlock for the arguments.
    """
    order = None if len(times) == 1 else _order(times, seqs)
    if order is not None:
        times, seqs = [times[n] for n in order], [seqs[n] for n in order]
        wires = [wires[n] for n in order]
        received = None if received is None else [received[n] for n in order]
    zones, nan, odd = table.encoder.zones(wires)
    if len(wires[0]) <= LARGE_MESSAGE_CHUNK_BYTES:
        data = pack_block(times, seqs, wires, received)
        crc = crc32(data)
    else:
        data = b"" if received is None else pack_block(times, seqs, [b""], received)
        crc = crc32(wires[0])
    return NewBlock(times, seqs, received, wires, conn, data, crc, zones, nan, odd, again)


def _order(times: Sequence[int], seqs: Sequence[int]) -> list[int] | None:
    """Return the order of messages by time and ``_seq``; None if they are in this order."""
    t, s = np.array(times, np.int64), np.array(seqs, np.int64)
    if ((t[1:] > t[:-1]) | ((t[1:] == t[:-1]) & (s[1:] > s[:-1]))).all():
        return None
    order: list[int] = np.lexsort((s, t)).tolist()
    return order


class BlockBuilder:
    """Fills the blocks of one connection of one writer. Thread-safe.

    Its lock is taken before that of the writer, to which it passes blocks.

    Args:
        table: A table of format ``packed``.
        node: The robot or other source of the messages.
        conn: Number of the connection.
        builders: All builders of the writer.
        key_time: Returns the key time of a message; None = it is the receive time.
        again: Writes a message again after its table was dropped; None = not possible.

    Attributes:
        nbytes: Number of serialised bytes in the present block.
        since: Monotonic time at which the oldest message of the present block came, s; 0 = there is
            no block.
    """

    def __init__(
        self,
        table: RowTable,
        node: str,
        conn: int,
        builders: Builders,
        key_time: KeyTime | None = None,
        again: MessageAgain | None = None,
    ) -> None:
        self.table, self.node, self.conn = table, node, conn
        self._all = builders
        self._span_ns, self._bucket_ns = table.metadata.span_ns, table.metadata.bucket_ns
        self._max_messages, self._max_bytes = builders.limits
        self._key_time = key_time
        self._again = again
        # Held while a block is packed and passed on, so that blocks leave in their order.
        self._lock = threading.RLock()
        self._clear()

    def _clear(self) -> None:
        self.nbytes = 0
        self.since = 0.0
        # Key times that the block takes, ns. An empty range: the next message begins a block.
        self._first, self._latest = 0, -1
        self._times: list[int] = []
        self._seqs: list[int] = []
        self._wires: list[bytes] = []
        self._received: list[int] = []

    def add_message(self, received: int, seq: int, wire: bytes) -> bool:
        """Add a message to a block; return False, without adding it, if its table was dropped.

        Args:
            received: Receive time, ns.
            seq: Writer id << 32 | counter.

        Raises:
            WriteFailed: An earlier block was given up, which was not reported otherwise.
        """
        key_time, size = self._key_time, len(wire)
        t = received if key_time is None else key_time(received, wire)
        with self._lock:
            nbytes = self.nbytes + size
            # Runs for every message of a recording, so it is written for speed.
            if (
                not self._first <= t <= self._latest
                or nbytes > self._max_bytes
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
            if len(times) >= self._max_messages or size > ALONE_BYTES:
                self.seal()
        return True

    def add_messages(self, received: Longs, seqs: Longs, wires: Sequence[bytes]) -> int:
        """Add messages like ``add_message``, which makes the same blocks of them.

        Return how many were added: fewer if the table was dropped.
        """
        nbytes = np.cumsum(np.fromiter(map(len, wires), np.int64, len(wires)))
        alone = np.diff(nbytes, prepend=0).max(initial=0) > ALONE_BYTES
        times, numbers = received.tolist(), seqs.tolist()
        if alone or self._key_time is not None:
            messages = zip(times, numbers, wires)
            return next(
                (n for n, args in enumerate(messages) if not self.add_message(*args)), len(wires)
            )
        at = 0
        with self._lock:
            while at < len(wires):
                stop = self._room(received, nbytes, at)
                if stop == at:
                    if not self._begin(times[at]):
                        return at
                    # A new block takes its first message, however large that is.
                    stop = max(at + 1, self._room(received, nbytes, at))
                self.nbytes += int(nbytes[stop - 1] - (nbytes[at - 1] if at else 0))
                self._times += times[at:stop]
                self._seqs += numbers[at:stop]
                self._wires += wires[at:stop]
                at = stop
                if len(self._times) >= self._max_messages:
                    self.seal()
        return at

    def _room(self, times: Longs, nbytes: Longs, at: int) -> int:
        """Return the index, from ``at`` on, of the first message that no longer fits the block.

        Args:
            nbytes: Running total of the serialised bytes, including each message.
        """
        limit = self._max_bytes - self.nbytes + (int(nbytes[at - 1]) if at else 0)
        stop = int(np.searchsorted(nbytes, limit, "right"))
        stop = max(at, min(stop, at + self._max_messages - len(self._times)))
        beyond = (times[at:stop] < self._first) | (times[at:stop] > self._latest)
        return at + int(beyond.argmax()) if beyond.any() else stop

    def _begin(self, t: int) -> bool:
        """Close the present block and begin one at key time ``t``; raises like ``add_message``.

        Return False, and begin none, if the table was dropped.
        """
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
        """Close the present block and pass it on, if it has messages; may wait for the store."""
        with self._lock:
            if not self._times:
                return
            received = self._received if self._key_time is not None else None
            block = make_block(
                self.table, self.conn, self._times, self._seqs, self._wires, received, self._again
            )
            try:
                self._all.put(self, block)
            finally:  # even after an error its messages are either stored or counted as lost
                self._clear()
                self._all.filling.pop(id(self), None)

    def seal_older(self, than: float) -> None:
        """Close the block if it began before a monotonic time, s."""
        if self.since < than:  # without the lock, which its thread may hold for long
            with self._lock:
                if self.since < than:
                    self.seal()


class Builders:
    """The block builders of one writer. Thread-safe.

    Args:
        limits: Maximum size of a block.
        put: Takes a closed block; it may wait, and reports errors itself.
        check: Called before a block is begun; raises the error of an earlier block that has not
            been reported otherwise.
        gone: Names of dropped tables, for which no more messages are taken.
    """

    def __init__(
        self,
        limits: BlockLimits,
        put: Callable[[BlockBuilder, NewBlock], None],
        check: Callable[[], None],
        gone: AbstractSet[str],
    ) -> None:
        self.limits, self.put, self.check, self.gone = limits, put, check, gone
        self.filling: dict[int, BlockBuilder] = {}
        """Builders with messages, by their id; each adds and removes itself."""
        # A builder without messages lives as long as the writer of its connection refers to it.
        self._by_connection: WeakValueDictionary[tuple[str, str, int], BlockBuilder] = (
            WeakValueDictionary()
        )
        """Builders by table, node and connection."""
        self._mutex = threading.Lock()

    def get(
        self,
        table: RowTable,
        node: str,
        conn: int,
        key_time: KeyTime | None = None,
        again: MessageAgain | None = None,
    ) -> BlockBuilder:
        """Return the builder for the messages of a connection."""
        key = (table.name, node, conn)
        with self._mutex:
            builder = self._by_connection.get(key)
            if builder is None:
                builder = BlockBuilder(table, node, conn, self, key_time, again)
                self._by_connection[key] = builder
            return builder

    def seal(self, older_than: float = math.inf) -> None:
        """Close and pass on all blocks that began before a monotonic time, s."""
        for builder in list(self.filling.values()):
            builder.seal_older(older_than)

    @property
    def nbytes(self) -> int:
        """Number of serialised bytes in open blocks."""
        return sum(builder.nbytes for builder in list(self.filling.values()))
