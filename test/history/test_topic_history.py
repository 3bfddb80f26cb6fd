# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Stored messages from a real store, then live messages that the test hands in: no ROS."""

from __future__ import annotations

import logging
import struct
import threading
import time

import pytest
from nodes.children import await_true
from rosgraph_msgs.msg import Log
from std_msgs.msg import Header, String, UInt32

from cassandra_ros.errors import ClockNotSet, RunNotFound, StoreUnavailable
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.playing.history import live_queue, topic_history
from cassandra_ros.playing.history.live_queue import LiveQueue
from cassandra_ros.playing.history.stored_past import StoredPast
from cassandra_ros.playing.history.topic_history import History
from cassandra_ros.store.tables.registry import Loss, LossKind, Run

TOPIC = "/joined"
MS = 1_000_000


def fields(name="/talker", msg_class=UInt32, latching=False):
    return {
        "callerid": name,
        "latching": "1" if latching else "0",
        "md5sum": msg_class._md5sum,
        "message_definition": msg_class._full_text,
        "topic": TOPIC,
        "type": msg_class._type,
    }


def numbered(n):
    return struct.pack("<I", n)


@pytest.fixture(autouse=True)
def patience(monkeypatch):
    times = {"SETTLE": 0.15, "PATIENCE": 0.6, "DOUBT": 0.3, "POLL": 0.02, "MOST": 600.0}
    for name, seconds in times.items():
        monkeypatch.setattr(topic_history, f"{name}_SEC", seconds)
    # Also where the machine stands still for a while: who writes is seen to write.
    monkeypatch.setattr("cassandra_ros.store.rows.writer.IDLE_SEC", 600.0)
    monkeypatch.setattr("cassandra_ros.playing.history.stored_past.RUNNING_REPORT_SEC", 600.0)


class Stage:
    """A recorder and a subscriber that hear the same publishers; the test sets the times."""

    def __init__(self, store, topic=TOPIC):
        self.store, self.topic = store, topic
        self.now = self.begin = time.time_ns()
        self.writers, self.counter = {}, 0
        self.queue = self.history = None
        self.heard = []

    def stored(self, header, wire, t, writer=1, node=""):
        if (writer, node) not in self.writers:
            run = Run(node, writer, "recording")
            self.writers[writer, node] = self.store.messageWriter(
                writer_id=writer, nodeID=node, format="binary", run=run, linger_sec=0.01
            )
        out = self.writers[writer, node]
        handle = out.connect(live_connection(self.topic, header))
        self.counter += 1
        out.write(handle, t, self.counter, wire)

    def flush(self):
        for writer in self.writers.values():
            writer.flush()

    def end(self):
        """End the recorders."""
        for writer in self.writers.values():
            writer.close()
        self.writers = {}

    def subscribe(self, t, bound=10**6, since=0, connected=lambda: True):
        self.now = t
        self.queue = LiveQueue(bound, lambda: self.now)
        past = StoredPast(self.store.catalog, self.topic)
        self.history = History(past, self.queue, lambda now: since, connected)

    def live(self, header, wire, t):
        self.now = t
        self.queue.put(header, wire)

    def listen(self, slow=0.0):
        def take():
            for heard in self.history.messages():
                self.heard.append(heard)
                time.sleep(slow)

        self.thread = threading.Thread(target=take, daemon=True)
        self.thread.start()

    def result(self, count, name=None):
        """Return the messages once ``count`` came and no more followed for a moment."""
        deadline = time.monotonic() + 180
        while len(self.heard) < count or not self.history.live:
            assert time.monotonic() < deadline, (len(self.heard), count)
            assert self.thread.is_alive()
            time.sleep(0.01)
        time.sleep(0.05)
        return [h.wire for h in self.heard if name in (None, h.header["callerid"])]

    def close(self):
        if self.queue is not None:
            self.queue.close()
            self.thread.join(180)
            assert not self.thread.is_alive()
        self.end()


@pytest.fixture
def stage(rosCas):
    made = Stage(rosCas)
    yield made
    made.close()


def talk(stage, header, range_stored, range_live, period=10 * MS, wire=numbered, lag=2 * MS):
    for n in range_stored:
        stage.stored(header, wire(n), stage.begin + n * period)
    stage.flush()
    for n in range_live:
        stage.live(header, wire(n), stage.begin + n * period + lag)


def test_stored_ones_up_to_the_first_live_one(stage):
    stage.subscribe(stage.begin + 3000 * MS)
    talk(stage, fields(), range(400), range(300, 450))
    stage.listen()
    assert stage.result(450) == list(map(numbered, range(450)))
    assert [h.stored for h in stage.heard] == [True] * 300 + [False] * 150
    assert stage.heard[7].t == stage.begin + 70 * MS
    assert stage.heard[7].header == fields()
    stage.live(fields(), b"more", stage.now)
    assert stage.result(451)[-1] == b"more"


def test_a_recorder_that_is_behind_is_waited_for(stage, monkeypatch):
    monkeypatch.setattr(topic_history, "PATIENCE_SEC", 600.0)
    stage.subscribe(stage.begin + 3000 * MS)
    talk(stage, fields(), range(250), range(300, 350))
    stage.listen()
    time.sleep(0.7)
    assert not stage.history.live
    talk(stage, fields(), range(250, 300), ())
    talk(stage, fields(), range(300, 345), ())  # when all before the first live one is there
    assert stage.result(350) == list(map(numbered, range(350)))


def test_what_is_on_its_way_into_the_store_is_waited_for(stage, monkeypatch):
    """Rows become visible in another order than that in which they were sent."""
    monkeypatch.setattr(topic_history, "SETTLE_SEC", 600.0)
    stage.subscribe(stage.begin + 3000 * MS)
    talk(stage, fields(), [*range(295), *range(300, 320)], range(300, 350))
    looks, read_end = [], stage.history._read_end
    monkeypatch.setattr(
        stage.history, "_read_end", lambda reach: looks.append(reach) or read_end(reach)
    )
    stage.listen()
    await_true(lambda: len(looks) > 2)
    assert not stage.history.live
    talk(stage, fields(), range(295, 300), ())
    before = len(looks)
    await_true(lambda: len(looks) > before + 1)  # one that began since has ended
    monkeypatch.setattr(topic_history, "SETTLE_SEC", 0.0)
    assert stage.result(350) == list(map(numbered, range(350)))


def test_what_is_stored_after_the_first_live_one_came(stage, monkeypatch, caplog):
    """A batch that failed is sent again after the past was read: its rows come late, each once."""
    caplog.set_level(logging.WARNING, "cassandra_ros")
    monkeypatch.setattr(topic_history, "LATE_SEC", (1e9, 1e9))
    stage.subscribe(stage.begin + 3000 * MS)
    talk(stage, fields(), [*range(280), *range(285, 295), *range(305, 320)], range(300, 350))
    stage.listen()
    past = list(map(numbered, [*range(280), *range(285, 295)]))
    assert stage.result(340) == past + list(map(numbered, range(300, 350)))
    talk(stage, fields(), range(295, 305), ())
    stage.history._late_sec[0] = 0.0
    assert stage.result(345)[340:] == list(map(numbered, range(295, 300)))
    talk(stage, fields(), range(280, 285), ())
    stage.live(fields(), numbered(350), stage.begin + 3500 * MS)
    stage.history._late_sec[0] = 0.0
    got = stage.result(351)
    assert sorted(got) == sorted(map(numbered, range(351)))
    assert "5 messages" in caplog.text and "stored late" in caplog.text
    assert not stage.history.lost


def test_what_is_stored_while_the_place_is_found(stage, monkeypatch):
    stage.subscribe(stage.begin + 3000 * MS)
    talk(stage, fields(), [*range(298), *range(305, 320)], range(300, 350))
    go_over = stage.queue.join

    def store_and_go_over(epoch):
        talk(stage, fields(), range(298, 305), ())
        return go_over(epoch)

    monkeypatch.setattr(stage.queue, "join", store_and_go_over)
    stage.listen()
    assert stage.result(350) == list(map(numbered, range(350)))


def test_memory_of_a_long_past(stage, monkeypatch):
    monkeypatch.setattr(topic_history, "ROOM", 50)
    stage.subscribe(stage.begin + 300_000 * MS)
    talk(stage, fields(), range(1500), range(1499, 1501), 200 * MS)
    most = 0
    for count, heard in enumerate(stage.history.messages()):
        assert heard.wire == numbered(count)
        most = max(most, len(stage.history._done))
        if count == 1500:
            break
    assert most < 400
    stage.queue = None


def test_equal_messages_and_equal_stamps(stage):
    stage.subscribe(stage.begin + 3000 * MS)
    for n in range(300):  # three at a time
        stage.stored(fields(), numbered(n), stage.begin + n // 3 * 30 * MS)
    talk(stage, fields("/constant"), range(350), range(290, 400), wire=lambda n: b"same")
    for n in range(290, 350):
        stage.live(fields(), numbered(n), stage.begin + n * 10 * MS)
    stage.listen()
    stage.result(750)
    assert stage.result(750, "/talker") == list(map(numbered, range(350)))
    assert stage.result(750, "/constant") == [b"same"] * 400


def test_publishers_that_come_and_go_in_the_order_of_reception(stage):
    old, other, new = fields("/old"), fields("/other"), fields("/new")
    for n in range(200):
        stage.stored(old, numbered(n), stage.begin + n * 10 * MS)
        stage.stored(other, numbered(n), stage.begin + n * 10 * MS + 5 * MS)
    stage.subscribe(stage.begin + 1500 * MS)
    for n in range(150, 220):
        stage.live(other, numbered(n), stage.begin + n * 10 * MS + 6 * MS)
        if n >= 190:
            stage.live(new, numbered(n), stage.begin + n * 10 * MS + 8 * MS)
            if n < 200:
                stage.stored(new, numbered(n), stage.begin + n * 10 * MS + 7 * MS)
    stage.flush()
    stage.listen()
    # The old one was heard by the recorder alone.
    assert stage.result(450, "/old") == list(map(numbered, range(200)))
    assert stage.result(450, "/other") == list(map(numbered, range(220)))
    assert stage.result(450, "/new") == list(map(numbered, range(190, 220)))
    times = [heard.t for heard in stage.heard]
    assert times == sorted(times)


def test_a_latched_message_that_is_stored_comes_once(stage):
    map_header, quiet = fields("/map", latching=True), fields("/quiet", latching=True)
    stage.stored(map_header, b"map1", stage.begin - 3600_000 * MS)
    stage.stored(map_header, b"map2", stage.begin - 60_000 * MS)
    stage.stored(quiet, b"quiet", stage.begin - 7200_000 * MS)
    stage.flush()
    stage.subscribe(stage.begin, since=stage.begin - 7000_000 * MS)
    stage.live(map_header, b"map2", stage.begin + 5 * MS)
    stage.live(quiet, b"quiet", stage.begin + 5 * MS)  # from before since
    stage.live(map_header, b"map3", stage.begin + 500 * MS)
    stage.stored(map_header, b"map3", stage.begin + 500 * MS)
    stage.flush()
    stage.listen()
    assert stage.result(4, "/map") == [b"map1", b"map2", b"map3"]
    assert stage.result(4, "/quiet") == [b"quiet"]


def test_a_latching_publisher_that_begins_now_and_repeats_itself(stage):
    header = fields("/state", latching=True)
    stage.subscribe(stage.begin)
    talk(stage, header, range(5), range(5), 200 * MS, wire=lambda n: b"on")
    stage.listen()
    assert stage.result(5) == [b"on"] * 5


def test_a_recorder_that_came_later_than_we(stage):
    stage.subscribe(stage.begin)
    talk(stage, fields(), range(50, 80), range(100))
    talk(stage, fields("/constant"), range(50, 80), range(100), wire=lambda n: b"same")
    stage.listen()
    assert stage.result(200, "/talker") == list(map(numbered, range(100)))
    assert stage.result(200, "/constant") == [b"same"] * 100


def test_a_recorder_that_ended_before(stage, caplog):
    caplog.set_level(logging.WARNING, "cassandra_ros")
    talk(stage, fields(), range(20), ())
    stage.end()
    stage.subscribe(stage.begin + 10_000 * MS)
    stage.live(fields(), numbered(7), stage.now)  # the same number again
    stage.listen()
    assert stage.result(21) == [*map(numbered, range(20)), numbered(7)]
    assert "no recorder is recording it" in caplog.text


def test_a_recorder_that_was_killed_before(stage, caplog):
    """No live message comes: the run has not ended, and no report shows that its writer runs."""
    talk(stage, fields(), range(20), ())
    for writer in stage.writers.values():
        writer.close = lambda: None
    stage.subscribe(stage.begin + 10_000 * MS)
    stage.history._past.is_written = lambda now: False
    stage.listen()
    assert stage.result(20) == list(map(numbered, range(20)))
    assert "no recorder is seen to record it now" in caplog.text


def test_two_recorders_of_which_one_died(stage):
    """The past has the messages of both, as for any reader."""
    stage.subscribe(stage.begin + 900 * MS)
    for n in range(50):
        stage.stored(fields(), numbered(n), stage.begin + n * 10 * MS, writer=1)
    for n in range(30, 120):
        stage.stored(fields(), numbered(n), stage.begin + n * 10 * MS + MS, writer=2)
    talk(stage, fields(), (), range(90, 130))
    stage.listen()
    got = stage.result(20 + 130)
    assert sorted(got) == sorted(map(numbered, [*range(50), *range(30, 130)]))
    assert got[-40:] == list(map(numbered, range(90, 130)))


def test_clocks_that_differ_where_messages_have_headers(stage):
    for skew, name in ((-40_000, "/behind"), (4_000, "/ahead")):
        header = fields(name, Log)
        stage.begin = time.time_ns()
        wires = [serialize(Log(header=Header(seq=n))) for n in range(200)]
        for n in range(160):
            stage.stored(header, wires[n], stage.begin + (n * 10 + skew) * MS)
    stage.flush()
    stage.subscribe(stage.begin + 1000 * MS)
    for n in range(100, 200):
        for name in ("/behind", "/ahead"):
            stage.live(fields(name, Log), wires[n], stage.begin + n * 10 * MS)
    stage.listen()
    assert stage.result(400, "/behind") == wires
    assert stage.result(400, "/ahead") == wires


def test_what_has_no_room_is_read_from_the_store(stage, caplog):
    """The past is read slowly; live messages fill the buffer again and again."""
    header, count, published = fields(), 3000, threading.Event()
    for n in range(1000):
        stage.stored(header, numbered(n), stage.begin + n * 10 * MS)
    stage.flush()
    stage.subscribe(stage.begin + 10_000 * MS, bound=60_000, connected=published.is_set)
    stage.history._check_written()
    assert stage.queue.recorded
    stage.listen(slow=0.0002)
    for n in range(1000, count):
        stage.stored(header, numbered(n), stage.begin + n * 10 * MS)
        stage.live(header, numbered(n), stage.begin + n * 10 * MS + MS)
    stage.flush()
    published.set()
    assert stage.result(count) == list(map(numbered, range(count)))
    assert stage.queue.epoch >= live_queue.TOO_OFTEN
    assert "give more with buff_size" in caplog.text
    assert stage.history.lost == 0


def test_what_was_forgotten_and_never_stored_is_told(stage, caplog):
    header = fields()
    talk(stage, header, range(300), ())
    stage.subscribe(stage.begin + 3000 * MS, bound=40_000)
    stage.history._check_written()
    for n in range(300, 700):  # the recorder has died, and the directory does not show it yet
        stage.live(header, numbered(n), stage.begin + n * 10 * MS)
    stage.listen()
    await_true(lambda: stage.heard and stage.heard[-1].wire == numbered(699))
    got = [struct.unpack("<I", wire)[0] for wire in stage.result(301)]
    assert got == [*range(300), *range(got[300], 700)]
    assert got[300] > 300
    assert stage.history.lost == got[300] - 300
    assert f"{got[300] - 300} messages of /talker are lost" in caplog.text


def test_publishers_wait_where_no_recorder_runs(stage, caplog):
    talk(stage, fields(), range(100), ())
    stage.end()
    stage.subscribe(stage.begin + 60_000 * MS, bound=20_000)

    def publish():
        for n in range(100, 600):
            stage.live(fields(), numbered(n), stage.begin + 60_000 * MS + n * MS)

    publisher = threading.Thread(target=publish)
    publisher.start()
    time.sleep(0.2)
    assert publisher.is_alive()
    stage.listen()
    assert stage.result(600) == list(map(numbered, range(600)))
    publisher.join()
    assert "publishers must wait" in caplog.text
    assert stage.history.lost == 0


def test_a_topic_that_is_not_stored(stage, caplog):
    stage.subscribe(stage.begin)
    stage.live(fields(), b"a", stage.now)
    stage.listen()
    assert stage.result(1) == [b"a"]
    assert "no message of it is stored" in caplog.text


def test_a_keyspace_that_does_not_exist(connect, new_keyspace):
    with connect(keyspace=new_keyspace) as store:
        made = Stage(store)
        made.subscribe(made.begin)
        made.live(fields(), b"a", made.now)
        made.listen()
        assert made.result(1) == [b"a"]
        made.close()


def test_a_beginning_that_is_to_come(stage, caplog):
    talk(stage, fields(), range(10), ())
    stage.subscribe(stage.begin + 100 * MS, since=stage.begin + 10**12)
    stage.live(fields(), b"a", stage.now)
    stage.listen()
    assert stage.result(1) == [b"a"]
    assert "which is in the future" in caplog.text


def test_only_what_was_received_since_then(stage):
    stage.subscribe(stage.begin + 3000 * MS, since=stage.begin + 1000 * MS)
    talk(stage, fields(), range(350), range(300, 400))
    stage.listen()
    assert stage.result(300) == list(map(numbered, range(100, 400)))


def test_simulated_time_that_has_not_begun(stage):
    talk(stage, fields(), range(350), ())
    clock = [0]

    def now():
        if not clock[0]:
            raise ClockNotSet("no /clock")
        return clock[0]

    stage.queue = LiveQueue(10**6, now)
    stage.history = History(
        StoredPast(stage.store.catalog, TOPIC), stage.queue, lambda now: 0, lambda: True
    )
    for n in range(300, 320):
        stage.queue.put(fields(), numbered(n))
    stage.listen()
    time.sleep(0.1)
    assert not stage.heard
    clock[0] = stage.begin + 3200 * MS
    for n in range(320, 400):
        stage.queue.put(fields(), numbered(n))
    assert stage.result(400) == list(map(numbered, range(400)))


def test_a_store_that_fails_meanwhile(stage, caplog, monkeypatch):
    stage.subscribe(stage.begin + 3000 * MS)
    talk(stage, fields(), range(350), range(300, 400))
    rows = StoredPast.rows

    def broken(self, low, high=None):
        for count, row in enumerate(rows(self, low, high)):
            if count == 50:
                raise StoreUnavailable("it went away")
            yield row

    monkeypatch.setattr(StoredPast, "rows", broken)
    stage.listen()
    assert stage.result(150) == list(map(numbered, [*range(50), *range(300, 400)]))
    assert "there may be a gap" in caplog.text


def test_what_was_not_recorded_is_told(stage, caplog):
    for t in (100, 900):
        first = stage.begin + t * MS
        loss = Loss(TOPIC, "", 1, LossKind.BUFFER_FULL, first, first + MS, 3)
        stage.store.catalog.keyspace.registry.put_loss(loss)
    stage.subscribe(stage.begin + 3000 * MS, since=stage.begin + 500 * MS)
    talk(stage, fields(), range(350), range(300, 400))
    stage.listen()
    assert stage.result(350) == list(map(numbered, range(50, 400)))
    assert "at least 3 messages were not recorded" in caplog.text
    assert "(buffer full)" in caplog.text


def test_one_run_of_two(stage):
    for n in range(320):
        stage.stored(fields(), numbered(n), stage.begin + n * 10 * MS, writer=1)
        stage.stored(fields(), numbered(n), stage.begin + n * 10 * MS + MS, writer=2)
    stage.flush()
    stage.subscribe(stage.begin + 3000 * MS)
    past = StoredPast(stage.store.catalog, TOPIC, run=2)
    assert past.is_written(stage.begin)
    stage.history = History(past, stage.queue, lambda now: 0, lambda: True)
    talk(stage, fields(), (), range(300, 400))
    stage.listen()
    assert stage.result(400) == list(map(numbered, range(400)))
    stage.writers.pop((2, "")).close()
    written = {run: StoredPast(stage.store.catalog, TOPIC, run=run) for run in (1, 2)}
    assert written[1].is_written(stage.begin)
    assert not written[2].is_written(stage.begin)  # the other run goes on, this one does not
    with pytest.raises(RunNotFound):
        StoredPast(stage.store.catalog, TOPIC, run="nobody")


def test_a_simulation_whose_clock_begins_at_0_reads_nothing_of_today(stage):
    stage.stored(fields(), numbered(0), stage.begin)
    stage.flush()
    past = StoredPast(stage.store.catalog, TOPIC)
    assert list(past.rows(5 * 10**9, 6 * 10**9)) == []
    assert [row.wire for row in past.rows(5 * 10**9)] == [numbered(0)]


def test_large_messages(stage):
    wires = [serialize(String(str(n) * 700_000)) for n in range(8)]
    header = fields("/big", String)
    stage.subscribe(stage.begin + 500 * MS, bound=10**8)
    talk(stage, header, range(6), range(4, 8), 100 * MS, wire=wires.__getitem__)
    stage.listen()
    assert stage.result(8) == wires
