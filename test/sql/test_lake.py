# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Topics as Parquet: other programs read them, only changes are written, and differences found."""

from __future__ import annotations

import json
import os

import duckdb
import pandas as pd
import pyarrow.dataset
import pyarrow.parquet as pq
import pytest
from geometry_msgs.msg import Vector3
from sensor_msgs.msg import Imu
from std_msgs.msg import Header, String

from cassandra_ros import RosCassandra
from cassandra_ros.cli import cassandra_bag
from cassandra_ros.client.sql.lake import Lake
from cassandra_ros.errors import InvalidOption, TopicNotFound
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.store.tables.registry import Run

DAY = 86_400 * SECOND_NS
T0 = 18_500 * DAY - 5 * SECOND_NS
"""Five seconds before midnight."""


def fill(store, writer_id=1, node="r1", first=0, count=10, fmt="packed"):
    definition = definition_of(Imu)
    with store.messageWriter(nodeID=node, writer_id=writer_id, format=fmt) as writer:
        handle = writer.connect(api_connection("/imu/data", definition, "/x"), bucket_ns=SECOND_NS)
        for n in range(first, first + count):
            message = Imu(linear_acceleration=Vector3(n, 0, float("nan")))
            message.orientation_covariance = [float(n)] * 9
            writer.write(handle, T0 + n * SECOND_NS, n, serialize(message))


@pytest.fixture
def lake(rosCas, tmp_path):
    fill(rosCas)
    fill(rosCas, 2, "", fmt="ros")
    folder = tmp_path / "lake"
    report = Lake(rosCas.catalog, folder).write()
    assert (report.files, report.messages, report.unchanged) == (4, 20, 0)
    return folder


def files(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def test_there_is_a_file_for_each_topic_day_and_robot(lake):
    days = ("day=2020-08-25", "day=2020-08-26")
    robots = ("robot=-", "robot=r1")
    wanted = [f"imu%2Fdata/{d}/{r}/messages.parquet" for d in days for r in robots]
    assert files(lake) == sorted(["_lake.lock", "imu%2Fdata/_lake.json", *wanted])


def test_a_file_says_what_it_is(lake):
    schema = pq.read_schema(lake / "imu%2Fdata/day=2020-08-25/robot=r1/messages.parquet")
    metadata = {key.decode(): value.decode() for key, value in schema.metadata.items()}
    assert metadata["cassandra_ros.topic"] == "/imu/data"
    (kind,) = json.loads(metadata["cassandra_ros.types"]).values()
    assert kind["type"] == "sensor_msgs/Imu" and "linear_acceleration" in kind["definition"]
    units = json.loads(metadata["cassandra_ros.units"])
    assert units["linear_acceleration.x"] == "m/s²" and units["header.stamp"] == "ns"


@pytest.mark.suite("all", "make test asks others of its kind")
def test_two_programs_do_not_write_at_once(lake, rosCas):
    fill(rosCas, 3, first=20)
    refused = []

    def write_too(path, count):
        with pytest.raises(InvalidOption, match="written by another program") as error:
            Lake(rosCas.catalog, lake).write()
        refused.append(error.value)

    assert Lake(rosCas.catalog, lake).write(write_too).files == len(refused) == 1
    assert not Lake(rosCas.catalog, lake).verify().differences


@pytest.mark.suite("all", "make test asks others of its kind")
def test_the_name_of_a_run_that_comes_later_is_written(lake, rosCas):
    rosCas.catalog.keyspace.registry.put_run(Run("r1", 1, "recording", name="patrol"))
    again = RosCassandra(*place_of(rosCas), keyspace=rosCas.keyspace)
    with again:
        report = Lake(again.catalog, lake).write()
        assert (report.files, report.unchanged) == (2, 2)
        assert not Lake(again.catalog, lake).verify().differences


def place_of(rosCas):
    return rosCas.cassandra.hosts, rosCas.cassandra.port


def test_other_programs_read_it(lake):
    topic = lake / "imu%2Fdata"
    tables = f"FROM read_parquet('{topic}/**/*.parquet')"
    asked = "SELECT count(*), max(linear_acceleration.x), max(orientation_covariance[9]) " + tables
    assert duckdb.sql(asked).fetchall() == [(20, 9.0, 9.0)]
    by_day = f"SELECT day, robot, count(*) {tables} GROUP BY ALL ORDER BY ALL"
    assert [row[2] for row in duckdb.sql(by_day).fetchall()] == [5, 5, 5, 5]
    table = pyarrow.dataset.dataset(topic, partitioning="hive").to_table()
    assert table.num_rows == 20 and {"KEY", "NODE", "RUN", "day", "robot"} <= set(
        table.schema.names
    )
    frame = pd.read_parquet(topic)
    assert len(frame) == 20 and frame["KEY"].min() == pd.Timestamp(T0)
    assert sorted({each["x"] for each in frame["linear_acceleration"]}) == list(range(10))


@pytest.mark.suite("all", "make test reads it with DuckDB and pandas")
def test_polars_reads_it(lake):
    polars = pytest.importorskip("polars")
    frame = polars.scan_parquet(lake / "imu%2Fdata/**/*.parquet", hive_partitioning=True).collect()
    assert frame.height == 20
    assert frame["linear_acceleration"].struct.field("x").max() == 9.0


def test_only_what_has_changed_is_written(lake, rosCas):
    before = {name: os.stat(lake / name).st_mtime_ns for name in files(lake)}
    report = Lake(rosCas.catalog, lake).write()
    assert (report.files, report.unchanged) == (0, 4)
    fill(rosCas, 3, "r1", first=8, count=4)
    rosCas.getTopic("/imu/data").removeData(T0, T0, nodeID="")
    report = Lake(rosCas.catalog, lake).write()
    assert (report.files, report.unchanged) == (2, 2)
    changed = {name for name in before if os.stat(lake / name).st_mtime_ns != before[name]}
    assert {name.split("/")[1:3][-1] for name in changed if "day" in name} == {
        "robot=r1",
        "robot=-",
    }
    assert not Lake(rosCas.catalog, lake).verify().differences


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_bucket_that_a_deletion_left_open_is_written_once(lake, rosCas, monkeypatch):
    for module in ("client.sql.lake", "store.rows.row_counts"):
        monkeypatch.setattr(f"cassandra_ros.{module}.STALE_SEC", -1.0)
    rosCas.getTopic("/imu/data").removeData(T0, T0, nodeID="r1")
    assert Lake(rosCas.catalog, lake).write().files == 1
    assert Lake(rosCas.catalog, lake).write().files == 0
    assert not Lake(rosCas.catalog, lake).verify().differences


@pytest.mark.suite("all", "make test asks others of its kind")
def test_other_columns_are_written_to_all_files(lake, rosCas):
    with rosCas.messageWriter(nodeID="r1", format="packed") as writer:
        connection = api_connection("/imu/data", definition_of(Header), "/y")
        writer.write(writer.connect(connection), T0 + 20 * SECOND_NS, 1, serialize(Header(seq=3)))
    assert Lake(rosCas.catalog, lake).write().files == 4
    assert duckdb.sql(f"SELECT max(seq) FROM '{lake}/**/*.parquet'").fetchall() == [(3,)]


def test_differences_are_found(lake, rosCas):
    assert not Lake(rosCas.catalog, lake).verify().differences
    paths = sorted(lake.rglob("*.parquet"))
    table = pq.read_table(paths[0], partitioning=None)
    pq.write_table(table.slice(1), paths[0])
    changed = pq.read_table(paths[1], partitioning=None)
    pq.write_table(changed.set_column(2, "RUN", [["x"] * changed.num_rows]), paths[1])
    paths[2].write_bytes(b"no Parquet")
    paths[3].unlink()
    found = Lake(rosCas.catalog, lake).verify().differences
    assert [text.split(" ", 1)[1].split(":")[0] for text in found] == [
        "has 4 messages, the store 5",
        "has other values than the store",
        "cannot be read",
        "has 0 messages, the store 5",
    ]


def test_a_file_with_damaged_pages_is_a_difference(lake, rosCas):
    path, *_ = sorted(lake.rglob("*.parquet"))
    content = bytearray(path.read_bytes())
    content[8 : len(content) // 3] = bytes(len(content) // 3 - 8)
    path.write_bytes(content)
    (text,) = Lake(rosCas.catalog, lake).verify().differences
    assert text.startswith(f"{path} cannot be read: ")


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_file_whose_messages_are_all_deleted_is_a_difference(lake, rosCas):
    path = sorted(lake.rglob("*.parquet"))[0]
    robot = path.parent.name.partition("=")[2]
    count = pq.read_metadata(path).num_rows
    rosCas.upkeep.delete(nodeID="" if robot == "-" else robot)
    verified = Lake(rosCas.catalog, lake).verify()
    assert f"{path} has {count} messages, the store 0" in verified.differences
    gone = [each for each in lake.rglob("*.parquet") if each.parent.name == path.parent.name]
    assert len(verified.differences) == len(gone)
    assert Lake(rosCas.catalog, lake).write().files == 0 and path.exists()


def test_a_file_is_replaced_whole(lake, rosCas, monkeypatch):
    fill(rosCas, 4, "r1", first=2, count=1)
    before = files(lake)
    writer = pq.ParquetWriter.write_table

    def broken(self, table, **options):
        writer(self, table, **options)
        raise OSError("disk full")

    monkeypatch.setattr(pq.ParquetWriter, "write_table", broken)
    with pytest.raises(InvalidOption, match="disk full"):
        Lake(rosCas.catalog, lake).write()
    assert files(lake) == before
    monkeypatch.undo()
    assert Lake(rosCas.catalog, lake).write().files == 1


def test_the_verb_writes_and_compares(rosCas, cassandra, tmp_path, capsys):
    fill(rosCas)
    rosCas.addTopic("/named", key_format="manual").addData(String("x"), key="kitchen")
    where = ["--host", cassandra.host, "--port", str(cassandra.port), "--keyspace", rosCas.keyspace]
    folder = str(tmp_path / "a")
    assert cassandra_bag.main(["export", folder, "--parquet", *where]) == 0
    out, err = capsys.readouterr()
    assert "2 files written, 0 unchanged" in out and "/named is left out" in err
    assert cassandra_bag.main(["verify", folder, "--parquet", "--json", *where]) == 0
    assert json.loads(capsys.readouterr().out)["files"] == 2
    next(path for path in (tmp_path / "a").rglob("*.parquet")).unlink()
    assert cassandra_bag.main(["verify", folder, "--parquet", *where]) == 1
    capsys.readouterr()
    for line, text in {
        ("export", folder): "is a folder: give OUT.bag, or --parquet",
        ("export", folder, "--parquet", "--start", "5"): "it goes without --start",
        ("export", folder, "--parquet", "--no-latched"): "it goes without --no-latched",
        ("export", folder, "--parquet", "--lz4"): "it goes without --lz4",
        ("export", folder, "--parquet", "--store", "home"): "it goes without --store",
        ("verify", folder, "--parquet", "--content"): "it goes without --content",
        ("verify", folder, "--parquet", "--with", "home"): "give FILE.bag, or --with",
        ("verify", "--parquet", "--with", "home"): "it goes without --with",
        ("verify", "--parquet"): "give FILE.bag",
    }.items():
        with pytest.raises(SystemExit) as ended:
            cassandra_bag.main([*line, *where])
        assert (ended.value.code, text in capsys.readouterr().err) == (2, True), line
    with pytest.raises(TopicNotFound):
        Lake(rosCas.catalog, folder, ["/nothing"])
