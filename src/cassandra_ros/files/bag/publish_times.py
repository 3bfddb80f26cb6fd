# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Store, read and compare publish_time and sequence of the messages of an MCAP."""

from __future__ import annotations

from functools import lru_cache
from typing import Iterator

import numpy as np

from cassandra_ros.errors import BagError
from cassandra_ros.files.bag.message_file import MessageFile
from cassandra_ros.keys import split_seq
from cassandra_ros.store.tables.registry import Run
from cassandra_ros.store.tables.sent_times import STRIPE, SendTimes, SendTimeStore
from cassandra_ros.store.tables.side_tables import SideTables
from cassandra_ros.stores.fleet.fleet_row import FleetRow
from cassandra_ros.topics.stored_row import StoredRow

_STRIPES_HELD = 64
"""Number of 64 KiB stripes kept in memory. Rows arrive almost in file order, so few are needed."""


def store_publish_times(side_tables: SideTables, reader: MessageFile, run: Run) -> None:
    """Store the publish times and sequence numbers of a file.

    The caller has read all chunks before, so ``has_publish_times`` is valid.
    """
    for stripe, sent in _stripes(reader):
        SendTimeStore(side_tables).write_stripe(run.writer, run.node, stripe, sent)


def count_other_publish_times(side_tables: SideTables, reader: MessageFile, run: Run) -> int:
    """Return the number of messages whose stored publish time or sequence differs from the file."""
    table, count = SendTimeStore(side_tables), 0
    for stripe, sent in _stripes(reader):
        stored = table.read_stripe(run.writer, run.node, stripe) or _nothing()
        equal = (stored.delays == sent.delays) & (stored.sequences == sent.sequences)
        count += int((~equal).sum())
    return count


class PublishTimeFinder:
    """Looks up publish time and sequence number of stored rows.

    Args:
        enabled: False = return 0 and 0 for each row, without asking the store.
    """

    def __init__(self, side_tables: SideTables, enabled: bool) -> None:
        table = SendTimeStore(side_tables)
        self._any = enabled and table.has_table()
        self._get = lru_cache(maxsize=_STRIPES_HELD)(table.read_stripe)

    def of(self, row: StoredRow | FleetRow, t_ns: int) -> tuple[int, int]:
        """Return publish_time minus log_time of a message, ns, and its sequence number.

        Return 0 and 0 if they are unknown, or if ``t_ns`` is not the receive time of the message.

        Args:
            t_ns: Time at which the message is written to the file, ns.
        """
        if not self._any or t_ns != row.received:
            return 0, 0
        writer, position = split_seq(row.seq)
        stripe, place = divmod(position, STRIPE)
        sent = self._get(writer, row.node, stripe)
        return (0, 0) if sent is None else (int(sent.delays[place]), int(sent.sequences[place]))


def _nothing() -> SendTimes:
    return SendTimes(np.zeros(STRIPE, np.int64), np.zeros(STRIPE, np.int64))


def _stripes(reader: MessageFile) -> Iterator[tuple[int, SendTimes]]:
    """Yield the number and values of each stripe that has a value other than 0.

    Stripe n holds the messages at positions n * STRIPE to (n + 1) * STRIPE - 1 of the file.
    """
    if not reader.has_publish_times:
        return
    number, stripe = 0, _nothing()
    for chunk in range(reader.chunk_count):
        try:
            times = reader.chunk_publish_times(chunk)
        except BagError:
            break  # the import of the messages tells it when it reaches this chunk
        if times is None:
            continue
        taken = 0
        while taken < len(times.delays):
            target, place = divmod(times.first + taken, STRIPE)
            if target != number:
                if stripe.delays.any() or stripe.sequences.any():
                    yield number, stripe
                number, stripe = target, _nothing()
            count = min(STRIPE - place, len(times.delays) - taken)
            for whole, column in zip(stripe, (times.delays, times.sequences)):
                whole[place : place + count] = column[taken : taken + count]
            taken += count
    if stripe.delays.any() or stripe.sequences.any():
        yield number, stripe
