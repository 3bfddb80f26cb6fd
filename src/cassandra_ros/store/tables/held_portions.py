# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Portions whose messages may lie between each other, held until they can be taken in order."""

from __future__ import annotations

import heapq
from typing import Iterable, Iterator, Sequence

from cassandra_ros.store.tables.row_table import TableRow
from cassandra_ros.store.tables.table_layout import Place, Portion

TAKEN_BYTES = 8 * 1024 * 1024
"""Number of serialised bytes of whole portions that are taken, however much is held besides."""


class HeldPortions:
    """Portions of one or several buckets.

    They are added in the order of their beginnings, and taken up to a place before which no further
    message comes. Where portions overlap, those that reach beyond this place are cut in two.
    """

    def __init__(self) -> None:
        self._clear()

    def _clear(self) -> None:
        self._portions: list[Portion] = []
        self._by_end: list[tuple[Place, int, Portion]] = []
        """Heap of those that are not known to end before the last place that was asked for."""
        self._messages = self._ended_messages = self._ended_bytes = 0

    def __bool__(self) -> bool:
        return bool(self._portions)

    def add(self, portion: Portion) -> None:
        """Add a portion."""
        self._portions.append(portion)
        heapq.heappush(self._by_end, (portion.end, len(self._portions), portion))
        self._messages += portion.most

    def are_enough(self, place: Place) -> bool:
        """Return whether the portions that end before a place are worth a cut of the others.

        They are if they hold half of the messages, or TAKEN_BYTES. So a portion is cut about once,
        of however many robots messages are read. The place is not before the last one.
        """
        while self._by_end and self._by_end[0][0] < place:
            _, _, portion = heapq.heappop(self._by_end)
            self._ended_messages += portion.most
            self._ended_bytes += portion.nbytes
        return 2 * self._ended_messages >= self._messages or self._ended_bytes >= TAKEN_BYTES

    def take(self, place: Place | None) -> Sequence[Portion]:
        """Remove and return the messages before a place; None = all."""
        portions, taken = self._portions, []
        self._clear()
        for portion in portions:
            before, after = (portion, None) if place is None else portion.split(place)
            if before is not None and before.most:
                taken.append(before)
            if after is not None and after.most:
                self.add(after)
        return taken


def place_of(message: TableRow | Portion) -> Place:
    """Return the place of a row, or that from which the messages of a portion may come."""
    return message[:4] if isinstance(message, TableRow) else message.begin


def rows_of(portions: Sequence[Portion]) -> Iterable[TableRow]:
    """Return the messages of portions as rows, in order."""
    if len(portions) == 1:
        return portions[0].rows()
    return heapq.merge(*[portion.rows() for portion in portions])


def rows_in_order(messages: Iterable[TableRow | Portion]) -> Iterator[TableRow]:
    """Yield the messages of one bucket as rows, in order."""
    held = HeldPortions()
    for message in messages:
        place = place_of(message)
        if held and (isinstance(message, TableRow) or held.are_enough(place)):
            yield from rows_of(held.take(place))
        if isinstance(message, TableRow):
            yield message
        else:
            held.add(message)
    yield from rows_of(held.take(None))
