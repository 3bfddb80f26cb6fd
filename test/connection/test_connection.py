# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The connection to the cluster: invalid addresses, and its end."""

from __future__ import annotations

import pytest
from cassandra.cluster import NoHostAvailable
from cassandra.protocol import ServerError
from std_msgs.msg import String

from cassandra_ros import Cassandra, RosCassandra
from cassandra_ros.errors import ConnectionFailed, InvalidOption, WriteFailed
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.store.connection import cassandra as connection
from cassandra_ros.store.connection.driver_errors import is_passing, translate
from cassandra_ros.store.connection.requests import await_answer

SEC = 10**9


@pytest.fixture
def environment(monkeypatch):
    """Sets CASSANDRA_ROS_HOST, _PORT and _KEYSPACE."""

    def set_these(host="", port="", keyspace=""):
        for name, value in (("HOST", host), ("PORT", port), ("KEYSPACE", keyspace)):
            monkeypatch.setenv(f"CASSANDRA_ROS_{name}", str(value))

    return set_these


def test_the_environment_says_where_the_store_is(environment, cassandra, keyspace):
    environment(cassandra.host, cassandra.port, keyspace)
    with RosCassandra() as store:
        store.addTopic("/a").addData(String("x"), key=1)
        assert store.keyspace == keyspace
    with Cassandra() as bare:
        assert bare.port == cassandra.port
    environment("127.0.0.1", 1, "nothing")
    with RosCassandra(cassandra.host, cassandra.port, keyspace=keyspace) as store:
        assert store.getTopic("/a").getData(1).data == "x"
    with pytest.raises(ConnectionFailed, match="127.0.0.1 port 1 "):
        RosCassandra()
    environment(cassandra.host, cassandra.port)
    with RosCassandra() as store:
        assert store.keyspace is None


@pytest.mark.parametrize("port", ["x", "0", "65536", "1.5", "-1", "9" * 30, "٣"])
def test_invalid_ports(environment, port):
    environment(port=port)
    with pytest.raises(InvalidOption, match=r"\(CASSANDRA_ROS_PORT\) is not a port"):
        RosCassandra()
    with pytest.raises(InvalidOption, match="is not a port"):
        RosCassandra("127.0.0.1", port)


def test_what_was_begun_gives_all_pages_and_each_in_time(cassandra, monkeypatch):
    waited = []

    def counted(future, outage):
        waited.append(future)
        return await_answer(future, outage)

    monkeypatch.setattr(connection, "await_answer", counted)
    cql, what = "SELECT table_name FROM system_schema.tables WHERE keyspace_name = ?", "tables"
    with Cassandra(cassandra.host, cassandra.port) as store:
        store._session.default_fetch_size = 3
        found = store.begin(cql, ("system",), what=what)()
        assert found == store.execute(cql, ("system",), what=what)
    assert len(found) > 6
    assert len(waited) >= len(found) / 3


@pytest.fixture
def stored(connect, keyspace):
    """A RosCassandra with a topic of ten messages; closed by the test."""
    store = connect(keyspace=keyspace)
    topic = store.addTopic("/a")
    for n in range(10):
        topic.addData(String(str(n)), key=n * SEC)
    return store, topic


def test_a_closed_connection_says_so_at_once(stored, caplog):
    store, topic = stored
    begun = [
        iter(topic.items()),
        topic.rows(),
        store.readMessages(),
        store.iterCQL("select * from a"),
    ]
    for one in begun:
        next(one)
    row = next(topic.rows())
    writer = store.messageWriter()
    store.close()
    uses = [
        lambda: store.getAllTopics(),
        lambda: store.getTopic("/a"),
        lambda: store.existTopic("/a"),
        lambda: store.addTopic("/b"),
        lambda: store.info(),
        lambda: store.runs(),
        lambda: store.executeCQL("select data from a"),
        lambda: store.connectToKeyspace(store.keyspace),
        lambda: store.connectToKeyspace(store.keyspace, make=False),
        lambda: store.messageWriter(),
        lambda: writer.connect(api_connection("/a", definition_of(String), "")),
        lambda: topic.getMeta["type"],
        lambda: topic.getData(0),
        lambda: topic.getData(0, nearest="before"),
        lambda: topic.addData(String("x")),
        lambda: topic.countTopicData(),
        lambda: topic.removeData(0),
        lambda: topic.createIndex("data"),
        lambda: topic.setMeta(site="lab"),
        lambda: list(topic.items()),
        lambda: store.cassandra.execute("SELECT * FROM system.local"),
        lambda: store.cassandra.schema_change("DROP TABLE none.none", what="a test"),
        *(lambda one=one: next(one) for one in begun),
    ]
    for use in uses:
        with pytest.raises(ConnectionFailed, match="is closed; make another RosCassandra"):
            use()
    assert row.message().data == "0"  # it is here
    writer.close()
    store.close()
    assert not [r for r in caplog.records if "trying again" in r.getMessage()]


def test_what_a_writer_has_not_sent_when_the_connection_is_closed_is_lost(connect, keyspace):
    lost = []
    store = connect(keyspace=keyspace)
    connection = api_connection("/a", definition_of(String), "")
    loud = store.messageWriter(linger_sec=3600)
    quiet = store.messageWriter(linger_sec=3600, on_loss=lambda *what: lost.append(what[:2]))
    for writer in (loud, quiet):
        handle = writer.connect(connection)
        for n in range(3):
            writer.write(handle, n, n, b"\1\0\0\0a")
    store.close()
    with pytest.raises(WriteFailed, match="3 messages of topic /a .* is closed"):
        loud.close()
    quiet.close()
    assert lost == [("/a", 3)]
    assert [part.lost for part in quiet.stats().values()] == [3]


@pytest.mark.parametrize(
    "host", ["no.such.host.invalid", "a b", "x" * 64, "a..b", "\udc80", "a\0b"]
)
def test_a_host_that_cannot_be_found_is_named(host):
    with pytest.raises(ConnectionFailed, match="no host of this name") as caught:
        RosCassandra(host, 9042)
    for part in (repr(host), "give the address", "rosrun cassandra_ros local_cassandra start"):
        assert part in str(caught.value)


def test_a_server_that_tells_of_its_full_disk():
    """The operator may make room: the statement is tried again, and the error names the disk."""
    told = ServerError(code=0, message="IOException: No space left on device", info=None)
    for exc in (told, NoHostAvailable("no host", {"127.0.0.1:9042": told})):
        assert is_passing(exc)
        assert "writing: the disk of the store is full; make room" in str(translate(exc, "writing"))
