# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Messages are deleted while their topic is recorded: the reported number is the deleted one."""

from __future__ import annotations

import threading
from functools import partial

import numpy as np
import pytest
from cassandra.protocol import PrepareMessage
from nodes.children import await_true
from proxy import Proxy
from std_msgs.msg import String
from suites import sparing
from threads import together

from cassandra_ros import RosCassandra
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.recording.recording import Recording
from cassandra_ros.recording.topic_settings import RecordingSettings, TopicSettings
from cassandra_ros.topics.message_writer import MessageWriter

HEADER = {
    "type": "std_msgs/String",
    "md5sum": String._md5sum,
    "message_definition": String._full_text,
    "callerid": "/talker",
    "latching": "0",
}
PREPARE = PrepareMessage.opcode
END = 2**32 * 10**9 - 1


@pytest.fixture
def recorded(rosCas, connect):
    """Records /a while the context is open, in a format; ends and reports."""
    ended = threading.Event()

    class Recorded:
        def begin(self, form):
            settings = RecordingSettings(TopicSettings(form))
            self.recording = Recording(rosCas.catalog, settings=settings)
            self.feeder = threading.Thread(target=self.feed, daemon=True)
            self.feeder.start()

        def feed(self):
            while not ended.wait(0.002):
                for _ in range(4):
                    self.recording.received("/a", HEADER, serialize(String("some text")))

        def stored(self):
            return sum(report.stored for report in self.recording.reports())

        def end(self):
            ended.set()
            self.feeder.join()
            (report,) = self.recording.close()
            assert report.lost == 0
            return report.stored

    yield Recorded()
    ended.set()


def outages(caplog):
    """What was told of a store that does not answer, but for a busy server that is late."""
    told = [text for text in caplog.messages if "has not answered" in text]
    return [text for text in told if "timed out" not in text and "timeout" not in text]


HOW = {
    "removeData": lambda store: store.getTopic("/a").removeData(0, END),
    "delete": lambda store: store.upkeep.delete(["/a"], 0, END)["/a"],
    "truncate": lambda store: store.truncateTopic("/a"),
}


@pytest.mark.parametrize("form", sparing(["packed", "ros"], kept=["packed"]))
@pytest.mark.parametrize("how", sparing(HOW, kept=["delete"]))
def test_what_is_told_is_what_is_gone(rosCas, connect, recorded, caplog, form, how):
    recorded.begin(form)
    told = 0
    with connect(keyspace=rosCas.keyspace) as other:
        for _ in range(3):
            before = recorded.stored()
            await_true(
                lambda least=before + 500: other.existTopic("/a") and recorded.stored() > least
            )
            told += HOW[how](other)
        stored = recorded.end()
        left = sum(1 for _ in other.getTopic("/a").rows())
    assert told > 1000
    assert told == stored - left
    assert outages(caplog) == []


def test_what_arrives_between_counting_and_deleting_stays(rosCas, connect, cassandra, keyspace):
    """A batch in the middle of the time range reaches the server after the range was counted."""
    with Proxy(cassandra.host, cassandra.port) as proxy:
        with RosCassandra(proxy.host, proxy.port, keyspace=keyspace) as far:
            write(rosCas, 7, [0, 1, 2, 10, 11, 12])
            deleting = proxy.catch(
                lambda frame: b"DELETE" in frame.body and frame.opcode == PREPARE, failed=False
            ).hold()
            told = []
            thread = threading.Thread(
                target=lambda: told.append(far.getTopic("/a").removeData(0, END))
            )
            thread.start()
            deleting.wait()
            write(rosCas, 8, [5, 6])
            deleting.release()
            thread.join()
    assert told == [6]
    assert [row.t for row in rosCas.getTopic("/a").rows()] == [5, 6]
    assert rosCas.getTopic("/a").countTopicData() == 2


def write(store, writer_id, times):
    connection = live_connection("/a", HEADER)
    with store.messageWriter(writer_id=writer_id, format="ros") as writer:
        handle = writer.connect(connection)
        for number, t in enumerate(times):
            writer.write(handle, t, number, serialize(String(str(t))))


@pytest.mark.suite("all", "make test asks others of its kind")
@pytest.mark.parametrize("form", ["packed", "ros"])
def test_a_recorder_says_once_that_its_table_was_replaced(rosCas, connect, recorded, caplog, form):
    recorded.begin(form)
    with connect(keyspace=rosCas.keyspace) as other:
        await_true(lambda: other.existTopic("/a") and recorded.stored() > 100)
        other.removeTopic("/a")
        await_true(lambda: "removed or replaced by another client" in caplog.text)
        await_true(lambda: other.existTopic("/a"))
    before = recorded.stored()
    await_true(lambda: recorded.stored() > before + 500)
    recorded.end()
    assert caplog.text.count("removed or replaced by another client") == 1
    assert outages(caplog) == []


@pytest.mark.parametrize("form", ["packed", "ros"])
def test_messages_written_together_stay_together_after_a_removal(
    rosCas, connect, caplog, monkeypatch, form
):
    """The writer writes one by one only those messages that the removed table did not take."""
    single = []
    write_one = MessageWriter.write
    monkeypatch.setattr(
        MessageWriter, "write", lambda self, *args: (single.append(1), write_one(self, *args))[1]
    )
    numbers = np.arange(100)
    wires = [serialize(String(str(n))) for n in numbers]
    with rosCas.messageWriter(format=form) as writer:
        handle = writer.connect(live_connection("/a", HEADER))
        writer.write_run(handle, numbers, numbers, wires)
        writer.flush()
        with connect(keyspace=rosCas.keyspace) as other:
            other.removeTopic("/a")
        writer.write_run(handle, numbers + 100, numbers + 100, wires)
        writer.flush()
        single.clear()
        for first in range(200, 1000, 100):
            writer.write_run(handle, numbers + first, numbers + first, wires)
    assert single == []
    assert [row.t for row in rosCas.getTopic("/a").rows()] == list(range(100, 1000))
    assert caplog.text.count("removed or replaced by another client") == 1


def test_one_thread_makes_the_table_after_a_removal(rosCas, connect, monkeypatch):
    """The others wait for it; it is ready for large messages if the removed one was."""
    made = []
    make = MessageWriter.connect
    with rosCas.messageWriter(format="ros") as writer:
        handle = writer.connect(live_connection("/a", HEADER))
        second = writer.connect(live_connection("/a", {**HEADER, "callerid": "/second"}))
        writer.write(handle, 0, 0, serialize(String("x" * 600_000)))
        writer.flush()
        with connect(keyspace=rosCas.keyspace) as other:
            other.removeTopic("/a")
        writer.write(handle, 1, 1, serialize(String("y")))
        writer.flush()
        assert writer.current(handle).table.has_chunks
        monkeypatch.setattr(
            MessageWriter,
            "connect",
            lambda self, *args, **options: (made.append(1), make(self, *args, **options))[1],
        )
        together(*[partial(writer.current, second)] * 4)
        assert len(made) == 1
        assert writer.current(second).table is writer.current(handle).table


@pytest.mark.parametrize("form", ["packed", "ros"])
def test_no_message_is_lost_when_the_keyspace_is_dropped_before_a_bucket(rosCas, cql, form):
    """The writer asks the directory of the new bucket, which went with the keyspace."""
    losses = []
    with rosCas.messageWriter(
        format=form, on_loss=lambda topic, number, exc: losses.append(exc)
    ) as writer:
        handle = writer.connect(live_connection("/a", HEADER))
        writer.write(handle, 0, 0, serialize(String("gone")))
        writer.flush()
        cql.execute(f"DROP KEYSPACE {rosCas.keyspace}")
        later = handle.table.metadata.bucket_ns
        for number in range(1, 4):
            writer.write(handle, number * later, number, serialize(String("kept")))
    assert losses == []
    assert [row.t for row in rosCas.getTopic("/a").rows()] == [later, 2 * later, 3 * later]


@pytest.mark.suite("all", "it kills or cuts something, and waits")
def test_a_recording_goes_on_after_its_keyspace_was_dropped(rosCas, connect, recorded, cql):
    """The keyspace is made anew with its side tables, and the topic in it."""
    recorded.begin("ros")
    await_true(lambda: recorded.stored() > 100)
    cql.execute(f"DROP KEYSPACE {rosCas.keyspace}")
    names = "SELECT table_name FROM system_schema.tables WHERE keyspace_name = %s"
    await_true(lambda: any(n[:2] == "t_" for (n,) in cql.execute(names, (rosCas.keyspace,))))
    with connect(keyspace=rosCas.keyspace) as other:
        await_true(lambda: other.existTopic("/a") and other.getTopic("/a").countTopicData() > 100)
    recorded.end()
