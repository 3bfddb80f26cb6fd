# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Conversion of undecoded columns of many rows to arrays at once, and of decoded values.

A missing value is a zero in the array, and marked in a second array. The arrays of batches and of
tables are joined.
"""

from __future__ import annotations

from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any, Callable, NamedTuple, Optional, Sequence

import numpy as np

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.wire.cql_values import split_list
from cassandra_ros.messages.wire.layout import FieldColumn
from cassandra_ros.query.arrays.array_types import AnyArray, ArrayType
from cassandra_ros.query.tree.field_names import FieldRef

if TYPE_CHECKING:
    from cassandra_ros.query.arrays.array_types import AnyType

Raws = Sequence[Optional[bytes]]
"""One column of many rows, in CQL's encoding; None = missing."""
BIG_ENDIAN = {
    "boolean": ">u1",
    "tinyint": ">i1",
    "smallint": ">i2",
    "int": ">i4",
    "bigint": ">i8",
    "float": ">f4",
    "double": ">f8",
}
"""numpy types of CQL's encodings, by CQL type."""
_FIXED_LISTS = {f"frozen<list<{cql_type}>>": big for cql_type, big in BIG_ENDIAN.items()}
_NO_LIST = b"\0\0\0\1"
"""Number of elements, encoded, that stands for a missing list: it counts as one element."""


class ColumnArray(NamedTuple):
    """An array of values, one value or array per row."""

    values: AnyArray
    missing: AnyArray
    """A bool for each row: its value is missing. If none is, it may be none_missing: read-only."""


Convert = Callable[[Raws], ColumnArray]
"""Function from the columns of many rows to values. A malformed column raises CorruptMessage,
ValueError or struct.error."""


def compile_convert(
    ref: FieldRef, column: FieldColumn, kind: ArrayType, inside: bool
) -> Convert | None:
    """Return the function from the columns of many rows to a field's values.

    None: the values must be decoded one by one. ``inside``: the column is a list over an array that
    is unnested, so that each element becomes a row.
    """
    direct = all(step.index is None for step in ref.steps) and column.name == ref.column
    if not direct or column.kind == "wire" or kind.depth > 1:
        return None
    is_list = column.is_list and not inside
    convert: Convert
    if is_list and ref.index is not None:
        return partial(_list_element, ref.index)
    if column.cql_type in _FIXED_LISTS:
        convert = partial(_elements, column, kind)
    else:
        convert = _one(ref, column, kind)
        if column.is_list:
            convert = partial(_split, convert)
    if is_list:
        convert = partial(_lists, kind, convert)
    return partial(_part, convert, ref.part) if ref.part else convert


def count_elements(raws: Raws) -> AnyArray:
    """Return the number of elements of each list; a missing list counts as one element."""
    return np.frombuffer(b"".join([raw[:4] if raw else _NO_LIST for raw in raws]), ">i4")


@lru_cache(maxsize=64)  # most batches have the same number of rows
def none_missing(count: int) -> AnyArray:
    """Return the marks of ``count`` values that all exist: read-only, and without memory."""
    return np.broadcast_to(np.False_, (count,))


def _absent(raws: Sequence[object]) -> AnyArray:
    """Return a bool for each row: it is None."""
    if None not in raws:
        return none_missing(len(raws))
    return np.fromiter((raw is None for raw in raws), bool, len(raws))


def _one(ref: FieldRef, column: FieldColumn, kind: ArrayType) -> Convert:
    """Return the conversion of columns, or of list elements, that hold one field each."""
    if column.kind == "array" and ref.index is not None:
        # ref.type is the type of secs, but the array holds times.
        base = column.field_type.partition("[")[0] if ref.part else ref.type
        return partial(_element, ref.index, base)
    if column.kind == "array":
        length = kind.length
        return partial(_cells, kind.kind) if length is None else partial(_arrays, kind.kind, length)
    if column.kind == "text":
        return _texts
    if column.field_type == "uint64":
        return _varints
    return partial(_numbers, np.dtype(BIG_ENDIAN[column.cql_type]), kind.dtype)


def _numbers(big: AnyType, dtype: AnyType, raws: Raws) -> ColumnArray:
    return ColumnArray(join_fixed(raws, big).astype(dtype), _absent(raws))


def join_fixed(raws: Raws, dtype: AnyType) -> AnyArray:
    """Join the values of all rows, zeros for a missing one.

    CorruptMessage: a value does not have the size of the type.
    """
    filler = bytes(dtype.itemsize)
    data = b"".join([filler if raw is None else raw for raw in raws])
    if len(data) != len(raws) * dtype.itemsize:
        raise CorruptMessage("a column does not have the size of its type")
    return np.frombuffer(data, dtype)


def _varints(raws: Raws) -> ColumnArray:
    return ColumnArray(as_uint64(raws), _absent(raws))


def as_uint64(raws: Raws) -> AnyArray:
    """Return varints as uint64; 0 for a missing one."""
    data = b"".join([(raw or b"")[-8:].rjust(8, b"\0") for raw in raws])
    return np.frombuffer(data, ">u8").astype(np.uint64)


def _texts(raws: Raws) -> ColumnArray:
    return ColumnArray(decode_texts(raws), _absent(raws))


def decode_texts(raws: Raws) -> AnyArray:
    """Return texts as an array of objects, None for a missing one."""
    # Texts such as frame names repeat: equal texts share one object.
    texts = {raw: None if raw is None else raw.decode("utf-8", "replace") for raw in set(raws)}
    values = np.empty(len(raws), object)
    values[:] = [texts[raw] for raw in raws]
    return values


def numbers_of(kind: str, wire: bytes) -> AnyArray:
    """Return the elements of a primitive array as on the wire."""
    if kind in ("time", "duration"):
        pairs = np.frombuffer(wire, "<u4" if kind == "time" else "<i4").reshape(-1, 2)
        ns: AnyArray = pairs[:, 0].astype(np.int64) * SECOND_NS + pairs[:, 1]
        return ns
    dtype = np.dtype("u1" if kind == "bool" else kind)
    return np.frombuffer(wire, dtype.newbyteorder("<")).astype(kind)


def _size_of(kind: str) -> int:
    """Return the size of a primitive on the wire, bytes."""
    return 8 if kind in ("time", "duration") else np.dtype(kind).itemsize


def _cells(kind: str, raws: Raws) -> ColumnArray:
    """Return arrays of any length, each an object of its own."""
    missing = _absent(raws)
    sizes = {0 if raw is None else len(raw) for raw in raws}
    # Arrays of equal length, as in most scans, are read together.
    if len(sizes) == 1 and 0 not in sizes:
        rows = _arrays(kind, sizes.pop() // _size_of(kind), raws).values
        return ColumnArray(objects_of(list(rows)), missing)
    cells = [None if raw is None else numbers_of(kind, raw) for raw in raws]
    return ColumnArray(objects_of(cells), missing)


def _arrays(kind: str, length: int, raws: Raws) -> ColumnArray:
    """Return arrays of one length as the rows of one array."""
    data = join_fixed(raws, np.dtype(f"V{length * _size_of(kind)}"))
    return ColumnArray(numbers_of(kind, data.tobytes()).reshape(len(raws), length), _absent(raws))


def _element(index: int, kind: str, raws: Raws) -> ColumnArray:
    """Return the element with this index of each array of numbers; missing in a shorter one."""
    size = _size_of(kind)
    low, high = index * size, (index + 1) * size
    cut = [raw[low:high] if raw is not None and len(raw) >= high else None for raw in raws]
    return ColumnArray(
        numbers_of(kind, join_fixed(cut, np.dtype(f"V{size}")).tobytes()), _absent(cut)
    )


def _split(convert: Convert, raws: Raws) -> ColumnArray:
    """Convert all elements of lists, list after list."""
    cut: list[bytes | None] = []
    for raw in raws:
        cut += [None] if raw is None else split_list(raw)
    return convert(cut)


def _elements(column: FieldColumn, kind: ArrayType, raws: Raws) -> ColumnArray:
    """Convert like _split, for elements that all have the same size."""
    value = np.dtype(_FIXED_LISTS[column.cql_type])
    element = np.dtype([("size", ">i4"), ("value", value)])
    filler = value.itemsize.to_bytes(4, "big") + bytes(value.itemsize)
    data = b"".join([filler if raw is None else raw[4:] for raw in raws])
    counts = count_elements(raws)
    if len(data) != int(counts.sum()) * element.itemsize:
        raise CorruptMessage(f"list column {column.name} is malformed")
    numbers = np.frombuffer(data, element)
    if (numbers["size"] != value.itemsize).any():
        raise CorruptMessage(f"list column {column.name} has a malformed element")
    return ColumnArray(numbers["value"].astype(kind.dtype), np.repeat(_absent(raws), counts))


def _lists(kind: ArrayType, elements: Convert, raws: Raws) -> ColumnArray:
    """Return lists as arrays; ``elements`` converts the elements of all lists together."""
    # A missing list counts as one element.
    values, ends = elements(raws).values, np.cumsum(count_elements(raws))
    cells = np.split(values, ends[:-1])
    return _arrays_of([None if raw is None else c for raw, c in zip(raws, cells)], kind)


def _list_element(index: int, raws: Raws) -> ColumnArray:
    """Return the element with this index of each string[]."""
    lists = [[] if raw is None else split_list(raw) for raw in raws]
    return _texts([elements[index] if index < len(elements) else None for elements in lists])


def _part(convert: Convert, time_part: str, raws: Raws) -> ColumnArray:
    """Return the secs or nsecs of times."""
    values, missing = convert(raws)
    return ColumnArray(values // SECOND_NS if time_part == "secs" else values % SECOND_NS, missing)


def objects_of(cells: Sequence[object]) -> AnyArray:
    """Return an array of objects of any type."""
    values = np.empty(len(cells), object)
    for n, cell in enumerate(cells):
        values[n] = cell
    return values


def _arrays_of(cells: Sequence[AnyArray | None], kind: ArrayType) -> ColumnArray:
    """Return one-dimensional arrays as the rows of one array, if their length is fixed."""
    missing = np.fromiter((cell is None for cell in cells), bool, len(cells))
    if kind.length is None:
        return ColumnArray(objects_of(cells), missing)
    values = empty_values(kind, len(cells)).values
    for n, cell in enumerate(cells):
        if cell is not None:
            values[n] = cell
    return ColumnArray(values, missing)


def from_decoded(values: Sequence[Any], kind: ArrayType) -> ColumnArray:
    """Return the arrays of values that were decoded one by one."""
    if kind.depth == 1:
        return _arrays_of([None if value is None else _cell(value, kind) for value in values], kind)
    if kind.depth > 1 or kind.dtype.kind == "O":
        return ColumnArray(objects_of(values), _absent(values))
    filled = np.array([0 if value is None else value for value in values], kind.dtype)
    return ColumnArray(filled, _absent(values))


def _cell(value: Any, kind: ArrayType) -> AnyArray:
    """Return a decoded array; one with a missing element holds objects."""
    if isinstance(value, bytes):
        return np.frombuffer(value, np.uint8).copy()
    if kind.dtype.kind == "O" or None in value:
        return objects_of(value)
    return np.array(value, kind.dtype)


def empty_values(kind: ArrayType, count: int) -> ColumnArray:
    """Return ``count`` values that are all missing, in arrays that the caller may fill."""
    dtype = np.dtype(object) if kind.cells else kind.dtype
    shape = (count, kind.length) if kind.depth == 1 and kind.length is not None else (count,)
    values = np.full(shape, None, object) if dtype.kind == "O" else np.zeros(shape, dtype)
    return ColumnArray(values, np.ones(count, bool))


def join_values(arrays: Sequence[ColumnArray], kind: ArrayType) -> ColumnArray:
    """Concatenate values of one type."""
    if not arrays:
        return empty_values(kind, 0)
    values = np.concatenate([array.values for array in arrays])
    if not any(array.missing.any() for array in arrays):
        return ColumnArray(values, none_missing(len(values)))
    return ColumnArray(values, np.concatenate([array.missing for array in arrays]))


def cast_values(array: ColumnArray, table_kind: ArrayType, kind: ArrayType) -> ColumnArray:
    """Convert the values of one table from their own type to the type common to all tables."""
    values, missing = array
    if table_kind == kind or table_kind.depth > 1:
        return array
    if kind.depth == 1 and not kind.cells or table_kind.depth == kind.depth == 0:
        values = values.astype(kind.dtype)
        if values.dtype.kind == "O":
            values[missing] = None
        return ColumnArray(values, missing)
    if table_kind.depth == 0:  # other tables have arrays
        return ColumnArray(rows_of(values.astype(object), missing), missing)
    cells = rows_of(values, missing)
    dtype = table_kind.dtype if kind.depth == 0 else kind.dtype
    return ColumnArray(objects_of([c if c is None else c.astype(dtype) for c in cells]), missing)


def rows_of(values: AnyArray, missing: AnyArray) -> AnyArray:
    """Return the rows of an array as an array of objects, None for a missing row."""
    rows = objects_of(list(values))
    rows[missing] = None
    return rows


def stack_cells(cells: AnyArray, kind: ArrayType) -> AnyArray:
    """Return arrays of equal length as the rows of one array.

    Arrays of several lengths unchanged.
    """
    lengths = set(map(len, cells))
    if len(lengths) != 1:
        return cells
    rows = np.concatenate(cells.tolist()).reshape(len(cells), lengths.pop())
    # An array with a missing element has another type.
    return rows if rows.dtype == kind.dtype else cells
