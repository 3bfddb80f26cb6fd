# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The buckets in which a read probably begins: those in which the last read of its tables began.

A read of few rows requests these buckets at the same time as the directory. It uses the answer only
if the directory names the same buckets. That saves one round trip and never changes the result.
"""

from __future__ import annotations

from typing import Collection, Dict, Iterable, List, Sequence, Tuple

from cassandra_ros.read import Read
from cassandra_ros.store.piece import BucketPart, first_and_last, may_hold
from cassandra_ros.tables.directory import BucketRow, Directory
from cassandra_ros.tables.row_table import RowTable

MOST = 8
"""Maximum number of buckets requested so. If more begin together, the directory is read first."""


def foresee(
    directory: Directory, tables: Sequence[RowTable], read: Read
) -> Tuple[List[BucketPart], int]:
    """Return the buckets in which a read probably begins, and the number of nodes of its tables."""
    found: List[BucketPart] = []
    streams = 0
    for table in tables:
        known, groups = directory.first.get((table.name, read.reverse), ((), ()))
        nodes = [node for node in known if read.whose.nodes is None or node in read.whose.nodes]
        streams += len(nodes)
        low, high = first_and_last(read, table)
        found += [
            BucketPart(0, table, group[0].node, group[0].bucket, group)
            for group in groups
            if group[0].node in nodes and low <= group[0].bucket <= high and may_hold(read, group)
        ]
    return (found if len(found) <= MOST else []), streams


def note_first(
    directory: Directory,
    walks: Iterable[Tuple[RowTable, Collection[str]]],
    begun: Iterable[BucketPart],
    read: Read,
) -> None:
    """Cache the buckets in which a read began, and the nodes that were found in each table."""
    groups: Dict[str, List[Sequence[BucketRow]]] = {}
    for piece in begun:
        if piece.rows:
            groups.setdefault(piece.table.name, []).append(piece.rows)
    for table, met in walks:
        if table.name in groups:
            directory.first[table.name, read.reverse] = tuple(met), groups[table.name]
