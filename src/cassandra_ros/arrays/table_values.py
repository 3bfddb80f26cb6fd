# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The values of some fields of one table, gathered in arrays while its rows are read.

Rows are taken in batches: their columns stay undecoded until a batch is turned into arrays at
once. Only what has no column to itself (an array inside an array of messages, say) is decoded
value by value.
"""

from __future__ import annotations

import struct
from typing import Any, Optional, Sequence

import numpy as np

from cassandra_ros.arrays.array_types import ArrayType
from cassandra_ros.arrays.join import joinValues
from cassandra_ros.arrays.outputs import Output, outputsOf
from cassandra_ros.arrays.table_columns import TableColumns
from cassandra_ros.arrays.values import Values, countElements, fromDecoded, objectsOf
from cassandra_ros.errors import CassandraRosError, CorruptMessage
from cassandra_ros.query.conditions import readable
from cassandra_ros.query.evaluate import compileCondition
from cassandra_ros.query.extract import Extractor
from cassandra_ros.query.protocols import Row, Table
from cassandra_ros.query.scope import KEY_PLACE, NODE_PLACE, Findings, Scope
from cassandra_ros.query.syntax import Key, Node, Select

BATCH_ROWS = 4096
BATCH_BYTES = 8 * 1024 * 1024


class TableValues:
    """Gathers the values of a statement's columns from the rows of one table.

    Args:
        select: The statement; its columns are fields, KEY and NODE.
        table: The table.
        findings: Collects what the statement names in vain.

    Attributes:
        outputs: The columns that the table has, for each selected path.
    """

    def __init__(self, select: Select, table: Table, findings: Findings) -> None:
        definition = table.definition
        self._scope = scope = Scope(definition, findings, table.named)
        self._check = compileCondition(select.condition, scope.locate, scope.fit)
        tested = scope.refs
        self.outputs = outputsOf(select, scope, definition, table.named)
        self._all = [output for group in self.outputs for output in group]
        self._named = table.named
        self._extractor = scope.extractor()
        self._columns = TableColumns(table, self._all, scope.unnested)
        self._tester: Optional[Extractor] = None
        if definition is not None and any(
            array in scope.unnested for ref in tested for array in ref.arrays
        ):
            self._tester = Extractor(definition, tested, scope.unnested)
        self._chunks: list[list[Values]] = [[] for _ in self._all]
        self._orders: list[Any] = []
        self._clear()

    def _clear(self) -> None:
        self._numbers: list[int] = []
        self._own: list[tuple[Any, str]] = []
        self._raws: list[Sequence[Optional[bytes]]] = []
        self._hits: list[list[bool]] = []
        self._decoded: list[Sequence[Any]] = []
        self._bytes = 0

    # ---------------------------------------------------------------- rows

    def add(self, row: Row, number: int) -> None:
        """Take a row in.

        Args:
            row: A row of the table that satisfies the condition.
            number: Orders the rows of all tables; never falls.
        """
        if self._columns.direct:
            raws = self._columns.read(row)
            if raws is None:
                return
            self._numbers.append(number)
            self._own.append((row.name if self._named else row.t, row.node))
            self._raws.append(raws)
            if self._tester is not None:
                self._hits.append(self._test(row, self._tester))
            self._bytes += sum([len(raw) for raw in raws if raw is not None])
        else:
            found = readable(row, self._scope.rows(row, self._extractor), self._scope.width)
            if self._tester is not None:
                found = [values for values in found if self._check(values) is True]
            self._decoded += found
            self._numbers += [number] * len(found)
            self._bytes += row.size
        if len(self._numbers) >= BATCH_ROWS or self._bytes >= BATCH_BYTES:
            self.flush()

    def _test(self, row: Row, tester: Extractor) -> list[bool]:
        """Say for each element of the unnested array whether it satisfies the condition."""
        own = (row.name if self._named else row.t, row.node)
        values = ((*own, *found) for found in tester.values(row))
        found = readable(row, values, self._scope.width)
        return [self._check(element) is True for element in found]

    # ---------------------------------------------------------------- arrays

    def flush(self) -> None:
        """Turn the rows of the batch into arrays."""
        if not self._numbers:
            return
        try:
            chunks = self._direct() if self._columns.direct else self._value_by_value()
        except (ValueError, struct.error) as exc:
            if isinstance(exc, CassandraRosError):
                raise
            raise CorruptMessage(f"a column of a row is malformed: {exc}") from exc
        for gathered, chunk in zip(self._chunks, chunks):
            gathered.append(chunk)
        self._clear()

    def _value_by_value(self) -> list[Values]:
        columns = list(zip(*self._decoded))
        self._orders.append(_order(self._numbers))
        return [fromDecoded(columns[_placeOf(o)], o.kind) for o in self._all]

    def _direct(self) -> list[Values]:
        columns = list(zip(*self._raws))
        counts = kept = None
        if self._tester is not None:
            counts = np.array([len(hits) for hits in self._hits])
            kept = np.array([hit for hits in self._hits for hit in hits], bool)
        elif self._columns.listed is not None:
            counts = countElements(columns[self._columns.listed])
        chunks = []
        for output, source in zip(self._all, self._columns.sources):
            if source is None:
                chunk = self._ownValues(output)
            else:
                chunk = source.convert(columns[source.place])
            inside = source is not None and source.inside
            chunks.append(_chosen(chunk, None if inside else counts, kept))
        self._orders.append(_chosen(Values(_order(self._numbers)), counts, kept).values)
        return chunks

    def _ownValues(self, output: Output) -> Values:
        own = [pair[_placeOf(output)] for pair in self._own]
        return Values(objectsOf(own) if output.kind.dtype.kind == "O" else np.array(own, np.int64))

    @property
    def needed(self) -> Sequence[str]:
        """The columns of the table that must be read."""
        return self._columns.needed

    @property
    def count(self) -> int:
        """How many values there are of each output."""
        return sum(len(order) for order in self._orders)

    @property
    def order(self) -> Any:
        """The numbers of the rows from which the values come."""
        return np.concatenate(self._orders)

    def take(self, name: str) -> Optional[tuple[ArrayType, Values]]:
        """Give away the values of a column, with their type; None where the table lacks it."""
        for n, output in enumerate(self._all):
            if output.name == name:
                chunks, self._chunks[n] = self._chunks[n], []
                return output.kind, joinValues(chunks, output.kind)
        return None


def _placeOf(output: Output) -> int:
    if isinstance(output.what, Key):
        return KEY_PLACE
    return NODE_PLACE if isinstance(output.what, Node) else output.place


def _order(numbers: Sequence[int]) -> Any:
    # While only one table has rows all are 0, and take no memory.
    return np.array(numbers) if numbers[-1] else np.broadcast_to(np.int64(0), (len(numbers),))


def _chosen(chunk: Values, counts: Any, kept: Any) -> Values:
    """Repeat the values of a message for each of its elements, and leave those that match."""
    values, missing = chunk
    if counts is not None:
        values = np.repeat(values, counts, axis=0)
        missing = None if missing is None else np.repeat(missing, counts)
    if kept is not None:
        values = values[kept]
        missing = None if missing is None else missing[kept]
    return Values(values, missing)
