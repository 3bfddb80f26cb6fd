# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rows that release 1.0.0 wrote are read, continued and changed by this release.

They are in the folder rows_v1, which make_rows.py wrote. If a test fails because rows, blocks or
comments are other ones now, the version of what has changed must be another one, too.
"""

from __future__ import annotations

import json

import pytest
from std_msgs.msg import String
from store.make_rows import FOLDER, SIDE_TABLES, long

from cassandra_ros import RosCassandra
from cassandra_ros.keys import MAX_NS
from cassandra_ros.metadata import FORMAT_NAMES

pytestmark = pytest.mark.suite("all", "rows of each format")


def make_table(cql, keyspace, path):
    """Make a table of the folder and fill it, with the bare driver."""
    from cassandra.query import UNSET_VALUE, BoundStatement

    table = json.loads(path.read_text())
    comment = table["comment"].replace("'", "''")
    first, *indexes = table["statements"]
    cql.execute(first.format(keyspace=keyspace) + f" WITH comment = '{comment}'")
    for statement in indexes:
        cql.execute(statement.format(keyspace=keyspace))
    names = ", ".join(f'"{name}"' for name in table["columns"])
    marks = ", ".join("?" * len(table["columns"]))
    insert = cql.prepare(f'INSERT INTO {keyspace}."{table["table"]}" ({names}) VALUES ({marks})')
    for row in table["rows"]:
        bound = BoundStatement(insert)
        bound.values = [UNSET_VALUE if value is None else long(value) for value in row]
        cql.execute(bound)


@pytest.fixture
def filled(cassandra, new_keyspace, cql):
    """A store with the rows, and what is to be read of each topic."""
    cql.execute(
        f"CREATE KEYSPACE {new_keyspace} WITH replication = "
        "{'class': 'SimpleStrategy', 'replication_factor': 1}"
    )
    expected = FOLDER / "expected.json"
    paths = sorted(set(FOLDER.glob("*.json")) - {expected})
    assert {path.stem for path in paths} >= set(SIDE_TABLES), "run make_rows.py"
    for path in paths:
        make_table(cql, new_keyspace, path)
    with RosCassandra(cassandra.host, cassandra.port, keyspace=new_keyspace) as rosCas:
        yield rosCas, json.loads(expected.read_text())


def test_all_rows_are_read_and_the_topics_go_on(filled):
    rosCas, expected = filled
    assert {topic.name for topic in rosCas.getAllTopics()} == set(expected)
    told = {}
    for info in rosCas.info():
        told[info.topic] = told.get(info.topic, 0) + info.count
    for name, messages in expected.items():
        topic = rosCas.getTopic(name)
        rows = list(topic.rows())
        assert [[r.t, r.node, r.type, r.md5sum, r.wire] for r in rows] == [
            [*facts, long(wire)] for *facts, wire in messages
        ]
        for row in rows:
            cls = row.message_class()
            assert (cls._type, cls._md5sum) == (row.type, row.md5sum)
            # An installed type only where it is the one that was recorded.
            assert (cls is String) == (row.md5sum == String._md5sum)
        assert told[name] == len(messages)
        if topic.getMeta["key_format"] == "time":
            assert topic.countTopicData(0, MAX_NS) == len(messages)
    check_values(rosCas)
    # The topics go on: new rows beside the old.
    for form in FORMAT_NAMES:
        topic = rosCas.addTopic(f"/{form}/text", form)
        key = topic.addData(String(data="new"), nodeID="robot")
        assert topic.getData(key).data == "new"
        assert len(topic.tables) == 3


def check_values(rosCas):
    for form in FORMAT_NAMES:
        things = [message for _, message in rosCas.getTopic(f"/{form}/thing").items()]
        assert (things[0].number, things[0].names, things[0].parts[0].value) == (7, ["hi"], 1.0)
        assert rosCas.executeCQL(f"select number from /{form}/thing") == [(7,)]
        (big,) = [message for _, message in rosCas.getTopic(f"/{form}/big").items()]
        assert big.data == bytes(600_000)
    assert rosCas.getTopic("/manual").getData("kitchen").x == 1.0
    assert rosCas.getTopic("/part").getData(1.5).x == 1.5
    assert rosCas.getTopic("/stamp").getData(1_400_000_000.0).child_frame_id == "part"


def test_they_are_checked_converted_and_deleted(filled):
    rosCas, expected = filled
    assert not rosCas.upkeep.check().damages
    for form, other in (("packed", "ros"), ("ros", "packed")):
        name = f"/{form}/thing"
        rosCas.convertTopic(name, other)
        (row,) = rosCas.getTopic(name).rows()
        assert [row.t, row.node, row.type, row.md5sum] == expected[name][0][:4]
        assert row.wire == long(expected[name][0][4])
    for form in FORMAT_NAMES:
        topic = rosCas.getTopic(f"/{form}/text")
        assert topic.removeData(0, MAX_NS) == len(expected[topic.name])
        assert topic.countTopicData() == 0
        rosCas.removeTopic(f"/{form}/big")
    rosCas.renameTopic("/manual", "/named")
    assert rosCas.getTopic("/named").getData("kitchen").x == 1.0
    assert not rosCas.upkeep.check().damages


def test_the_folder_has_every_format():
    names = {path.name for path in FOLDER.glob("*.json")}
    for form in FORMAT_NAMES:
        assert any(name.startswith(f"{form}_") for name in names), "run make_rows.py"
    assert sum(path.stat().st_size for path in FOLDER.iterdir()) < 300_000
