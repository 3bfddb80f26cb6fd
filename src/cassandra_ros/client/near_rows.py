# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Messages of any topics by the place of their robot: NEAR, for all topics at once."""

from __future__ import annotations

from typing import Dict, Iterable, Iterator, Optional, Tuple

from cassandra_ros.errors import InvalidOption, InvalidQuery
from cassandra_ros.read import Read
from cassandra_ros.topics.catalog import Catalog, Conditions
from cassandra_ros.topics.row_finder import Where
from cassandra_ros.topics.stored_row import StoredRow

NearDisk = Tuple[float, float, float, str, str]
"""x, y and radius (m) in a frame, the frame, and the robot; '' = to be found out."""


def near_rows(
    catalog: Catalog,
    asked: NearDisk,
    topics: Optional[Iterable[str]],
    read: Read,
    where: Conditions,
) -> Iterator[StoredRow]:
    """Yield the rows of topics (None = all) whose robot was on a disk; see RosCassandra.near."""
    tables = catalog.tables(topics)
    names = sorted({table.metadata.topic for table in tables})
    catalog.filters(where, names, read.whose)  # raises for invalid conditions
    given = {catalog.get(name).name: condition for name, condition in (where or {}).items()}
    conditions: Dict[str, Where] = {name: _and_near(given.get(name), asked) for name in names}
    try:
        with catalog.places.shared():
            filters = catalog.filters(conditions, names, read.whose)
            return catalog.merged(tables, filters, read)
    except InvalidQuery as exc:
        raise InvalidOption(exc.reason) from exc


def _and_near(where: Optional[Where], asked: NearDisk) -> Where:
    """Return the condition NEAR, joined with another condition if there is one."""
    values = list(asked if asked[-1] else asked[:-1])
    near = f"NEAR({', '.join('?' * len(values))})"
    if where is None:
        return near, values
    text, params = (where, ()) if isinstance(where, str) else where
    # On separate lines, because the condition may end with a comment.
    return f"(\n{text}\n) AND {near}", [*params, *values]
