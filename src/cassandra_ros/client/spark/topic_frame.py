# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A topic as a DataFrame of Spark."""

from __future__ import annotations

import sys
from typing import Any, Iterable

from cassandra_ros.arguments import check_integer, check_list, check_node
from cassandra_ros.client.spark.part_plan import MAX_PART_BYTES, plan_parts
from cassandra_ros.client.spark.part_reader import (
    FrameSelection,
    PartReader,
    StoreLogin,
    spark_schema,
)
from cassandra_ros.errors import InvalidName, MissingDependency
from cassandra_ros.installation import optional_module
from cassandra_ros.messages.stamps import Time
from cassandra_ros.topics.row_finder import Where
from cassandra_ros.topics.run_finder import RunName

Session = Any
DataFrame = Any
_MOST_BYTES = 2**40
"""Maximum of part_bytes."""
_TOO_NEW = (3, 12)
"""Oldest Python that PySpark 3.5 does not run in."""


def topic(
    spark: Session,
    name: str,
    start: Time | None = None,
    end: Time | None = None,
    nodes: str | Iterable[str] | None = None,
    *,
    fields: str | Iterable[str] | None = None,
    where: Where | None = None,
    run: RunName = None,
    host: str | None = None,
    port: int | None = None,
    keyspace: str | None = None,
    part_bytes: int = MAX_PART_BYTES,
    **login: Any,
) -> DataFrame:
    """Return the messages of a topic as a DataFrame of Spark, which its executors read.

    The columns are those of toArrow and sql: KEY, NODE, RUN, and one for each field. Spark's
    timestamps hold only microseconds, so times are bigint, ns since 1970, UTC, as durations are
    bigint, ns. Spark has no unsigned integers: uint8, uint16 and uint32 have the next larger type,
    and uint64 is decimal(20, 0).

    Only the arguments bound what is read of the store; conditions and columns that the DataFrame
    is asked for later do not. The partitions are planned now: a bucket that begins later is not
    read. Rows of a partition are in the order of toArrow.

    Args:
        spark: A SparkSession, of Spark 3.5.
        name: Name of the topic, with or without the leading slash.
        start: First time, included; None = open. In topics with names there are no times.
        end: Last time, included; None = open.
        nodes: nodeID or nodeIDs whose messages are read; None = all.
        fields: As in toArrow: names of columns, or of fields in them; None = all.
        where: Condition that the messages satisfy, in CQL, as in getData.
        run: Run whose messages are read, by name or writer id; None = all.
        host, port, keyspace: As in RosCassandra, but the keyspace is 'ros' if none is named. The
            executors connect to the same addresses, which must not be 127.0.0.1 on a cluster.
        part_bytes: Maximum size of the serialised messages of a partition that has more than one
            bucket, bytes. Partitions are smaller if Spark could not run enough of them at once.
        login: ``username password cqlshrc credentials consistency answer_sec``, as in class
            Cassandra. The executors get user name and password from the driver; with TLS each reads
            the cqlshrc and the certificates on its machine.

    Raises:
        TopicNotFound: There is no such topic; the text has similar names.
        InvalidName: There is no such field, or a nodeID is not valid.
        InvalidKey, InvalidQuery, RunNotFound: As in toArrow.
        InvalidOption: An option is not valid, or cannot be given to executors.
        MissingDependency: PySpark is not installed; the text says how to install it.
    """
    if sys.version_info >= _TOO_NEW:
        raise MissingDependency(
            "cassandra_ros.client.spark needs PySpark 3.5, which needs Python 3.8 to 3.11; with "
            f"this Python ({sys.executable}) use sql, toArrow or 'cassandra_bag export --parquet'"
        )
    optional_module("pyspark", "cassandra_ros.client.spark")
    frames = optional_module("pyspark.sql.pandas.types", "cassandra_ros.client.spark")
    check_integer("part_bytes", part_bytes, 1, _MOST_BYTES)
    store = StoreLogin.read(host, port, keyspace, login)
    names = None if fields is None else check_list("fields", fields, "['linear.x']")
    selection = FrameSelection(name, names, where, run)
    with store.open() as ros_cas:
        stored = ros_cas.getTopic(name)
        reader = selection.reader(stored)
        if not reader.schema.names:
            raise InvalidName(f"fields={names} names no column of topic {name}")
        parts = plan_parts(
            ros_cas.catalog.keyspace,
            stored.tables,
            (start, end),
            ros_cas.catalog.whose(None, run)._replace(nodes=_robots(nodes)),
            part_bytes,
            spark.sparkContext.defaultParallelism,
        )
    numbers = spark.range(0, len(parts), 1, max(1, len(parts)))
    read = PartReader(store, selection, parts, reader.schema)
    return numbers.mapInArrow(read, frames.from_arrow_schema(spark_schema(reader.schema)))


def _robots(nodes: str | Iterable[str] | None) -> tuple[str, ...] | None:
    if nodes is None:
        return None
    return tuple(dict.fromkeys(map(check_node, check_list("nodes", nodes, "['robot_1']"))))
