# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""cr_place and cr_placed: in which squares of the ground robots were when, as far as it is noted.

A row of cr_place is a visit: from t_in to t_out a robot may have been in a square, in coordinates
of a frame. Visits are a superset: what is deleted later may stay in it; what is written twice is
the same row. A row of cr_placed says of which poses all visits are there: those that one run put
into one table with keys from low to high. Poses of which nothing says so are looked at themselves;
so whoever writes visits notes how far they go behind them, and whoever adds poses among those that
are noted, or deletes some of them, takes that back: between the others a robot went another way.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import FrozenSet, Iterable, Mapping, NamedTuple, Optional, Sequence, Set, Tuple

from cassandra_ros.connection.cassandra import CqlRow
from cassandra_ros.keys import MAX_NS
from cassandra_ros.tables.side_tables import SideTables

_VISIT = ("frame", "robot", "size", "x", "y", "node", "t_in", "writer", "t_out")
_DONE = ("tbl", "node", "writer", "robot", "low", "high", "frames", "above")
_LONGER_SEC = 86400
"""So much longer visits stay than what says that they are there."""


class Square(NamedTuple):
    """A square of the ground, for one robot: a frame, or the table of a topic of its poses."""

    frame: str
    robot: str
    size: int
    """Its side, metres."""
    x: int
    y: int
    """Its number to the east and to the north; (0, 0) begins at the origin."""


class Visited(NamedTuple):
    """A robot may have been in a square from t_in to t_out, ns, both included."""

    square: Square
    node: str
    t_in: int
    writer: int
    t_out: int


@dataclass(frozen=True)
class Placed:
    """Of which poses all visits are noted."""

    table: str
    """Where the poses lie."""
    node: str
    writer: int
    """Of the run that stored them."""
    robot: str
    low: int
    high: int
    """First and last key, ns, both included."""
    frames: FrozenSet[str] = frozenset()
    """All frames that were seen with them."""
    above: Mapping[str, str] = field(default_factory=dict)
    """The robot's frame and those above it, in which its places are noted, and for each how it is
    fixed to the next one; '' where it moves, or is the last."""


class PlaceIndex:
    """Reads and writes the two tables in one keyspace."""

    def __init__(self, side_tables: SideTables) -> None:
        self._tables = side_tables

    def put(self, visits: Sequence[Visited], done: Iterable[Placed], ttl: int = 0) -> None:
        """Note visits, and then how far they go; for ttl seconds, 0 = ever."""
        self._tables.make("cr_place", "cr_placed")
        rows = [(*square, *rest) for square, *rest in visits]
        longer = ttl + _LONGER_SEC if ttl else 0
        self._tables.insert_many("cr_place", _VISIT, rows, "noting where robots were", ttl=longer)
        placed = [
            (d.table, d.node, d.writer, d.robot, d.low, d.high, set(d.frames), dict(d.above))
            for d in done
        ]
        what = "noting how far the index of places goes"
        self._tables.insert_many("cr_placed", _DONE, placed, what, ttl=ttl)

    def placed(self, tables: Sequence[str]) -> list[Placed]:
        """Return what is noted of the poses in some tables."""
        what = "reading how far the index of places goes"
        every = [(table,) for table in tables]
        found = self._tables.select_many("cr_placed", ", ".join(_DONE), "tbl = ?", every, what)
        return [_placed(row) for rows in found for row in rows]

    def visits(
        self, squares: Sequence[Square], node: str, low: int, high: int
    ) -> list[Tuple[int, int]]:
        """Return from when to when a robot of a node was in one of some squares.

        Args:
            low, high: t_in of the visits, ns, both included.
        """
        where = f"{' AND '.join(f'{name} = ?' for name in _VISIT[:6])} AND t_in >= ? AND t_in <= ?"
        params = [(*square, node, low, high) for square in squares]
        what = "reading where robots were"
        found = self._tables.select_many("cr_place", "t_in, t_out", where, params, what)
        return [(t_in, t_out) for rows in found for t_in, t_out in rows]

    def noted(self, table: str, node: str, writer: int) -> Set[str]:
        """Return of which robots it is noted that all visits of a run's poses are there."""
        where, what = "tbl = ? AND node = ? AND writer = ?", "reading how far the index goes"
        rows = self._tables.select("cr_placed", "robot", where, (table, node, writer), what=what)
        return {robot for (robot,) in rows}

    def withdraw(
        self,
        table: str,
        low: int = 0,
        high: int = MAX_NS,
        run: Optional[Tuple[str, int]] = None,
    ) -> None:
        """Take back that all visits are noted of poses among which some come or go.

        Args:
            low, high: Keys of these, ns, both included.
            run: Node and writer id whose poses they are; None = anybody's.
        """
        what = "taking back how far the index of places goes"
        names = "node, writer, robot, low, high"
        rows = self._tables.select("cr_placed", names, "tbl = ?", (table,), what=what)
        keys = [
            (table, node, writer, robot)
            for node, writer, robot, first, last in rows
            if first <= high and last >= low and run in (None, (node, writer))
        ]
        if keys:
            self._tables.delete("cr_placed", ("tbl", "node", "writer", "robot"), keys, what)

    def forget(self, table: str) -> None:
        """Remove what is noted of a table that was dropped; its visits are found by nobody then."""
        if self._tables.has("cr_placed"):
            what = "clearing the index of places"
            self._tables.delete("cr_placed", ("tbl",), [(table,)], what)


def _placed(row: CqlRow) -> Placed:
    table, node, writer, robot, low, high, frames, above = row
    return Placed(table, node, writer, robot, low, high, frozenset(frames or ()), dict(above or {}))
