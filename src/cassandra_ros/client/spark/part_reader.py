# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What runs in the executors: the messages of a partition, read from the store by toArrow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Iterable, Iterator, Sequence

from cassandra_ros.client.spark.part_plan import RobotTimeRange, SparkPartition
from cassandra_ros.client.spark.store_login import StoreLogin
from cassandra_ros.errors import StoreUnavailable
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.query.arrays.arrow_types import load_arrow
from cassandra_ros.topics.cassandra_topic import CassandraTopic
from cassandra_ros.topics.row_finder import Where
from cassandra_ros.topics.run_finder import RunName

if TYPE_CHECKING:
    import pyarrow


_EVERYTHING = RobotTimeRange()
_SIGNED = {"uint8": "int16", "uint16": "int32", "uint32": "int64"}
"""Type of Spark, which has no unsigned ones, for a type of Arrow."""
_UINT64_DIGITS = 20
"""Number of digits of the largest uint64."""


@dataclass(frozen=True)
class FrameSelection:
    """The messages and columns of a topic that all partitions read."""

    topic: str
    fields: Sequence[str] | None
    where: Where | None
    run: RunName

    def reader(self, topic: CassandraTopic, piece: RobotTimeRange = _EVERYTHING) -> Any:
        """Return a pyarrow.RecordBatchReader of the messages of a robot and time range."""
        # As Stamps, because a small integer is refused as one that may mean seconds.
        low, high = (None if t is None else Stamp.from_ns(t) for t in (piece.low, piece.high))
        return topic.toArrow(self.fields, low, high, self.where, piece.node, self.run)


class PartReader:
    """Reads parts of a topic, by their numbers. Spark pickles it, and sends it to the executors.

    Args:
        store: Address and login of the store.
        selection: What is read of the topic.
        parts: The parts.
        schema: Schema of toArrow when the parts were planned.
    """

    def __init__(
        self,
        store: StoreLogin,
        selection: FrameSelection,
        parts: Sequence[SparkPartition],
        schema: pyarrow.Schema,
    ) -> None:
        self._store = store
        self._selection = selection
        self._parts = parts
        self._schema = schema

    def __call__(self, numbers: Iterable[pyarrow.RecordBatch]) -> Iterator[pyarrow.RecordBatch]:
        """Yield the messages of the parts whose numbers are in the first column of the batches.

        Each task of an executor calls it once, and so has a connection of its own.

        Raises:
            StoreUnavailable: The topic has other columns than when the parts were planned.
        """
        schema = spark_schema(self._schema)
        with self._store.open() as ros_cas:
            topic = ros_cas.getTopic(self._selection.topic)
            for batch in numbers:
                for number in batch.column(0).to_pylist():
                    for piece in self._parts[number]:
                        for messages in self._read(topic, piece):
                            yield spark_batch(messages, schema)

    def _read(self, topic: CassandraTopic, piece: RobotTimeRange) -> Iterator[pyarrow.RecordBatch]:
        reader = self._selection.reader(topic, piece)
        if reader.schema != self._schema:
            raise StoreUnavailable(
                f"topic {topic.name} has got another message type since the DataFrame was made: "
                "make it anew"
            )
        yield from reader


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
