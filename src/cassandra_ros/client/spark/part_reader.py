# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What runs in the executors: the messages of a partition, read from the store by toArrow.

The driver decides the address and login of the store, and sends them (``StoreLogin``).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Iterable, Iterator, Mapping, Sequence

from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.client.spark.part_plan import RobotTimeRange, SparkPartition
from cassandra_ros.errors import InvalidOption, StoreUnavailable
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.query.arrays.arrow_types import load_arrow
from cassandra_ros.store.connection.address import DEFAULT_KEYSPACE, from_environment
from cassandra_ros.store.connection.login import read_login
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


_OF_LOGIN = ("username", "password", "cqlshrc", "credentials")
"""Options that the driver reads; the executors get what they say."""
_OF_ANSWERS = ("consistency", "answer_sec")
"""Options that the executors get as they are."""


@dataclass(frozen=True)
class StoreLogin:
    """What an executor needs to open the store. Its text shows no password."""

    hosts: tuple[str, ...]
    port: int
    keyspace: str
    username: str | None = None
    password: str | None = field(default=None, repr=False)
    cqlshrc: str | None = None
    """File with the settings of TLS, which each executor reads on its machine; None = no TLS."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options of class Cassandra for answers."""

    @classmethod
    def read(
        cls, host: str | None, port: int | None, keyspace: str | None, options: Mapping[str, Any]
    ) -> StoreLogin:
        """Decide where to connect and as whom, as RosCassandra does.

        Raises:
            InvalidOption: An option is not one of those, or a file cannot be read.
        """
        unknown = sorted(set(options) - {*_OF_LOGIN, *_OF_ANSWERS})
        if unknown:
            reason = "name the certificates in a cqlshrc" if "ssl_context" in unknown else ""
            choices = f"give one of {', '.join((*_OF_LOGIN, *_OF_ANSWERS))}"
            raise InvalidOption(f"{unknown[0]}= cannot be sent to executors: {reason or choices}")
        login = read_login(
            host, port, **{name: options[name] for name in _OF_LOGIN if name in options}
        )
        return cls(
            tuple(login.hosts),
            login.port,
            keyspace or from_environment("KEYSPACE") or DEFAULT_KEYSPACE,
            login.username,
            login.password,
            login.files[0] if login.tls else None,
            {name: options[name] for name in _OF_ANSWERS if name in options},
        )

    def open(self) -> RosCassandra:
        """Connect to the store. Close what it returns."""
        return RosCassandra(
            ",".join(self.hosts),
            self.port,
            keyspace=self.keyspace,
            username=self.username,
            password=self.password,
            cqlshrc=self.cqlshrc,
            **self.options,
        )
