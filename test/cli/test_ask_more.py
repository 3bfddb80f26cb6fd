# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Arrays, arithmetic, groups, distinct rows and orders, asked in every format as a person asks."""

from __future__ import annotations

import csv
import io
import json
import time

import numpy as np
import pyarrow.parquet
from query.kinds import serialized
from sensor_msgs.msg import LaserScan

from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.metadata import FORMAT_NAMES

SECOND = 10**9
RANGES = ([1.0, 0.125, 3.0], [0.5, 0.5], [], [8.0, 0.25], [0.125, 9.0, 2.0, 2.0])
HEADER = {
    "type": LaserScan._type,
    "md5sum": LaserScan._md5sum,
    "message_definition": LaserScan._full_text,
}
ASKED = {
    "where ANY(ranges) < range_min": [0, 4],
    "where ALL(ranges) >= range_min": [1, 2, 3],
    "where 8.5 < max(ranges)": [4],
    "where len(ranges) - 1 = 1": [1, 3],
    "where ANY(ranges) between 2.5 and 3.5": [0],
    "where sqrt(abs(-range_max)) * 2 = range_max": [0, 1, 2, 3, 4],
    "where min(ranges) / range_min >= 2": [1],
    "where not min(ranges) > 0.3": [0, 3, 4],
    "where KEY - header.stamp > 2500ms": [3, 4],
    "where KEY > now() - 1h and KEY < now()": [0, 1, 2, 3, 4],
    "where KEY < now() - 1h": [],
    "order by len(ranges) desc": [4, 0, 1, 3, 2],
    "order by max(ranges) desc, KEY limit 2": [4, 3],
    "where ranges[0] = ANY(ranges) order by ranges[0]": [4, 1, 0, 3],
}


def test_every_format_gives_the_same_answers(call, rosCas, tmp_path):
    begin = (time.time_ns() // (10 * SECOND) - 6) * 10 * SECOND
    times = [begin + n * 4 * SECOND for n in range(len(RANGES))]
    for name in FORMAT_NAMES:
        with rosCas.messageWriter(format=name, nodeID="husky") as writer:
            handle = writer.connect(live_connection(f"/{name}/scan", HEADER))
            for n, ranges in enumerate(RANGES):
                scan = LaserScan(ranges=ranges, range_min=0.25, range_max=4.0)
                scan.header.stamp.secs, scan.header.stamp.nsecs = divmod(
                    times[n] - n * SECOND, SECOND
                )
                writer.write(handle, times[n], n, serialized(scan))
    for name in FORMAT_NAMES:
        topic = f"/{name}/scan"
        for asked, numbers in ASKED.items():
            found = rosCas.executeCQL(f"select KEY from {topic} {asked}")
            assert [key.ns for (key,) in found] == [times[n] for n in numbers], (name, asked)
        grouped = f"select time(10s), count(*), max(max(ranges)) from {topic} group by time(10s)"
        tens = begin // SECOND
        assert [(t.secs - tens, *more) for t, *more in rosCas.executeCQL(grouped)] == [
            (0, 3, 3.0),
            (10, 2, 9.0),
        ]
        assert rosCas.executeCQL(f"select distinct ranges[0], NODE from {topic}") == [
            (1.0, "husky"),
            (0.5, "husky"),
            (None, "husky"),
            (8.0, "husky"),
            (0.125, "husky"),
        ]
        assert rosCas.getTopic(topic).countTopicData(where="ANY(ranges) < 0.2") == 2
    told = str(rosCas.explainCQL("select KEY from /ros/scan where ANY(ranges) < range_min"))
    assert "client alone:  ANY(ranges) < range_min" in told
    frame = rosCas.getTopic("/ros/scan").toDataFrame(["min(ranges)", "range_max - range_min"])
    np.testing.assert_array_equal(frame["min(ranges)"], [0.125, 0.5, np.nan, 0.25, 0.125])
    assert list(frame["range_max - range_min"]) == [3.75] * 5

    statement = "select min(ranges) as least, len(ranges), KEY - header.stamp from /ros/scan"
    status, out, err = call("query", statement + " order by least", "--output", "csv")
    assert (status, err) == (0, "")
    lines = list(csv.reader(io.StringIO(out)))
    assert lines[0] == ["least", "len(ranges)", "KEY - header.stamp"]
    assert [line[0] for line in lines[1:]] == ["0.125", "0.125", "0.25", "0.5", ""]
    path = tmp_path / "a.parquet"
    assert call("query", statement, "--output", "parquet", "-O", path)[0] == 0
    table = pyarrow.parquet.read_table(path)
    assert table.column(0).to_pylist() == [0.125, 0.5, None, 0.25, 0.125]
    assert [str(field.type) for field in table.schema] == ["float", "int64", "duration[ns]"]
    status, out, err = call("query", "select KEY from /ros/scan where ANY(ranges) < KEY")
    assert status != 0
    assert "ranges is a float32 and KEY a time: they cannot be compared" in err
    status, out, _ = call("query", grouped + " limit 1", "--output", "json")
    assert [row["count(*)"] for row in json.loads(out)] == [3]
    assert rosCas.executeCQL("delete from /ros/scan where KEY < now() - 1h") == [(0,)]
    assert rosCas.executeCQL("delete from /ros/scan where max(ranges) >= 8") == [(2,)]


def test_blocks_are_sifted_by_any_and_all(rosCas):
    with rosCas.messageWriter(format="packed") as writer:
        handle = writer.connect(live_connection("/scan", HEADER))
        for n in range(200):
            wire = serialized(LaserScan(ranges=[1.0, 0.5 + n, 2.0]))
            writer.write(handle, 1_400_000_000 * SECOND + n, n, wire)
    for condition, left in (
        ("ANY(ranges) < 1", 1),
        ("min(ranges) < 1", 1),
        ("max(ranges) > 197", 3),
        ("ALL(ranges) >= 1 and ANY(ranges) > 198.5", 1),
        ("not ALL(ranges) >= 1", 200),
    ):
        told = rosCas.explainCQL(f"select KEY from scan where {condition}")
        assert (told.unpacked, told.sifted) == (200, 200 - left), condition
        assert told.rows_returned == min(left, 3 if left < 200 else 1), condition
