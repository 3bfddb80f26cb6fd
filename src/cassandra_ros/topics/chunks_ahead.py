# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Large messages whose chunks are requested before the reader gets there."""

from __future__ import annotations

from collections import deque
from typing import Iterable, Iterator

from cassandra_ros.topics.stored_row import StoredRow

AHEAD_BYTES = 8 * 1024 * 1024
"""Approximate maximum number of bytes of large messages that are requested or wait here."""
AHEAD_ROWS = 64
"""Maximum number of rows that wait here: rows of other sizes may be between the large ones."""


def chunks_ahead(rows: Iterable[StoredRow]) -> Iterator[StoredRow]:
    """Yield rows as they come, with the chunks of the next large ones requested ahead.

    Only for readers that need the messages. The first large message is requested when its bytes are
    accessed. While every yielded message is accessed, more and more are requested ahead.
    """
    waiting: deque[tuple[StoredRow, int]] = deque()
    """Rows, and the number of bytes of each that have been requested."""
    held = budget = 0
    for row in rows:
        if not (waiting or row.chunked):
            yield row
            continue
        asked = row.size if row.chunked and budget else 0
        if asked:
            row.ask()
        waiting.append((row, asked))
        held += asked
        while waiting and (held >= budget or len(waiting) > AHEAD_ROWS):
            first, asked = waiting.popleft()
            held -= asked
            yield first
            if first.chunked:
                budget = min(AHEAD_BYTES, 2 * budget + first.size) if first.was_read else 0
    while waiting:
        yield waiting.popleft()[0]
