# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""HistorySubscriber in a process of its own, beside a real recorder and publishers made for it."""

from __future__ import annotations

import json
import struct
import sys
import threading
import time
from pathlib import Path

import pytest
from nodes.children import Child, start_recorder
from nodes.raw_publisher import RawPublisher, header_of
from std_msgs.msg import UInt32

LISTENER = Path(__file__).with_name("history_listener.py")


def numbered(n):
    return struct.pack("<I", n)


class Listener(Child):
    def ask(self, command):
        number = len(self.lines)
        print(command, file=self.process.stdin, flush=True)
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            for line in self.lines[number:]:
                if line[:1] in "{0123456789":
                    return json.loads(line)
            time.sleep(0.01)
        raise AssertionError(self.output)

    def await_count(self, count, timeout_sec=120):
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
            deadline = time.monotonic() + 60
            while not rosCas.existTopic(topic) or rosCas.getTopic(topic).countTopicData() < count:
                assert time.monotonic() < deadline
                time.sleep(0.1)

    yield Stage()
    for each in reversed(started):
        with each:
            pass


def goes_over(stage, count, rate_hz, msg_class=UInt32):
    """Half is stored when the subscriber comes; publishing goes on all the time."""
    topic = "/numbers"
    stage.recorder(topic)
    publisher = stage.publisher(topic).await_subscribers()
    due = threading.Event()

    def publish():
        begin, sent = time.monotonic(), 0
        while sent < count:
            upto = min(count, int((time.monotonic() - begin) * rate_hz) + 1)
            publisher.publish(*map(numbered, range(sent, upto)))
            sent = upto
            if sent >= count // 2:
                due.set()
            time.sleep(0.005)

    thread = threading.Thread(target=publish)
    thread.start()
    due.wait()
    listener = stage.listener(topic, type="std_msgs/UInt32")
    thread.join()
    answer = listener.await_count(count)
    assert [wire for _, wire in answer["got"]] == [numbered(n).hex() for n in range(count)]
    assert (answer["lost"], answer["failed"]) == (0, 0)
    return listener


def test_the_past_goes_over_into_the_present(stage):
    goes_over(stage, 6000, 2000).await_line("live")


@pytest.mark.long
@pytest.mark.parametrize("run", range(20))
def test_a_hundred_thousand_messages_each_once_and_in_order(stage, run):
    goes_over(stage, 100_000, 10_000)
