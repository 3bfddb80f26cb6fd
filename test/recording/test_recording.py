# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A recording without ROS: every received message is stored, or counted with a reason."""

from __future__ import annotations

import functools
import itertools
import threading
import time
from concurrent.futures import Future
from functools import partial
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from nodes.children import await_true
from nodes.raw_publisher import header_of, message
from proxy import BATCH, Proxy
from sensor_msgs.msg import Image, Imu
from std_msgs.msg import Header, String
from suites import sparing
from threads import together

from cassandra_ros import RosCassandra
from cassandra_ros.errors import AccessDenied, ClockNotSet, ConnectionFailed, StoreUnavailable
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.recording import message_buffer
from cassandra_ros.recording import recording as recording_module
from cassandra_ros.recording.losses import LossLog
from cassandra_ros.recording.message_buffer import (
    ITEM_BYTES,
    Buffer,
    BufferedMessage,
    Feed,
    MessageSource,
    starts_with_header,
)
from cassandra_ros.recording.recording import Recording
from cassandra_ros.recording.topic_counts import Counts
from cassandra_ros.recording.topic_settings import RecordingSettings, TopicSettings
from cassandra_ros.store.tables.context_blob import NodeGraph, RunContext
from cassandra_ros.store.tables.registry import LossKind

T0 = 1_400_000_000 * 10**9


def text(n):
    return message(String(str(n)))


def by_topic(reports):
    return {report.topic: report for report in reports}


def item(n, size=0):
    return BufferedMessage(None, n, n, bytes(size))


def test_buffer_drops_the_oldest():
    buffer = Buffer(3 * (ITEM_BYTES + 10))
    assert [buffer.put(item(n, 10)) for n in range(3)] == [[], [], []]
    assert [dropped.t for dropped in buffer.put(item(3, 10))] == [0]
    taken = buffer.next_messages(10, 10**6, 0)
    assert [i.t for i in taken] == [1, 2, 3]
    # A message that was taken and not released still counts.
    assert buffer.put(item(4, 10)) == []
    assert [dropped.t for dropped in buffer.put(item(5, 10))] == [4]
    for one in taken:
        buffer.release(one)
    assert buffer.held_bytes == ITEM_BYTES + 10


@pytest.mark.parametrize(("bound", "kept"), [(0, 2), (-1, 1)])
def test_buffer_is_filled_to_its_bound_and_no_byte_more(bound, kept):
    buffer = Buffer(2 * (ITEM_BYTES + 10) + bound)
    for number in range(5):
        buffer.put(item(number, 10))
        assert buffer.held_bytes == min(kept, number + 1) * (ITEM_BYTES + 10)


def test_buffer_takes_one_message_of_any_size():
    buffer = Buffer(1000)
    buffer.put(item(0, 100))
    assert [dropped.t for dropped in buffer.put(item(1, 10**6))] == [0]
    assert [i.t for i in buffer.next_messages(10, 10**9, 0)] == [1]
    unbounded = Buffer(0)
    assert not any(unbounded.put(item(n, 10**5)) for n in range(100))


def test_buffer_ends():
    buffer = Buffer(0)
    buffer.put(item(0))
    buffer.close()
    assert not buffer.ended
    assert len(buffer.next_messages(10, 10**6, 5)) == 1
    assert buffer.ended
    assert buffer.next_messages(10, 10**6, 0) == []


def gaps(*runs):
    """Gaps after runs of sequence numbers, each over a connection of its own."""
    counts = Counts(LossLog("", 1))
    source = MessageSource(live_connection("/t", header_of(Imu)))
    for run in runs:
        feed = Feed({}, source)
        for number in run:
            wire = message(Imu(header=Header(seq=number)))
            counts.received("/t", wire)
            counts.attribute("/t", wire, feed)
    return counts.reports({})[0].gaps


@pytest.mark.parametrize("size", [600_000, 500_000])
def test_messages_that_no_row_takes_are_foreseen(size):
    source = MessageSource(live_connection("/t", header_of(Image)))
    for n in range(3):
        source.hold(BufferedMessage(source, 0, n, bytes(size)))
    assert source.lengths().large == (size == 600_000)


def test_gaps_before_us():
    assert gaps(range(5, 10)) == 0
    assert gaps([5, 6, 9, 10, 12]) == 3
    assert gaps([1, 2], [5, 6]) == 2  # lost while the connection was down
    assert gaps([100, 101], [0, 1, 2]) == 0  # the publisher began anew
    assert gaps([2**32 - 2, 2**32 - 1, 0, 1]) == 0
    assert gaps([0, 0, 0]) is None  # not numbered
    assert gaps([1, 2, 700, 3, 701, 4]) is None  # two counters behind one connection
    assert gaps(range(0, 90_000, 7)) is None  # sparse throughout: no counter of messages
    assert gaps([*range(0, 20, 2), *range(20, 60)]) == 10  # a counter of which some were lost


def test_only_a_header_that_comes_first_is_read():
    assert starts_with_header("# comment\n\nint32 A=5\nHeader header  # x\nint32 x")
    assert starts_with_header("std_msgs/Header h")
    assert not starts_with_header("int32 x\nHeader header")
    assert not starts_with_header("")
    assert not starts_with_header("=" * 80 + "\nMSG: std_msgs/Header\nHeader h")


@given(st.text())
def test_any_definition_text(definition):
    starts_with_header(definition)


def test_messages_are_stored_as_they_came(rosCas):
    settings = RecordingSettings(TopicSettings("ros"))
    recorder = Recording(rosCas.catalog, settings=settings, node="husky")
    header = header_of(String)
    before = time.time_ns()
    for n in range(500):
        recorder.received("/text", header, text(n))
    (report,) = recorder.close()
    assert (report.received, report.stored, report.lost, report.gaps) == (500, 500, 0, None)
    rows = list(rosCas.getTopic("/text").rows())
    assert [row.wire for row in rows] == [text(n) for n in range(500)]
    assert before <= rows[0].t <= rows[-1].t <= time.time_ns()
    assert {row.node for row in rows} == {"husky"}
    assert rows[0].connection == live_connection("/text", header)
    assert report.types == ("std_msgs/String",)
    (run,) = rosCas.runs()
    assert (run.kind, run.node, run.stored) == ("recording", "husky", {"/text": 500})
    recorder.received("/text", header, text(0))
    assert recorder.close() == [report]  # twice is harmless, and nothing is taken any more


def test_stamps_and_counters_have_one_order(rosCas):
    clock_lock = threading.Lock()
    ticks = iter(range(T0, T0 + 10**9))

    def clock():
        with clock_lock:
            return next(ticks) // 10 * 10  # ten messages share a stamp

    recorder = Recording(rosCas.catalog, clock=clock)

    def publish(name):
        header = header_of(String, callerid=name)
        for n in range(300):
            recorder.received("/text", header, text(f"{name}{n}"))

    together(*(partial(publish, f"/p{n}") for n in range(5)))
    (report,) = recorder.close()
    assert (report.stored, report.lost) == (1500, 0)
    rows = list(rosCas.getTopic("text").rows())
    assert [row.seq for row in rows] == sorted(row.seq for row in rows)
    for name in range(5):
        sent = [text(f"/p{name}{n}") for n in range(300)]
        assert [row.wire for row in rows if row.wire in set(sent)] == sent


def test_what_does_not_fit_is_counted(cassandra, keyspace, rosCas):
    with Proxy(cassandra.host, cassandra.port) as proxy:
        held = proxy.catch(lambda frame: frame.opcode == BATCH, failed=False).hold()
        with RosCassandra(proxy.host, proxy.port, keyspace=keyspace) as store:
            recorder = Recording(store.catalog, buffer_bytes=100_000)
            header = header_of(String)
            for n in range(2000):
                recorder.received("/text", header, text(n))
            held.release()
            (report,) = recorder.close()
    assert report.received == 2000 == report.stored + report.lost
    assert report.lost > 0
    assert report.reasons == {LossKind.BUFFER_FULL: report.lost}
    losses = rosCas.losses()  # one, or another where the store was told of one already
    assert {(loss.topic, loss.kind) for loss in losses} == {("/text", LossKind.BUFFER_FULL)}
    assert sum(loss.count for loss in losses) == report.lost
    assert all(loss.first_ns <= loss.last_ns for loss in losses)
    assert rosCas.getTopic("/text").countTopicData() == report.stored


def test_the_limit(rosCas):
    recorder = Recording(rosCas.catalog, limit=3)
    for n in range(10):
        recorder.received("/a", header_of(String), text(n))
    recorder.received("/b", header_of(String), text(0))
    assert recorder.is_complete("/a")
    assert not recorder.is_complete("/b")
    reports = by_topic(recorder.close())
    assert (reports["/a"].stored, reports["/b"].stored) == (3, 1)
    assert [row.wire for row in rosCas.getTopic("/a").rows()] == [text(n) for n in range(3)]


def test_a_clock_that_is_not_set(rosCas):
    def clock():
        raise ClockNotSet("no /clock")

    recorder = Recording(rosCas.catalog, clock=clock)
    recorder.received("/text", header_of(String), text(0))
    (report,) = recorder.close()
    assert (report.received, report.stored) == (1, 0)
    assert report.reasons == {LossKind.NO_CLOCK: 1}
    assert report.losses[LossKind.NO_CLOCK].detail == "no /clock"


def test_time_that_goes_back_is_told(rosCas, caplog):
    """Simulated time starts again: messages keep the times that they have."""
    times = [T0 + 100 * 10**9, T0 + 101 * 10**9, T0, T0 + 10**9]
    ticks = iter(times)
    recorder = Recording(rosCas.catalog, clock=lambda: next(ticks))
    header = header_of(String)
    for n in range(4):
        recorder.received("/text", header, text(n))
    (report,) = recorder.close()
    assert (report.stored, report.lost) == (4, 0)
    assert [row.t for row in rosCas.getTopic("/text").rows()] == sorted(times)
    assert caplog.text.count("time went back by 101.000 s") == 1


def test_a_context_is_kept_when_the_store_is_back(rosCas, monkeypatch):
    recorder = Recording(rosCas.catalog)
    registry = rosCas.catalog.keyspace.registry
    put, tries = registry.put_context, []

    def away(*context):
        tries.append(context)
        if len(tries) == 1:
            raise StoreUnavailable("away")
        put(*context)

    monkeypatch.setattr(registry, "put_context", away)
    recorder.put_context(RunContext({"robot": "husky"}, NodeGraph({}, {}, {}, {})))
    await_true(lambda: tries)
    recorder.close()
    assert rosCas.runContext(recorder.writer_id).params == {"robot": "husky"}


@pytest.mark.parametrize(
    "context",
    [
        RunContext({"deep": functools.reduce(lambda inner, _: [inner], range(300), 0)}),
        RunContext({"robot": "husky"}),
    ],
    ids=["invalid", "denied"],
)
def test_a_context_that_cannot_be_stored_keeps_no_loss_back(rosCas, monkeypatch, caplog, context):
    monkeypatch.setattr(recording_module, "SAVE_SEC", 0.01)
    registry = rosCas.catalog.keyspace.registry
    if "deep" not in context.params:

        def denied(*context):
            raise AccessDenied("no right to modify cr_context", "MODIFY")

        monkeypatch.setattr(registry, "put_context", denied)
    recorder = Recording(rosCas.catalog, name="drive")
    recorder.put_context(context)
    recorder.lose("/text", LossKind.UNHEARD, 0, T0, T0)
    await_true(lambda: rosCas.losses())  # during the recording
    recorder.lose("/text", LossKind.NOT_READ, 1, T0, T0)
    recorder.close()
    assert {loss.kind for loss in rosCas.losses()} == {LossKind.UNHEARD, LossKind.NOT_READ}
    assert caplog.text.count("the parameters of run drive are not stored: ") == 1


def test_a_context_that_comes_too_late_is_told(rosCas, monkeypatch, caplog):
    registry = rosCas.catalog.keyspace.registry

    def away(*context):
        raise StoreUnavailable("away")

    monkeypatch.setattr(registry, "put_context", away)
    recorder = Recording(rosCas.catalog, name="drive")
    recorder.put_context(RunContext({"robot": "husky"}))
    recorder.close()
    assert "the parameters of run drive are not stored: the store did not answer" in caplog.text
    late = Recording(rosCas.catalog, name="walk")
    late.close()
    late.put_context(RunContext({"robot": "husky"}))
    assert "the parameters of run walk came after its end" in caplog.text


def test_what_is_given_up_is_counted(far, proxy, rosCas):
    held = proxy.catch(lambda frame: frame.opcode == BATCH, failed=False).hold()
    recorder = Recording(far.catalog)
    recorder.received("/text", header_of(String), text(0))
    (report,) = recorder.abandon()
    assert (report.stored, report.reasons) == (0, {LossKind.AT_END: 1})
    await_true(rosCas.losses)  # the loss is stored meanwhile
    assert [(loss.kind, loss.count) for loss in rosCas.losses()] == [(LossKind.AT_END, 1)]
    held.release()
    recorder.close()


@pytest.mark.suite("all", "it waits for seconds")
@pytest.mark.parametrize(("failures", "lost"), [(4, 0), (2**31, 1)])
def test_only_the_end_gives_up(cassandra, keyspace, monkeypatch, failures, lost):
    """A request is retried without limit in the recording, and for a limited time after it."""
    monkeypatch.setattr(recording_module, "GIVE_UP_SEC", 0.3)
    with Proxy(cassandra.host, cassandra.port) as proxy:
        failed = proxy.catch(lambda frame: frame.opcode == BATCH, most=failures)
        with RosCassandra(proxy.host, proxy.port, keyspace=keyspace) as store:
            recorder = Recording(store.catalog)
            recorder.received("/text", header_of(String), text(0))
            failed.wait(4)  # tried for 0.7 s
            if not lost:
                await_true(lambda: recorder.reports()[0].stored)
            assert recorder.reports()[0].lost == 0
            (report,) = recorder.close()
    assert (report.stored, report.lost) == (1 - lost, lost)


@pytest.mark.parametrize(
    "header",
    [
        {},
        {"type": "std_msgs/String"},
        {"type": "*", "md5sum": "*", "message_definition": ""},
        {"type": "no such", "md5sum": "x", "message_definition": "rubbish rubbish rubbish"},
        {"type": "std_msgs/String", "md5sum": "0" * 32, "message_definition": "string data"},
        {"type": "a/B", "md5sum": "1" * 32, "message_definition": "string \udcb0C"},
        header_of(String, latching=None, callerid=None, message_definition=None),
    ],
)
def test_headers_that_lack_or_lie(rosCas, header):
    recorder = Recording(rosCas.catalog, settings=RecordingSettings(TopicSettings("ros")))
    wires = [text(0), b"", bytes(range(256))]
    for wire in wires:
        recorder.received("/text", header, wire)
    recorder.received("/good", header_of(String), text(0))
    reports = by_topic(recorder.close())
    assert (reports["/text"].stored, reports["/text"].lost) == (3, 0)
    assert reports["/good"].stored == 1
    rows = list(rosCas.getTopic("/text").rows())
    assert [row.wire for row in rows] == wires
    assert rows[0].connection == live_connection("/text", header)


@pytest.mark.suite("all", "it waits for seconds")
@pytest.mark.fault
@pytest.mark.parametrize("how", sparing(["truncateTopic", "removeTopic"], kept=["removeTopic"]))
def test_a_topic_that_is_emptied_while_it_is_recorded(rosCas, connect, keyspace, how):
    """Messages not stored before go into the topic's next table: none is lost or stored twice."""
    recorder = Recording(rosCas.catalog)
    sent, stop = [], threading.Event()

    def publish():
        pads = (b"", b"", b"x" * 600_000, b"")
        while not stop.wait(0.002):
            # A slow server must not fill the buffer: messages that do not fit are lost anyway.
            while recorder.held_bytes > 64_000_000 and not stop.wait(0.01):
                pass
            sent.append(text(len(sent)) + pads[len(sent) % 200 // 50])
            recorder.received("/text", header_of(String), sent[-1])

    publishing = threading.Thread(target=publish)
    publishing.start()
    ended = []
    with connect(keyspace=keyspace) as other:
        for _ in range(3):
            stored = recorder.reports()[0].stored if recorder.reports() else 0
            await_true(lambda: any(r.stored > stored + 100 for r in recorder.reports()))  # noqa: B023
            getattr(other, how)("/text")
            ended.append(len(sent))
    stop.set()
    publishing.join()
    (report,) = recorder.close()
    assert (report.stored, report.lost) == (len(sent), 0)
    rosCas.catalog.keyspace.schema.tables(fresh=True)
    numbers = {wire: number for number, wire in enumerate(sent)}
    found = [numbers[row.wire] for row in rosCas.getTopic("/text").rows()]
    assert found == sorted(set(found))  # nothing twice
    # Messages that an older table had acknowledged may be gone, between others that are stored.
    assert [n for n in found if n >= ended[-1]] == list(range(ended[-1], len(sent)))
    assert rosCas.getTopic("/text").countTopicData() == len(found)


def test_a_topic_that_cannot_have_a_table(rosCas):
    recorder = Recording(rosCas.catalog, clock=itertools.count(T0).__next__)
    recorder.received("", header_of(String), text(0))
    recorder.received("/good", header_of(String), text(0))
    reports = by_topic(recorder.close())
    assert (reports[""].stored, reports[""].reasons) == (0, {LossKind.NO_TABLE: 1})
    why = reports[""].losses[LossKind.NO_TABLE]
    assert "not a topic name" in why.detail
    assert (why.first_ns, why.last_ns) == (T0, T0)
    assert reports["/good"].stored == 1


def test_the_first_second_fixes_the_bucket(rosCas, monkeypatch):
    # A machine that stands still meanwhile would make the messages fewer in a second.
    monkeypatch.setattr(message_buffer, "time", SimpleNamespace(monotonic=lambda: 0.0))
    ticks = itertools.count(T0, 10**5)  # ten thousand a second
    recorder = Recording(rosCas.catalog, clock=ticks.__next__)
    imu = message(Imu())
    header = header_of(Imu)
    for _ in range(6000):
        recorder.received("/fast", header, imu)
    # After it: otherwise the table of this one would be made first, and the time would count.
    recorder.received("/slow", header_of(String), text(0))
    recorder.close()
    lengths = {info.topic: info.bucket_ns for info in rosCas.info()}
    assert lengths["/slow"] == 600 * 10**9
    assert lengths["/fast"] <= 10 * 10**9


def test_what_comes_before_the_store_answers_is_stored_when_it_does(rosCas):
    """A buffer that is nearly full loses no message while the tables are made."""
    store, ticks = Future(), itertools.count(T0, 10**7)
    recorder = Recording(store, clock=lambda: next(ticks), buffer_bytes=1_000_000)
    headers = {f"/{name}": header_of(String) for name in "abcd"}
    for n in range(600):
        for topic, header in headers.items():
            recorder.received(topic, header, text(n))
    assert not recorder.opened
    assert recorder.held_bytes > 700_000
    assert [report.stored for report in recorder.reports()] == [0, 0, 0, 0]
    store.set_result(rosCas.catalog)
    reports = recorder.close()
    assert [(r.received, r.stored, r.lost) for r in reports] == [(600, 600, 0)] * 4
    for topic in headers:
        assert [row.wire for row in rosCas.getTopic(topic).rows()] == [text(n) for n in range(600)]
    # The rate is 25 messages per second, not the rate at which they leave the buffer.
    assert {info.bucket_ns for info in rosCas.info()} == {600 * 10**9}
    assert rosCas.losses() == []


def test_what_does_not_fit_before_the_store_answers_is_a_loss(rosCas):
    store, ticks = Future(), itertools.count(T0, 10**9)
    recorder = Recording(store, clock=lambda: next(ticks), buffer_bytes=100_000)
    header = header_of(String)
    for n in range(1000):
        recorder.received("/a", header, text(n))
    lost = recorder.reports()[0].lost
    assert 600 < lost < 1000
    store.set_result(rosCas.catalog)
    (report,) = recorder.close()
    assert (report.stored, report.reasons) == (1000 - lost, {LossKind.BUFFER_FULL: lost})
    rows = list(rosCas.getTopic("/a").rows())
    assert [row.wire for row in rows] == [text(n) for n in range(lost, 1000)]
    (loss,) = rosCas.losses()
    assert (loss.topic, loss.count) == ("/a", lost)
    assert (loss.first_ns, loss.last_ns) == (T0, T0 + (lost - 1) * 10**9)


def test_a_store_that_never_answers():
    """Messages received before and after are lost, with the reason."""
    store = Future()
    recorder = Recording(store)
    header = header_of(String)
    recorder.received("/a", header, text(0))
    assert recorder.problem == ""
    store.set_exception(ConnectionFailed("no Cassandra answers at mars"))
    await_true(lambda: recorder.problem)
    assert recorder.problem == "no Cassandra answers at mars"
    recorder.received("/a", header, text(1))
    (report,) = recorder.close()
    assert (report.received, report.stored) == (2, 0)
    assert report.reasons == {LossKind.AT_END: 2}
    assert "mars" in report.losses[LossKind.AT_END].detail


@pytest.mark.parametrize("answers", [True, False])
def test_the_end_waits_for_a_store_that_has_not_answered_yet(rosCas, monkeypatch, answers):
    if not answers:
        monkeypatch.setattr(recording_module, "GIVE_UP_SEC", 0.3)
    store = Future()
    recorder = Recording(store)
    recorder.received("/a", header_of(String), text(0))
    assert not recorder.stop(0.0)
    recorder.received("/a", header_of(String), text(1))  # after the end
    if answers:
        store.set_result(rosCas.catalog)
    (report,) = recorder.close()
    reasons = {} if answers else {LossKind.AT_END: 1}
    assert (report.received, report.stored, report.reasons) == (1, int(answers), reasons)


def test_a_recording_without_messages_ends_without_a_store():
    recorder = Recording(Future())
    recorder.expect("/a")
    (report,) = recorder.close()
    assert (report.received, report.lost) == (0, 0)


@pytest.mark.suite("all", "it waits for seconds")
def test_topics_with_a_table_go_on_while_that_of_another_cannot_be_made(cassandra, keyspace):
    """Beyond half of the buffer only messages of a topic that gets no table are dropped."""
    held = threading.Event()
    with RosCassandra(cassandra.host, cassandra.port, keyspace=keyspace) as store:
        recorder = Recording(store.catalog, buffer_bytes=100_000)
        make = recorder._connect

        def connect(source):
            if source.topic == "/none" and not held.is_set():
                raise StoreUnavailable("no table yet")
            return make(source)

        recorder._tables._connect = connect
        none, good = header_of(String), header_of(String)
        for n in range(50):
            recorder.received("/none", none, text(n))
        await_true(lambda: any(source.told for source in recorder._waiting))
        for n in range(50, 300):  # all together fit into the buffer
            recorder.received("/none", none, text(n))
        recorder.received("/good", good, text(0))
        await_true(lambda: by_topic(recorder.reports())["/good"].stored)
        held.set()
        reports = by_topic(recorder.close())
    assert (reports["/good"].stored, reports["/good"].lost) == (1, 0)
    assert reports["/none"].stored + reports["/none"].lost == 300
    assert reports["/none"].reasons == {LossKind.TABLE_LATE: reports["/none"].lost}
    assert reports["/none"].lost > 0
