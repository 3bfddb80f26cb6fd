# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A recording in format packed: blocks are closed by age and rate, and no message is lost."""

from __future__ import annotations

import itertools

from nodes.children import await_true
from sensor_msgs.msg import Imu
from std_msgs.msg import Header, String

from cassandra_ros.messages.classes import serialize
from cassandra_ros.recording.recording import Recording
from cassandra_ros.recording.topic_settings import RecordingSettings, TopicSettings

T0 = 1_500_000_000 * 10**9
STEP = 2_000_000


def header(cls, callerid="/publisher"):
    return {
        "type": cls._type,
        "md5sum": cls._md5sum,
        "message_definition": cls._full_text,
        "callerid": callerid,
        "latching": "0",
    }


def recording(rosCas, **options):
    ticks = itertools.count(T0, STEP)
    settings = RecordingSettings(TopicSettings("packed"))
    return Recording(rosCas.catalog, clock=lambda: next(ticks), settings=settings, **options)


def blocks(cql, rosCas, topic):
    """Return (n, size, t, last) of all blocks of a topic, read with the driver alone."""
    (table,) = rosCas.catalog.keyspace.tables.of_topic(topic)
    query = f'SELECT "_n", "_size", "_t", "_last" FROM {table.qualified}'
    return sorted(map(tuple, cql.execute(query)), key=lambda row: row[2])


def test_a_block_is_stored_when_it_is_old(rosCas, cql):
    running = recording(rosCas, block_sec=0.2)
    told = header(String)
    for n in range(3):
        assert running.received("/a", told, serialize(String(data=f"text {n}")))
    await_true(lambda: running.reports()[0].stored == 3)
    first = [n for n, *_ in blocks(cql, rosCas, "/a")]
    assert sum(first) == 3  # in one, unless a busy machine took longer for them
    assert running.received("/a", told, serialize(String(data="text 3")))
    await_true(lambda: running.reports()[0].stored == 4)
    assert [n for n, *_ in blocks(cql, rosCas, "/a")] == [*first, 1]
    (report,) = running.close()
    assert (report.received, report.stored, report.lost) == (4, 4, 0)


def test_what_waits_in_blocks_is_stored_at_the_end(rosCas, cql):
    running = recording(rosCas, block_sec=3600.0)
    told = header(Imu)
    for n in range(3000):
        message = Imu()
        message.header.seq = n
        assert running.received("/imu", told, serialize(message))
    (report,) = running.close()
    assert (report.received, report.stored, report.lost) == (3000, 3000, 0)
    found = blocks(cql, rosCas, "/imu")
    assert sum(n for n, *_ in found) == 3000
    assert len(found) < 30
    (table,) = rosCas.catalog.keyspace.tables.of_topic("/imu")
    span_ns = table.metadata.span_ns
    assert 0 < span_ns <= 10**10
    assert all(n <= 1024 and size <= 256 * 1024 for n, size, *_ in found)
    assert all(last - t <= span_ns for *_, t, last in found)
    assert rosCas.info(["/imu"])[0].count == 3000


def test_a_topic_whose_key_is_no_time_is_recorded_in_the_format_that_it_has(rosCas, caplog):
    rosCas.addTopic("/map", "binary", msg_type="std_msgs/String", key_format="manual")
    rules = [[("/by_name", {"key_part": "frame_id"}), ("/found", {"index": ("data",)})]]
    settings = RecordingSettings(TopicSettings("packed"), rules)
    running = Recording(rosCas.catalog, clock=itertools.count(T0, STEP).__next__, settings=settings)
    for topic, cls in (("/map", String), ("/by_name", Header), ("/found", String)):
        assert running.received(topic, header(cls), serialize(cls()))
    assert all(report.stored == 1 and not report.lost for report in running.close())
    formats = {name: rosCas.getTopic(name).getMeta["format"] for name in ("/map", "/by_name")}
    assert formats == {"/map": "binary", "/by_name": "ros"}
    for said in ("/map is kept in format binary", "/by_name is kept in format ros"):
        assert said in caplog.text
    assert "/found takes no index" in caplog.text and "cassandra_bag index" not in caplog.text
