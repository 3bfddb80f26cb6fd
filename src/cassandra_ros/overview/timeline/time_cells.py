# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""How many messages lie in each of many equal time ranges: cells, as a picture needs them.

Counts are known of longer or shorter stretches (buckets, blocks, single messages). What lies
across several cells is spread over them evenly, and these are told to be so if they are many.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Iterable, NamedTuple, Sequence, Tuple

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.errors import InvalidOption

Longs = NDArray[np.int64]
Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
MAX_CELLS = 10_000
USUAL_TIMES = 10
"""A gap is so many times as long as the usual time from one message to the next."""
LEAST_CELLS = 2
"""A gap covers so many cells at least: shorter ones are not seen."""
MAX_GAPS = 500
WIDE_CELLS = 3
"""Over so many cells what is spread evenly is told to be: on the border of two it shows nothing."""


class Scale(NamedTuple):
    """Cells of equal length, the first of which begins at start."""

    start: int
    """ns since 1970, included."""
    end: int
    """ns since 1970, included; the last cell may reach beyond."""
    step: int
    """Length of a cell, ns, at least 1."""

    @classmethod
    def over(cls, start: int, end: int, most: int) -> Scale:
        """Return the shortest cells of which ``most`` cover [start, end].

        Raises:
            InvalidOption: There are none, or start lies behind end.
        """
        if not 1 <= most <= MAX_CELLS:
            raise InvalidOption(f"pixels {most}: give 1 to {MAX_CELLS}")
        if start > end:
            raise InvalidOption(f"start {start} lies behind end {end}; both are ns since 1970")
        return cls(start, end, -(-(end - start + 1) // most))

    @property
    def cells(self) -> int:
        """How many cells there are."""
        return -(-(self.end - self.start + 1) // self.step)

    def cells_of(self, times: Longs) -> Longs:
        """Return the cells in which times lie; of those outside a number that no cell has."""
        return np.asarray((times - self.start) // self.step)


class TimeRanges(NamedTuple):
    """Messages of which is known between which times they lie, ns, and how many they are.

    There is one at each end, and the others lie anywhere between.
    """

    first: Longs
    last: Longs
    messages: Longs
    """0 = nobody knows."""
    bytes: Longs
    writer: Longs
    sure: Bools
    """The counts hold; else they are estimates."""

    def where(self, chosen: Bools) -> TimeRanges:
        """Return those of which ``chosen`` says so."""
        return TimeRanges._make(column[chosen] for column in self)

    @classmethod
    def joined(cls, parts: Sequence[TimeRanges]) -> TimeRanges:
        """Return all stretches of some."""
        if not parts:
            none = np.zeros(0, np.int64)
            return cls(none, none, none, none, none, none.astype(bool))
        return cls(*map(np.concatenate, zip(*parts)))

    def within(self, start: int, end: int) -> TimeRanges:
        """Return those that touch [start, end]."""
        return self.where((self.first <= end) & (self.last >= start))

    def shares(self, start: int, end: int) -> Floats:
        """Return how much of each lies in [start, end], from 0 to 1, were it spread evenly."""
        length = (self.last - self.first + 1).astype(np.float64)
        low, high = np.maximum(self.first, start), np.minimum(self.last, end)
        return np.asarray(np.clip((high - low + 1) / length, 0.0, 1.0))


@dataclass
class Cells:
    """Counts of messages in the cells of a scale, to which stretches and messages are added."""

    scale: Scale

    def __post_init__(self) -> None:
        count = self.scale.cells
        self._counts = np.zeros(count + 1)
        """Of what lies in one cell, and at the ends of what lies in more."""
        self._rises = np.zeros(count + 1)
        """By how much what is spread evenly, several in a cell, rises at each cell."""
        self._dense = np.zeros(count + 1, np.int64)
        self._even = np.zeros(count + 1, np.int64)
        self._unknown = np.zeros(count + 1, np.int64)

    @property
    def counts(self) -> Floats:
        """Messages by cell; fractions where they are spread evenly."""
        # The sum of what rose and fell again is not quite nothing.
        spread = np.where(np.cumsum(self._dense) > 0, np.cumsum(self._rises), 0.0)
        return np.asarray((self._counts + np.maximum(spread, 0.0))[:-1])

    @property
    def even(self) -> Bools:
        """The cells of WIDE_CELLS and more over which messages are spread: where is not known."""
        return np.asarray(np.cumsum(self._even)[:-1] > 0)

    @property
    def unknown(self) -> Bools:
        """The cells in which messages may lie that nobody has counted."""
        return np.asarray(np.cumsum(self._unknown)[:-1] > 0)

    def add_times(self, times: Longs) -> None:
        """Add single messages, by their times."""
        cells = self.scale.cells_of(times)
        inside = cells[(cells >= 0) & (cells < self.scale.cells)]
        self._counts += np.bincount(inside, minlength=self.scale.cells + 1)

    def add(self, time_ranges: TimeRanges) -> None:
        """Add what touches the scale of some stretches."""
        near = time_ranges.within(self.scale.start, self.scale.end)
        counted = near.messages > 0
        self._mark(self._unknown, near.where(~counted))
        near = near.where(counted)
        spans = self.scale.cells_of(near.last) - self.scale.cells_of(near.first)
        narrow = spans == 0
        cells = self.scale.cells_of(near.first[narrow])
        self._counts += np.bincount(cells, near.messages[narrow], self.scale.cells + 1)
        sparse = ~narrow & (near.messages <= spans + 1)
        self._add_sparse(near.where(sparse))
        self._add_dense(near.where(~narrow & ~sparse))
        self._mark(self._even, near.where((spans >= WIDE_CELLS - 1) & (near.messages > 2)))

    def _mark(self, rises: Longs, time_ranges: TimeRanges) -> None:
        """Count the stretches over each cell, as rises."""
        count = self.scale.cells
        np.add.at(rises, np.clip(self.scale.cells_of(time_ranges.first), 0, count), 1)
        np.add.at(rises, np.clip(self.scale.cells_of(time_ranges.last) + 1, 0, count), -1)

    def _add_sparse(self, time_ranges: TimeRanges) -> None:
        """Add messages at equal distances, the first and last of each at its ends."""
        start, end = self.scale.start, self.scale.end
        for first, last, messages in zip(*time_ranges[:3]):
            gaps, length = max(1, int(messages) - 1), int(last - first)
            low = max(0, -((int(first) - start) * gaps // length))
            high = min(int(messages) - 1, (end - int(first)) * gaps // length)
            steps = np.arange(low, high + 1)
            # Without a product beyond 64 bits.
            self.add_times(first + steps * (length // gaps) + steps * (length % gaps) // gaps)

    def _add_dense(self, time_ranges: TimeRanges) -> None:
        """Add messages of which there are several in each cell, by their share of its time."""
        (start, _, step), count = self.scale, self.scale.cells
        self._mark(self._dense, time_ranges)
        first, last = self.scale.cells_of(time_ranges.first), self.scale.cells_of(time_ranges.last)
        per_ns = time_ranges.messages / (time_ranges.last - time_ranges.first + 1)
        in_first = ((first + 1) * step + start - time_ranges.first) * per_ns
        in_last = (time_ranges.last + 1 - (last * step + start)) * per_ns
        for cells, share in ((first, in_first), (last, in_last)):
            inside = (cells >= 0) & (cells < count)
            self._counts += np.bincount(cells[inside], share[inside], count + 1)
        np.add.at(self._rises, np.clip(first + 1, 0, count), per_ns * step)
        np.add.at(self._rises, np.clip(last, 0, count), -per_ns * step)


def gaps_between(time_ranges: TimeRanges, scale: Scale) -> list[Tuple[int, int]]:
    """Find where the messages of one writer paused: much longer than usual, and to be seen.

    Args:
        stretches: Those of some writers, of one topic.

    Returns:
        Times of the message before and of the one behind, ns; at most MAX_GAPS, the longest.
    """
    order = np.lexsort((time_ranges.first, time_ranges.writer))
    writer, first, last = (
        column[order] for column in (time_ranges.writer, time_ranges.first, time_ranges.last)
    )
    seen = (first[1:] - last[:-1] >= LEAST_CELLS * scale.step) & (writer[1:] == writer[:-1])
    found: list[Tuple[int, int]] = []
    for one in np.unique(writer[1:][seen]):  # of thousands of runs few have any
        own = order[writer == one]
        columns = time_ranges.first[own], time_ranges.last[own], time_ranges.messages[own]
        found += _gaps(*columns, scale)
    return _longest(found)


def _gaps(first: Longs, last: Longs, messages: Longs, scale: Scale) -> list[Tuple[int, int]]:
    steps = np.maximum(messages - 1, 0).sum()
    if len(first) < 2 or not steps:
        return []  # nobody knows what is usual
    usual = int((last - first).sum() // steps)
    pause = first[1:] - np.maximum.accumulate(last)[:-1]
    wide = (pause > USUAL_TIMES * usual) & (pause >= LEAST_CELLS * scale.step)
    ends = np.maximum.accumulate(last)[:-1][wide], first[1:][wide]
    return [(int(low), int(high)) for low, high in zip(*ends)]


def gaps_in(times: Longs, scale: Scale) -> list[Tuple[int, int]]:
    """Find where single messages of one writer paused, as gaps_between does."""
    if len(times) < 3:
        return []
    times = np.sort(times)
    pause = np.diff(times)
    wide = (pause > USUAL_TIMES * np.median(pause)) & (pause >= LEAST_CELLS * scale.step)
    return _longest([(int(low), int(high)) for low, high in zip(times[:-1][wide], times[1:][wide])])


def _longest(gaps: Iterable[Tuple[int, int]]) -> list[Tuple[int, int]]:
    return sorted(sorted(gaps, key=lambda gap: gap[0] - gap[1])[:MAX_GAPS])


def runs_of_cells(counts: Floats) -> list[list[int]]:
    """Write counts as runs without an empty cell: the first cell of each, then its counts.

    Counts are rounded, but none that is more than nothing to nothing.
    """
    filled = np.flatnonzero(counts > 1e-9)
    if not len(filled):
        return []
    whole = np.maximum(np.rint(counts), 1).astype(np.int64)
    runs = np.split(filled, np.flatnonzero(np.diff(filled) > 1) + 1)
    return [[int(run[0]), *whole[run].tolist()] for run in runs]


def time_ranges_of_cells(marked: Bools) -> list[list[int]]:
    """Write marked cells as pairs: the first and the last of each run."""
    filled = np.flatnonzero(marked)
    if not len(filled):
        return []
    runs = np.split(filled, np.flatnonzero(np.diff(filled) > 1) + 1)
    return [[int(run[0]), int(run[-1])] for run in runs]
