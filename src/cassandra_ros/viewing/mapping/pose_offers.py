# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Which topics tell the poses of a robot while it measured, and for how much of its messages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Iterable, Mapping, NamedTuple, Sequence

import numpy as np

from cassandra_ros.keys import MAX_NS
from cassandra_ros.read import Whose, Writers
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.overview.timeline.lanes import Timeline, View
from cassandra_ros.topics.overview.timeline.time_cells import Bools, Floats, Longs, Scale

_CELLS = 2000
"""Number of equal cells into which the time of the messages is divided."""
_AS_GOOD = 0.99
"""Share of the best topic's messages from which on another topic is as good: a topic that begins
one message later is not worse."""


class PoseOffer(NamedTuple):
    """A topic that tells poses of a robot."""

    topic: str
    share: float
    """Share of the messages that lie between two of its poses, 0 to 1, as the directory counts."""
    taken: bool = False
    """Whether the poses are taken from this topic."""


@dataclass(frozen=True)
class Measurements:
    """The messages of one robot whose poses are needed."""

    catalog: Catalog
    topic: str
    start: int | None = None
    """First key, ns, included; None = that of the first message."""
    end: int | None = None
    """Last key, ns, included; None = that of the last message."""
    node: str | None = None
    """nodeID of the robot; None = all robots."""
    writers: Writers = None
    """Writer ids of the runs; None = all runs."""

    def offers(self, ranks: Mapping[str, int], gap_ns: int) -> list[PoseOffer]:
        """Return for each topic the share of messages with poses, by counts in the directory.

        Args:
            ranks: Rank of each topic. Of equally good topics the one with the lowest rank comes
                first, then the one whose name comes first.
            gap_ns: Maximum time between two poses with known poses in between, ns.

        Returns:
            One offer for each topic, best first.
        """
        if not ranks:
            return []
        shares = self._shares(sorted(ranks), gap_ns)
        good = _AS_GOOD * max(shares.values())

        def order(name: str) -> tuple[float, int, str]:
            share = shares[name]
            return (-1.0 if share >= good else 1.0 - share, ranks[name], name)

        return [PoseOffer(name, shares[name]) for name in sorted(ranks, key=order)]

    def _shares(self, names: Sequence[str], gap_ns: int) -> dict[str, float]:
        shares = dict.fromkeys(names, 0.0)
        nodes = None if self.node is None else [self.node]
        timeline, whose = Timeline(self.catalog), Whose(nodes, self.writers)
        whole_view = View(self.start, self.end, 1, [self.topic], whose)
        window = timeline.picture(whole_view).scale
        if window is None:
            return shares
        # Poses shortly before the first and after the last message are needed too.
        start, end = max(0, window.start - gap_ns), min(MAX_NS, window.end + gap_ns)
        view = View(start, end, _CELLS, [self.topic, *names], whose, detail=True)
        picture = timeline.picture(view)
        scale = picture.scale
        if scale is None:
            return shares
        counts = {name: np.zeros(scale.cells) for name in [self.topic, *names]}
        for lane in picture.lanes:
            counts[lane.topic] += lane.cells(scale).counts
        message_counts = _inside(counts[self.topic], scale, window)
        if message_counts.any():
            for name in names:
                covered = _covered_cells(counts[name] > 0, gap_ns / scale.step)
                shares[name] = float(message_counts[covered].sum() / message_counts.sum())
        return shares


def _inside(counts: Floats, scale: Scale, window: Scale) -> Floats:
    """Return the counts of the cells that overlap a time range, and 0 for other cells."""
    first, last = scale.cells_of(np.array([window.start, window.end]))
    cells = np.arange(len(counts))
    return np.where((cells >= first) & (cells <= last), counts, 0.0)


def _covered_cells(filled: Bools, gap: float) -> Bools:
    """Return a mask of the cells between two filled ones at most a gap apart, both included.

    Args:
        filled: For each cell, whether it has poses.
        gap: Maximum gap, cells.
    """
    cells: Longs = np.arange(len(filled))
    before = np.maximum.accumulate(np.where(filled, cells, -len(cells)))
    after = np.minimum.accumulate(np.where(filled, cells, 2 * len(cells))[::-1])[::-1]
    has_both = (before >= 0) & (after < len(cells))
    return np.asarray(has_both & (after - before <= gap + 1))


def merge_offers(robots: Iterable[Sequence[PoseOffer]]) -> list[PoseOffer]:
    """Return the offers of several robots as one list.

    Of each topic the offer with most messages.
    """
    offer_of: dict[str, PoseOffer] = {}
    for offer in (offer for offers in robots for offer in offers):
        other = offer_of.get(offer.topic, offer)
        share, taken = max(offer.share, other.share), offer.taken or other.taken
        offer_of[offer.topic] = PoseOffer(offer.topic, share, taken)
    return list(offer_of.values())
