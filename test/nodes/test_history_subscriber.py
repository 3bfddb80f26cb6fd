# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""HistorySubscriber in a process of its own, beside a real recorder and publishers made for it."""

from __future__ import annotations

import json
import signal
import struct
import sys
import threading
import time
from pathlib import Path

import genpy
import pytest
from nodes.children import Child, await_true, start_recorder
from nodes.raw_publisher import RawPublisher, header_of, message
from std_msgs.msg import String, UInt32
from suites import CAMPAIGN

from cassandra_ros import CassandraRosError, HistorySubscriber
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.nodes.history_subscriber import _start_time_of

LISTENER = Path(__file__).with_name("history_listener.py")


def numbered(n):
    return struct.pack("<I", n)


class Listener(Child):
    def ask(self, command):
        number = len(self.lines)
        print(command, file=self.process.stdin, flush=True)
        deadline = time.monotonic() + 180
        while time.monotonic() < deadline:
            for line in self.lines[number:]:
                if line.startswith(tuple("{0123456789")):
                    return json.loads(line)
            time.sleep(0.01)
        raise AssertionError(self.output)

    def await_count(self, count, timeout_sec=180):
        deadline = time.monotonic() + timeout_sec
        while self.ask("count") < count:
            assert time.monotonic() < deadline, f"{self.ask('count')} of {count}:\n{self.output}"
            time.sleep(0.05)
        answer = self.ask("got")
        assert answer["one"]
        return answer


@pytest.fixture
def stage(roscore, cassandra, keyspace, rosCas):
    """Start recorders, publishers and listeners; they are gone afterwards."""
    started = []

    class Stage:
        def recorder(self, *arguments, ready="recording "):
            child = start_recorder(roscore, cassandra, keyspace, *arguments)
            started.append(child)
            if ready:
                child.await_line(ready)
            return child

        def publisher(self, topic, msg_class=UInt32, name="/raw", **fields):
            found = RawPublisher(roscore.uri, topic, header_of(msg_class, name, **fields), name)
            started.append(found)
            return found

        def listener(self, topic, **wanted):
            env = {
                **roscore.env,
                "CASSANDRA_ROS_HOST": cassandra.host,
                "CASSANDRA_ROS_PORT": str(cassandra.port),
                "CASSANDRA_ROS_KEYSPACE": keyspace,
            }
            words = json.dumps({"topic": topic, **wanted})
            child = Listener([sys.executable, LISTENER, words], env)
            started.append(child)
            child.await_line("subscribed")
            return child

        def await_stored(self, topic, count):
            await_true(
                lambda: (
                    rosCas.existTopic(topic) and rosCas.getTopic(topic).countTopicData() >= count
                )
            )

    yield Stage()
    for each in reversed(started):
        with each:
            pass


def goes_over(stage, count, rate_hz, pause=False, **options):
    """Half is stored when the subscriber comes; publishing goes on all the time, or with ``pause``
    hardly until the subscriber is there, which a busy machine may start late."""
    topic = "/numbers"
    stage.recorder(topic)
    publisher = stage.publisher(topic).await_subscribers()
    due, subscribed = threading.Event(), threading.Event()

    def publish(first, last):
        begin, sent = time.monotonic(), first
        while sent < last:
            upto = min(last, first + int((time.monotonic() - begin) * rate_hz) + 1)
            publisher.publish(*map(numbered, range(sent, upto)))
            sent = upto
            time.sleep(0.005)

    def work():
        publish(0, count // 2)
        due.set()
        sent = count // 2
        while pause and not subscribed.wait(1.0):
            publish(sent, sent + 1)  # or the recorder would close what is idle for 10 s
            sent += 1
        publish(sent, count)

    thread = threading.Thread(target=work)
    thread.start()
    due.wait()
    try:
        listener = stage.listener(topic, type="std_msgs/UInt32", **options)
    finally:
        subscribed.set()
    thread.join()
    answer = listener.await_count(count)
    assert [wire for _, wire in answer["got"]] == [numbered(n).hex() for n in range(count)]
    assert (answer["lost"], answer["failed"]) == (0, 0)
    return listener


@pytest.mark.suite("test", "the past and the present, with a real publisher")
def test_the_past_goes_over_into_the_present(stage):
    listener = goes_over(stage, 5000, 2500)
    listener.await_line("live")
    print("unregister", file=listener.process.stdin, flush=True)
    listener.await_line("unregistered")


@pytest.mark.suite("all", "a hundred thousand messages by rospy")
@pytest.mark.parametrize("run", range(20 if CAMPAIGN else 1))
def test_a_hundred_thousand_messages_each_once_and_in_order(stage, run):
    goes_over(stage, 100_000, 10_000)


@pytest.mark.suite("all", "a hundred thousand messages by rospy")
def test_a_buffer_that_is_too_small_for_the_time_that_the_past_takes(stage):
    # Slow enough that many live messages wait while the past is read, also if publishing is slow.
    listener = goes_over(stage, 20_000, 3000, pause=True, buff_size=200_000, slow=0.001)
    assert "will be read from the store" in listener.output


def send(publisher, numbers, period_sec, wire):
    """Publish regularly, on a thread of its own."""

    def work():
        begin = time.monotonic()
        for count, n in enumerate(numbers):
            time.sleep(max(0.0, begin + count * period_sec - time.monotonic()))
            publisher.publish(wire(n))

    thread = threading.Thread(target=work)
    thread.start()
    return thread


@pytest.mark.suite("all", "it kills or cuts something, and waits")
def test_two_publishers_a_latched_one_and_a_recorder_that_dies(stage):
    """A type that is not installed, constant messages, and a present without a recorder."""
    unknown = {"type": "nowhere/Strange", "message_definition": "uint32 data\n"}
    counter = stage.publisher("/mixed", name="/counter", **unknown)
    constant = stage.publisher("/mixed", name="/constant")
    recorder = stage.recorder("/mixed")
    latched = stage.publisher("/mixed", name="/latched", latching="1")
    for each in (counter, constant, latched):
        each.await_subscribers()
    latched.publish(numbered(77))
    for thread in (
        send(counter, range(100), 0.01, numbered),
        send(constant, range(20), 0.05, lambda n: numbered(5)),
    ):
        thread.join()
    # What the recorder has received and not stored when it dies is lost to who did not hear it.
    stage.await_stored("/mixed", 121)
    listener = stage.listener("/mixed")
    for each in (counter, constant, latched):
        each.await_subscribers(2)
    threads = [
        send(counter, range(100, 250), 0.01, numbered),
        send(constant, range(20, 50), 0.05, lambda n: numbered(5)),
    ]
    with latched.only_last() as new:
        new.publish(numbered(77))  # what a latching publisher does for each that comes
    listener.await_line("live")
    assert recorder.end(signal.SIGKILL) < 0
    for thread in threads:
        thread.join()
    answer = listener.await_count(301)
    got = {name: [w for who, w in answer["got"] if who == name] for name, _ in answer["got"]}
    assert got["/counter"] == [numbered(n).hex() for n in range(250)]
    assert got["/constant"] == [numbered(5).hex()] * 50
    assert got["/latched"] == [numbered(77).hex()]


@pytest.mark.suite("all", "make test asks others of its kind")
def test_messages_of_another_class_are_left_out_and_said(stage, rosCas):
    with rosCas.messageWriter() as writer:
        fields = header_of(String, "/old")
        handle = writer.connect(live_connection("/changed", fields))
        writer.write(handle, time.time_ns() - 10**10, 0, message(String("old")))
    publisher = stage.publisher("/changed")
    listener = stage.listener("/changed", type="std_msgs/UInt32", since=3600)
    publisher.await_subscribers().publish(numbered(1))
    answer = listener.await_count(1)
    assert answer["got"] == [["/raw", numbered(1).hex()]]
    assert answer["failed"] == 1
    assert "std_msgs/String" in listener.await_line("are left out")


@pytest.mark.parametrize(
    ("wanted", "error"),
    [
        ({"data_class": int}, "not a class of messages"),
        ({"callback": 3}, "cannot be called"),
        ({"since": -1.0}, "not a length of time"),
        ({"since": "yesterday"}, "not a time"),
        ({"since": True}, "not a length of time"),
        ({"since": float("nan")}, "since is neither"),
        ({"buff_size": 0}, "buff_size=0"),
        ({"topic": "/has space"}, "has space"),
        ({"topic": 7}, "not a name of a topic"),
        ({"nodeID": 3, "rosCas": None}, "nodeID=3"),
    ],
    ids=str,
)
def test_bad_arguments_are_refused_at_once(wanted, error):
    good = {"topic": "/a", "data_class": UInt32, "callback": print}
    with pytest.raises(CassandraRosError, match=error):
        HistorySubscriber(**{**good, **wanted})


def test_since():
    now = 1_700_000_000 * 10**9
    assert _start_time_of(None)(now) == 0
    assert _start_time_of(60)(now) == now - 60 * 10**9
    assert _start_time_of(0.5)(now) == now - 5 * 10**8
    assert _start_time_of(genpy.Duration(2))(now) == now - 2 * 10**9
    assert _start_time_of(genpy.Time(5))(now) == 5 * 10**9
    assert _start_time_of(now - 1)(now) == now - 1
    assert _start_time_of(1.5e9)(now) == 1_500_000_000 * 10**9
    assert _start_time_of("2020-01-01T00:00:00Z")(now) == 1_577_836_800 * 10**9
