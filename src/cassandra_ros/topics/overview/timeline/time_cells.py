# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Numbers of messages in many time ranges of equal length: the cells of a picture.

The counts belong to time ranges of any length (buckets, blocks, single messages). A time range
across several cells is spread over them evenly, and marked as such if it covers many cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Iterable, NamedTuple, Sequence

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.errors import InvalidOption

Longs = NDArray[np.int64]
Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
MAX_TIMELINE_CELLS = 10_000
"""Maximum number of cells of a picture."""
USUAL_TIMES = 10
"""Minimum ratio of a gap to the usual time between two messages."""
LEAST_CELLS = 2
"""Minimum length of a gap, cells. Shorter ones cannot be seen."""
MAX_GAPS = 500
"""Maximum number of gaps of a lane for which the time ranges, or a run's messages, are searched."""
WIDE_CELLS = 3
"""Minimum number of cells of a time range that is marked as spread evenly. Across the border of two
cells spreading makes no visible difference."""


class Scale(NamedTuple):
    """Cells of equal length, the first of which begins at start."""

    start: int
    """First time, ns since 1970, included."""
    end: int
    """Last time, ns since 1970, included; the last cell may end later."""
    step: int
    """Length of a cell, ns, at least 1."""

    @classmethod
    def over(cls, start: int, end: int, most: int) -> Scale:
        """Return the shortest cells of which ``most`` cover [start, end].

        Raises:
            InvalidOption: The number of cells is out of range, or start is later than end.
        """
        if not 1 <= most <= MAX_TIMELINE_CELLS:
            raise InvalidOption(f"pixels {most}: give 1 to {MAX_TIMELINE_CELLS}")
        if start > end:
            raise InvalidOption(f"start {start} is later than end {end}; both are ns since 1970")
        return cls(start, end, -(-(end - start + 1) // most))

    @property
    def cells(self) -> int:
        """Number of cells."""
        return -(-(self.end - self.start + 1) // self.step)

    def cells_of(self, times: Longs) -> Longs:
        """Return the cells of times; for times outside of the scale a number without a cell."""
        return np.asarray((times - self.start) // self.step)


class TimeRanges(NamedTuple):
    """Time ranges with known numbers of messages, ns.

    One message is at each end of a time range, the others are anywhere between.
    """

    first: Longs
    last: Longs
    messages: Longs
    """Number of messages; 0 = unknown."""
    bytes: Longs
    writer: Longs
    sure: Bools
    """Whether the counts are final; otherwise they are estimates."""

    def where(self, mask: Bools) -> TimeRanges:
        """Return the time ranges for which ``mask`` is true."""
        return TimeRanges._make(column[mask] for column in self)

    @classmethod
    def joined(cls, parts: Sequence[TimeRanges]) -> TimeRanges:
        """Return the time ranges of several objects."""
        if not parts:
            empty = np.zeros(0, np.int64)
            return cls(empty, empty, empty, empty, empty, empty.astype(bool))
        return cls(*map(np.concatenate, zip(*parts)))

    def within(self, start: int, end: int) -> TimeRanges:
        """Return the time ranges that meet [start, end]."""
        return self.where((self.first <= end) & (self.last >= start))

    def shares(self, start: int, end: int) -> Floats:
        """Return the share of each, 0 to 1, that is in [start, end] if it is spread evenly.

        It is exactly 1.0 for a time range that lies wholly inside: ``Lane.exact`` compares with it.
        """
        length = (self.last - self.first + 1).astype(np.float64)
        low, high = np.maximum(self.first, start), np.minimum(self.last, end)
        return np.asarray(np.clip((high - low + 1) / length, 0.0, 1.0))


@dataclass
class TimeCells:
    """Counts of messages in the cells of a scale, to which time ranges and messages are added."""

    scale: Scale

    def __post_init__(self) -> None:
        count = self.scale.cells
        self._counts = np.zeros(count + 1)
        """Messages in one cell, and those at the ends of time ranges in several cells."""
        self._rises = np.zeros(count + 1)
        """Change of the messages per cell at each cell, for time ranges that are spread evenly."""
        self._dense = np.zeros(count + 1, np.int64)
        """Change of the number of such time ranges at each cell."""
        self._even = np.zeros(count + 1, np.int64)
        """The same for time ranges of at least WIDE_CELLS cells and three messages."""
        self._unknown = np.zeros(count + 1, np.int64)
        """The same for time ranges with an unknown number of messages."""

    @property
    def counts(self) -> Floats:
        """Number of messages in each cell; fractions if they are spread evenly."""
        # The sum of floats that rise and fall again is not exactly 0.
        spread = np.where(np.cumsum(self._dense) > 0, np.cumsum(self._rises), 0.0)
        return np.asarray((self._counts + np.maximum(spread, 0.0))[:-1])

    @property
    def even(self) -> Bools:
        """Cells of time ranges with at least WIDE_CELLS cells, over which messages are spread."""
        return np.asarray(np.cumsum(self._even)[:-1] > 0)

    @property
    def unknown(self) -> Bools:
        """Cells of time ranges with an unknown number of messages."""
        return np.asarray(np.cumsum(self._unknown)[:-1] > 0)

    def add_times(self, times: Longs) -> None:
        """Add single messages by their times."""
        cells = self.scale.cells_of(times)
        inside = cells[(cells >= 0) & (cells < self.scale.cells)]
        self._counts += np.bincount(inside, minlength=self.scale.cells + 1)

    def add(self, time_ranges: TimeRanges) -> None:
        """Add the time ranges that meet the scale."""
        near = time_ranges.within(self.scale.start, self.scale.end)
        has_messages = near.messages > 0
        self._mark(self._unknown, near.where(~has_messages))
        near = near.where(has_messages)
        spans = self.scale.cells_of(near.last) - self.scale.cells_of(near.first)
        narrow = spans == 0
        cells = self.scale.cells_of(near.first[narrow])
        self._counts += np.bincount(cells, near.messages[narrow], self.scale.cells + 1)
        sparse = ~narrow & (near.messages <= spans + 1)
        self._add_sparse(near.where(sparse))
        self._add_dense(near.where(~narrow & ~sparse))
        self._mark(self._even, near.where((spans >= WIDE_CELLS - 1) & (near.messages > 2)))

    def _mark(self, rises: Longs, time_ranges: TimeRanges) -> None:
        """Count the time ranges over each cell, as changes from cell to cell."""
        count = self.scale.cells
        np.add.at(rises, np.clip(self.scale.cells_of(time_ranges.first), 0, count), 1)
        np.add.at(rises, np.clip(self.scale.cells_of(time_ranges.last) + 1, 0, count), -1)

    def _add_sparse(self, time_ranges: TimeRanges) -> None:
        """Add messages at equal distances, the first and last of each time range at its ends."""
        start, end = self.scale.start, self.scale.end
        for first, last, messages in zip(*time_ranges[:3]):
            gaps, length = max(1, int(messages) - 1), int(last - first)
            low = max(0, -((int(first) - start) * gaps // length))
            high = min(int(messages) - 1, (end - int(first)) * gaps // length)
            steps = np.arange(low, high + 1)
            # Written without a product of more than 64 bits.
            self.add_times(first + steps * (length // gaps) + steps * (length % gaps) // gaps)

    def _add_dense(self, time_ranges: TimeRanges) -> None:
        """Add time ranges with several messages per cell, by each cell's share of their time."""
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


def gaps_between(time_ranges: TimeRanges, scale: Scale) -> list[tuple[int, int]]:
    """Find the visible pauses of each writer that are much longer than usual.

    Args:
        time_ranges: Time ranges of some writers of one topic.

    Returns:
        Times of the message before and the message after each pause, ns; at most the MAX_GAPS
        longest.
    """
    order = np.lexsort((time_ranges.first, time_ranges.writer))
    writer, first, last = (
        column[order] for column in (time_ranges.writer, time_ranges.first, time_ranges.last)
    )
    is_pause = (first[1:] - last[:-1] >= LEAST_CELLS * scale.step) & (writer[1:] == writer[:-1])
    gaps: list[tuple[int, int]] = []
    for writer_id in np.unique(writer[1:][is_pause]):  # of thousands of runs few have a pause
        run = order[writer == writer_id]
        columns = time_ranges.first[run], time_ranges.last[run], time_ranges.messages[run]
        gaps += _gaps(*columns, scale)
    return _longest(gaps)


def _gaps(first: Longs, last: Longs, messages: Longs, scale: Scale) -> list[tuple[int, int]]:
    """Find the pauses of one writer by its time ranges, in order; see gaps_between."""
    steps = np.maximum(messages - 1, 0).sum()
    if len(first) < 2 or not steps:
        return []  # the usual time between messages is unknown
    usual = int((last - first).sum() // steps)
    pause = first[1:] - np.maximum.accumulate(last)[:-1]
    wide = (pause > USUAL_TIMES * usual) & (pause >= LEAST_CELLS * scale.step)
    ends = np.maximum.accumulate(last)[:-1][wide], first[1:][wide]
    return [(int(low), int(high)) for low, high in zip(*ends)]


def gaps_in(times: Longs, scale: Scale) -> list[tuple[int, int]]:
    """Find the pauses of single messages of one writer, like gaps_between."""
    if len(times) < 3:
        return []
    times = np.sort(times)
    pause = np.diff(times)
    wide = (pause > USUAL_TIMES * np.median(pause)) & (pause >= LEAST_CELLS * scale.step)
    return _longest([(int(low), int(high)) for low, high in zip(times[:-1][wide], times[1:][wide])])


def _longest(gaps: Iterable[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return the MAX_GAPS longest gaps, in order of time."""
    return sorted(sorted(gaps, key=lambda gap: gap[0] - gap[1])[:MAX_GAPS])


def runs_of_cells(counts: Floats) -> list[list[int]]:
    """Return counts as runs of cells that are not empty: the first cell of each, then its counts.

    Counts are rounded, but not to 0.
    """
    filled = np.flatnonzero(counts > 1e-9)
    if not len(filled):
        return []
    whole = np.maximum(np.rint(counts), 1).astype(np.int64)
    runs = np.split(filled, np.flatnonzero(np.diff(filled) > 1) + 1)
    return [[int(run[0]), *whole[run].tolist()] for run in runs]


def time_ranges_of_cells(marked: Bools) -> list[list[int]]:
    """Return marked cells as pairs: the first and the last cell of each run."""
    filled = np.flatnonzero(marked)
    if not len(filled):
        return []
    runs = np.split(filled, np.flatnonzero(np.diff(filled) > 1) + 1)
    return [[int(run[0]), int(run[-1])] for run in runs]
