# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""where=: the messages that a condition means, with every key format and every format."""

from __future__ import annotations

import random
import tracemalloc

import genpy
import pytest
from geometry_msgs.msg import TransformStamped
from std_msgs.msg import Header, String, UInt8MultiArray
from suites import sparing
from tf2_msgs.msg import TFMessage
from topics.key_kinds import KEYS, every_key

from cassandra_ros.errors import (
    InvalidKey,
    InvalidOption,
    InvalidQuery,
    MessageNotFound,
    TopicNotFound,
)
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.metadata import FORMAT_NAMES
from cassandra_ros.store.rows import reader
from cassandra_ros.topics import removal

SEC = 10**9
T0 = 1_500_000_000 * SEC

CONDITION = "seq >= 20 AND (frame_id = 'a' OR frame_id LIKE 'c%') AND NOT seq = 33"


def holds(message):
    return message.seq >= 20 and message.frame_id[:1] in ("a", "c") and message.seq != 33


def header(number):
    stamp = genpy.Time(*divmod(T0 + number // 3 * SEC // 10, SEC))
    return Header(seq=number, stamp=stamp, frame_id="a b cc d a".split()[number % 5])


def fill(rosCas, kind, count=60, name="/h", fmt="ros"):
    """Sixty messages of two nodes, three at each time."""
    topic = rosCas.addTopic(name, fmt, msg_type="std_msgs/Header", **KEYS[kind])
    connection = api_connection(name, definition_of(Header), "/x")
    for node in ("", "r1"):
        with rosCas.messageWriter(nodeID=node, writer_id=7) as writer:
            handle = writer.connect(connection, bucket_ns=SEC)
            for number in range(node == "r1", count, 2):
                message = header(number)
                given = {"name": message.frame_id} if kind == "manual" else {}
                t = message.stamp.to_nsec()
                writer.write(handle, t, number, serialize(message), **given)
    return topic


def plain(items):
    return [(str(key), key.node, message) for key, message in items]


@every_key
def test_it_means_the_same_with_every_key(rosCas, kind):
    topic = fill(rosCas, kind)
    every = plain(topic.items())
    assert len(every) == 60
    wanted = [item for item in every if holds(item[2])]
    assert 10 < len(wanted) < 30
    assert plain(topic.items(where=CONDITION)) == wanted
    assert plain(topic.items(where=CONDITION, reverse=True)) == wanted[::-1]
    assert plain(topic.items(where=CONDITION, limit=4)) == wanted[:4]
    assert topic.countTopicData(where=CONDITION) == len(wanted)
    mine = [item for item in wanted if item[1] == "r1"]
    assert 0 < len(mine) < len(wanted)
    assert plain(topic.items(where=CONDITION, nodeID="r1")) == mine
    assert plain(topic.items(where=CONDITION + " AND NODE = 'r1'")) == mine
    assert topic.countTopicData(nodeID="r1", where=CONDITION) == len(mine)
    assert list(topic.items(where=CONDITION + " AND NODE = 'r1'", nodeID="")) == []
    assert plain(topic.items(where=("seq IN ?", [[3, 5, 99]]))) == [
        item for item in every if item[2].seq in (3, 5)
    ]


@pytest.mark.parametrize("kind", ["value", "hash", "manual"])
def test_names_and_values_hold_beside_it(rosCas, kind):
    topic = fill(rosCas, kind)
    key = next(key for key, message in topic.items() if message.seq == 24)
    asked = str(key) if kind == "hash" else "a"
    all_there = [item for item in plain(topic.items()) if item[2].frame_id == "a"]
    if kind == "hash":
        all_there = [item for item in all_there if item[2].seq == 24]
    wanted = [item for item in all_there if holds(item[2])]
    assert plain(topic.items(asked, where=CONDITION)) == wanted
    assert topic.countTopicData(asked, where=CONDITION) == len(wanted)
    first = wanted[-1 if kind == "manual" else 0]
    assert topic.getData(asked, where=CONDITION) == first[2]
    assert topic.getData(asked, where="seq = 24").seq == 24
    with pytest.raises(MessageNotFound, match="no message that satisfies 'seq = 26' (whose|under)"):
        topic.getData(asked, where="seq = 26")
    assert topic.removeData(asked, where=CONDITION) == len(wanted)
    assert topic.countTopicData() == 60 - len(wanted)
    with pytest.raises(MessageNotFound, match="that satisfies"):
        topic.removeData(asked, where=CONDITION)


@pytest.mark.parametrize("kind", ["time", "stamp"])
def test_times_hold_beside_it(rosCas, kind):
    topic = fill(rosCas, kind)
    low, high = header(10).stamp, header(40).stamp
    wanted = [
        item for item in plain(topic.items()) if holds(item[2]) and low <= item[2].stamp <= high
    ]
    assert plain(topic.items(low, high, where=CONDITION)) == wanted
    assert topic.getData(low, high, where=CONDITION) == [message for *_, message in wanted]
    assert topic.getData(low, high, where=CONDITION, limit=2) == [m for *_, m in wanted[:2]]
    assert topic.countTopicData(low, high, where=CONDITION) == len(wanted)
    assert topic.countTopicData(low, high, where=f"KEY > {high}") == 0


@pytest.mark.parametrize("kind", ["time", "stamp"])
def test_one_message(rosCas, kind):
    topic = fill(rosCas, kind)
    at = header(24).stamp  # beside 25 and 26, in the order 24, 26, 25: by node
    assert [row.message().seq for row in topic.rows(at, at)] == [24, 26, 25]
    assert topic.getData(at, where="seq > 24").seq == 26
    assert topic.getData(at, where="seq > 24", nodeID="r1").seq == 25
    assert topic.getData(at, where="seq > 26", default=None) is None
    key = next(key for key, message in topic.items() if message.seq == 25)
    assert topic.getData(key, where="seq = 25").seq == 25
    assert topic.getData(key, where="seq = 24", default=None) is None
    assert topic.getRow(at, where="seq = 25").key == key
    with pytest.raises(MessageNotFound, match="message of node r1 that satisfies 'seq = 24' at"):
        topic.getData(at, where="seq = 24", nodeID="r1")
    with pytest.raises(MessageNotFound, match="that satisfies 'seq = 24' at"):
        topic.removeData(key, where="seq = 24")
    assert topic.removeData(key, where="seq = 25") == 1
    assert topic.removeData(at, where="seq > 20") == 2
    assert topic.countTopicData() == 57


def test_the_nearest_that_satisfies_it(rosCas):
    topic = fill(rosCas, "time")
    seqs = [message.seq for _, message in topic.items()]

    def near(number, nearest, where):
        found = topic.getData(header(number).stamp, nearest=nearest, where=where, default=None)
        return found and found.seq

    assert near(30, "before", "seq < 10") == 9
    assert near(30, "after", "seq < 10") is None
    assert near(30, "after", "seq > 50") == 52  # 51, of the second node, is at a time with it
    assert near(30, "either", "seq = 3 OR seq = 48") == 48
    assert near(30, "either", "seq = 18 OR seq = 48") == 18
    assert near(30, "either", "seq = 20 OR seq = 42") == 20  # equally near: what was before
    assert near(30, "either", "seq = 15 OR seq = 42") == 42
    assert near(30, "either", "frame_id = 'x'") is None
    # The first of three with one stamp in the order of all reads, as without nearest.
    assert topic.getData(header(0).stamp, nearest="either").seq == seqs[0]


@pytest.mark.parametrize("fmt", FORMAT_NAMES)
def test_it_means_the_same_in_every_format(rosCas, fmt):
    rand = random.Random(1)
    topic = rosCas.addTopic("/tf", fmt, msg_type="tf2_msgs/TFMessage")
    messages = []
    for number in range(40):
        message = TFMessage()
        for child in rand.sample("abc", rand.randrange(4)):
            transform = TransformStamped(child_frame_id=child)
            transform.transform.translation.x = float(rand.randrange(-3, 4))
            message.transforms.append(transform)
        messages.append(message)
        topic.addData(message, key=T0 + number)
    # One element must satisfy all of it.
    condition = "transforms.child_frame_id = 'b' AND transforms.transform.translation.x > 0"
    wanted = []
    for message in messages:
        elements = [(t.child_frame_id, t.transform.translation.x) for t in message.transforms]
        if any(child == "b" and x > 0 for child, x in elements):
            wanted.append(message)
    assert 2 < len(wanted) < 20
    assert [message for _, message in topic.items(where=condition)] == wanted
    assert topic.countTopicData(where=condition) == len(wanted)
    assert topic.getData(T0, T0 + 19, where=condition) == [
        message for message in messages[:20] if message in wanted
    ]
    assert topic.removeData(T0 + 20, T0 + 99, where=condition) == sum(
        message in wanted for message in messages[20:]
    )
    assert [message for _, message in topic.items()] == [
        message for n, message in enumerate(messages) if n < 20 or message not in wanted
    ]


@every_key
def test_removal_without_a_key(rosCas, monkeypatch, kind):
    monkeypatch.setattr(removal, "REMOVED_ROWS_AT_ONCE", 7)
    topic = fill(rosCas, kind)
    every = plain(topic.items())
    assert sum(info.count for info in rosCas.info()) == 60
    gone = [item for item in every if holds(item[2]) and item[1] == "r1"]
    assert topic.removeData(where=CONDITION, nodeID="r1") == len(gone)
    left = [item for item in every if item not in gone]
    assert plain(topic.items()) == left
    assert topic.removeData(where=CONDITION, nodeID="r1") == 0
    assert topic.removeData(where=CONDITION) == sum(holds(item[2]) for item in left)
    left = [item for item in left if not holds(item[2])]
    assert plain(topic.items()) == left
    assert topic.countTopicData() == len(left)
    assert sum(info.count for info in rosCas.info()) == len(left)


def test_the_pieces_of_large_messages_go_too(rosCas, cql):
    topic = rosCas.addTopic("/large", "ros")
    for number in range(4):
        message = UInt8MultiArray(data=bytes([number]) * 1_100_000)
        message.layout.data_offset = number
        topic.addData(message, key=T0 + number)
    (table,) = topic.tables
    count = f'SELECT count(*) FROM {rosCas.keyspace}."{table.name}_c"'
    assert cql.execute(count).one()[0] == 12
    assert topic.removeData(where="layout.data_offset IN (1, 2)") == 2
    assert cql.execute(count).one()[0] == 6
    assert [message.data[0] for _, message in topic.items()] == [0, 3]


@pytest.mark.suite("all", "make test asks others of its kind")
def test_removal_says_what_it_needs(rosCas):
    topic = fill(rosCas, "time")
    for arguments in ({}, {"key": None}, {"nodeID": "r1"}):
        with pytest.raises(InvalidKey, match="where= or run="):
            topic.removeData(**arguments)
    assert topic.countTopicData() == 60
    assert topic.removeData(to_key=header(5).stamp, where="seq < 3") == 3
    assert topic.removeData(to_key=header(5).stamp) == 3


NO_CONDITIONS = [
    ("seq >", "the statement ends here"),
    ("seq > 1 frame_id", "found 'frame_id'"),
    ("sequ > 1", "did you mean seq"),
    ("seq > 'a'", "seq"),
    ("", "the statement ends here"),
    (("seq > ?", []), "1 parameters, 0 were given"),
    (("seq > ?", "1"), "list of values"),
    (5, "takes a condition as text"),
    (("seq > ?",), "takes a condition as text"),
]


def test_what_is_no_condition(rosCas):
    topic = fill(rosCas, "time", count=2)
    for where, text in NO_CONDITIONS:
        refused(rosCas, topic, where, text)
    assert topic.countTopicData() == 2


def refused(rosCas, topic, where, text):
    asks = (
        lambda: topic.getData(0, where=where),
        lambda: topic.getData(0, 1, where=where),
        lambda: topic.items(where=where),
        lambda: topic.countTopicData(where=where),
        lambda: topic.removeData(where=where),
        lambda: rosCas.readMessages(where={"/h": where}),
        lambda: rosCas.nearestMessages("/h", "/h", 1, where={"h": where}),
    )
    for ask in asks:
        with pytest.raises(InvalidQuery, match=text) as raised:
            ask()
        lines = str(raised.value).splitlines()
        assert lines[-1].strip() == "^"
        text_of_it = where[0] if isinstance(where, tuple) else str(where)
        assert lines[-2].strip() in (text_of_it, repr(where))


def test_a_condition_for_a_topic_that_is_not_read(rosCas):
    fill(rosCas, "time", count=2)
    fill(rosCas, "time", count=2, name="/g")
    for read in (
        lambda: rosCas.readMessages(["/g"], where={"/h": "seq > 1"}),
        lambda: rosCas.nearestMessages("/g", "g", 1, where={"/h": "seq > 1"}),
    ):
        with pytest.raises(InvalidOption, match="topic /h, which is not among .*: /g"):
            read()
    with pytest.raises(TopicNotFound, match="did you mean /h"):
        rosCas.readMessages(where={"/hh": "seq > 1"})
    with pytest.raises(InvalidOption, match="two conditions for topic /h"):
        rosCas.readMessages(where={"/h": "seq > 1", "h": "seq < 5"})
    with pytest.raises(InvalidOption, match="mapping"):
        rosCas.readMessages(["/h"], where="seq > 1")


@pytest.mark.parametrize("received", sparing([False, True], kept=[False]))
def test_several_topics_merged_by_time(rosCas, received):
    names = {f"/{kind}": kind for kind in KEYS}
    for name, kind in names.items():
        fill(rosCas, kind, name=name)
    # Stamps in another order than the messages came.
    rosCas.addTopic("/late", msg_type="std_msgs/Header", **KEYS["stamp"])
    with rosCas.messageWriter() as writer:
        handle = writer.connect(api_connection("/late", definition_of(Header), "/x"))
        for number in range(60):
            writer.write(handle, T0 + number * SEC, number, serialize(header(59 - number)))
    conditions = {name: CONDITION for name in names if name != "/value"}
    conditions.update(late=("seq < ?", [50]))

    def wanted(row):
        message = row.message()
        if row.topic == "/late":
            return message.seq < 50
        return row.topic == "/value" or holds(message)

    ends = (T0 + SEC // 2, T0 + 50 * SEC) if received else (header(10).stamp, header(50).stamp)
    for nodeID in (None, "r1"):
        ask = {"key": ends[0], "to_key": ends[1], "nodeID": nodeID, "received": received}
        every = list(rosCas.readMessages(**ask))
        found = list(rosCas.readMessages(**ask, where=conditions))
        assert [r.position for r in found] == [r.position for r in every if wanted(r)]
        assert {row.topic for row in found} == {row.topic for row in every}
        assert 50 < len(found) < len(every)
        if received:
            assert [r.received for r in found] == sorted(r.received for r in found)
    some = rosCas.readMessages(["/time", "hash"], where={"time": "seq = 3"})
    assert sum(row.topic == "/hash" for row in some) == 60


@pytest.mark.suite("all", "large messages, to see how much memory they take")
def test_reading_is_lazy_and_its_memory_bounded(rosCas, monkeypatch):
    # Pages of 32 KiB, and 12 MB of messages.
    monkeypatch.setattr(reader, "PAGE_BYTES", 32 * 1024)
    names = ("/a", "/b", "/c")
    with rosCas.messageWriter() as writer:
        definition = definition_of(String)
        handles = [
            writer.connect(api_connection(n, definition, "/x"), bucket_ns=SEC) for n in names
        ]
        wire = serialize(String(data="x" * 2000))
        for number in range(6000):
            writer.write(handles[number % 3], T0 + number * SEC // 100, number, wire)
    conditions = dict.fromkeys(names[:2], "data LIKE 'x%'")
    send, calls = rosCas.cassandra.ask_raw, []

    def counted(*arguments):
        calls.append(arguments)
        return send(*arguments)

    monkeypatch.setattr(rosCas.cassandra, "ask_raw", counted)
    rows = rosCas.readMessages(where=conditions)
    next(rows)
    at_first = len(calls)
    assert at_first < 20
    tracemalloc.start()
    try:
        assert sum(1 for _ in rows) == 5999
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert len(calls) > 5 * at_first
    assert peak < 4 << 20
    del calls[:]
    assert next(rosCas.getTopic("/a").items(where=conditions["/a"]))[1].data[0] == "x"
    assert len(calls) < 10
