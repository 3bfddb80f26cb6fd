# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Envelopes for plots of many numbers over time: minimum and maximum in each pixel.

The length of a pixel is a power of two of nanoseconds, and pixels begin at its multiples. So the
envelope of a time range can be reused for every plot with the same pixel length, and envelopes of
adjacent time ranges can be merged.

Numbers are float64: an integer above 2^53 is rounded, as by float(). Missing and infinite values
count as NaN. A pixel is NaN only if it contains no finite number.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cassandra_ros.query.arrays.array_types import AnyArray

_NEVER, _BEFORE = 2**63 - 1, -1
"""First and last time of a pixel without messages: any message is earlier, and later."""
GAP_INTERVALS = 5
"""Maximum pause in a connected line, as a multiple of the median interval between messages."""


class Grid(NamedTuple):
    """The pixels of a plot."""

    shift: int
    """Length of a pixel as a power of two: 2 ** shift ns."""
    first: int
    """Number of the first pixel, counted from 1970."""
    pixels: int

    @classmethod
    def over(cls, low: int, high: int, shift: int) -> Grid:
        """Return the pixels of this length that contain the times low to high, both included."""
        first = low >> shift
        return cls(shift, first, (high >> shift) - first + 1)

    @classmethod
    def between(cls, low: int, high: int, most: int) -> Grid:
        """Return the shortest pixels of which ``most`` (>= 1) or fewer contain low to high, ns.

        Both ends are included.
        """
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
        """First time in the grid, ns."""
        return self.first << self.shift

    @property
    def high(self) -> int:
        """Last time in the grid, ns."""
        return ((self.first + self.pixels) << self.shift) - 1

    def places(self, times: AnyArray) -> AnyArray:
        """Return the pixel index of times, ns.

        Outside the grid it is below 0 or at least ``pixels``.
        """
        pixels: AnyArray = (times >> self.shift) - self.first
        return pixels


class Points(NamedTuple):
    """The pixels that contain messages."""

    times: AnyArray
    """Middle between first and last message in each pixel, ns; exact for a single message."""
    low: AnyArray
    """Minimum in each pixel: (columns, pixels); NaN = the column has no finite number there."""
    high: AnyArray
    rows: AnyArray
    """Number of messages or rows in each pixel; 0 = unknown, but more than none."""
    breaks: AnyArray
    """Indices of the points after which the line is broken, because of a long pause."""


class Envelope:
    """Minimum and maximum of some columns in each pixel of a grid."""

    def __init__(self, grid: Grid, columns: int) -> None:
        self.grid = grid
        self._first = np.full(grid.pixels, _NEVER, np.int64)
        self._last = np.full(grid.pixels, _BEFORE, np.int64)
        self._rows = np.zeros(grid.pixels, np.int64)
        self._low = np.full((columns, grid.pixels), np.nan)
        self._high = np.full((columns, grid.pixels), np.nan)

    @property
    def nbytes(self) -> int:
        """Approximate size in memory, bytes."""
        arrays = (self._first, self._last, self._rows, self._low, self._high)
        return sum(array.nbytes + 128 for array in arrays)

    def add(self, times: AnyArray, values: AnyArray) -> None:
        """Add numbers: (columns, rows). Times outside the grid are ignored."""
        values = finite(values)
        self.add_spans(times, times, values, values, None)

    def add_spans(
        self,
        firsts: AnyArray,
        lasts: AnyArray,
        low: AnyArray,
        high: AnyArray,
        rows: AnyArray | None,
    ) -> None:
        """Add the minimum and maximum of groups of rows. Each group lies in one pixel.

        Args:
            firsts, lasts: First and last time of each group, ns.
            low, high: Minimum and maximum of each group, finite or NaN: (columns, groups).
            rows: Number of rows of each group; None = one each.
        """
        places = self.grid.places(firsts)
        counts = np.ones(len(places), np.int64) if rows is None else rows
        inside = (places >= 0) & (places < self.grid.pixels)
        indices = None if inside.all() else np.flatnonzero(inside)
        if (places[1:] < places[:-1]).any():
            order = np.argsort(places, kind="stable")
            indices = order if indices is None else order[inside[order]]
        if indices is not None:
            places, firsts, lasts, counts = (a[indices] for a in (places, firsts, lasts, counts))
            low, high = low[:, indices], high[:, indices]
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
        """Add groups of rows that may span several pixels: each pixel gets the group's bounds.

        How many rows lie in each pixel is not known: they count as 0. Arguments as in add_spans.
        """
        ends = (self.grid.low, self.grid.high)
        inside = np.flatnonzero((lasts >= ends[0]) & (firsts <= ends[1]))
        firsts, lasts = np.maximum(firsts[inside], ends[0]), np.minimum(lasts[inside], ends[1])
        begins = self.grid.places(firsts)
        counts = self.grid.places(lasts) - begins + 1
        groups = np.repeat(np.arange(len(inside)), counts)
        offsets = np.arange(len(groups)) - np.repeat(np.cumsum(counts) - counts, counts)
        starts = (begins[groups] + offsets + self.grid.first) << self.grid.shift
        firsts, lasts = firsts[groups], lasts[groups]
        self.add_spans(
            np.maximum(firsts, starts),
            np.minimum(lasts, starts + self.grid.width - 1),
            low[:, inside][:, groups],
            high[:, inside][:, groups],
            np.zeros(len(groups), np.int64),
        )

    def merge(self, other: Envelope) -> None:
        """Add another envelope with the same pixel length, as far as the grids overlap."""
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

    def widened(self, grid: Grid) -> Envelope:
        """Return this envelope in a grid around its own, with pixels that are at least as long."""
        envelope, pixels = Envelope(grid, len(self._low)), np.flatnonzero(self._last >= 0)
        low, high, rows = self._low[:, pixels], self._high[:, pixels], self._rows[pixels]
        envelope.add_spans(self._first[pixels], self._last[pixels], low, high, rows)
        return envelope

    def points(self) -> Points:
        """Return the pixels that contain messages, in time order."""
        pixels = np.flatnonzero(self._last >= 0)
        first, last = self._first[pixels], self._last[pixels]
        middles, rows = first + (last - first) // 2, self._rows[pixels]
        broken = self._breaks(pixels, rows)
        return Points(middles, self._low[:, pixels], self._high[:, pixels], rows, broken)

    def _breaks(self, pixels: AnyArray, rows: AnyArray) -> AnyArray:
        """Return the indices of the pixels after which a long pause follows.

        A pause is the time from the last message of a pixel to the first message of the next. It is
        short if messages are dense, however long the pixels are.
        """
        pauses = self._first[pixels[1:]] - self._last[pixels[:-1]]
        # If only bounds of a pixel are known, its first and last message may be anywhere in it.
        sure = (rows[1:] > 0) & (rows[:-1] > 0)
        usual = np.where(sure, np.median(pauses[sure]) if sure.any() else 0, self.grid.width)
        long = (pauses > GAP_INTERVALS * usual) & (np.diff(pixels) > 1)
        return np.flatnonzero(long) if len(pauses) > 1 else np.zeros(0, np.int64)


def finite(values: AnyArray) -> AnyArray:
    """Return numbers with NaN in place of infinities."""
    infinite = np.isinf(values)
    return np.where(infinite, np.nan, values) if infinite.any() else values
