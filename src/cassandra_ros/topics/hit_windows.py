# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Windows around hits, merged as the hits come if they overlap."""

from __future__ import annotations

from typing import Iterable, Iterator, NamedTuple

from cassandra_ros.read import TimeRange


class WindowPart(NamedTuple):
    """A window, or a part of a long one; times in ns, both ends included."""

    window: int
    """Beginning of the window to which this part belongs, ns."""
    low: int
    high: int


def merge_windows(
    hits: Iterable[int],
    before: int,
    after: int,
    bounds: TimeRange,
    longest: int,
) -> Iterator[WindowPart]:
    """Yield windows around hits, lazily; windows that overlap or touch are merged.

    Memory: that of one window, however many hits there are.

    Args:
        hits: Ascending times within the bounds, ns.
        before, after: Length of a window before and after its hit, ns, at least 0.
        bounds: Time range to which windows are cut.
        longest: Length from which a window is yielded in consecutive pieces, ns.

    Yields:
        Pieces in order, without overlap.
    """
    current: WindowPart | None = None
    for hit in hits:
        low, high = max(bounds.low, hit - before), min(bounds.high, hit + after)
        if current is None or low > current.high + 1:
            yield from _filled(current)
            current = WindowPart(low, low, high)
            continue
        current = current._replace(high=max(current.high, high))
        if current.high - current.low >= longest:
            yield current
            # The rest is empty until the next hit makes it longer.
            current = current._replace(low=current.high + 1)
    yield from _filled(current)


def _filled(piece: WindowPart | None) -> Iterator[WindowPart]:
    if piece is not None and piece.low <= piece.high:
        yield piece


def joined(pieces: Iterable[WindowPart]) -> Iterator[TimeRange]:
    """Yield whole windows, joined from their pieces."""
    whole: TimeRange | None = None
    for window, _, high in pieces:
        if whole is not None and whole.low != window:
            yield whole
        whole = TimeRange(window, high)
    if whole is not None:
        yield whole
