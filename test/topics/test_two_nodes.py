# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Two nodeIDs with the same topics and equal stamps: merged, separate, counted, deleted apart."""

from __future__ import annotations

import genpy
import pytest
from std_msgs.msg import Header
from topics.key_kinds import KEYS, every_key

from cassandra_ros.files.bag.bag_reader import BagReader
from cassandra_ros.files.bag.exporter import export_bag
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of

SEC = 10**9
T0 = 1_500_000_000 * SEC
NODES = ("", "r1")
COUNT = 24

EVEN = "frame_id IN ('0', '2', '4')"


def wanted():
    """The messages of each node, two at each time."""
    return [
        Header(seq=number, stamp=genpy.Time(*divmod(T0 + number // 2 * SEC, SEC)), frame_id=name)
        for number, name in ((n, str(n % 6)) for n in range(COUNT))
    ]


def isEven(message):
    return message.frame_id in ("0", "2", "4")


def fill(rosCas, kind, name):
    topic = rosCas.addTopic(name, msg_type="std_msgs/Header", **KEYS[kind])
    for number, node in enumerate(NODES):
        # The later node has the lower counters: order is by node first.
        with rosCas.messageWriter(nodeID=node, writer_id=9 - number) as writer:
            handle = writer.connect(api_connection(name, definition_of(Header), "/x"))
            for message in wanted():
                given = {"name": message.frame_id} if kind == "manual" else {}
                wire = serialize(message)
                writer.write(handle, message.stamp.to_nsec(), message.seq, wire, **given)
    return topic


def found(topic, **choice):
    return [(key.node, message.seq) for key, message in topic.items(**choice)]


def merged(keep):
    """(node, seq) of the messages to be found, in the order of reads."""
    every = [(m.stamp.to_nsec(), node, m.seq) for node in NODES for m in wanted() if keep(m)]
    return [(node, seq) for _, node, seq in sorted(every)]


@pytest.mark.suite("all", "make test asks others of its kind")
@every_key
def test_merged_separate_and_counted(rosCas, kind):
    topic = fill(rosCas, kind, "/h")
    assert found(topic) == merged(lambda message: True)
    even = merged(isEven)
    assert found(topic, where=EVEN) == even
    assert found(topic, where=EVEN, reverse=True) == even[::-1]
    assert topic.countTopicData(where=EVEN) == len(even) == COUNT
    for node in NODES:
        mine = [entry for entry in even if entry[0] == node]
        assert found(topic, where=EVEN, nodeID=node) == mine
        assert found(topic, where=(f"{EVEN} AND NODE = ?", [node])) == mine
        assert topic.countTopicData(nodeID=node, where=EVEN) == len(mine) == COUNT // 2
        assert found(topic, where=EVEN, nodeID=node, limit=3) == mine[:3]
    assert found(topic, where=EVEN, nodeID="r2") == []
    assert topic.getMeta["nodeIDs"] == list(NODES)


def test_values_of_one_node(rosCas):
    """The index on the field of the keys has the rows of both."""
    topic = fill(rosCas, "value", "/h")
    for node in NODES:
        mine = [(key.node, message.frame_id) for key, message in topic.items("3", nodeID=node)]
        assert mine == [(node, "3")] * 4
        assert topic.countTopicData("3", nodeID=node) == 4
    assert topic.removeData("3", nodeID="r1") == 4
    assert (topic.countTopicData("3"), topic.countTopicData("3", nodeID="r1")) == (4, 0)


@pytest.mark.suite("all", "make test asks others of its kind")
@every_key
def test_deleted_apart(rosCas, kind):
    topic = fill(rosCas, kind, "/h")
    assert topic.removeData(where=EVEN, nodeID="r1") == COUNT // 2
    left = [entry for entry in merged(lambda m: True) if entry not in even_of_r1()]
    assert found(topic) == left
    assert counts(rosCas) == {"": COUNT, "r1": COUNT // 2}
    assert topic.countTopicData(where=EVEN, nodeID="r1") == 0
    assert topic.removeData(where=f"{EVEN} AND NODE = 'r1'") == 0
    assert topic.removeData(where="NODE = ''") == COUNT
    assert counts(rosCas) == {"": 0, "r1": COUNT // 2}
    assert found(topic) == [entry for entry in left if entry[0] == "r1"]


def even_of_r1():
    return [("r1", message.seq) for message in wanted() if isEven(message)]


def counts(rosCas):
    told = dict.fromkeys(NODES, 0)
    for info in rosCas.info():
        told[info.node] += info.count
    return told


@pytest.mark.parametrize("kind", ["time", "stamp"])
def test_deleted_at_a_time_that_both_have(rosCas, kind):
    topic = fill(rosCas, kind, "/h")
    at = wanted()[4].stamp  # with 5, of both nodes
    assert topic.removeData(at, nodeID="r1", where="seq = 4") == 1
    assert [row.message().seq for row in topic.rows(at, at)] == [4, 5, 5]
    assert topic.removeData(at, where="seq = 5") == 2
    assert [row.node for row in topic.rows(at, at)] == [""]
    assert topic.removeData(at, T0 + COUNT * SEC, nodeID="") == COUNT - 5
    assert counts(rosCas) == {"": 4, "r1": COUNT - 2}


def test_several_topics_and_a_bag_of_one_node(rosCas, tmp_path):
    fill(rosCas, "time", "/a")
    fill(rosCas, "stamp", "/b")
    conditions = {"/a": EVEN, "/b": "seq < 5"}
    for node in (None, *NODES):
        rows = list(rosCas.readMessages(nodeID=node, where=conditions))
        nodes = NODES if node is None else (node,)
        assert {row.node for row in rows} == set(nodes)
        assert len(rows) == len(nodes) * (COUNT // 2 + 5)
        assert [row.position for row in rows] == sorted(row.position for row in rows)
    pairs = list(rosCas.nearestMessages("/a", "/b", 0, nodeID="r1", where={"/b": "seq = 5"}))
    assert [(a.node, b.node, a.message().seq, b.message().seq) for a, b in pairs] == [
        ("r1", "r1", 4, 5),
        ("r1", "r1", 5, 5),
    ]
    export_bag(rosCas, tmp_path / "r1.bag", nodeID="r1", where=conditions)
    with BagReader(tmp_path / "r1.bag") as reader:
        assert reader.message_count == COUNT // 2 + 5
