# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""No row brings a tombstone: the server's own trace of reading whole buckets tells."""

from __future__ import annotations

import re
import time

import pytest
from geometry_msgs.msg import TransformStamped
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Int64, String, UInt8MultiArray
from suites import FEW_FORMATS, sparing
from tf2_msgs.msg import TFMessage

from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.metadata import FORMAT_NAMES

T0 = 1_500_000_000 * 10**9
_READ = re.compile(r"Read (\d+) live rows and (\d+) tombstone cells")

# Strings that are no UTF-8, a time with nsecs of 10**9, bytes that are too many: their columns
# stay unset, and the bytes lie in _raw.
ODD = {
    "string": (String, b"\1\0\0\0\xff"),
    "surplus": (String, serialize(String(data="x")) + b"more"),
    "time": (TransformStamped, bytes(8) + (10**9).to_bytes(4, "little") + bytes(8 + 56)),
}
PLAIN = {
    "transform": TransformStamped(child_frame_id="robot"),
    "empty": LaserScan(),
    "scan": LaserScan(ranges=[1.0, 2.0, float("nan")], intensities=[0.5]),
    "tf": TFMessage([TransformStamped(child_frame_id="a"), TransformStamped()]),
    "no tf": TFMessage([]),
    "large": UInt8MultiArray(data=bytes(600_000)),
}


def cells_read(cql, statement, parameters=()):
    """Run a statement with tracing; return (rows, live rows, tombstones) as the server saw them."""
    deadline = time.monotonic() + 180
    while time.monotonic() < deadline:
        # Anew each time: of a trace the driver reads only what is there when it first looks.
        result = cql.execute(statement, parameters, trace=True)
        rows = len(list(result))
        trace = result.get_query_trace(max_wait_sec=60)
        found = [_READ.search(event.description) for event in trace.events]
        found = [(int(match[1]), int(match[2])) for match in found if match]
        if found:
            return rows, sum(live for live, _ in found), sum(dead for _, dead in found)
        time.sleep(0.1)  # events are written after the answer
    pytest.fail("the trace does not tell what was read")


def whole_buckets(cql, rosCas, topic):
    """Read all of a topic's partitions; return what cells_read says of them together."""
    total = (0, 0, 0)
    for table in rosCas.getTopic(topic).tables:
        for name in (table.name, table.name + "_c"):
            space = f'{rosCas.keyspace}."{name}"'
            if name != table.name and not table.has_chunks:
                continue
            keys = '"_node", "_bucket"' + (', "_t", "_seq"' if name != table.name else "")
            for key in list(cql.execute(f"SELECT DISTINCT {keys} FROM {space}")):
                where = " AND ".join(f"{column} = %s" for column in keys.split(", "))
                found = cells_read(cql, f"SELECT * FROM {space} WHERE {where}", tuple(key))
                total = tuple(a + b for a, b in zip(total, found))
    return total


@pytest.mark.parametrize("format_name", sparing(FORMAT_NAMES, kept=FEW_FORMATS))
def test_no_row_has_a_tombstone(rosCas, cql, format_name):
    wires = {name: (type(message), serialize(message)) for name, message in PLAIN.items()}
    wires.update(ODD)
    with rosCas.messageWriter(format=format_name) as writer:
        for n, (name, (cls, wire)) in enumerate(wires.items()):
            handle = writer.connect(api_connection(f"/{name}", definition_of(cls), "/x"))
            writer.write(handle, T0, n, wire)
    for name, (_, wire) in wires.items():
        assert [row.wire for row in rosCas.getTopic(f"/{name}").rows()] == [wire]
        rows, live, tombstones = whole_buckets(cql, rosCas, f"/{name}")
        assert (rows, tombstones) == (live, 0), name
        assert rows == (1 if name != "large" else 3)


def test_a_null_is_seen_by_the_same_check(rosCas, cql):
    rosCas.addTopic("/a", "ros").addData(TransformStamped(), key=T0)
    assert whole_buckets(cql, rosCas, "/a") == (1, 1, 0)
    (table,) = rosCas.getTopic("/a").tables
    cql.execute(
        f'INSERT INTO {rosCas.keyspace}."{table.name}" ("_node", "_bucket", "_t", "_seq", "_raw") '
        "VALUES (%s, %s, %s, %s, %s)",
        ("", table.bucket_of(T0), T0, 1, None),
    )
    assert whole_buckets(cql, rosCas, "/a") == (2, 2, 1)


@pytest.mark.suite("all", "110,000 messages")
@pytest.mark.parametrize("format_name", FEW_FORMATS)
def test_a_bucket_is_read_after_110_000_deletions(rosCas, format_name):
    """Cassandra refuses a read that meets 100,000 tombstones."""
    with rosCas.messageWriter(format=format_name) as writer:
        connection = api_connection("/n", definition_of(Int64), "/x")
        handle = writer.connect(connection, bucket_ns=10**12)
        for n in range(110_010):
            writer.write(handle, T0 + n, n, n.to_bytes(8, "little"))
    topic = rosCas.getTopic("/n")
    assert topic.removeData(where="data < 55000") == 55_000
    assert topic.removeData(T0 + 55_000, T0 + 109_999) == 55_000
    assert topic.countTopicData() == 10
    assert [message.data for _, message in topic.items()] == list(range(110_000, 110_010))
    assert list(rosCas.executeCQL("SELECT count(*) FROM /n WHERE data >= 0")) == [(10,)]
