# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a plot shows of many numbers over time: the least and the greatest of each of its pixels.

Pixels are as long as a power of two of nanoseconds, and begin at its multiples. So what was found
of a time range holds for everybody who looks at it as closely, and parts are joined by it.

Numbers are float64: an integer beyond 2^53 is rounded to the next one, as float() does. What is
missing, and NaN, is NaN: a pixel has it only where there is nothing else.
"""

from __future__ import annotations

from typing import NamedTuple, Optional

import numpy as np

from cassandra_ros.arrays.array_types import AnyArray

_NEVER, _BEFORE = 2**63 - 1, -1
GAP_INTERVALS = 5
"""A line is broken where no message came for more than this number of usual intervals."""


class Grid(NamedTuple):
    """The pixels of a plot."""

    shift: int
    """A pixel is 2 ** shift ns long."""
    first: int
    """Number of the first one, counted from 1970."""
    pixels: int

    @classmethod
    def over(cls, low: int, high: int, shift: int) -> Grid:
        """Return the pixels, of this length, that hold the times from low to high, both in it."""
        first = low >> shift
        return cls(shift, first, (high >> shift) - first + 1)

    @classmethod
    def between(cls, low: int, high: int, most: int) -> Grid:
        """Return the shortest pixels of which at most so many, 1 or more, hold low to high, ns."""
        shift = max(0, ((high - low) // most).bit_length() - 1)
        while (high >> shift) - (low >> shift) >= most:
            shift += 1
        return cls.over(low, high, shift)

    @property
    def width(self) -> int:
        """Length of a pixel, ns."""
        return 1 << self.shift

    @property
    def low(self) -> int:
        """The first time that lies in it, ns."""
        return self.first << self.shift

    @property
    def high(self) -> int:
        """The last time that lies in it, ns."""
        return ((self.first + self.pixels) << self.shift) - 1

    def places(self, times: AnyArray) -> AnyArray:
        """Return in which of the pixels times lie, ns; below 0 or from ``pixels`` on: in none."""
        found: AnyArray = (times >> self.shift) - self.first
        return found


class Points(NamedTuple):
    """The pixels in which something lies."""

    times: AnyArray
    """The middle of what lies in each, ns; of a single message exactly its time."""
    low: AnyArray
    """The least number: (columns, pixels)."""
    high: AnyArray
    rows: AnyArray
    """How many messages, or rows, lie in each; 0 = some, it is not known how many."""
    breaks: AnyArray
    """Places of the points behind which a line is broken, for nothing came for long."""


class Envelope:
    """The least and the greatest number of some columns in each pixel of a grid."""

    def __init__(self, grid: Grid, columns: int) -> None:
        self.grid = grid
        self._first = np.full(grid.pixels, _NEVER, np.int64)
        self._last = np.full(grid.pixels, _BEFORE, np.int64)
        self._rows = np.zeros(grid.pixels, np.int64)
        self._low = np.full((columns, grid.pixels), np.nan)
        self._high = np.full((columns, grid.pixels), np.nan)

    @property
    def nbytes(self) -> int:
        """About what it takes of the memory."""
        arrays = (self._first, self._last, self._rows, self._low, self._high)
        return sum(array.nbytes + 128 for array in arrays)

    def add(self, times: AnyArray, values: AnyArray) -> None:
        """Take numbers: (columns, rows); those outside of the grid are left out."""
        self.add_spans(times, times, values, values, None)

    def add_spans(
        self,
        firsts: AnyArray,
        lasts: AnyArray,
        low: AnyArray,
        high: AnyArray,
        rows: Optional[AnyArray],
    ) -> None:
        """Take what is known of several rows at once, which lie in one pixel.

        Args:
            firsts, lasts: Their first and their last time, ns.
            low, high: Their least and greatest numbers: (columns, spans).
            rows: How many they are; None = one each.
        """
        places = self.grid.places(firsts)
        counts = np.ones(len(places), np.int64) if rows is None else rows
        kept = (places >= 0) & (places < self.grid.pixels)
        chosen = None if kept.all() else np.flatnonzero(kept)
        if (places[1:] < places[:-1]).any():
            order = np.argsort(places, kind="stable")
            chosen = order if chosen is None else order[kept[order]]
        if chosen is not None:
            places, firsts, lasts, counts = (a[chosen] for a in (places, firsts, lasts, counts))
            low, high = low[:, chosen], high[:, chosen]
        if not len(places):
            return
        starts = np.flatnonzero(np.diff(places, prepend=-1))
        at = places[starts]
        self._first[at] = np.minimum(self._first[at], np.minimum.reduceat(firsts, starts))
        self._last[at] = np.maximum(self._last[at], np.maximum.reduceat(lasts, starts))
        self._rows[at] += np.add.reduceat(counts, starts)
        self._low[:, at] = np.fmin(self._low[:, at], np.fmin.reduceat(low, starts, axis=1))
        self._high[:, at] = np.fmax(self._high[:, at], np.fmax.reduceat(high, starts, axis=1))

    def add_wide(self, firsts: AnyArray, lasts: AnyArray, low: AnyArray, high: AnyArray) -> None:
        """Take rows as add_spans does that may lie in several pixels: each may hold any of them."""
        ends = (self.grid.low, self.grid.high)
        kept = np.flatnonzero((lasts >= ends[0]) & (firsts <= ends[1]))
        firsts, lasts = np.maximum(firsts[kept], ends[0]), np.minimum(lasts[kept], ends[1])
        begins = self.grid.places(firsts)
        counts = self.grid.places(lasts) - begins + 1
        every = np.repeat(np.arange(len(kept)), counts)
        offsets = np.arange(len(every)) - np.repeat(np.cumsum(counts) - counts, counts)
        starts = (begins[every] + offsets + self.grid.first) << self.grid.shift
        firsts, lasts = firsts[every], lasts[every]
        self.add_spans(
            np.maximum(firsts, starts),
            np.minimum(lasts, starts + self.grid.width - 1),
            low[:, kept][:, every],
            high[:, kept][:, every],
            np.zeros(len(every), np.int64),
        )

    def merge(self, other: Envelope) -> None:
        """Take what another one holds, of pixels of the same length; of its own pixels only."""
        begin = max(0, other.grid.first - self.grid.first)
        end = min(self.grid.pixels, other.grid.first + other.grid.pixels - self.grid.first)
        if begin >= end:
            return
        here = slice(begin, end)
        offset = self.grid.first - other.grid.first
        there = slice(begin + offset, end + offset)
        np.minimum(self._first[here], other._first[there], out=self._first[here])
        np.maximum(self._last[here], other._last[there], out=self._last[here])
        self._rows[here] += other._rows[there]
        np.fmin(self._low[:, here], other._low[:, there], out=self._low[:, here])
        np.fmax(self._high[:, here], other._high[:, there], out=self._high[:, here])

    def points(self) -> Points:
        """Return the pixels in which something lies, in the order of time."""
        held = np.flatnonzero(self._last >= 0)
        first, last = self._first[held], self._last[held]
        middles, rows = first + (last - first) // 2, self._rows[held]
        broken = self._breaks(held, rows)
        return Points(middles, self._low[:, held], self._high[:, held], rows, broken)

    def _breaks(self, held: AnyArray, rows: AnyArray) -> AnyArray:
        """Return behind which pixels nothing came for long.

        What counts is the time from the last message of a pixel to the first one of the next, which
        is short where messages are dense, however long the pixels are.
        """
        pauses = self._first[held[1:]] - self._last[held[:-1]]
        # Of a pixel of which only bounds are known the first and the last message may lie anywhere.
        sure = (rows[1:] > 0) & (rows[:-1] > 0)
        usual = np.where(sure, np.median(pauses[sure]) if sure.any() else 0, self.grid.width)
        long = (pauses > GAP_INTERVALS * usual) & (np.diff(held) > 1)
        return np.flatnonzero(long) if len(pauses) > 1 else np.zeros(0, np.int64)


def breaks(times: AnyArray) -> AnyArray:
    """Return behind which of some messages nothing came for long: their places.

    Args:
        times: Of the messages, ascending, ns.
    """
    pauses = np.diff(times)
    if len(pauses) < 2:
        return np.zeros(0, np.int64)
    return np.flatnonzero(pauses > GAP_INTERVALS * np.median(pauses))
