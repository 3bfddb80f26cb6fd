# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Statements about buckets that are still written to: the directory cannot tell what is in them."""

from __future__ import annotations

import struct

import genpy
import pytest
from std_msgs.msg import Header

from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.store.rows import writer

SEC = 10**9
T0 = 1_500_000_000 * SEC


def header(number):
    """A header; no column holds the time of each tenth, which has 1.5 s of nanoseconds."""
    message = Header(seq=number, stamp=genpy.Time(T0 // SEC + number, 0), frame_id=str(number))
    wire = bytearray(serialize(message))
    if number % 10 == 0:
        wire[8:12] = struct.pack("<I", 1_500_000_000)
    return bytes(wire)


@pytest.mark.parametrize("plan", ["client", "filter", "index"])
@pytest.mark.parametrize("closed", [False, True])
def test_what_no_column_holds_is_found(rosCas, monkeypatch, plan, closed):
    monkeypatch.setattr(writer, "HEARTBEAT_SEC", 1e9)  # it would tell of odd rows
    topic = rosCas.addTopic("/h", msg_type="std_msgs/Header", format="ros")
    topic.createIndex("stamp")
    target = rosCas.messageWriter()
    handle = target.connect(api_connection("/h", definition_of(Header), "/x"))
    for number in range(40):
        target.write(handle, T0 + number, number, header(number))
    target.flush()
    if closed:
        target.close()
    (table,) = topic.tables
    rows = rosCas.catalog.keyspace.directory.find(table.name, "", table.bucket_of(T0))
    assert [(row.closed, row.odd) for row in rows] == [(closed, 4 * closed)]
    statement = "select seq from /h where stamp >= ? and stamp <= ?"
    params = (T0 + 20 * SEC, T0 + 31 * SEC + SEC // 2)
    result = rosCas.statements.select(statement, params, plan=plan)
    assert [seq for (seq,) in result] == list(range(20, 32))
    assert bool(result.pushdown.whole) == (plan == "client")
    target.close()


@pytest.mark.parametrize("plan", ["index", "auto"])
def test_an_index_that_one_of_two_writers_fills_hides_no_row(rosCas, monkeypatch, plan):
    """One has opened the bucket before the index was made: its rows go on without."""
    monkeypatch.setattr(writer, "HEARTBEAT_SEC", 1e9)  # it would be closed, idle, meanwhile
    topic = rosCas.addTopic("/h", msg_type="std_msgs/Header", format="binary")
    early, late = (rosCas.messageWriter(writer_id=n, format="binary") for n in (1, 2))
    connection = api_connection("/h", definition_of(Header), "/x")
    handle = early.connect(connection)
    early.write(handle, T0, 0, header(1))
    early.flush()
    topic.createIndex("frame_id")
    for target in (early, late):
        handle = target.connect(connection)
        for number in range(1, 4):
            target.write(handle, T0 + number, number, header(1))
        target.flush()
    (table,) = topic.tables
    rows = rosCas.catalog.keyspace.directory.find(table.name, "", table.bucket_of(T0))
    assert sorted(len(row.filled) for row in rows) == [0, 1]
    for _ in ("open", "closed"):
        result = rosCas.statements.select("select seq from /h where frame_id = '1'", plan=plan)
        assert len(list(result)) == 7
        early.close()
        late.close()
