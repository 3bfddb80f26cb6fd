# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Format packed: what its tables are, and what it refuses."""

from __future__ import annotations

import pytest
from sensor_msgs.msg import Imu, NavSatFix
from std_msgs.msg import Float64, Header

from cassandra_ros.errors import InvalidOption, InvalidQuery
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.store.tables.lengths import UNKNOWN_SPAN_NS

SEC = 10**9


def tableOf(rosCas, name):
    (table,) = rosCas.getTopic(name).tables
    return table


def columnsOf(rosCas, table):
    return rosCas.statements._keyspace.schema.columns(table.name)


def test_a_table_of_blocks_has_zones(rosCas):
    rosCas.addTopic("/fix", "packed", msg_type="sensor_msgs/NavSatFix")
    table = tableOf(rosCas, "fix")
    assert table.packed and not table.by_field
    assert table.columns == ("_data",) and table.shadows() is None
    assert table.metadata.span_ns == UNKNOWN_SPAN_NS
    columns = columnsOf(rosCas, table)
    wanted = {"_last": "bigint", "_n": "int", "_data": "blob", "_gone": "set<int>"}
    assert {name: columns[name] for name in wanted} == wanted
    assert columns["_nan"] == "frozen<set<text>>" and "_recv" not in columns
    assert table.zone_columns[:4] == (
        "_min.header.seq",
        "_max.header.seq",
        *table.zone_columns[2:4],
    )
    assert columns["_min.latitude"] == columns["_max.latitude"] == "double"
    assert columns["_min.header.stamp"] == "bigint" and columns["_max.status.status"] == "tinyint"
    assert not [name for name in columns if "covariance[" in name or name.startswith("_ix")]
    zones = table.format.zones([b""])
    assert zones[2] and set(zones[0]) == {None} and len(zones[0]) == len(table.zone_columns)


def test_the_span_of_blocks_stays_within_a_bucket(rosCas):
    space, definition = rosCas.statements._keyspace, definition_of(Float64)
    wanted = {"a": (SEC, 0, SEC), "b": (60 * SEC, 5, 10**7), "c": (60 * SEC, 7 * SEC, 7 * SEC)}
    for topic, (bucket, span, expected) in wanted.items():
        about = (f"/{topic}", definition.type, definition.md5sum)
        metadata = TopicMetadata(*about, "packed", bucket, definition.text, span_ns=span)
        assert space.new_tables.make(metadata, definition).metadata.span_ns == expected
        other = space.new_tables.make(metadata.with_(format="binary"), definition)
        assert other.metadata.span_ns == 0 and not other.packed


REFUSED = [("hash", "", "'hash'"), ("manual", "", "'manual'"), ("msg_part", "frame_id", "frame_id")]


@pytest.mark.parametrize(("key_format", "key_part", "named"), REFUSED)
def test_other_keys_than_times_are_refused(rosCas, key_format, key_part, named):
    key = {"key_format": key_format, "key_part": key_part}
    with pytest.raises(InvalidOption, match=f"/h .*packed.*{named}.*choose another format"):
        rosCas.addTopic("/h", "packed", msg_type="std_msgs/Header", **key)
    assert not rosCas.existTopic("/h")
    if key_format == "msg_part":
        topic = rosCas.addTopic("/later", "packed", **key)
        with pytest.raises(InvalidOption, match="/later .*packed"):
            topic.addData(Header())
    rosCas.addTopic("/stored", "ros", msg_type="std_msgs/Header", **key)
    with pytest.raises(InvalidOption, match="/stored .*packed"):
        rosCas.addTopic("/stored", "packed").addData(Header())


def test_a_key_that_is_a_time_lies_in_the_blocks(rosCas):
    key = {"key_format": "msg_part", "key_part": "header.stamp"}
    rosCas.addTopic("/imu", "packed", msg_type="sensor_msgs/Imu", **key)
    table = tableOf(rosCas, "imu")
    assert table.key_part.is_time and table.metadata.own_time
    assert "_recv" not in columnsOf(rosCas, table)


def test_zones_take_the_place_of_indexes(rosCas):
    with pytest.raises(InvalidOption, match="/fix takes no index.*packed in blocks"):
        rosCas.addTopic("/fix", "packed", msg_type="sensor_msgs/NavSatFix", index=["latitude"])
    assert not rosCas.existTopic("/fix")
    topic = rosCas.addTopic("/fix", "packed", msg_type="sensor_msgs/NavSatFix")
    with pytest.raises(InvalidOption, match="/fix takes no index"):
        topic.createIndex("latitude")
    with pytest.raises(InvalidQuery, match="takes no index"):
        rosCas.executeCQL("create index on fix (latitude)")
    assert not topic.hasIndex("latitude") and topic.getMeta["indexes"] == []


def test_beside_another_format_that_has_the_index(rosCas):
    rosCas.addTopic("/fix", "ros", msg_type="sensor_msgs/NavSatFix", index=["latitude"])
    topic = rosCas.addTopic("/fix", "packed", msg_type="sensor_msgs/NavSatFix")
    assert sorted(table.packed for table in topic.tables) == [False, True]
    assert topic.hasIndex("latitude")
    topic.createIndex("longitude")
    assert topic.hasIndex("longitude")
    packed = next(table for table in topic.tables if table.packed)
    assert packed.metadata.indexes == {} and packed.index_fields == {}
    topic.removeIndex("latitude")


def test_types_are_told_by_the_definition(rosCas):
    for message in (Imu, NavSatFix):
        definition = definition_of(message)
        rosCas.addTopic(f"/{definition.type}", "packed", msg_type=definition.type)
        table = tableOf(rosCas, definition.type)
        assert len(table.zone_columns) == 2 * len(table.zone_map.fields)
        assert rosCas.getTopic(definition.type).getMeta["format"] == "packed"
