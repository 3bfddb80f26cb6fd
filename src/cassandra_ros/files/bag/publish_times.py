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
    for number, stripe in _stripes(reader):
        SendTimeStore(side_tables).write_stripe(run.writer, run.node, number, stripe)


def count_other_publish_times(side_tables: SideTables, reader: MessageFile, run: Run) -> int:
    """Return the number of messages whose stored publish time or sequence differs from the file.

    The caller has read all chunks before. Values that are stored where the file has only 0 in a
    whole stripe are not looked at.
    """
    table, count = SendTimeStore(side_tables), 0
    for number, stripe in _stripes(reader):
        stored = table.read_stripe(run.writer, run.node, number) or _empty_stripe()
        equal = (stored.delays == stripe.delays) & (stored.sequences == stripe.sequences)
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

        Raises:
            CorruptMessage: The stored values are damaged.
        """
        if not self._any or t_ns != row.received:
            return 0, 0
        writer, position = split_seq(row.seq)
        number, place = divmod(position, STRIPE)
        stripe = self._get(writer, row.node, number)
        if stripe is None:
            return 0, 0
        return int(stripe.delays[place]), int(stripe.sequences[place])


def _empty_stripe() -> SendTimes:
    return SendTimes(np.zeros(STRIPE, np.int64), np.zeros(STRIPE, np.int64))


def _stripes(reader: MessageFile) -> Iterator[tuple[int, SendTimes]]:
    """Yield the number and values of each stripe that has a value other than 0.

    Stripe n holds the messages at positions n * STRIPE to (n + 1) * STRIPE - 1 of the file.
    """
    if not reader.has_publish_times:
        return
    number, stripe = 0, _empty_stripe()
    for chunk in range(reader.chunk_count):
        try:
            times = reader.chunk_publish_times(chunk)
        except BagError:
            break  # the import of the messages tells it when it reaches this chunk
        if times is None:
            continue
        taken = 0  # number of messages of the chunk that are in a stripe
        while taken < len(times.delays):
            number_now, place = divmod(times.first + taken, STRIPE)
            if number_now != number:
                if stripe.delays.any() or stripe.sequences.any():
                    yield number, stripe
                number, stripe = number_now, _empty_stripe()
            count = min(STRIPE - place, len(times.delays) - taken)
            stripe.delays[place : place + count] = times.delays[taken : taken + count]
            stripe.sequences[place : place + count] = times.sequences[taken : taken + count]
            taken += count
    if stripe.delays.any() or stripe.sequences.any():
        yield number, stripe
