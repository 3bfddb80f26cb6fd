# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The rows of a statement as a Parquet file, written while they are read."""

from __future__ import annotations

from typing import Any, BinaryIO, Iterable, Iterator, Sequence, Tuple

from cassandra_ros.arrays.array_types import ArrayType
from cassandra_ros.arrays.optional import optionalModule
from cassandra_ros.errors import InvalidOption
from cassandra_ros.query.json_values import toJson

GROUP_ROWS = 20_000
GROUP_BYTES = 32 * 1024 * 1024
"""A row group holds as many rows, or about as many bytes."""

_NAMES = {"bool": "bool_", "string": "string", "mixed": "string"}
"""Those of pyarrow's functions that are not called like the ROS type."""
_MAX_INT64 = 2**63 - 1


def load_parquet() -> tuple[Any, Any]:
    """Import pyarrow and pyarrow.parquet.

    Raises:
        MissingDependency: pyarrow is not installed.
    """
    purpose = "--output parquet"
    return optionalModule("pyarrow", purpose), optionalModule("pyarrow.parquet", purpose)


def write_parquet(
    columns: Sequence[Tuple[str, ArrayType]], rows: Iterable[Tuple[Any, ...]], stream: BinaryIO
) -> None:
    """Write rows in row groups.

    Numbers keep their types, times are timestamps in UTC and durations durations, both in ns;
    uint8[] is binary, other arrays are lists. Columns whose type differs among the definitions of
    a topic hold JSON.

    Args:
        columns: Name and type of each.
        rows: Of a statement.
        stream: Where to.

    Raises:
        MissingDependency: pyarrow is not installed.
        InvalidOption: A value is not of its column's type.
    """
    arrow, parquet = load_parquet()
    groups = _groups(rows)
    first = next(groups, [])
    kinds = [_narrowed(kind, [row[n] for row in first]) for n, (_, kind) in enumerate(columns)]
    schema = arrow.schema(
        [(name, _arrowType(arrow, kind)) for (name, _), kind in zip(columns, kinds)]
    )
    with parquet.ParquetWriter(stream, schema) as writer:
        group = first
        while group:
            arrays = [
                _array(arrow, field, kind, values)
                for field, kind, values in zip(schema, kinds, zip(*group))
            ]
            writer.write_table(arrow.Table.from_arrays(arrays, schema=schema))
            group = next(groups, [])


def _groups(rows: Iterable[Tuple[Any, ...]]) -> Iterator[list[Tuple[Any, ...]]]:
    group: list[Tuple[Any, ...]] = []
    size = 0
    for row in rows:
        group.append(row)
        size += sum(len(value) for value in row if isinstance(value, (str, bytes, list)))
        if len(group) >= GROUP_ROWS or size >= GROUP_BYTES:
            yield group
            group, size = [], 0
    if group:
        yield group


def _narrowed(kind: ArrayType, values: Sequence[Any]) -> ArrayType:
    """Let a sum of integers, of which there is one, be an int64 where it fits."""
    if kind.kind == "sum" and all(v is None or abs(v) <= _MAX_INT64 for v in values):
        return ArrayType("int64")
    return kind


def _arrowType(arrow: Any, kind: ArrayType) -> Any:
    depth = kind.depth
    if kind.kind == "uint8" and depth:
        found, depth = arrow.binary(), depth - 1
    elif kind.kind == "time":
        found = arrow.timestamp("ns", tz="UTC")
    elif kind.kind == "duration":
        found = arrow.duration("ns")
    elif kind.kind == "sum":
        found = arrow.decimal128(38, 0)
    else:
        found = getattr(arrow, _NAMES.get(kind.kind, kind.kind))()
    for _ in range(depth):
        found = arrow.list_(found)
    return found


def _array(arrow: Any, field: Any, kind: ArrayType, values: Sequence[Any]) -> Any:
    if kind.kind == "mixed":
        found = [None if value is None else toJson(value) for value in values]
    else:
        found = [_plain(value) for value in values]
    try:
        return arrow.array(found, field.type)
    except (arrow.ArrowException, OverflowError) as exc:
        raise InvalidOption(
            f"column {field.name} cannot be written as Parquet's {field.type}: {exc}"
        ) from exc


def _plain(value: Any) -> Any:
    if isinstance(value, list):
        return [_plain(element) for element in value]
    return int(value.to_nsec()) if hasattr(value, "to_nsec") else value
