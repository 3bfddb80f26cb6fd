# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""cr_sent: send times and sequence numbers of messages of MCAP files.

A row holds them for STRIPE consecutive messages of a file. It exists only if a message has a send
time other than its receive time, or a sequence number.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import zstandard
from numpy.typing import NDArray

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.store.tables.side_tables import SideTables

STRIPE = 4096
"""Number of messages in a row."""
_TABLE = "cr_sent"
_NUMBER = np.dtype("<i8")
_BYTES = 2 * STRIPE * _NUMBER.itemsize
"""Size of the values of a row before they are compressed, bytes."""
Longs = NDArray[np.int64]


class SendTimes(NamedTuple):
    """Send times and sequence numbers of STRIPE consecutive messages."""

    delays: Longs
    """publish_time minus log_time of each message, ns."""
    sequences: Longs


class SendTimeStore:
    """Reads and writes the send times in one keyspace."""

    def __init__(self, side_tables: SideTables) -> None:
        self._tables = side_tables

    def has_table(self) -> bool:
        """Return whether the keyspace has the table of send times."""
        return self._tables.has(_TABLE)

    def write_stripe(self, writer: int, node: str, stripe: int, times: SendTimes) -> None:
        """Store the values of one stripe of an import; they replace those that are stored of it.

        The table of send times is made if the keyspace has none yet.

        Args:
            writer: Writer id of the import's run.
            node: Robot under whose name the messages were imported.
            stripe: Number of the stripe. The first message is at position ``stripe * STRIPE`` of
                the file.
            times: Values of STRIPE messages; 0 where a message has none, or the file ends.
        """
        self._tables.make(_TABLE)
        # Differences, all first bytes side by side, all second bytes, and so on: consecutive
        # numbers compress to nothing.
        columns = np.array([times.delays, np.diff(times.sequences, prepend=0)], _NUMBER)
        raw = columns.view(np.uint8).reshape(-1, _NUMBER.itemsize).T.tobytes()
        row = {"writer": writer, "node": node, "stripe": stripe, "sent": zstandard.compress(raw)}
        self._tables.insert(_TABLE, row, "storing when messages were sent")

    def read_stripe(self, writer: int, node: str, stripe: int) -> SendTimes | None:
        """Return the values of a stripe, as in ``write_stripe``; None if none are stored.

        Raises:
            CorruptMessage: The stored bytes are damaged.
        """
        where, key = "writer = ? AND node = ? AND stripe = ?", (writer, node, stripe)
        what = "reading when messages were sent"
        rows = self._tables.select(_TABLE, "sent", where, key, what=what)
        if not rows:
            return None
        try:
            raw = zstandard.ZstdDecompressor().decompress(rows[0][0], _BYTES)
            columns = np.frombuffer(raw, np.uint8).reshape(_NUMBER.itemsize, -1).T.copy()
            delays, steps = columns.view(_NUMBER).reshape(2, STRIPE)
        except (zstandard.ZstdError, ValueError, MemoryError) as exc:
            raise CorruptMessage(
                f"when messages of run {writer} were sent cannot be read: row {stripe} of {_TABLE} "
                f"is damaged ({exc}); import the file again"
            ) from exc
        return SendTimes(delays, np.cumsum(steps))
