# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Two streams of rows in the order of time, joined by who is nearest in time."""

from __future__ import annotations

from typing import Iterator, Optional, Tuple

from cassandra_ros.topics.stored_row import StoredRow

Pair = Tuple[StoredRow, Optional[StoredRow]]


def nearestPairs(
    first: Iterator[StoredRow],
    second: Iterator[StoredRow],
    tolerance_ns: int,
    unpaired: bool = False,
) -> Iterator[Pair]:
    """Pair each row of one stream with the nearest one of another; two of that are held.

    Of two rows that are equally near the earlier one is taken, of equal times the first.

    Args:
        first, second: In the order of time.
        tolerance_ns: The largest distance of a partner, ns.
        unpaired: Give rows of the first that have no partner with None, else leave them out.
    """
    before: Optional[StoredRow] = None
    ahead = next(second, None)
    for row in first:
        while ahead is not None and ahead.t <= row.t:
            if before is None or before.t < ahead.t:
                before = ahead
            ahead = next(second, None)
        partner = _nearer(row.t, before, ahead)
        if partner is not None and abs(partner.t - row.t) <= tolerance_ns:
            yield row, partner
        elif unpaired:
            yield row, None
        elif ahead is None:
            return  # the rows that follow are further away still


def _nearer(t: int, before: Optional[StoredRow], ahead: Optional[StoredRow]) -> Optional[StoredRow]:
    if before is None or ahead is None:
        return before or ahead
    return before if t - before.t <= ahead.t - t else ahead
