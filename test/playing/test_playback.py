# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A playback of a real store into a list: what comes, in which order, steered as asked."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import pytest
from nodes.children import await_true
from playing.robots import Robot
from std_msgs.msg import Int32, String

from cassandra_ros.errors import InvalidOption, MessageNotFound, StoreUnavailable
from cassandra_ros.playing import playback as playback_module
from cassandra_ros.playing import read_ahead
from cassandra_ros.playing.pace import Pace
from cassandra_ros.playing.play_options import PlayerOptions
from cassandra_ros.playing.play_selection import PlaySelection
from cassandra_ros.playing.play_stream import PlayStream
from cassandra_ros.playing.playback import Playback
from cassandra_ros.playing.played_store import PlayedKeyspace
from cassandra_ros.playing.read_ahead import ReadAhead
from cassandra_ros.topics.stored_row import StoredRow

SEC = 10**9
T0 = 1_405_015_391 * SEC
STEP = SEC // 20
COUNT = 40
BOTH = PlaySelection(topics=["/n", "/s"])
EACH_ALONE = PlaySelection(["/n", "/s"], around=("/n", "data >= 0"), before=0, after=0)
"""Each message is in a window of its own."""


@pytest.fixture(scope="module")
def store(fresh):
    with fresh() as rosCas:
        numbers = rosCas.addTopic("/n", format="binary")
        for n in range(COUNT):
            numbers.addData(Int32(n), key=T0 + n * STEP)
        rosCas.addTopic("/s").addData(String("x"), key=T0 + 3 * STEP)
        yield rosCas


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    """What is asked of a playback is waited for, on a busy machine too."""
    monkeypatch.setattr(playback_module, "COMMAND_SEC", 180.0)


class Into:
    """Notes what comes out; ``at`` waits for a number of messages."""

    def __init__(self):
        self.got = []
        self.clocks = []
        self.begun = []
        self.came = threading.Condition()

    def begin(self, t):
        self.begun.append(t)

    def clock(self, t):
        self.clocks.append(t)

    def publish(self, played):
        with self.came:
            self.got.append(played)
            self.came.notify_all()

    def await_count(self, count):
        with self.came:
            assert self.came.wait_for(lambda: len(self.got) >= count, 180)

    @property
    def numbers(self):
        return [(p.t - T0) // STEP for p in self.got if p.topic == "/n"]


@pytest.fixture
def playing(store):
    """Start playbacks; each is stopped afterwards."""
    started = []

    def start(selection=None, lags=lambda t: False, into=None, **options):
        into = into or Into()
        stream = PlayStream(
            PlayedKeyspace(store.catalog), selection or PlaySelection(topics=["/n"])
        )
        playback = Playback(stream, into, PlayerOptions(**options), lags, lambda played, exc: None)
        thread = threading.Thread(target=playback.run)
        thread.start()
        started.append((playback, thread))
        return SimpleNamespace(playback=playback, into=into, thread=thread)

    yield start
    for playback, thread in started:
        playback.stop()
        thread.join(180)
        assert not thread.is_alive()


def test_everything_at_once(playing):
    run = playing(BOTH, immediate=True)
    run.thread.join(180)
    assert run.into.numbers == list(range(COUNT))
    assert [p.t for p in run.into.got] == sorted(p.t for p in run.into.got)
    assert len(run.into.got) == COUNT + 1
    assert run.into.clocks[1:] == [p.t for p in run.into.got]  # the time before each
    assert run.playback.state == "ended"
    with pytest.raises(InvalidOption, match="ended"):
        run.playback.seek(T0)


def test_steered_while_it_is_paused(playing):
    run = playing(paused=True, keep_alive=True)
    run.playback.step(2)
    assert run.into.numbers == [0, 1]
    assert (run.playback.state, run.playback.pace.now()) == ("paused", T0 + STEP)
    assert run.playback.seek(T0 + 30 * STEP - 1) == T0 + 30 * STEP - 1
    assert run.playback.state == "paused"
    assert run.into.clocks[-1] == T0 + 30 * STEP - 1
    run.playback.step(1)
    assert run.playback.seek(0) == T0  # before the start
    run.playback.step(1)
    assert run.into.numbers == [0, 1, 30, 0]
    assert run.playback.seek(T0 + 999 * SEC) == T0 + (COUNT - 1) * STEP
    with pytest.raises(InvalidOption, match="1 of 2 messages"):
        run.playback.step(2)
    assert run.into.numbers == [0, 1, 30, 0, COUNT - 1]
    run.playback.set_rate(1000.0)
    assert run.playback.resume()
    assert not run.playback.resume()
    assert run.playback.seek(T0 + 35 * STEP) == T0 + 35 * STEP  # behind the end, kept alive
    run.into.await_count(10)
    assert run.into.numbers[5:] == [35, 36, 37, 38, 39]
    with pytest.raises(InvalidOption, match="only a paused replay"):
        run.playback.step(1)


def test_a_loop_begins_anew_until_it_is_stopped(playing):
    run = playing(loop=True, rate=1000.0)
    run.into.await_count(3 * COUNT)
    run.playback.stop()
    run.thread.join(180)
    assert run.into.numbers[: 3 * COUNT] == 3 * list(range(COUNT))
    assert set(run.into.begun) == {T0}


def test_time_does_not_run_ahead_of_what_is_late(playing):
    class Slow(Into):
        def publish(self, played):
            self.clocks.append(run.playback.now())
            super().publish(played)

    run = playing(into=Slow(), rate=1e6, paused=True)
    run.playback.resume()
    run.into.await_count(COUNT // 2)
    run.playback.set_rate(0.01)
    assert run.playback.now() <= T0 + (COUNT - 1) * STEP
    run.thread.join(0.2)
    run.playback.set_rate(1000.0)
    run.thread.join(180)
    assert run.into.clocks == [T0, *(p.t for p in run.into.got)]


def test_another_rate_holds_from_now_on(playing):
    """A waiting message becomes due at once; a replay that is late does not catch up."""
    run = playing(rate=1e-6)
    run.into.await_count(1)
    run.playback.set_rate(1e6)
    run.thread.join(180)
    assert run.into.numbers == list(range(COUNT))


def test_another_rate_does_not_make_up_for_what_is_late(store):
    stream = PlayStream(PlayedKeyspace(store.catalog), PlaySelection(topics=["/n"]))
    playback = Playback(stream, Into(), PlayerOptions(), lambda t: False, lambda played, exc: None)
    ticks = [0]
    playback.pace = Pace(T0, 1.0, lambda: ticks[0])
    playback.pace.release(Pace.BEGIN)
    ticks[0] += 1000 * SEC  # and the first message was not published yet
    playback.set_rate(2.0)
    assert playback.pace.now() == T0
    ticks[0] += SEC
    assert playback.pace.now() == T0 + 2 * SEC


def test_time_goes_back_before_what_is_latched_comes_again(rosCas):
    """A subscriber that sees time go back forgets what it has: tf, and all that is latched."""
    told = []

    class Told(Into):
        def clock(self, t):
            told.append(t)
            super().clock(t)

        def publish(self, played):
            told.append(played.topic)
            super().publish(played)

    with Robot(rosCas, 1) as robot:
        robot.send("/map", 0, "m", latched=True)
        for n in range(1, 10):
            robot.send("/tick", n, str(n))
    stream, into = PlayStream(PlayedKeyspace(rosCas.catalog), PlaySelection()), Told()
    options = PlayerOptions(paused=True, keep_alive=True)
    playback = Playback(stream, into, options, lambda t: False, lambda played, exc: None)
    thread = threading.Thread(target=playback.run)
    thread.start()
    playback.step(5)
    del told[:]
    back = playback.seek(stream.start_ns + 2 * SEC)
    into.await_count(6)
    playback.stop()
    thread.join(180)
    assert told[:2] == [back, "/map"]


def test_a_seek_between_two_windows_goes_on_with_the_next_one(playing, store):
    store.addTopic("/far").addData(String("a"), key=T0)
    store.getTopic("/far").addData(String("b"), key=T0 + 10_000 * SEC)
    around = PlaySelection(topics=["/far"], around=("/far", "data != ''"), before=1.0, after=1.0)
    run = playing(around, paused=True, keep_alive=True)
    run.playback.step(1)
    assert run.playback.seek(T0 + 5000 * SEC) == T0 + 5000 * SEC
    run.playback.resume()
    run.into.await_count(2)
    assert [p.t for p in run.into.got] == [T0, T0 + 10_000 * SEC]


def test_gaps_are_skipped_and_what_controls_is_waited_for(playing, store):
    store.addTopic("/gap").addData(String("a"), key=T0)
    store.getTopic("/gap").addData(String("b"), key=T0 + 1000 * SEC)
    behind = threading.Event()
    run = playing(
        PlaySelection(topics=["/gap"]), lambda t: t > T0 and not behind.is_set(), skip_empty=1.0
    )
    run.into.await_count(1)
    await_true(lambda: run.playback.state == "delayed")
    assert len(run.into.got) == 1
    behind.set()
    run.playback.wake()
    run.thread.join(180)
    assert [p.t for p in run.into.got] == [T0, T0 + 1000 * SEC]
    assert run.into.clocks == [T0, T0 + 1000 * SEC]


def test_a_step_ends_the_wait_for_what_controls(playing):
    behind = threading.Event()
    run = playing(lags=lambda t: t > T0 and not behind.is_set(), rate=1000.0)
    await_true(lambda: run.playback.state == "delayed")
    run.playback.pause()
    run.playback.step(1)
    behind.set()
    run.playback.resume()
    run.thread.join(180)
    assert run.into.numbers == list(range(COUNT))


def test_what_is_not_done_in_time_is_told(playing, monkeypatch):
    monkeypatch.setattr(playback_module, "COMMAND_SEC", 0.05)
    monkeypatch.setattr(playback_module, "RETRY_SEC", 0.01)
    answers, real = threading.Event(), PlayStream.messages

    def messages(self, t):
        answers.wait(180)
        return real(self, t)

    def latched(self, t):
        if not answers.is_set():
            raise StoreUnavailable("away")
        return []

    monkeypatch.setattr(PlayStream, "messages", messages)
    run = playing(paused=True, keep_alive=True)
    with pytest.raises(InvalidOption, match="0 of 3 messages were published: no more within"):
        run.playback.step(3)
    monkeypatch.setattr(PlayStream, "latched", latched)
    with pytest.raises(InvalidOption, match="the replay is not there after"):
        run.playback.seek(T0 + 30 * STEP)
    answers.set()
    monkeypatch.setattr(playback_module, "COMMAND_SEC", 180.0)
    run.playback.step(1)
    assert run.into.numbers == [30]


def test_time_jumps_before_the_first_message_of_a_window(playing):
    around = PlaySelection(["/n"], around=("/n", ("data IN (?, ?)", [0, 30])), before=0, after=0)
    run = playing(around)
    run.thread.join(180)
    assert run.into.clocks == [p.t for p in run.into.got] == [T0, T0 + 30 * STEP]


def test_it_pauses_before_messages_of_a_topic(playing):
    run = playing(BOTH, rate=1000.0, pause_topics=["/s"])
    run.into.await_count(3)
    await_true(lambda: run.playback.state == "paused")
    assert "/s" not in {p.topic for p in run.into.got}
    run.playback.resume()
    run.thread.join(180)
    assert len(run.into.got) == COUNT + 1


def test_nothing_to_play_says_why(playing, store):
    stream = PlayStream(
        PlayedKeyspace(store.catalog), PlaySelection(topics=["/n"], start=0.01, duration=0.02)
    )
    nothing = Playback(stream, Into(), PlayerOptions(), lambda t: False, lambda played, exc: None)
    with pytest.raises(MessageNotFound, match="nothing to play: .* from 2014-07-10T"):
        nothing.run()


def taken(reader, changed, look=lambda played: None):
    """Take all messages of a reader; each is looked at when it is taken."""
    got = []
    with changed:
        while True:
            while not reader.await_next(60):
                pass
            played = reader.next_message()
            if played is None:
                return got
            look(played)
            got.append(played)


@pytest.mark.parametrize("selection", [BOTH, EACH_ALONE])
def test_a_store_that_is_away_for_a_while(store, monkeypatch, selection):
    """Reading goes on after the last message, also between messages of equal times."""
    monkeypatch.setattr(read_ahead, "RETRY_SEC", 0.01)
    stream = PlayStream(PlayedKeyspace(store.catalog), selection)
    every = list(stream.messages(T0))
    changed, failures = threading.Condition(), iter(range(1, 6))

    def begin(t):
        rows = stream.messages(t)
        for _ in range(next(failures, 10**6) * 5):
            found = next(rows, None)
            if found is None:
                return
            yield found
        raise StoreUnavailable("away")

    reader = ReadAhead(begin, T0, 1 << 20, changed, lambda played, exc: None)
    got = taken(reader, changed)
    assert [p.row.key for p in got] == [p.row.key for p in every]


def test_what_was_read_needs_no_store_when_it_is_due(store, monkeypatch):
    monkeypatch.setattr(read_ahead, "RETRY_SEC", 0.01)
    real, asked, failures = StoredRow.connection.fget, [], iter(range(3))

    def connection(self):
        asked.append(self.key)
        if next(failures, None) is not None:
            raise StoreUnavailable("away")
        return real(self)

    monkeypatch.setattr(StoredRow, "connection", property(connection))
    stream = PlayStream(PlayedKeyspace(store.catalog), BOTH)
    changed = threading.Condition()
    reader = ReadAhead(stream.messages, T0, 1 << 20, changed, lambda played, exc: None)
    known = []  # whether its header was read when the message was taken
    times = [p.t for p in taken(reader, changed, lambda p: known.append(p.row.key in asked))]
    assert len(times) == COUNT + 1 and times == sorted(times)
    assert all(known) and len(known) == len(times)


def test_what_is_latched_may_be_away_or_gone(rosCas, monkeypatch):
    """As for other messages: the replay waits for the store and leaves unreadable ones out."""
    monkeypatch.setattr(playback_module, "RETRY_SEC", 0.01)
    with Robot(rosCas, 1, "r1") as robot:
        for topic in ("/a", "/b"):
            robot.send(topic, 0, topic, latched=True)
        robot.send("/tick", 9, "t")
    failures = iter((StoreUnavailable("away"), StoreUnavailable("away")))

    class Flaky(PlayStream):
        def latched(self, t):
            for failure in failures:
                raise failure
            found = super().latched(t)
            rosCas.getTopic("/a").removeData(run=1)
            return found

    stream, into, lost = Flaky(PlayedKeyspace(rosCas.catalog), PlaySelection(start=5)), Into(), []
    skipped = lambda played, exc: lost.append((played.topic, type(exc)))  # noqa: E731
    Playback(stream, into, PlayerOptions(immediate=True), lambda t: False, skipped).run()
    assert [p.topic for p in into.got] == ["/b", "/tick"]
    assert lost == [("/a", MessageNotFound)]


def test_no_more_is_read_ahead_than_the_budget(store):
    stream = PlayStream(PlayedKeyspace(store.catalog), PlaySelection(topics=["/n"]))
    changed, begun = threading.Condition(), threading.Event()
    taken = []

    def begin(t):
        for played in stream.messages(t):
            taken.append(played)
            begun.set()
            yield played

    size = 4 + read_ahead.ITEM_BYTES
    reader = ReadAhead(begin, T0, 5 * size, changed, lambda played, exc: None)
    assert begun.wait(180)
    got = 0
    with changed:
        while reader.await_next(180):
            played = reader.next_message()
            if played is None:
                break
            got += 1
            assert len(taken) - got <= 7
            assert not played.row.columns  # they may take more than the message
    assert got == COUNT


def test_who_reads_ends_where_it_is_closed_with_its_budget_used_up(store):
    stream = PlayStream(PlayedKeyspace(store.catalog), PlaySelection(topics=["/n"]))
    ended = threading.Event()

    def begin(t):
        try:
            for n, played in enumerate(stream.messages(t)):
                if n == 1:
                    reader.close()
                yield played
        finally:
            ended.set()

    reader = ReadAhead(begin, T0, 1500, threading.Condition(), lambda played, exc: None)
    assert ended.wait(180)
