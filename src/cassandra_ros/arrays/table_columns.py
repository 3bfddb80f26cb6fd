# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The columns of one table that hold the fields of a statement, undecoded, row by row."""

from __future__ import annotations

import logging
from typing import Any, Callable, List, NamedTuple, Optional, Sequence

from cassandra_ros.arrays.outputs import Output
from cassandra_ros.arrays.values import Convert, compileConvert
from cassandra_ros.errors import CorruptMessage, MessageNotFound
from cassandra_ros.messages.wire.plan import wirePlan
from cassandra_ros.query.extract import Array
from cassandra_ros.query.protocols import Row, Table
from cassandra_ros.query.syntax import Key, Node

_log = logging.getLogger(__name__)


class Source(NamedTuple):
    """Where the values of an output come from."""

    place: int
    """Of the column among those that are read."""
    convert: Convert
    inside: bool
    """The column is a list whose elements are rows."""


class TableColumns:
    """Takes undecoded columns from rows, or else cuts them out of the serialised message.

    Attributes:
        direct: Whether every field can be taken so. The others are of no use where not.
        names: The columns.
        sources: For each output; None where it is KEY or NODE.
        listed: Place of a column with one element for each row, where there is one.
    """

    def __init__(self, table: Table, outputs: Sequence[Output], unnested: Sequence[Array]) -> None:
        self._table = table
        self.direct = len(unnested) <= 1
        self.names: List[str] = []
        self.sources: List[Optional[Source]] = []
        arrays = [".".join(step.name for step in array) for array in unnested]
        fields = [o for o in outputs if not isinstance(o.what, (Key, Node))]
        known = {}
        if fields:
            plan = wirePlan(table.definition)
            known = {column.name: column for column in plan.all_columns}
        for output in outputs:
            source = None
            if output in fields:
                source = self._source(output, known, arrays)
                self.direct = self.direct and source is not None
            self.sources.append(source)
        inside = [source.place for source in self.sources if source is not None and source.inside]
        self.listed = inside[0] if inside else None
        self._cut: Optional[Callable[[bytes], Sequence[Optional[bytes]]]] = None
        if self.names:
            self._cut = plan.cutter(self.names)
        self._places: dict[int, Optional[list[int]]] = {}

    def _source(self, output: Output, known: Any, arrays: Sequence[str]) -> Optional[Source]:
        ref: Any = output.what
        column = known.get(ref.column)
        if column is None:
            return None
        inside = column.array in arrays
        convert = compileConvert(ref, column, output.kind, inside)
        if convert is None:
            return None
        if column.name not in self.names:
            self.names.append(column.name)
        return Source(self.names.index(column.name), convert, inside)

    @property
    def needed(self) -> Sequence[str]:
        """The columns of the table that must be read, in its order."""
        every: Sequence[str] = self._table.columns
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
