# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The Arrow types that Spark reads: signed integers, and times as numbers.

Spark 3.5 has no unsigned integers, and its timestamps hold only microseconds: times are int64 ns.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cassandra_ros.query.arrays.arrow_types import load_arrow

if TYPE_CHECKING:
    import pyarrow

_SIGNED = {"uint8": "int16", "uint16": "int32", "uint32": "int64"}
_UINT64_DIGITS = 20


def spark_schema(schema: pyarrow.Schema) -> pyarrow.Schema:
    """Return the schema of the batches that Spark gets for one of toArrow."""
    arrow = load_arrow("cassandra_ros.client.spark")
    return arrow.schema([(field.name, _spark_type(arrow, field.type)) for field in schema])


def _spark_type(arrow: Any, kind: pyarrow.DataType) -> pyarrow.DataType:
    types = arrow.types
    if types.is_struct(kind):
        return arrow.struct([(field.name, _spark_type(arrow, field.type)) for field in kind])
    if types.is_list(kind):
        return arrow.list_(_spark_type(arrow, kind.value_type))
    if types.is_timestamp(kind):
        return arrow.int64()
    if types.is_uint64(kind):
        return arrow.decimal128(_UINT64_DIGITS, 0)
    return getattr(arrow, _SIGNED[str(kind)])() if str(kind) in _SIGNED else kind


def spark_batch(batch: pyarrow.RecordBatch, schema: pyarrow.Schema) -> pyarrow.RecordBatch:
    """Return a batch of toArrow with the types of spark_schema; values stay as they are."""
    arrow = load_arrow("cassandra_ros.client.spark")
    columns = [column.cast(field.type) for column, field in zip(batch.columns, schema)]
    return arrow.RecordBatch.from_arrays(columns, schema=schema)
