# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Field values read directly from serialised messages, for all messages of a layout at once.

This works for single values and arrays of numbers that are not inside an array of messages. The
caller cuts the fields out of messages that share no layout with others, one by one.
"""

from __future__ import annotations

from typing import Any, Callable, Iterable, NamedTuple, Sequence, Tuple

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.wire.layout import FieldColumn
from cassandra_ros.messages.wire.message_stacks import (
    ByteArray,
    Int64Array,
    Planes,
    Stack,
    by_size,
    copy_planes,
    stacker,
)
from cassandra_ros.query.arrays.array_types import AnyArray, ArrayType
from cassandra_ros.query.arrays.column_values import ColumnArray, empty_values
from cassandra_ros.query.protocols import Table
from cassandra_ros.query.rows.projection import Projection
from cassandra_ros.query.tree.field_names import FieldRef

_NUMBERS = ("int", "float", "bool", "time", "duration")

SizeGroups = Iterable[Tuple[Int64Array, Planes]]
"""Pairs of message indices, ascending, and message planes; one pair for each message size."""
RestMessages = Sequence[Tuple[int, bytes]]
"""Index and bytes of the messages that share no layout with others."""


class MessageBlock(NamedTuple):
    """Messages of one writer in one table, in time order."""

    table: Table
    node: str
    run: Callable[[], str]
    """Returns the value of RUN for these messages."""
    times: Int64Array
    """Row keys of the messages, ns."""
    seqs: Int64Array
    groups: Sequence[tuple[Int64Array, Planes]]
    """The messages by size, see SizeGroups; a message in no group is unreadable."""
    unsure: NDArray[np.bool_] | None = None
    """For each message whether the condition of the read has to be checked again, because the store
    is not sure; None = all have to be."""

    def only(self, mask: NDArray[np.bool_]) -> MessageBlock:
        """Return the block of some of its messages: a bool for each."""
        groups = choose_groups(self.groups, mask)
        times, seqs = self.times[mask], self.seqs[mask]
        return self._replace(times=times, seqs=seqs, groups=groups, unsure=None)


def passing(block: MessageBlock, projection: Projection) -> MessageBlock:
    """Return the block of those messages that satisfy the condition of a projection."""
    unsure = np.ones(len(block.times), bool) if block.unsure is None else block.unsure
    if not unsure.any():
        return block
    wires: dict[int, bytes] = {}
    for members, planes in choose_groups(block.groups if projection.extractor else (), unsure):
        size, data = len(planes), planes.T.tobytes()
        wires.update((n, data[k * size : (k + 1) * size]) for k, n in enumerate(members.tolist()))
    run, times = block.run() if projection.runs else "", block.times[unsure].tolist()
    mask = ~unsure
    mask[unsure] = [
        projection.passes((t, block.node, run, t), wires.get(n)) for n, t in enumerate(times)
    ]
    return block.only(mask)


def choose_groups(
    groups: Iterable[tuple[Int64Array, Planes]], mask: NDArray[np.bool_]
) -> Sequence[tuple[Int64Array, Planes]]:
    """Return the groups of some of their messages, numbered anew; ``mask``: a bool for each."""
    if mask.all():
        return list(groups)
    numbers = np.cumsum(mask) - 1
    chosen: list[tuple[Int64Array, Planes]] = []
    for members, planes in groups:
        inside = mask[members]
        if inside.any():
            chosen.append((numbers[members[inside]], planes[:, inside]))
    return chosen


def join_blocks(blocks: Sequence[MessageBlock], apart: int | None = None) -> SizeGroups:
    """Join the groups of blocks: if sizes vary, each block has only few messages of a size.

    Args:
        blocks: The blocks.
        apart: Number of messages from which a group is not joined, because all of its bytes would
            be decoded and copied; None = all are joined.
    """
    groups: dict[int, list[tuple[Int64Array, Planes]]] = {}
    first = 0
    for block in blocks:
        for members, planes in block.groups:
            if apart is not None and len(members) >= apart:
                yield members + first, planes
            else:
                groups.setdefault(len(planes), []).append((members + first, planes))
        first += len(block.times)
    for pairs in groups.values():
        if len(pairs) == 1:
            yield pairs[0]
        else:
            indices = np.concatenate([members for members, _ in pairs])
            yield indices, _join([planes for _, planes in pairs], len(indices))


def _join(groups: Sequence[Planes], count: int) -> ByteArray:
    """Return the planes of ``count`` messages of one size, from several groups."""
    arrays = [planes for planes in groups if isinstance(planes, np.ndarray)]
    if len(arrays) == len(groups):
        return np.concatenate(arrays, axis=1)  # messages that are adjacent in memory stay so
    all_planes = np.empty((len(groups[0]), count), np.uint8)
    at = 0
    for planes in groups:
        after = at + planes.shape[1]
        copy_planes(planes, all_planes[:, at:after])
        at = after
    return all_planes


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
    cut = [characters[n * size : (n + 1) * size] for n in range(count)]
    # Texts such as frame names repeat: equal texts share one object.
    texts = {raw: raw.decode("utf-8", "replace") for raw in set(cut)}
    values: Any = np.empty(count, object)
    values[:] = [texts[raw] for raw in cut]
    return values  # type: ignore[no-any-return]


def group_by_size(wires: Sequence[bytes | None]) -> SizeGroups:
    """Group messages by size; None stands for a missing message."""
    indices = np.array([n for n, wire in enumerate(wires) if wire is not None], np.int64)
    for members, planes in by_size([wire for wire in wires if wire is not None]):
        yield indices[members], planes


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
