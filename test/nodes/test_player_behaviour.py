# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The player among others: slow subscribers, a master that goes, keys, time, an own node."""

from __future__ import annotations

import fcntl
import os
import re
import select
import signal
import socket
import struct
import subprocess
import sys
import termios
import time
import xmlrpc.client
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import pytest
from geometry_msgs.msg import PointStamped
from nodes.children import PROGRAMS, Child, await_true, start_client, start_node, told
from nodes.raw_publisher import RawPublisher, header_of, message
from nodes.raw_subscriber import RawSubscriber, find
from nodes.test_registration import listed, master  # noqa: F401 - a fixture
from proxy import Proxy
from rosgraph_msgs.msg import Log
from std_msgs.msg import Int32, UInt8MultiArray
from suites import CAMPAIGN

from cassandra_ros.cli.terminal_text import counted
from cassandra_ros.nodes.publication import MessageKind, Publication
from cassandra_ros.store.tables.registry import Loss, LossKind

SEC = 10**9
T0 = 1_405_015_391 * SEC
STEP = SEC // 10
COUNT = 20
OWN = Path(__file__).with_name("player_process.py")


@pytest.fixture
def where(cassandra, keyspace):
    return ("--host", cassandra.host, "--port", cassandra.port, "--keyspace", keyspace)


@pytest.fixture
def numbers(rosCas):
    topic = rosCas.addTopic("/n", format="binary")
    for n in range(COUNT):
        topic.addData(Int32(n), key=T0 + n * STEP)
    return topic


def number(wire):
    return struct.unpack("<i", wire)[0]


@pytest.mark.suite("all", "it waits for seconds")
def test_what_a_slow_subscriber_misses_is_counted(roscore, rosCas, where):
    topic = rosCas.addTopic("/big", format="binary")
    for n in range(40):
        topic.addData(UInt8MultiArray(data=bytes([n]) * (1 << 20)), key=T0 + n * STEP // 10)
    rosCas.addTopic("/go").addData(Int32(0), key=T0)
    rosCas.catalog.keyspace.registry.put_loss(
        Loss("/big", "", 7, LossKind.BUFFER_FULL, T0 + 5, T0 + SEC, count=12)
    )
    options = ("--queue", "3", "-r", "10", "--wait-for-subscribers")
    with start_node(roscore, "player", *where, *options) as child:
        slow = RawSubscriber(roscore.uri, "/big")
        with RawSubscriber(roscore.uri, "/big") as fast, RawSubscriber(roscore.uri, "/go"):
            heard = fast.rest()
        assert child.wait() == 0, child.output
        got = 0
        with slow:
            try:
                got = len(slow.rest())
            except OSError:
                pass  # a half sent message is cut off
    line = told(child)[-1]
    assert line.startswith("played 41 messages of 2 topics; slow subscribers missed ")
    assert len(heard) + got + int(line.split()[-1]) == 80
    assert got < 20
    assert "subscribers of /big missed" in child.output
    assert "12 messages of topic /big from 2014-07-10T" in child.output
    assert "were not recorded: buffer full" in child.output


def test_a_peer_without_a_header_does_not_delay_others(roscore, numbers, where):
    with start_node(roscore, "player", *where, "-r", "100", "--wait-for-subscribers") as child:
        with socket.create_connection(find(roscore.uri, "/n", 60, None), 60):
            with RawSubscriber(roscore.uri, "/n", 60) as heard:
                assert list(map(number, heard.rest())) == list(range(COUNT))
            assert child.wait() == 0, child.output


@pytest.mark.suite("all", "it waits for seconds of playing")
def test_its_own_log_is_not_among_what_is_played_under_another_name(roscore, rosCas, where):
    topic = rosCas.addTopic("/rosout", format="binary")
    for n in range(3):
        topic.addData(Log(msg=str(n)), key=T0 + n * STEP)
    rosCas.catalog.keyspace.registry.put_loss(
        Loss("/rosout", "", 7, LossKind.BUFFER_FULL, T0, T0 + STEP, count=12)
    )
    options = ("/rosout:=/old/rosout", "--wait-for-subscribers")
    with start_node(roscore, "player", *where, *options) as child:
        with RawSubscriber(roscore.uri, "/old/rosout") as heard:
            found = heard.rest()
        assert child.wait() == 0, child.output
    assert "were not recorded: buffer full" in child.output
    assert found == [message(Log(msg=str(n))) for n in range(3)]


def test_a_subscriber_that_leaves_while_its_topic_is_left():
    publication = Publication("/x", MessageKind.of("std_msgs/Int32", "1" * 32, ""), False, 1)
    publication.close()
    # The thread that was sending to it finds the connection broken then.
    publication.remove_connection(SimpleNamespace(endpoint_id="/y"))
    assert publication.subscribers == 0


@pytest.mark.suite("all", "it plays for seconds")
def test_at_once_means_as_fast_as_subscribers_take_it(roscore, rosCas, where):
    topic = rosCas.addTopic("/big", format="binary")
    for n in range(24):
        topic.addData(UInt8MultiArray(data=bytes([n]) * (1 << 20)), key=T0 + n)
    options = ("-i", "--queue", "2", "--wait-for-subscribers")
    with start_node(roscore, "player", *where, *options) as child:
        with RawSubscriber(roscore.uri, "/big") as heard:
            found = [heard.read()[-1]]
            child.await_line("a subscriber of topic /big has read nothing for 2 s")
            for wire in iter(heard.read, None):
                found.append(wire[-1])
                time.sleep(0.03)
        assert child.wait() == 0, child.output
    assert found == list(range(24))
    assert told(child)[-1] == "played 24 messages of 1 topic"


@pytest.mark.suite("all", "it kills or cuts something, and waits")
def test_a_master_that_is_started_anew(master, where, numbers):  # noqa: F811
    options = ("-l", "--wait-for-subscribers")
    with start_node(master, "player", *where, *options) as child, RawSubscriber(
        master.uri, "/n"
    ) as heard:
        child.await_line("playing 1 topic")
        master.stop()
        child.await_line("the ROS master does not answer")
        master.start()
        await_true(lambda: listed(master, "/player/status"))
        with RawSubscriber(master.uri, "/n") as new:
            assert new.read() is not None
        found = [number(heard.read()) for _ in range(COUNT + 1)]  # into the second round
        assert child.end(signal.SIGTERM) == 0, child.output
        found += [number(wire) for wire in heard.rest()]
    assert found == [n % COUNT for n in range(len(found))]  # no message was missed meanwhile


def controlling(ns):
    """A message that lets the replay go on until a second after this time."""
    late = PointStamped()
    late.header.stamp.secs, late.header.stamp.nsecs = divmod(ns, SEC)
    return message(late)


def nanoseconds(tick):
    secs, nsecs = struct.unpack("<II", tick)
    return secs * SEC + nsecs


@pytest.mark.suite("test", "--clock and --rate-control-topic")
def test_time_is_published_and_consumers_are_waited_for(roscore, rosCas, where, numbers):
    clock = rosCas.addTopic("/clock", msg_type="rosgraph_msgs/Clock")
    from rosgraph_msgs.msg import Clock

    clock.addData(Clock(), key=T0 + STEP)
    # Until now only the player publishes the time: it must not wait for it.
    parameters = xmlrpc.client.ServerProxy(roscore.uri)
    parameters.setParam("/test", "/use_sim_time", True)
    options = (
        "--clock",
        "--wait-for-subscribers",
        "--rate-control-topic",
        "/control",
        "-s",
        "0.05",
    )
    begun = time.monotonic()  # before the first tick
    try:
        with start_node(roscore, "player", *where, *options) as child, RawPublisher(
            roscore.uri, "/control", header_of(PointStamped)
        ) as control, RawSubscriber(roscore.uri, "/clock") as ticks:
            control.await_subscribers()
            with RawSubscriber(roscore.uri, "/n") as heard:
                first = [number(heard.read()) for _ in range(10)]
                for _ in range(3):  # it waits, a second after the stamp that controls it
                    assert child.process.poll() is None
                    stood = ticks.read()
                control.publish(controlling(T0 + 7 * STEP))
                times = [stood]
                while nanoseconds(times[-1]) <= T0 + 15 * STEP:  # until it stands again
                    times.append(ticks.read())
                control.publish(controlling(T0 + SEC))
                rest = [number(wire) for wire in heard.rest()]
            assert child.wait() == 0, child.output
            times += ticks.rest()
            assert len(times) < (time.monotonic() - begun) * 100 + 10
    finally:
        parameters.deleteParam("/test", "/use_sim_time")
    assert first + rest == list(range(1, COUNT))
    stamps = [nanoseconds(tick) for tick in times]
    assert stamps == sorted(stamps)
    assert T0 + STEP <= stamps[0] <= T0 + SEC + 2 * STEP
    assert T0 + 15 * STEP < stamps[-1] <= T0 + COUNT * STEP
    assert "/clock is not played as stored" in child.output
    assert told(child)[-1] == "played 19 messages of 2 topics; 1 left out: 1 of /clock"


class Terminal:
    """A player on a terminal of its own."""

    def __init__(self, env, command):
        self._ours, theirs = os.openpty()
        self.before = termios.tcgetattr(theirs)

        def own():
            os.setsid()
            fcntl.ioctl(0, termios.TIOCSCTTY, 0)

        self.process = subprocess.Popen(
            [str(word) for word in command],
            env=env,
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            preexec_fn=own,  # noqa: PLW1509 - no threads of ours hold locks here
        )
        self._theirs = theirs
        self.shown = ""

    def await_text(self, pattern):
        while not re.search(pattern, self.shown):
            ready, _, _ = select.select([self._ours], [], [], 180)
            assert ready, f"{pattern!r} never came:\n{self.shown}"
            self.shown += os.read(self._ours, 1 << 16).decode()

    def press(self, key):
        os.write(self._ours, key.encode())

    @property
    def after(self):
        return termios.tcgetattr(self._theirs)

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        os.close(self._ours)
        os.close(self._theirs)


def test_keys_on_a_terminal(roscore, where, numbers):
    options = ("--pause", "-r", "100", "--pause-topics", "/n", "/m", "--wait-for-subscribers")
    terminal = Terminal(roscore.env, [PROGRAMS / "player", *where, *options])
    try:
        with RawSubscriber(roscore.uri, "/n") as heard:
            terminal.await_text("Hit space to toggle paused, or 's' to step.")
            paused = r"\[PAUSED \]  Bag Time: 1405015391"
            terminal.await_text(rf"{paused}\.000000   Duration: 0\.000000 / 1\.9")
            terminal.press("s")
            assert number(heard.read()) == 0
            terminal.press("s")
            assert number(heard.read()) == 1
            terminal.press(" ")
            terminal.await_text(rf"{paused}\.2")  # before the next one
            terminal.press("t")
            terminal.press(" ")
            assert [number(wire) for wire in heard.rest()] == list(range(2, COUNT))
        terminal.await_text("played 20 messages")
        assert terminal.process.wait(180) == 0, terminal.shown
        assert terminal.after == terminal.before
        assert "no topic /m is played, so the replay never pauses for it" in terminal.shown
    finally:
        terminal.close()


def test_a_player_in_a_node_of_ones_own(roscore, cassandra, keyspace, numbers):
    command = [sys.executable, OWN, cassandra.host, cassandra.port, keyspace]
    with Child(command, roscore.env) as child:
        with RawSubscriber(roscore.uri, "/own") as heard:
            assert [number(heard.read()) for _ in range(4)] == [0, 1, COUNT - 1, 99]
            child.process.stdin.close()
        assert child.wait() == 0, child.output
    end = (COUNT - 1) * STEP
    for line in (f"stepped {STEP}", f"sought {end} True", "published /own 3", "ended True"):
        assert line in child.lines, child.output


@pytest.mark.suite("all", "it starts and ends a player many times")
def test_played_and_stopped_many_times(roscore, where, numbers):
    """No message is lost or doubled before the stop, and no process is left."""
    pids, rounds = set(), 50 if CAMPAIGN else 5
    for round_ in range(rounds):
        with start_node(roscore, "player", *where, "-r", "20", "--wait-for-subscribers") as child:
            pids.add(child.process.pid)
            with RawSubscriber(roscore.uri, "/n") as heard:
                for n in range(round_ % COUNT):
                    assert number(heard.read()) == n
                assert child.end((signal.SIGINT, signal.SIGTERM)[round_ % 2]) == 0, child.output
                rest = [number(wire) for wire in heard.rest()]
            assert rest == list(range(round_ % COUNT, round_ % COUNT + len(rest)))
            total = round_ % COUNT + len(rest)
            assert told(child)[-1] == f"played {counted(total, 'message')} of 1 topic"
    assert len(pids) == rounds
    for pid in pids:
        assert not Path(f"/proc/{pid}").exists()


@pytest.mark.fault
@pytest.mark.suite("all", "it starts and ends a player many times")
def test_a_store_that_is_away_is_waited_for(roscore, cassandra, rosCas, keyspace):
    topic = rosCas.addTopic("/big", format="binary")
    for n in range(40):
        topic.addData(UInt8MultiArray(data=bytes([n]) * (1 << 20)), key=T0 + n * STEP // 2)
    with Proxy(cassandra.host, cassandra.port) as proxy, ThreadPoolExecutor(1) as pool:
        where = ("--host", proxy.host, "--port", proxy.port, "--keyspace", keyspace)
        # Paused, or a busy machine might have read all before the store is away.
        options = ("--read-ahead", "1", "--wait-for-subscribers", "--pause")
        with start_node(roscore, "player", *where, *options) as child, RawSubscriber(
            roscore.uri, "/big"
        ) as heard, start_client(roscore) as client:
            await_true(lambda: client.call("/player/status")["state"] == "paused")
            assert client.call("/player/step")["success"]
            found = [heard.read()]
            rest = pool.submit(heard.rest)
            proxy.cut()
            assert client.call("/player/resume")["success"]
            child.await_line("the store does not answer, the replay waits for it")
            proxy.mend()
            found += rest.result(180)
            assert child.wait() == 0, child.output
    assert [wire[-1] for wire in found] == list(range(40))
    assert "the replay stood for" in child.output
