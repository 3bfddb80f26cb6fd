# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A driver's session that has ended while the server answers others: another one is made."""

from __future__ import annotations

import pytest
from bag.test_import_process import write_bag
from proxy import EXECUTE
from std_msgs.msg import String

from cassandra_ros.files.bag.comparison import verify_bag
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.recording.recording import Recording
from cassandra_ros.recording.topic_settings import RecordingSettings, TopicSettings
from cassandra_ros.store.connection import cassandra as connection
from cassandra_ros.store.connection import sessions as link

pytestmark = pytest.mark.suite("all", "it kills or cuts something, and waits")

COUNT = 30_000
HEADER = {
    "type": "std_msgs/String",
    "md5sum": String._md5sum,
    "message_definition": String._full_text,
    "callerid": "/talker",
    "latching": "0",
}


def shut_pools(store):
    for pool in store.cassandra._links.current.raw_session.get_pools():
        pool.shutdown()


def shut_all_pools(store):
    shut_pools(store)
    for pool in list(store.cassandra._session.get_pools()):
        pool.shutdown()


def shut_session(store):
    store.cassandra._links.current.raw_session.shutdown()


def shut_cluster(store):
    store.cassandra._cluster.shutdown()


ENDS = [shut_pools, shut_all_pools, shut_session, shut_cluster]


@pytest.mark.parametrize("shut_down", ENDS)
@pytest.mark.parametrize("form", ["packed", "binary"])
def test_an_import_goes_on_by_another_session(rosCas, connect, tmp_path, shut_down, form):
    path = write_bag(tmp_path / "a.bag", COUNT, 100)
    taken = [0]

    def progress(messages, size):
        before, taken[0] = taken[0], taken[0] + messages
        if before < COUNT // 2 <= taken[0]:
            shut_down(rosCas)

    report = import_bag(rosCas, path, format=form, progress=progress)
    assert report.messages == COUNT
    with connect(keyspace=rosCas.keyspace) as other:
        assert verify_bag(other, path).equal
        assert sum(info.count for info in other.info()) == COUNT
        assert sum(1 for topic in other.getAllTopics() for _ in topic.rows()) == COUNT
        assert [run.state for run in other.runs()] == ["ended"]


@pytest.mark.parametrize("shut_down", ENDS)
def test_a_recording_goes_on_by_another_session(rosCas, connect, shut_down, caplog):
    settings = RecordingSettings(TopicSettings("binary"))
    recording = Recording(rosCas.catalog, settings=settings)
    wires = [serialize(String(str(n))) for n in range(2000)]
    for n, wire in enumerate(wires):
        if n in (500, 1500):
            shut_down(rosCas)
        recording.received("/a", HEADER, wire)
        if n == 1000:
            assert recording.waiting()[0] >= 0
    (report,) = recording.close()
    assert (report.stored, report.lost) == (2000, 0)
    with connect(keyspace=rosCas.keyspace) as other:
        assert [row.wire for row in other.getTopic("/a").rows()] == wires
    assert "was shut down: made anew" in caplog.text


@pytest.mark.parametrize("shut_down", ENDS)
def test_all_kinds_of_requests_find_the_new_session(rosCas, shut_down):
    """Threads of a program use one object: what each asks for is answered by the new session."""
    topic = rosCas.addTopic("/a")
    topic.addData(String("x"), key=1)
    uses = [
        lambda: topic.getData(1).data,
        lambda: [row.t for row in topic.rows()],
        lambda: rosCas.executeCQL("select data from a"),
        lambda: rosCas.addTopic("/b").addData(String("y"), key=2),
        lambda: topic.createIndex("data"),
        lambda: rosCas.removeTopic("/b"),
        lambda: rosCas.cassandra.execute_on_each("SELECT key FROM system.local", what="nodes"),
        lambda: rosCas.connectToKeyspace(rosCas.keyspace),
    ]
    for use in uses:
        shut_down(rosCas)
        use()


def test_a_closed_connection_makes_no_other_session(connect):
    store = connect()
    links = store.cassandra._links
    store.close()
    links.failed(1000.0)
    assert links.await_open(0.0).is_shut_down()
    assert not links._making


@pytest.mark.fault
def test_a_session_that_gets_no_answers_is_made_anew(far, proxy, connect, monkeypatch, caplog):
    """Requests of old connections are swallowed, while their heartbeats are answered."""
    monkeypatch.setattr(link, "SILENT_SEC", 1.0)
    monkeypatch.setattr(connection, "REQUEST_TIMEOUT_SEC", 1.0)
    options = {"writer_id": 9, "linger_sec": 0.0, "give_up_after_sec": 600.0}
    with far.messageWriter(**options) as writer:
        handle = writer.connect(api_connection("/a", definition_of(String), "/x"), format="binary")
        for n in range(1000):
            if n == 500:
                writer.flush()
                proxy.freeze()
            writer.write(handle, n, n, serialize(String(str(n))))
    assert writer.stats()["/a"].stored == 1000
    with connect(keyspace=far.keyspace) as other:
        found = [row.wire for row in other.getTopic("/a").rows()]
    assert found == [serialize(String(str(n))) for n in range(1000)]
    assert "has answered nothing for" in caplog.text


def test_errors_of_a_server_are_answers(far, proxy, monkeypatch, caplog):
    """One that lacks replicas answers: another session would not help."""
    monkeypatch.setattr(link, "SILENT_SEC", 1e-6)
    far.addTopic("/a").addData(String("x"), key=1)
    first = far.cassandra._links.current
    failed = proxy.catch(lambda frame: frame.opcode == EXECUTE, most=3)
    assert far.getTopic("/a").getData(1).data == "x"
    assert len(failed.frames) == 3
    assert far.cassandra._links.current is first
    assert "made anew" not in caplog.text
