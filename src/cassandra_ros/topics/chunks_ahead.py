# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Large messages of a scan, asked for before their turn comes."""

from __future__ import annotations

from collections import deque
from typing import Iterable, Iterator

from cassandra_ros.topics.stored_row import StoredRow

AHEAD_BYTES = 8 * 1024 * 1024
"""Of large messages that are on their way, or wait here, about."""
AHEAD_ROWS = 64
"""So many rows wait at most, for rows of other sizes may stand between large ones."""


def chunks_ahead(rows: Iterable[StoredRow]) -> Iterator[StoredRow]:
    """Yield rows as they come, with the chunks of the next ones on their way.

    Only for a reader that wants the messages: the first large one is asked for when its bytes
    are, and as long as each that was yielded has been read, more and more are asked for ahead.
    """
    waiting: deque[tuple[StoredRow, int]] = deque()
    """Rows, and how much of each has been asked for, bytes."""
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
