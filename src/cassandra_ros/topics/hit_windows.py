# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Windows around hits, merged as the hits come if they overlap or touch."""

from __future__ import annotations

from typing import Iterable, Iterator

from cassandra_ros.places.paths import merge_ranges
from cassandra_ros.read import TimeRange


def merge_windows(
    hits: Iterable[int], before: int, after: int, bounds: TimeRange
) -> Iterator[TimeRange]:
    """Yield windows around hits in order, lazily; they do not overlap or touch.

    Args:
        hits: Ascending times within the bounds, ns.
        before, after: Length of a window before and after its hit, ns, at least 0.
        bounds: Time range to which windows are cut.
    """
    around = ((max(bounds.low, hit - before), min(bounds.high, hit + after)) for hit in hits)
    return (TimeRange(*window) for window in merge_ranges(around))
