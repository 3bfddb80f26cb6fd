# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rows whose keys are known: fetched one by one, the next ones asked for ahead."""

from __future__ import annotations

from collections import deque
from typing import Any, Deque, Iterable, Iterator, NamedTuple

from cassandra_ros.keys import Position
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.driver_errors import DRIVER_ERRORS
from cassandra_ros.store.patience import Patience
from cassandra_ros.store.row_table import RowTable, TableRow, bind, encodeLong

AHEAD = 16


class Wanted(NamedTuple):
    """A row to be fetched."""

    table: RowTable
    position: Position


def fetchRows(
    cassandra: Cassandra, wanted: Iterable[Wanted], ahead: int = AHEAD
) -> Iterator[TableRow]:
    """Yield the rows in the order asked for; one that was deleted meanwhile is left out.

    Args:
        cassandra: The connection.
        wanted: The keys.
        ahead: How many are on their way at once.
    """
    asked: Deque[tuple[Wanted, Any]] = deque()
    for key in wanted:
        asked.append((key, _ask(cassandra, key)))
        if len(asked) >= ahead:
            yield from _answer(cassandra, *asked.popleft())
    while asked:
        yield from _answer(cassandra, *asked.popleft())


def _ask(cassandra: Cassandra, key: Wanted) -> Any:
    table, (t, node, seq, _, name) = key
    end = tuple(encodeLong(value) for value in table.storedOrder(t, seq))
    place = (node.encode("utf-8"), table.partitionOf(t, name))
    return cassandra.sendRaw(bind(table.selectRange(table.columns), (*place, *end, *end)))


def _answer(cassandra: Cassandra, key: Wanted, future: Any) -> Iterator[TableRow]:
    table, position = key
    patience = Patience(f"reading topic {table.metadata.topic}")
    while True:
        try:
            rows = future.result().current_rows
            break
        except DRIVER_ERRORS as exc:
            patience.wait(exc)
            future = _ask(cassandra, key)
    if rows and not table.isRest(rows[0]):
        yield table.rowFromValues(position.node, rows[0], position.name)
