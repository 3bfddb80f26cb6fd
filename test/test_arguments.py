# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the public methods take: an argument that cannot be one is refused, and named."""

from __future__ import annotations

import genpy
import numpy as np
import pytest
from geometry_msgs.msg import Twist
from std_msgs.msg import String, UInt8MultiArray

from cassandra_ros.arguments import MAX_MESSAGE_NAME_BYTES, MAX_NAME_BYTES
from cassandra_ros.errors import (
    CassandraRosError,
    InvalidKey,
    InvalidName,
    InvalidOption,
    InvalidQuery,
    TypeMismatch,
    UnknownFormat,
)

LONG, SURROGATE = "x" * 70_000, "a\ud800"
NO_TEXT = (5, True, 0.5, b"r1", ["r1"], {"r1": 1}, 10**5000)
"""What is not a text, and what no number may be printed of."""
UNFIT = (*NO_TEXT, SURROGATE)
NEW = {"msg_type": "std_msgs/String"}


def refused(call, values, error, name):
    """Check that a call refuses each of these values, and says which argument it was."""
    for value in values:
        with pytest.raises(error, match=name) as caught:
            found = call(value)
            list(found)  # where it is lazy it must not fail later
            pytest.fail(f"{name}={value!r:.40} was taken")
        assert type(caught.value) is error
        assert len(str(caught.value)) < 500


@pytest.fixture
def filled(rosCas):
    rosCas.addTopic("/n").addData(Twist(), key=genpy.Time(7))
    return rosCas


def test_addTopic_stores_nothing_of_what_it_refuses(rosCas):
    def add(name):
        return lambda value: rosCas.addTopic("/new", **{**NEW, name: value})

    refused(
        lambda value: rosCas.addTopic(value, **NEW), (*UNFIT, None, LONG), InvalidName, "topic="
    )
    refused(lambda value: rosCas.addTopic(value, **NEW), ("", "/a\0"), InvalidName, "topic name")
    refused(add("nodeID"), (*UNFIT, None, LONG), InvalidName, "nodeID=")
    refused(add("comment"), (*UNFIT, None, "x" * (1 << 20) + "y"), InvalidOption, "comment=")
    refused(add("format"), (*UNFIT[:-2], 0), UnknownFormat, "format")
    refused(add("msg_type"), UNFIT, InvalidName, "msg_type=")
    refused(add("key_format"), (5, True, b"time", ["time"], "Time"), InvalidKey, "key_format")
    refused(add("key_part"), (*UNFIT, None), InvalidKey, "key_part=")
    refused(add("ttl"), (None, "5", -1, 1.5, True, 10**5000), InvalidOption, "ttl=")
    refused(add("metadata"), (5, "site", ["site"], b"site"), InvalidName, "metadata=")
    refused(add("index"), (None, 5, b"x", 10**5000), InvalidName, "index=")
    refused(add("index"), ([5], [None], [SURROGATE]), InvalidName, "field=")
    assert rosCas.getAllTopics() == [] and not rosCas.existTopic("/new")


def test_names_of_topics_that_are_looked_for(filled):
    for method in (filled.getTopic, filled.existTopic, filled.removeTopic, filled.truncateTopic):
        refused(method, (*NO_TEXT, None), InvalidName, "name of a topic")
    refused(lambda topic: filled.nearestMessages("/n", topic, 1), (None, 5), InvalidName, "topic")
    refused(lambda topic: filled.lookupTransform("a", "b", 0, tf=topic), (5,), InvalidName, "topic")
    refused(
        lambda name: filled.renameTopic("/n", name), (*UNFIT, None, LONG), InvalidName, "topic="
    )
    refused(filled.getAllTopics, UNFIT, InvalidName, "pattern=")
    refused(filled.getAllTopics, ["(", "a{99999999999}"], InvalidName, "regular expression")
    refused(filled.readMessages, (5, True, b"/n", 0.5), InvalidName, "topics=")
    refused(filled.readMessages, ([5], [None]), InvalidName, "name of a topic")
    refused(filled.info, (5, b"/n"), InvalidName, "topics=")
    assert [topic.name for topic in filled.getAllTopics()] == ["/n"]


def test_a_text_is_one_topic(filled):
    filled.addTopic("/other").addData(String())
    assert [row.topic for row in filled.readMessages("n")] == ["/n"]
    assert [found.topic for found in filled.info("/n")] == ["/n"]


def test_nodeID_wherever_it_is_taken(filled):
    topic = filled.getTopic("/n")
    unfit = (*UNFIT, LONG)
    for call in (
        *(topic.first, topic.last),
        lambda node: topic.addData(Twist(), nodeID=node),
        lambda node: topic.getData(7.0, nodeID=node),
        lambda node: topic.getData(7.0, 8.0, nodeID=node),
        lambda node: topic.getData(7.0, nearest="either", nodeID=node),
        lambda node: topic.getRow(7.0, nodeID=node),
        lambda node: topic.items(nodeID=node),
        lambda node: topic.rows(nodeID=node),
        lambda node: topic.versions("a", nodeID=node),
        lambda node: topic.countTopicData(nodeID=node, where="linear.x = 0"),
        lambda node: topic.removeData(7.0, 8.0, nodeID=node),
        lambda node: topic.getArrays("linear.x", nodeID=node),
        lambda node: topic.toDataFrame("linear.x", nodeID=node),
        lambda node: filled.messageWriter(nodeID=node),
        lambda node: filled.readMessages(nodeID=node),
        lambda node: filled.nearestMessages("/n", "/n", 1, nodeID=node),
        lambda node: filled.toDataFrame("/n", every=1, nodeID=node),
        lambda node: filled.executeCQL("select * from n", nodeID=node),
        lambda node: filled.executeCQL("delete from n where linear.x = 0", nodeID=node),
        lambda node: filled.iterCQL("select count(*) from n", nodeID=node),
        lambda node: filled.explainCQL("select * from n", nodeID=node),
        lambda node: filled.lookupTransform("a", "b", 0, nodeID=node, tf="/n"),
    ):
        refused(call, unfit, InvalidName, "nodeID=")
    for node in (SURROGATE, LONG):  # no message can be of these
        assert filled.executeCQL("select * from n where NODE = ?", [node]) == []
        assert filled.executeCQL("select count(*) from n where NODE = ?", [node]) == [(0,)]
        assert topic.getData(0.0, 8.0, where=("NODE = ?", [node])) == []
    assert topic.countTopicData() == 1 and topic.getMeta["nodeIDs"] == [""]


def test_the_longest_names_can_be_stored(rosCas):
    """A message in chunks has the longest partition keys."""
    node, name = "ä" * (MAX_NAME_BYTES // 2), "k" * MAX_MESSAGE_NAME_BYTES
    topic = rosCas.addTopic("/" + "t" * (MAX_NAME_BYTES - 1), key_format="manual", nodeID=node)
    key = topic.addData(UInt8MultiArray(data=bytes(700_000)), key=name)
    assert len(topic.getData(key).data) == len(topic.getData(name, nodeID=node).data) == 700_000
    assert topic.getMeta["nodeIDs"] == [node]


def test_fields_keys_and_places(filled):
    topic = filled.getTopic("/n")
    for method in (topic.createIndex, topic.hasIndex, topic.removeIndex):
        refused(method, (*UNFIT, None), InvalidName, "field=")
    refused(topic.getArrays, (5, b"x"), InvalidName, "fields=")
    refused(topic.toDataFrame, (5, b"x"), InvalidName, "fields=")
    refused(lambda after: topic.rows(after=after), (5, "a", b"a"), InvalidKey, "after=")
    refused(topic.keyOfText, (5, None, b"7"), InvalidKey, "text=")
    refused(topic.versions, (5, None, b"7"), InvalidKey, "name=")
    refused(lambda text: topic.setMeta(comment=text), UNFIT, InvalidOption, "comment=")
    refused(topic.decode, (5, None, b"", (1, 2, 3)), TypeMismatch, "encode")
    manual = filled.addTopic("/m", key_format="manual")
    bad = (*UNFIT, None, "", LONG)
    refused(lambda key: manual.addData(String(), key=key), bad, InvalidKey, "kept under names")


def test_limits(filled):
    topic = filled.getTopic("/n")
    for call in (
        lambda limit: topic.getData(0, 8.0, limit=limit),
        lambda limit: topic.items(limit=limit),
        lambda limit: topic.items(where="linear.x = 0", limit=limit),
        lambda limit: topic.rows(limit=limit),
        lambda limit: filled.executeCQL("select * from n", limit=limit),
        lambda limit: filled.iterCQL("select * from n", limit=limit),
    ):
        unfit = (2**63, 10**5000, -1, True, 1.0, 0.5, float("nan"), "1", b"1", [1])
        refused(call, unfit, InvalidOption, f"limit=.* 0 to {2**63 - 1}, or None")
        assert [len(list(call(most))) for most in (None, 0, 1, np.int64(1), 2**63 - 1)] == [
            *(1, 0, 1, 1, 1)
        ]
    for most in (2**63, 10**30, 0):
        with pytest.raises(InvalidQuery, match="LIMIT takes .* at most"):
            filled.executeCQL(f"select * from n limit {most}")
    for most in (2**63, -1, True, 1.0, "1", None):
        with pytest.raises(InvalidQuery, match="LIMIT takes .* at most"):
            filled.executeCQL("select * from n limit ?", [most])
    assert len(filled.executeCQL(f"select * from n limit {2**63 - 1}")) == 1


def test_what_is_no_statement_and_no_message(filled):
    for statement in (None, 5, b"select * from n", ["select * from n"], {}):
        for ask in (filled.executeCQL, filled.iterCQL, filled.explainCQL):
            with pytest.raises(InvalidQuery, match="a statement is text, not"):
                ask(statement)
    topic = filled.getTopic("/n")
    for method in (topic.addData, filled.addTopic("/pending").addData):
        refused(method, (None, 5, "x", b"", {}, Twist), TypeMismatch, "is not a message")
    assert topic.countTopicData() == 1 and filled.getTopic("/pending").tables == []


@pytest.mark.parametrize(
    ("params", "remedy"),
    [
        *((273, r"give \[273\]"), (0.9, r"give \[0\.9\]"), ("x", r"give \['x'\]")),
        *((b"x", r"give \[b'x'\]"), (None, "give"), ({"a": 1}, "not a dict")),
        *(({1}, "not a set"), (iter([1]), "not a list_iterator")),
    ],
)
def test_parameters_that_are_no_list(filled, params, remedy):
    topic, condition = filled.getTopic("/n"), "linear.x > ?"
    where = (condition, params)
    for ask in (
        lambda: filled.executeCQL(f"select * from n where {condition}", params),
        lambda: filled.executeCQL(f"delete from n where {condition}", params),
        lambda: filled.iterCQL(f"select * from n where {condition}", params),
        lambda: filled.explainCQL(f"select * from n where {condition}", params),
        lambda: topic.getData(0, 8.0, where=where),
        lambda: topic.items(where=where),
        lambda: topic.getArrays("linear.x", where=where),
        lambda: filled.readMessages("/n", where={"/n": where}),
    ):
        with pytest.raises(
            InvalidQuery, match=f"a list of values in the order .*{remedy}"
        ) as caught:
            ask()
        assert caught.value.statement[caught.value.position] == "?"


def test_options_of_a_writer(rosCas):
    def writer(name):
        return lambda value: rosCas.messageWriter(**{name: value})

    refused(writer("writer_id"), (0, -1, 2**31, "1", b"1", 1.5, True), InvalidKey, "writer_id=")
    for name in ("linger_sec", "give_up_after_sec"):
        unfit = (None, "1", -1, float("nan"), True, 10**400)
        refused(writer(name), unfit, InvalidOption, f"{name}=")
    refused(writer("run"), (5, "run"), InvalidOption, "run=")
    refused(writer("format"), (5, 0, "Ros"), UnknownFormat, "format")
    refused(writer("ttl"), (-1, None, "5"), InvalidOption, "ttl=")
    assert issubclass(InvalidKey, CassandraRosError)
