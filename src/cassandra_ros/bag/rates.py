# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Lengths of time buckets that fit the topics of a bag."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, Mapping, Tuple

from cassandra_ros.bag.reader import BagReader
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.store.buckets import bucketFor

_WINDOW_NS = 10 * SECOND_NS

TableKey = Tuple[str, str]
"""Topic and md5sum: what shares one table."""


@dataclass
class _Rate:
    start_ns: int
    end_ns: int
    count: int = 0
    bytes: float = 0.0
    peak_hz: float = 0.0
    peak_bytes: float = 0.0

    def finish(self, start_ns: int, last: bool = False) -> None:
        """End a window; a short one at the end counts only where it is the only one."""
        if not last or not self.peak_hz:
            seconds = max(1.0, (self.end_ns - self.start_ns) / SECOND_NS)
            self.peak_hz = max(self.peak_hz, self.count / seconds)
            self.peak_bytes = max(self.peak_bytes, self.bytes / seconds)
        self.start_ns, self.count, self.bytes = start_ns, 0, 0.0


def bucketLengths(reader: BagReader, sizes: Mapping[int, int]) -> Dict[int, int]:
    """Choose the bucket length of each connection's table.

    The highest rate over stretches of at least 10 s decides, as the counts of the chunks show
    it: a single stray stamp stretches the whole bag, but not all of its parts.

    Args:
        reader: The bag.
        sizes: Serialised bytes by number of the connection.

    Returns:
        Nanoseconds by number of the connection, equal for those that share a table.
    """
    rates: Dict[TableKey, _Rate] = {}
    means = {number: sizes[number] / total.count for number, total in reader.totals.items()}
    keys = {number: (c.topic, c.md5sum) for number, c in reader.connections.items()}
    for chunk in range(reader.chunk_count):
        info = reader.chunkInfo(chunk)
        seen = set()
        for number, count in info.counts.items():
            rate = rates.setdefault(keys[number], _Rate(info.start_ns, info.end_ns))
            if keys[number] not in seen and rate.end_ns - rate.start_ns >= _WINDOW_NS:
                rate.finish(info.start_ns)
            seen.add(keys[number])
            rate.end_ns = max(rate.start_ns, info.end_ns)
            rate.count += count
            rate.bytes += count * means[number]
    for rate in rates.values():
        rate.finish(rate.end_ns, last=True)
    return {n: bucketFor(rates[key].peak_hz, rates[key].peak_bytes) for n, key in keys.items()}
