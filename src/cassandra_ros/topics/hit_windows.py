# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Windows around hits: merged where they overlap, while the hits come."""

from __future__ import annotations

from typing import Iterable, Iterator, NamedTuple, Optional

from cassandra_ros.topics.key_selection import TimeRange


class Piece(NamedTuple):
    """A window, or a part of a long one; times are ns, ends are included."""

    window: int
    """Where the window begins, of which this is a part."""
    low: int
    high: int


def merge_windows(
    hits: Iterable[int],
    before: int,
    after: int,
    bounds: TimeRange,
    longest: int,
) -> Iterator[Piece]:
    """Make windows of before to after around hits, lazily, one where some overlap or touch.

    Memory: that of one window, however many hits there are.

    Args:
        hits: Times in their order, inside of the bounds, ns.
        before, after: How far a window reaches around its hit, ns, at least 0.
        bounds: No window reaches beyond these.
        longest: A window that is at least so long is given in pieces, each beginning behind
            the one before it, ns.

    Yields:
        Pieces in order, without overlap.
    """
    current: Optional[Piece] = None
    for hit in hits:
        low, high = max(bounds.low, hit - before), min(bounds.high, hit + after)
        if current is None or low > current.high + 1:
            yield from _filled(current)
            current = Piece(low, low, high)
            continue
        current = current._replace(high=max(current.high, high))
        if current.high - current.low >= longest:
            yield current
            # Empty until the next hit makes it longer.
            current = current._replace(low=current.high + 1)
    yield from _filled(current)


def _filled(piece: Optional[Piece]) -> Iterator[Piece]:
    if piece is not None and piece.low <= piece.high:
        yield piece


def joined(pieces: Iterable[Piece]) -> Iterator[TimeRange]:
    """Put the pieces of each window together."""
    whole: Optional[TimeRange] = None
    for window, _, high in pieces:
        if whole is not None and whole.low != window:
            yield whole
        whole = TimeRange(window, high)
    if whole is not None:
        yield whole
