# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Mean, maximum and 99th percentile of a field by robot and hour, over all topics of one type.

Spark reads the topics: each of its executors reads some buckets from the store by itself. Run it
with python for a Spark on this machine, or with spark-submit, see doc/spark.md:

    python examples/spark_fleet.py sensor_msgs/Imu linear_acceleration.z
    spark-submit --master spark://head:7077 examples/spark_fleet.py sensor_msgs/Imu \
        linear_acceleration.z --host cassandra1,cassandra2
"""

from __future__ import annotations

import argparse
import sys
from functools import reduce
from typing import Any

from pyspark.sql import SparkSession
from pyspark.sql import functions as sql

from cassandra_ros import CassandraRosError, RosCassandra
from cassandra_ros.client.spark import topic

ACCURACY = 10_000
"""The rank of a percentile is wrong by at most this part of the messages of an hour."""


def measured(spark: SparkSession, args: argparse.Namespace) -> Any:
    """Return robot, hour (UTC) and value of each message in the topics of the type."""
    login = {"host": args.host, "port": args.port, "keyspace": args.keyspace}
    with RosCassandra(**login) as rosCas:
        every = [(t.name, t.getMeta) for t in rosCas.getAllTopics()]
    names = [name for name, meta in every if meta["msg_type"] == args.msg_type]
    if not names:
        raise SystemExit(f"no topic of type {args.msg_type} is stored")
    bounds = {"start": args.start, "end": args.end, "nodes": args.nodes, "where": args.where}
    fields = ["KEY", "NODE", args.field]
    frames = [topic(spark, name, fields=fields, **bounds, **login) for name in names]
    time = sql.timestamp_micros(sql.expr("KEY DIV 1000"))
    return reduce(lambda one, two: one.unionByName(two, True), frames).select(
        sql.col("NODE").alias("robot"),
        sql.date_trunc("hour", time).alias("hour"),
        sql.col(args.field).cast("double").alias("value"),
    )


def summary(values: Any) -> Any:
    """Return a DataFrame with one row for each robot and hour, in this order."""
    return (
        values.groupBy("robot", "hour")
        .agg(
            sql.count("value").alias("messages"),
            sql.avg("value").alias("mean"),
            sql.max("value").alias("highest"),
            sql.percentile_approx("value", 0.99, ACCURACY).alias("p99"),
        )
        .orderBy("robot", "hour")
    )


def main() -> int:
    """Parse the command line, ask, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("msg_type", metavar="TYPE", help="type of the topics: sensor_msgs/Imu")
    parser.add_argument("field", metavar="FIELD", help="a number in it: linear_acceleration.z")
    parser.add_argument("--start", metavar="TIME", help="first time (default: the first message)")
    parser.add_argument("--end", metavar="TIME", help="last time (default: the last message)")
    parser.add_argument("--nodes", nargs="+", metavar="ROBOT", help="nodeIDs (default: all)")
    parser.add_argument("--where", metavar="CONDITION", help="condition for the messages, in CQL")
    parser.add_argument("--master", help="of Spark (default: as spark-submit says, else local[*])")
    parser.add_argument("--host", help="addresses of the store (default: as RosCassandra)")
    parser.add_argument("--port", type=int, help="its port")
    parser.add_argument("--keyspace", default="ros", help="(default: %(default)s)")
    args = parser.parse_args()
    builder = SparkSession.builder.appName("cassandra_ros fleet")
    if args.master:
        builder = builder.master(args.master)
    builder = builder.config("spark.ui.showConsoleProgress", "false")
    spark = builder.config("spark.sql.session.timeZone", "UTC").getOrCreate()
    try:
        print("robot hour messages mean max p99")
        for row in summary(measured(spark, args)).toLocalIterator():
            numbers = " ".join(f"{value:.6g}" for value in (row["mean"], row.highest, row.p99))
            print(f"{row.robot or '-'} {row.hour:%Y-%m-%dT%H} {row.messages} {numbers}")
    except CassandraRosError as exc:
        print(f"error: {exc}", file=sys.stderr)
        return 1
    finally:
        spark.stop()
    return 0


if __name__ == "__main__":
    sys.exit(main())
