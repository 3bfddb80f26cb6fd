# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""cr_place and cr_placed: the index of the squares of the ground in which robots were.

A row of cr_place is a visit: from t_in to t_out a robot may have been in a square, in coordinates
of a frame. There may be more visits than true ones: a visit stays after its poses are deleted. A
visit that is written twice is one row. A row of cr_placed says that the visits of some poses are
complete: those that one run stored in one table with keys from low to high. All other poses are
read themselves. So a program that writes visits then adds the row of cr_placed. A program that adds
poses between these keys, or deletes some, removes the row, because the robot's way between the
remaining poses is no longer known.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Iterable, Mapping, NamedTuple, Sequence

from cassandra_ros.keys import MAX_NS
from cassandra_ros.store.connection.cassandra import CqlRow
from cassandra_ros.store.tables.side_tables import SideTables

_VISIT = ("frame", "robot", "size", "x", "y", "node", "t_in", "writer", "t_out")
"""Columns of cr_place: those of a Square, then the other fields of a VisitRow."""
_POSES = ("tbl", "node", "writer", "robot", "low", "high", "frames", "above")
"""Columns of cr_placed: the fields of IndexedPoses."""
_LONGER_SEC = 86400
"""How much longer than the rows of cr_placed the visits stay, s, so that none is missing."""


class Square(NamedTuple):
    """A square of the ground for one robot."""

    frame: str
    """A tf frame, or the table with the robot's poses."""
    robot: str
    size: int
    """Length of its side, m."""
    x: int
    y: int
    """Number of the square to the east and to the north; (0, 0) begins at the origin."""


class VisitRow(NamedTuple):
    """A visit: a robot may have been in a square from t_in to t_out, ns, both included."""

    square: Square
    node: str
    t_in: int
    writer: int
    t_out: int


@dataclass(frozen=True)
class IndexedPoses:
    """Poses whose visits are all in the index.

    They are the poses of one robot in one table that one run stored, in a range of keys.
    """

    table: str
    """Table of the poses."""
    node: str
    writer: int
    """Writer id of the run that stored the poses."""
    robot: str
    low: int
    high: int
    """First and last key, ns, both included."""
    frames: frozenset[str] = frozenset()
    """All frames of the transforms between low and high."""
    above: Mapping[str, str] = field(default_factory=dict)
    """The robot's frame and the frames above it for which visits are stored, each with the fixed
    transform to the next one as text; '' if it moves, or is the last."""


class PlaceIndex:
    """Reads and writes cr_place and cr_placed of one keyspace."""

    def __init__(self, side_tables: SideTables) -> None:
        self._tables = side_tables

    def put(self, visits: Sequence[VisitRow], poses: Iterable[IndexedPoses], ttl: int = 0) -> None:
        """Write visits, and then the poses whose visits are complete.

        Args:
            ttl: How long the rows of poses stay, s; 0 = for ever. Visits stay longer.
        """
        self._tables.make("cr_place", "cr_placed")
        rows = [(*square, *rest) for square, *rest in visits]
        longer = ttl + _LONGER_SEC if ttl else 0
        self._tables.insert_many("cr_place", _VISIT, rows, "noting where robots were", ttl=longer)
        pose_rows = [
            (p.table, p.node, p.writer, p.robot, p.low, p.high, set(p.frames), dict(p.above))
            for p in poses
        ]
        what = "noting how far the index of places goes"
        self._tables.insert_many("cr_placed", _POSES, pose_rows, what, ttl=ttl)

    def placed(self, tables: Sequence[str]) -> list[IndexedPoses]:
        """Return the rows of cr_placed of some tables."""
        what = "reading how far the index of places goes"
        keys = [(table,) for table in tables]
        answers = self._tables.select_many("cr_placed", ", ".join(_POSES), "tbl = ?", keys, what)
        return [_poses_of(row) for rows in answers for row in rows]

    def visits(
        self, squares: Sequence[Square], node: str, low: int, high: int
    ) -> list[tuple[int, int]]:
        """Return the (t_in, t_out) of a robot's visits to some squares, ns.

        Args:
            node: nodeID of the robot.
            low, high: Range of t_in, ns, both included.
        """
        where = f"{' AND '.join(f'{name} = ?' for name in _VISIT[:6])} AND t_in >= ? AND t_in <= ?"
        params = [(*square, node, low, high) for square in squares]
        what = "reading where robots were"
        answers = self._tables.select_many("cr_place", "t_in, t_out", where, params, what)
        return [(t_in, t_out) for rows in answers for t_in, t_out in rows]

    def noted(self, table: str, node: str, writer: int) -> set[str]:
        """Return the robots for which the visits of a run's poses in a table are complete."""
        where, what = "tbl = ? AND node = ? AND writer = ?", "reading how far the index goes"
        rows = self._tables.select("cr_placed", "robot", where, (table, node, writer), what=what)
        return {robot for (robot,) in rows}

    def withdraw(
        self, table: str, low: int = 0, high: int = MAX_NS, run: tuple[str, int] | None = None
    ) -> None:
        """Note that visits are no longer complete, because poses are added or deleted.

        Args:
            low, high: Range of the keys of these poses, ns, both included.
            run: Node and writer id of the run that stored the poses; None = any run.
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

    def delete_entries(self, table: str) -> None:
        """Delete the rows of cr_placed of a dropped table; its visits are never read then."""
        if self._tables.has("cr_placed"):
            what = "clearing the index of places"
            self._tables.delete("cr_placed", ("tbl",), [(table,)], what)


def _poses_of(row: CqlRow) -> IndexedPoses:
    table, node, writer, robot, low, high, frames, above = row
    return IndexedPoses(
        table, node, writer, robot, low, high, frozenset(frames or ()), dict(above or {})
    )
