# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A topic gets another table by one client; others see its messages from their acknowledgement on.

The reading client sits behind a proxy that hands on what the server pushes as late as may be: right
before the answer to the next request. So what it knows when it begins to read is always too old.
"""

from __future__ import annotations

from contextlib import ExitStack

import pytest
from proxy import Proxy
from std_msgs.msg import Header, Int64, String

from cassandra_ros import RosCassandra
from cassandra_ros.errors import MessageNotFound
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.messages.stamps import Stamp

SEC = 10**9
FIRST, SECOND = 100 * SEC, 200 * SEC


@pytest.fixture
def connect_far(cassandra, keyspace):
    """Connects clients that hear of changes late."""
    with Proxy(cassandra.host, cassandra.port) as proxy, ExitStack() as clients:
        proxy.late_pushes = True

        def make():
            store = RosCassandra(proxy.host, proxy.port, keyspace=keyspace)
            return clients.enter_context(store)

        yield make


@pytest.fixture
def far(connect_far):
    """A client that hears of changes late."""
    return connect_far()


def add_first(rosCas):
    rosCas.addTopic("/t", format="ros").addData(String(data="first"), key=FIRST)


def add_second(rosCas):
    """Store a message in a second table; return its key."""
    return rosCas.addTopic("/t", format="binary").addData(String(data="second"), key=SECOND)


def seen_by(store):
    """Return the topic as a client has it that has read its first table."""
    found = store.getTopic("/t")
    assert found.countTopicData() == 1
    return found


def texts(messages):
    return [message.data for message in messages]


BOTH = ["first", "second"]
READS = {
    "the key": lambda t, far, key: ([t.getData(key).data], ["second"]),
    "a time": lambda t, far, key: ([t.getData(SECOND).data], ["second"]),
    "nearest": lambda t, far, key: ([t.getData(190 * SEC, nearest="either").data], ["second"]),
    "before": lambda t, far, key: ([t.getData(300 * SEC, nearest="before").data], ["second"]),
    "items": lambda t, far, key: (texts(m for _, m in t.items()), BOTH),
    "items backwards": lambda t, far, key: (texts(m for _, m in t.items(reverse=True)), BOTH[::-1]),
    "a stretch": lambda t, far, key: (texts(t.getData(FIRST, SECOND)), BOTH),
    "where": lambda t, far, key: (texts(m for _, m in t.items(where="data >= 'first'")), BOTH),
    "count": lambda t, far, key: (t.countTopicData(), 2),
    "count between": lambda t, far, key: (t.countTopicData(FIRST, SECOND), 2),
    "buckets": lambda t, far, key: (t.countBuckets(), 2),
    "last": lambda t, far, key: (t.last().ns, SECOND),
    "arrays": lambda t, far, key: (list(t.getArrays(["data"])["data"]), BOTH),
    "select": lambda t, far, key: (far.executeCQL("select data from /t"), [(x,) for x in BOTH]),
    "count(*)": lambda t, far, key: (far.executeCQL("select count(*) from /t"), [(2,)]),
    "readMessages": lambda t, far, key: (
        texts(r.message() for r in far.readMessages(["/t"])),
        BOTH,
    ),
    "info": lambda t, far, key: (sum(each.count for each in far.info()), 2),
}


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_read_sees_what_was_acknowledged_before_it_began(rosCas, connect_far):
    add_first(rosCas)
    clients = {way: connect_far() for way in READS}
    topics = {way: seen_by(client) for way, client in clients.items()}
    key = add_second(rosCas)
    answers = {way: read(topics[way], clients[way], key) for way, read in READS.items()}
    assert {way: found for way, (found, _) in answers.items()} == {
        way: wanted for way, (_, wanted) in answers.items()
    }


def test_blocks_of_a_second_table_are_among_the_arrays(rosCas, far):
    rosCas.addTopic("/t", format="packed").addData(String(data="first"), key=FIRST)
    topic = seen_by(far)
    add_second(rosCas)
    assert list(topic.getArrays(["data"])["data"]) == BOTH


def test_a_field_of_a_definition_that_came_since_can_be_asked_for(rosCas, far):
    rosCas.addTopic("/t", format="ros").addData(String(data="first"), key=FIRST)
    assert far.executeCQL("select data from /t") == [("first",)]
    with rosCas.messageWriter() as writer:
        handle = writer.connect(api_connection("/t", definition_of(Int64), "/x"))
        writer.write(handle, SECOND, 0, (7).to_bytes(8, "little"))
    found = far.executeCQL("select data, KEY from /t where data = 7")
    assert found == [(7, Stamp.from_ns(SECOND))]


def test_messages_of_a_definition_that_came_since_have_the_same_columns(rosCas, far):
    rosCas.addTopic("/t", format="ros").addData(String(data="first"), key=FIRST)
    ask = "select * from /t"
    assert [text for _, text in far.executeCQL(ask)] == ["first"]
    with rosCas.messageWriter() as writer:
        handle = writer.connect(api_connection("/t", definition_of(Header), "/x"))
        writer.write(handle, SECOND, 0, serialize(Header(frame_id="map")))
    found = far.executeCQL(ask)
    rows = list(found)
    assert {len(row) for row in rows} == {len(found.columns)}
    assert [row[found.columns.index("data")] for row in rows] == ["first", None]


def test_a_topic_that_was_removed_and_made_anew_is_read_at_once(rosCas, far):
    add_first(rosCas)
    topic = seen_by(far)
    rosCas.removeTopic("/t")
    rosCas.addTopic("/t", format="ros").addData(String(data="anew"), key=SECOND)
    assert texts(m for _, m in topic.items()) == ["anew"]
    assert topic.getData(SECOND).data == "anew"


def test_a_topic_that_was_emptied_goes_on(rosCas, far):
    add_first(rosCas)
    topic = seen_by(far)
    rosCas.truncateTopic("/t")
    rosCas.getTopic("/t").addData(String(data="anew"), key=SECOND)
    assert topic.getData(SECOND).data == "anew"


def test_a_topic_that_was_only_named_shows_the_first_message_of_another_client(rosCas, far):
    topic = far.addTopic("/t")
    assert list(topic.items()) == []
    rosCas.addTopic("/t").addData(String(data="first"), key=FIRST)
    assert topic.getData(FIRST).data == "first"


DELETIONS = {
    "all of a stretch": lambda t, far: t.removeData(0, 300 * SEC),
    "a time": lambda t, far: t.removeData(SECOND),
    "where": lambda t, far: t.removeData(where="data = 'second'"),
    "DELETE": lambda t, far: far.executeCQL(f"delete from /t where KEY >= {SECOND}"),
    "DELETE where": lambda t, far: far.executeCQL("delete from /t where data = 'second'"),
    "deleteMessages": lambda t, far: far.upkeep.delete(["/t"], SECOND, SECOND),
}


@pytest.mark.suite("all", "make test asks others of its kind")
@pytest.mark.parametrize("way", DELETIONS)
def test_a_deletion_spares_nothing_that_was_acknowledged(rosCas, far, way):
    add_first(rosCas)
    topic = seen_by(far)
    add_second(rosCas)
    DELETIONS[way](topic, far)
    with pytest.raises(MessageNotFound):
        rosCas.getTopic("/t").getData(SECOND)
