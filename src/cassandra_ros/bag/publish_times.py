# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""publish_time and sequence of an MCAP's messages, in and out of the store, and compared."""

from __future__ import annotations

from functools import lru_cache
from typing import Iterator

import numpy as np

from cassandra_ros.bag.message_file import MessageFile
from cassandra_ros.keys import split_seq
from cassandra_ros.tables.registry import Run
from cassandra_ros.tables.sent_times import STRIPE, Sent, SentTimes
from cassandra_ros.tables.side_tables import SideTables
from cassandra_ros.topics.stored_row import StoredRow

_STRIPES_HELD = 64
"""Of 64 KiB each: rows come in the order of time, nearly that of a file."""


def store_sent(side_tables: SideTables, reader: MessageFile, run: Run) -> None:
    """Store what a file, whose content was read before, tells of its messages."""
    table = SentTimes(side_tables)
    for stripe, sent in _stripes(reader):
        table.put(run.writer, run.node, stripe, sent)


def count_differing(side_tables: SideTables, reader: MessageFile, run: Run) -> int:
    """Count the messages of which the store tells something else than their file."""
    table, count = SentTimes(side_tables), 0
    for stripe, sent in _stripes(reader):
        stored = table.get(run.writer, run.node, stripe) or _nothing()
        equal = (stored.delays == sent.delays) & (stored.sequences == sent.sequences)
        count += int((~equal).sum())
    return count


class SentFinder:
    """Finds delay and sequence of stored rows; 0 and 0 where nothing is known, or wanted."""

    def __init__(self, side_tables: SideTables, wanted: bool) -> None:
        table = SentTimes(side_tables)
        self._any = wanted and table.any()
        self._get = lru_cache(maxsize=_STRIPES_HELD)(table.get)

    def of(self, row: StoredRow, t_ns: int) -> tuple[int, int]:
        """Return publish_time minus log_time of a message, ns, and its sequence number.

        Args:
            t_ns: Where it is to stand: what is known is of the time when it was received.
        """
        if not self._any or t_ns != row.received:
            return 0, 0
        writer, position = split_seq(row.seq)
        stripe, place = divmod(position, STRIPE)
        sent = self._get(writer, row.node, stripe)
        return (0, 0) if sent is None else (int(sent.delays[place]), int(sent.sequences[place]))


def _nothing() -> Sent:
    return Sent(np.zeros(STRIPE, np.int64), np.zeros(STRIPE, np.int64))


def _stripes(reader: MessageFile) -> Iterator[tuple[int, Sent]]:
    """Gather what the chunks of a file tell, by the places of messages; not where it is nothing."""
    if not reader.tells_sent:
        return
    number, stripe = 0, _nothing()
    for chunk in range(reader.chunk_count):
        told = reader.chunk_sent(chunk)
        if told is None:
            continue
        taken = 0
        while taken < len(told.delays):
            target, place = divmod(told.first + taken, STRIPE)
            if target != number:
                if stripe.delays.any() or stripe.sequences.any():
                    yield number, stripe
                number, stripe = target, _nothing()
            count = min(STRIPE - place, len(told.delays) - taken)
            for whole, part in zip(stripe, (told.delays, told.sequences)):
                whole[place : place + count] = part[taken : taken + count]
            taken += count
    if stripe.delays.any() or stripe.sequences.any():
        yield number, stripe
