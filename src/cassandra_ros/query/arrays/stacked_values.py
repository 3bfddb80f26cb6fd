# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Field values read directly from serialised messages, for all messages of a layout at once.

This works for single values and arrays of numbers that are not inside an array of messages. The
caller cuts the fields out of messages that share no layout with others, one by one.
"""

from __future__ import annotations

from typing import NamedTuple, Sequence, Tuple

import numpy as np

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.wire.layout import FieldColumn
from cassandra_ros.messages.wire.message_stacks import Stack, stacker
from cassandra_ros.query.arrays.array_types import AnyArray, ArrayType
from cassandra_ros.query.arrays.batch import SizeGroups
from cassandra_ros.query.arrays.column_values import ColumnArray, decode_texts, empty_values
from cassandra_ros.query.tree.field_names import FieldRef

_NUMBERS = ("int", "float", "bool", "time", "duration")

RestMessages = Sequence[Tuple[int, bytes]]
"""Index and bytes of the messages that share no layout with others."""


class StackedField(NamedTuple):
    """A field that can be read from many messages at once."""

    ref: FieldRef
    column: FieldColumn
    kind: ArrayType

    @property
    def is_able(self) -> bool:
        """Whether it is a single value or an array of numbers, outside all arrays of messages."""
        ref, column, kind = self
        if column.name != ref.column or column.is_list or kind.depth > 1:
            return False
        if any(step.many for step in ref.steps):
            return False
        return column.kind in (*_NUMBERS, "text", "array")

    def put(self, stack: Stack, array: ColumnArray) -> None:
        """Set the values of the messages of a layout at their indices."""
        if self.column.kind == "text":
            array.values[stack.members] = _texts(stack, self.column.name)
        else:
            numbers = self._numbers(stack)
            if numbers is None:
                return  # the array is shorter than the index
            if array.values.dtype.kind == "O":
                for member, row in zip(stack.members.tolist(), numbers):
                    array.values[member] = row
            else:
                array.values[stack.members] = numbers
        array.missing[stack.members] = False

    def _numbers(self, stack: Stack) -> AnyArray | None:
        """Return one number, or one row of numbers, per message; None: the array is too short."""
        ref, path = self.ref, self.column.name
        base = self.column.field_type.partition("[")[0]
        if self.kind.depth:
            rows: AnyArray = np.ascontiguousarray(stack.array(path, base).T)
            return rows.astype(self.kind.dtype, copy=False)
        if ref.index is not None:
            by_offset = stack.element(path, ref.index, base)
        else:
            by_offset = stack.numbers(path, base)
        if not len(by_offset):
            return None
        numbers: AnyArray = by_offset[0]
        if ref.part:
            numbers = numbers // SECOND_NS if ref.part == "secs" else numbers % SECOND_NS
        return numbers.astype(self.kind.dtype)


def _texts(stack: Stack, path: str) -> AnyArray:
    """Return a text of each message, as an array of objects."""
    ((at, size),) = stack.layout.texts[path]
    characters = stack.planes[at : at + size].T.tobytes()
    count = stack.planes.shape[1]
    return decode_texts([characters[n * size : (n + 1) * size] for n in range(count)])


def read_stacked(
    definition: Definition, fields: Sequence[StackedField], count: int, groups: SizeGroups
) -> tuple[list[ColumnArray], RestMessages]:
    """Read fields of ``count`` messages.

    Returns:
        The values of each field, missing for every message that was not read; and the messages of
        the groups that were not read.
    """
    arrays = [empty_values(field.kind, count) for field in fields]
    rest: list[tuple[int, bytes]] = []
    for members, planes in groups:
        stacks, others = stacker(definition).stacks(planes, members)
        rest += [(n, planes[:, np.searchsorted(members, n)].tobytes()) for n in others.tolist()]
        for stack in stacks:
            for field, values in zip(fields, arrays):
                field.put(stack, values)
    return arrays, rest
