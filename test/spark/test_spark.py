# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Spark itself gets what toArrow gives; only make campaign installs it (317 MB)."""

from __future__ import annotations

import logging
import struct
import subprocess
import sys

import numpy as np
import pytest
from conftest import ROOT
from geometry_msgs.msg import Vector3
from messages.random_wire import DefinitionMaker
from messages.test_message_stacks import manyWires
from pages.walk import pieces
from sensor_msgs.msg import Imu
from spark.test_parts import T0, TYPES, expected, store, typed

from cassandra_ros.client.spark import topic
from cassandra_ros.client.sql.lake import Lake
from cassandra_ros.errors import InvalidName, InvalidQuery, TopicNotFound
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.definition import definition_of, parse_definition

pytestmark = pytest.mark.suite("campaign", "only make campaign installs Spark")


PHRASE = "1-2-3-4-5"


def place(ros_cas):
    cassandra = ros_cas.cassandra
    return {"host": cassandra.hosts[0], "port": cassandra.port, "keyspace": ros_cas.keyspace}


def plain(value):
    """A value of Spark as pyarrow has it."""
    if hasattr(value, "asDict"):
        return {name: plain(inner) for name, inner in value.asDict().items()}
    if isinstance(value, list):
        return [plain(each) for each in value]
    return bytes(value) if isinstance(value, bytearray) else value


def same_rows(frame, table):
    assert frame.columns == table.column_names
    found = sorted(repr(plain(row)) for row in frame.collect())
    assert found == sorted(map(repr, table.to_pylist()))


@pytest.mark.parametrize("fmt", ["packed", "ros", "string"])
@pytest.mark.parametrize("seed", range(4))
def test_random_types(spark, fresh, seed, fmt):
    definition = parse_definition(*DefinitionMaker(seed).make())
    wires = manyWires(definition, seed)[:60]
    with fresh() as ros_cas:
        store(ros_cas, "/a", definition, wires, fmt)
        store(ros_cas, "/a", definition, wires[:9], fmt, "", 2)
        frame = topic(spark, "a", **place(ros_cas), part_bytes=3000)
        same_rows(frame, expected(ros_cas, "/a"))


@pytest.fixture(scope="module")
def numbers(fresh):
    with fresh() as ros_cas:
        definition = parse_definition("t/Numbers", TYPES, None)
        for node, writer_id in (("r1", 1), ("r2", 2), ("", 3)):
            wires = [typed(n) for n in range(50)]
            store(ros_cas, "/numbers", definition, wires, "packed", node, writer_id)
        other = parse_definition("t/Other", "float64 x\nstring said\n", None)
        wires = [struct.pack("<dI2s", n, 2, b"hi") for n in range(7)]
        store(ros_cas, "/numbers", other, wires, "binary", "r2", 4)
        yield ros_cas


def test_two_types_of_a_topic(spark, numbers):
    frame = topic(spark, "/numbers", **place(numbers), part_bytes=1)
    assert frame.rdd.getNumPartitions() > 30
    assert frame.schema["d"].dataType.simpleString() == "decimal(20,0)"
    assert frame.schema["KEY"].dataType.simpleString() == "bigint"
    same_rows(frame, expected(numbers, "/numbers"))


@pytest.mark.parametrize(
    ("bounds", "mine"),
    [
        ({}, "true"),
        ({"nodes": "r1"}, "NODE = 'r1'"),
        ({"nodes": ["r2", ""]}, "NODE IN ('r2', '')"),
        ({"start": T0 + 1, "end": T0 + 9**10}, f"KEY BETWEEN {T0 + 1} AND {T0 + 9**10}"),
        ({"run": 2}, "RUN = '2'"),
        ({"where": "x > 3 AND x < 9", "nodes": "r1"}, "x > 3 AND x < 9 AND NODE = 'r1'"),
        ({"end": T0 - 1}, "false"),
    ],
)
def test_what_is_pushed_is_what_spark_would_filter(spark, numbers, bounds, mine):
    fields = ["KEY", "NODE", "RUN", "x", "s.v"]
    pushed = topic(spark, "/numbers", fields=fields, **bounds, **place(numbers))
    filtered = topic(spark, "/numbers", **place(numbers)).where(mine)
    columns = ["KEY", "NODE", "RUN", "x", "s.v"]
    found = [sorted(map(repr, frame.select(columns).collect())) for frame in (pushed, filtered)]
    assert found[0] == found[1]
    assert pushed.columns == [*fields[:4], "s"]


def test_a_lake_is_read_as_the_page_says(spark, numbers, tmp_path):
    """Times in ns need an option of Spark 3.5, and are integers then."""
    Lake(numbers.catalog, tmp_path / "lake").write()
    [name] = {topic_.name for topic_ in numbers.getAllTopics()}
    folder = tmp_path / "lake" / name.lstrip("/")
    option = "spark.sql.legacy.parquet.nanosAsLong"
    with pytest.raises(Exception, match=r"Illegal Parquet type.*NANOS"):
        spark.read.parquet(str(folder)).collect()
    spark.conf.set(option, "true")
    try:
        frame = spark.read.parquet(str(folder))
        found = sorted((row["robot"], row["KEY"]) for row in frame.collect())
    finally:
        spark.conf.unset(option)
    rows = numbers.getTopic(name).rows()
    assert found == sorted((row.node or "-", row.t) for row in rows)


def test_no_message(spark, rosCas):
    rosCas.addTopic("/bare", "ros", msg_type="std_msgs/String")
    frame = topic(spark, "/bare", **place(rosCas))
    assert frame.columns == ["KEY", "NODE", "RUN", "data"]
    assert frame.count() == 0


@pytest.mark.parametrize(
    ("options", "error", "text"),
    [
        ({"name": "/number"}, TopicNotFound, "did you mean /numbers"),
        ({"fields": ["y.z"]}, InvalidName, "no column"),
        ({"fields": []}, InvalidName, "no column"),
        ({"nodes": 7}, InvalidName, "nodes=7"),
        ({"where": "x >"}, InvalidQuery, r"x >"),
    ],
)
def test_what_cannot_be_read(spark, numbers, options, error, text):
    options = {"name": "/numbers", **options}
    with pytest.raises(error, match=text):
        topic(spark, **options, **place(numbers))


def test_an_error_of_an_executor_says_what_failed_and_no_password(spark, numbers, caplog, capfd):
    login = {"username": "ann", "password": PHRASE}  # the server asks for no login
    frame = topic(spark, "/numbers", fields=["KEY", "x"], **place(numbers), **login)
    assert frame.count() == 157
    frame = topic(spark, "/numbers", **{**place(numbers), **login})
    frame.explain()
    definition = parse_definition("t/Third", "int8 y\n", None)
    store(numbers, "/numbers", definition, [b"\1"], "binary", "r1", 5)
    with pytest.raises(Exception, match="make it anew") as caught, caplog.at_level(logging.DEBUG):
        frame.count()
    shown = "".join(capfd.readouterr())
    assert PHRASE not in str(caught.value) + caplog.text + shown


IMUS = [
    ("/imu/data", "alpha", "packed"),
    ("/imu/data", "beta", "packed"),
    ("/imu/raw", "beta", "ros"),
]


def imu_topics(ros_cas):
    """Store the z of two topics and robots over three hours; return it by robot and hour."""
    rng, found = np.random.default_rng(1), {}
    for number, (name, node, fmt) in enumerate(IMUS):
        values = rng.normal(9.8, 2, 600)
        wires = [serialize(Imu(linear_acceleration=Vector3(0, 0, z))) for z in values]
        store(ros_cas, name, definition_of(Imu), wires, fmt, node, number + 1, step=18 * SECOND_NS)
        for n, z in enumerate(values):
            hour = np.datetime64(T0 + n * 18 * SECOND_NS, "ns").astype("M8[h]")
            found.setdefault((node, str(hour)), []).append(z)
    return found


def test_the_connector_reads_a_table_as_the_page_says(rosCas, spark_env, tmp_path):
    """It comes from Maven Central."""
    wires = [serialize(Imu(linear_acceleration=Vector3(0, 0, 13 + n))) for n in range(6)]
    store(rosCas, "/imu/data", definition_of(Imu), wires, "ros", "alpha")
    page = (ROOT / "doc/spark.md").read_text(encoding="utf-8").split("## The tables of format")[1]
    [listing] = [block for kind, block in pieces(page) if kind == "python"]
    cassandra = rosCas.cassandra
    mine = {
        "'ros'": repr(rosCas.keyspace),
        "'127.0.0.1'": repr(cassandra.hosts[0]),
        "'9042'": repr(str(cassandra.port)),
    }
    for theirs, ours in mine.items():
        assert theirs in listing
        listing = listing.replace(theirs, ours)
    program = tmp_path / "listing.py"
    program.write_text(listing, encoding="utf-8")
    address = {"HOST": cassandra.hosts[0], "PORT": str(cassandra.port)}
    env = {**spark_env, **{f"CASSANDRA_ROS_{name}": text for name, text in address.items()}}
    done = subprocess.run(
        [sys.executable, str(program)], env=env, capture_output=True, text=True, timeout=500
    )
    assert done.returncode == 0, done.stderr
    rows = [line.strip("|").split("|") for line in done.stdout.splitlines() if line[:1] == "|"]
    found = [[cell.strip() for cell in row] for row in rows]
    assert found[0] == ["KEY", "NODE", "z"]
    times = [T0 + n * SECOND_NS // 4 for n in range(6)]
    assert found[1:] == [[str(times[n]), "alpha", str(13.0 + n)] for n in (3, 4, 5)]


@pytest.mark.parametrize("master", ["local[2]", "local-cluster[2,1,1024]"])
def test_the_example(rosCas, spark_env, master):
    by_hour = imu_topics(rosCas)
    login = place(rosCas)
    options = [text for name, value in login.items() for text in (f"--{name}", str(value))]
    example = [sys.executable, ROOT / "examples/spark_fleet.py", "sensor_msgs/Imu"]
    done = subprocess.run(
        [*map(str, example), "linear_acceleration.z", "--master", master, *options],
        env=spark_env,
        capture_output=True,
        text=True,
        timeout=500,
    )
    assert done.returncode == 0, done.stderr
    lines = [line.split() for line in done.stdout.splitlines()]
    assert lines[0] == ["robot", "hour", "messages", "mean", "max", "p99"]
    assert [(line[0], line[1]) for line in lines[1:]] == sorted(by_hour)
    for robot, hour, count, mean, most, p99 in lines[1:]:
        values = sorted(by_hour[robot, hour])
        assert int(count) == len(values)
        assert float(mean) == pytest.approx(np.mean(values), rel=1e-5)
        assert float(most) == pytest.approx(values[-1], rel=1e-5)
        rank = -(-99 * len(values) // 100)
        assert float(p99) == pytest.approx(values[rank - 1], rel=1e-5)
