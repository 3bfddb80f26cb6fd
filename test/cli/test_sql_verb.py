# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""cassandra_bag sql: its outputs are those of query, and messages are objects in them."""

from __future__ import annotations

import csv
import io
import json

import pyarrow.parquet
import pytest
from geometry_msgs.msg import Vector3
from sensor_msgs.msg import Imu

from cassandra_ros.cli import cassandra_bag
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.stamps import Stamp

T0 = 1_600_000_000 * SECOND_NS


@pytest.fixture(scope="module")
def stored(fresh):
    with fresh() as rosCas:
        topic = rosCas.addTopic("/imu/data", "packed", msg_type="sensor_msgs/Imu", nodeID="r1")
        for n in range(5):
            message = Imu(linear_acceleration=Vector3(n, 0, float("nan")))
            topic.addData(message, key=Stamp.from_ns(T0 + n))
        rosCas.catalog.adder.close()
        yield rosCas


@pytest.fixture
def call(stored, cassandra, capsys):
    def run(*words):
        where = ["--host", cassandra.host, "--port", str(cassandra.port)]
        status = cassandra_bag.main([*words, *where, "--keyspace", stored.keyspace])
        out, err = capsys.readouterr()
        return status, out, err

    return run


TEXT = 'SELECT KEY, linear_acceleration AS a, KEY - KEY AS d FROM "/imu/data" ORDER BY KEY'


def test_the_table_is_aligned(call):
    status, out, _ = call("sql", TEXT, "--limit", "2")
    lines = out.splitlines()
    assert status == 0 and len(lines) == 3
    assert lines[0].split() == ["KEY", "a", "d"]
    assert "2020-09-13T12:26:40.000000001Z" in lines[2] and "{x: 1.0, y: 0.0, z: nan}" in lines[2]


def test_csv_and_json_have_objects(call):
    rows = list(csv.reader(io.StringIO(call("sql", TEXT, "--output", "csv")[1])))
    assert rows[0] == ["KEY", "a", "d"] and rows[1][0] == str(T0) and rows[1][2] == "0"
    found = json.loads(call("sql", TEXT, "--json")[1])
    assert found[4] == {"KEY": T0 + 4, "a": {"x": 4.0, "y": 0.0, "z": None}, "d": 0}
    lines = call("sql", TEXT, "--output", "ndjson", "-l", "1")[1].splitlines()
    assert [json.loads(line)["a"]["x"] for line in lines] == [0.0]


def test_parquet_has_structs(call, tmp_path):
    path = str(tmp_path / "a.parquet")
    text = 'SELECT KEY, linear_acceleration AS a FROM "/imu/data" WHERE linear_acceleration.x >= ?'
    assert call("sql", text, "2", "--output", "parquet", "-O", path)[0] == 0
    table = pyarrow.parquet.read_table(path)
    assert [row["x"] for row in table["a"].to_pylist()] == [2.0, 3.0, 4.0]
    assert call("sql", text, "9", "--output", "parquet", "-O", path, "--force")[0] == 0
    assert pyarrow.parquet.read_table(path).num_rows == 0
    interval = 'SELECT KEY - KEY AS d FROM "/imu/data"'
    status, _, err = call("sql", interval, "--output", "parquet", "-O", path, "--force")
    assert status == 1 and "cast the column to text" in err


def test_it_explains(call):
    status, out, _ = call("sql", TEXT, "--explain")
    assert status == 0 and "columns:  KEY, linear_acceleration.x" in out


def test_errors_show_the_place(call):
    status, _, err = call("sql", 'SELECT KEI FROM "/imu/data"')
    assert status == 1 and "did you mean KEY" in err and err.rstrip().endswith("^")
    status, _, err = call("sql", "DROP TABLE x")
    assert status == 1 and "takes a SELECT" in err
