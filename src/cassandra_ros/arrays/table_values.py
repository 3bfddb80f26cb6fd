# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The values of some fields of one table, gathered in arrays while its rows are read.

Rows are taken in batches: their columns stay undecoded until a batch is turned into arrays at
once. Only what has no column to itself (an array inside an array of messages, say) is decoded
value by value.
"""

from __future__ import annotations

import logging
import struct
from dataclasses import replace
from typing import TYPE_CHECKING, Callable, List, Mapping, NamedTuple, Optional, Sequence, Union

import numpy as np

from cassandra_ros.arrays.array_types import ArrayType, group_types
from cassandra_ros.arrays.values import (
    Convert,
    Values,
    compile_convert,
    count_elements,
    from_decoded,
    join_values,
    objects_of,
)
from cassandra_ros.errors import CassandraRosError, CorruptMessage, MessageNotFound
from cassandra_ros.messages.wire.layout import FieldColumn
from cassandra_ros.messages.wire.plan import wire_plan
from cassandra_ros.query.names import FieldRef, Findings
from cassandra_ros.query.projection import Projection
from cassandra_ros.query.protocols import Row, Table
from cassandra_ros.query.syntax import Select

if TYPE_CHECKING:
    from cassandra_ros.arrays.array_types import AnyArray

_log = logging.getLogger(__name__)

BATCH_ROWS = 4096
BATCH_BYTES = 8 * 1024 * 1024


class Origin(NamedTuple):
    """Where the values of a field come from."""

    place: int
    """Of the column among those that are cut out."""
    convert: Convert
    inside: bool
    """The column is a list whose elements are rows."""


class TableColumns:
    """Takes undecoded columns from rows, or else cuts them out of the serialised message.

    Args:
        table: Whose rows.
        fields: With their types; None = KEY or NODE.
        arrays: The dotted names of the arrays of messages that are unnested.

    Attributes:
        direct: Whether every field can be taken so. The others are of no use where not.
        names: The columns.
        origins: For each field.
        listed: Place of a column with one element for each row, where there is one.
    """

    def __init__(
        self,
        table: Table,
        fields: Sequence[tuple[Optional[FieldRef], ArrayType]],
        arrays: Sequence[str],
    ) -> None:
        self._table = table
        self.names: List[str] = []
        self._cut: Optional[Callable[[bytes], Sequence[Optional[bytes]]]] = None
        self._places: dict[int, Optional[list[int]]] = {}
        known: Mapping[str, FieldColumn] = {}
        if table.definition is not None:
            plan = wire_plan(table.definition)
            known = {column.name: column for column in plan.all_columns}
        self.origins = [
            None if ref is None else self._origin(ref, kind, known, arrays) for ref, kind in fields
        ]
        self.direct = len(arrays) <= 1 and all(
            ref is None or origin is not None for (ref, _), origin in zip(fields, self.origins)
        )
        inside = [origin.place for origin in self.origins if origin is not None and origin.inside]
        self.listed = inside[0] if inside else None
        if self.names:
            self._cut = plan.cutter(self.names)

    def _origin(
        self,
        ref: FieldRef,
        kind: ArrayType,
        known: Mapping[str, FieldColumn],
        arrays: Sequence[str],
    ) -> Optional[Origin]:
        column = known.get(ref.column)
        if column is None:
            return None
        inside = column.array in arrays
        convert = compile_convert(ref, column, kind, inside)
        if convert is None:
            return None
        if column.name not in self.names:
            self.names.append(column.name)
        return Origin(self.names.index(column.name), convert, inside)

    @property
    def needed(self) -> Sequence[str]:
        """The columns of the table that must be read, in its order."""
        every = self._table.columns
        if not self.direct or not set(self.names) <= set(every):
            return every
        return [name for name in every if name in self.names]

    def read(self, row: Row) -> Optional[Sequence[Optional[bytes]]]:
        """Return the columns of a row, None for each where the message cannot be read.

        None instead of all where the message was removed since its columns were read.
        """
        if self._cut is None:
            return ()
        try:
            columns = row.columns
            places = self._where(len(columns))
            if places is not None:
                raws = [columns[n] for n in places]
                # A column of a row that is marked as odd is exact, if it is there at all.
                if None not in raws:
                    return raws
            return self._cut(row.wire)
        except MessageNotFound:
            return None
        except CorruptMessage as exc:
            _log.warning("message %s of topic %s cannot be read: %s", row.key, row.topic, exc)
            return [None] * len(self.names)

    def _where(self, width: int) -> Optional[list[int]]:
        """Places of the columns in a row of so many: all of the table's, or those asked for."""
        if not self._table.by_field:
            return None
        if width not in self._places:
            held = list(self._table.columns)
            if width != len(held):
                held = [name for name in held if name in self.names]
            fits = width == len(held) and all(name in held for name in self.names)
            self._places[width] = [held.index(name) for name in self.names] if fits else None
        return self._places[width]


class TableValues:
    """Gathers the values of a statement's columns from the rows of one table.

    Args:
        select: The statement; its columns are fields, KEY and NODE.
        table: The table.
        findings: Collects what the statement names in vain.

    Attributes:
        groups: Name and type of the columns that each selected path gives.
        count: How many values there are of each.
    """

    def __init__(self, select: Select, table: Table, findings: Findings) -> None:
        self._projection = Projection.compile(select, table, findings)
        unnested = self._projection.unnested
        self.groups = group_types(self._projection, table)
        self._outputs = [output for group in self._projection.groups for output in group]
        self._kinds = [kind for group in self.groups for _, kind in group]
        fields = [(output.ref, kind) for output, kind in zip(self._outputs, self._kinds)]
        arrays = [".".join(step.name for step in array) for array in unnested]
        self._columns = TableColumns(table, fields, arrays)
        condition = Projection.compile(replace(select, columns=()), table, Findings(select.text))
        self._tester = condition if condition.unnested else None
        """Tells of each element whether it satisfies the condition; None: all of them do."""
        self._chunks: list[list[Values]] = [[] for _ in self._outputs]
        self._orders: list[AnyArray] = []
        self._clear()

    def _clear(self) -> None:
        self._numbers: list[int] = []
        self._own: list[tuple[Union[int, str], str]] = []
        self._raws: list[Sequence[Optional[bytes]]] = []
        self._hits: list[list[bool]] = []
        self._decoded: list[Sequence[object]] = []
        self._bytes = 0

    # ---------------------------------------------------------------- rows

    def add(self, row: Row, number: int) -> None:
        """Take a row in.

        Args:
            row: A row of the table that satisfies the condition.
            number: Orders the rows of all tables; never falls.
        """
        projection = self._projection
        if self._columns.direct:
            raws = self._columns.read(row)
            if raws is None:
                return
            self._numbers.append(number)
            self._own.append((row.name if projection.named else row.t, row.node))
            self._raws.append(raws)
            if self._tester is not None:
                self._hits.append(list(self._tester.hits(row)))
            self._bytes += sum([len(raw) for raw in raws if raw is not None])
        else:
            found = projection.values(row)
            if self._tester is not None:
                found = [values for values in found if projection.check(values) is True]
            self._decoded += found
            self._numbers += [number] * len(found)
            self._bytes += row.size
        if len(self._numbers) >= BATCH_ROWS or self._bytes >= BATCH_BYTES:
            self.flush()

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
        return [
            from_decoded(columns[output.place], kind)
            for output, kind in zip(self._outputs, self._kinds)
        ]

    def _direct(self) -> list[Values]:
        columns = list(zip(*self._raws))
        counts = kept = None
        if self._tester is not None:
            counts = np.array([len(hits) for hits in self._hits])
            kept = np.array([hit for hits in self._hits for hit in hits], bool)
        elif self._columns.listed is not None:
            counts = count_elements(columns[self._columns.listed])
        chunks = []
        for output, kind, origin in zip(self._outputs, self._kinds, self._columns.origins):
            if origin is None:
                chunk = self._own_values(output.place, kind)
            else:
                chunk = origin.convert(columns[origin.place])
            inside = origin is not None and origin.inside
            chunks.append(_chosen(chunk, None if inside else counts, kept))
        self._orders.append(_chosen(Values(_order(self._numbers)), counts, kept).values)
        return chunks

    def _own_values(self, place: int, kind: ArrayType) -> Values:
        own = [pair[place] for pair in self._own]
        return Values(objects_of(own) if kind.dtype.kind == "O" else np.array(own, np.int64))

    @property
    def needed(self) -> Sequence[str]:
        """The columns of the table that must be read."""
        return self._columns.needed

    @property
    def count(self) -> int:
        """How many values there are of each output."""
        return sum(len(order) for order in self._orders)

    @property
    def order(self) -> AnyArray:
        """The numbers of the rows from which the values come."""
        return np.concatenate(self._orders)

    def take(self, name: str) -> Optional[tuple[ArrayType, Values]]:
        """Give away the values of a column, with their type; None where the table lacks it."""
        for n, (output, kind) in enumerate(zip(self._outputs, self._kinds)):
            if output.name == name:
                chunks, self._chunks[n] = self._chunks[n], []
                return kind, join_values(chunks, kind)
        return None


def _order(numbers: Sequence[int]) -> AnyArray:
    # While only one table has rows all are 0, and take no memory.
    return np.array(numbers) if numbers[-1] else np.broadcast_to(np.int64(0), (len(numbers),))


def _chosen(chunk: Values, counts: Optional[AnyArray], kept: Optional[AnyArray]) -> Values:
    """Repeat the values of a message for each of its elements, and leave those that match."""
    values, missing = chunk
    if counts is not None:
        values = np.repeat(values, counts, axis=0)
        missing = None if missing is None else np.repeat(missing, counts)
    if kept is not None:
        values = values[kept]
        missing = None if missing is None else missing[kept]
    return Values(values, missing)
