# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A master that goes away and comes back as another one: nodes register again, and go on."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import threading
import time
import xmlrpc.client
from pathlib import Path
from socketserver import ThreadingMixIn
from types import SimpleNamespace
from xmlrpc.server import SimpleXMLRPCServer

import pytest
from conftest import NO_MASTER
from mapping.room import Drive
from nodes.children import PROGRAMS, Child, await_true, start_node, start_recorder
from nodes.raw_publisher import RawPublisher, header_of, message
from rospy.impl.registration import get_service_manager, get_topic_manager
from std_msgs.msg import String
from suites import sparing

from cassandra_ros.local_server import free_port
from cassandra_ros.nodes import registration
from cassandra_ros.nodes.ros_node import own_name
from cassandra_ros.store.tables.registry import LossKind

LISTENER = Path(__file__).with_name("history_listener.py")


def text(n):
    return message(String(str(n)))


@pytest.fixture
def master(ros_env):
    """A master that can be stopped and started anew: .uri, .env, .start(), .stop()."""
    port, running = free_port(), []
    uri = f"http://127.0.0.1:{port}"
    env = dict(ros_env, ROS_MASTER_URI=uri)

    def answers():
        with contextlib.suppress(OSError, xmlrpc.client.Error):
            return xmlrpc.client.ServerProxy(uri).getPid("/test")[0] == 1
        return False

    def start():
        running.append(Child(["rosmaster", "--core", "-p", str(port)], env))
        await_true(answers)

    def stop():
        running.pop().end(signal.SIGKILL)

    start()
    yield SimpleNamespace(uri=uri, env=env, start=start, stop=stop)
    while running:
        stop()


@contextlib.contextmanager
def frozen(master):
    """Stop the master's process, which then does not answer, until the context ends."""
    pid = xmlrpc.client.ServerProxy(master.uri).getPid("/test")[2]
    os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(pid, signal.SIGCONT)


class SlowMaster(ThreadingMixIn, SimpleXMLRPCServer):
    """A proxy of a master that holds back the answer to getSystemState until a node has ended."""

    def __init__(self, uri):
        super().__init__(("127.0.0.1", 0), logRequests=False, allow_none=True)
        self.uri = f"http://127.0.0.1:{self.server_address[1]}/"
        self.holds, self.asked, self.unregistered = (threading.Event() for _ in range(3))
        self._behind = uri

    def _dispatch(self, method, params):
        if method == "getSystemState" and self.holds.is_set():
            self.asked.set()
            self.unregistered.wait(180)
        answer = getattr(xmlrpc.client.ServerProxy(self._behind), method)(*params)
        if method in ("unregisterSubscriber", "system.multicall"):
            self.unregistered.set()
        return answer


@pytest.fixture
def slow_master(master):
    server = SlowMaster(master.uri)
    serving = threading.Thread(target=server.serve_forever, daemon=True)
    serving.start()
    yield server
    server.shutdown()
    server.server_close()
    serving.join()


def listed(master, service):
    code, _, uri = xmlrpc.client.ServerProxy(master.uri).lookupService("/test", service)
    return code == 1 and uri


def listed_node(master, name):
    return xmlrpc.client.ServerProxy(master.uri).lookupNode("/test", name)[2]


AWAY, UNKNOWN = "the ROS master does not answer", "the ROS master does not know this node any more"
BACK = "the ROS master answers again"


@pytest.mark.parametrize("manager", [get_topic_manager(), get_service_manager()])
def test_a_registration_that_waits_for_the_master_does_not_silence_the_watch(
    monkeypatch, caplog, manager
):
    """rospy holds a lock until the master has answered it."""
    monkeypatch.setattr(registration, "TIMEOUT_SEC", 0.1)
    monkeypatch.setattr(registration, "POLL_SEC", 0.01)
    ended = threading.Event()

    def wait_for_the_master():
        with manager.lock:
            ended.wait(60)

    waiting = threading.Thread(target=wait_for_the_master)
    waiting.start()
    watch = registration.Registration().start()
    try:
        await_true(lambda: AWAY in caplog.text, 60)
        assert "a registration was not answered within 0.1 s" in caplog.text
    finally:
        ended.set()
        waiting.join()
        watch.stop()


@pytest.mark.suite("all", "it kills or cuts something, and waits")
@pytest.mark.fault
def test_a_master_that_is_started_anew(master, cassandra, keyspace, rosCas):
    """New publishers are heard again, services are found, and missed messages are reported."""
    where = ("--host", cassandra.host, "--port", cassandra.port, "--keyspace", keyspace)
    with start_recorder(master, cassandra, keyspace, "/a", "/b") as child, start_node(
        master, "query_server", *where
    ) as server:
        child.await_line("recording 2 topics")
        server.await_line("serving keyspace")
        service = listed(master, "/cassandra_ros/getData")
        old = RawPublisher(master.uri, "/a", header_of(String, "/old"), "/old")
        other = RawPublisher(master.uri, "/b", header_of(String, "/other"), "/other")
        old.await_subscribers().publish(text(1))
        other.await_subscribers().publish(text(1))
        master.stop()
        child.await_line("the ROS master does not answer")
        old.publish(text(2))  # existing connections go on
        before = time.time_ns()
        # Else it might register first, and the new master tell it of the publisher.
        child.process.send_signal(signal.SIGSTOP)
        master.start()
        new = RawPublisher(master.uri, "/a", header_of(String, "/new"), "/new")
        child.process.send_signal(signal.SIGCONT)
        new.await_subscribers().publish(text(3))
        old.publish(text(4))
        await_true(lambda: listed(master, "/cassandra_ros/getData") == service)
        await_true(lambda: listed(master, "/recorder/get_loggers"))
        child.await_line("publishers of /a that came after")
        for one in (new, old, other):
            one.close()
        assert child.end() == 1, child.output
        assert server.end() in (0, 130), server.output
    assert sorted(row.wire for row in rosCas.getTopic("/a").rows()) == [
        text(n) for n in (1, 2, 3, 4)
    ]
    assert "publishers of /a were not heard" in child.output
    said = [text for line in child.lines for text in (AWAY, UNKNOWN, BACK) if text in line]
    assert {AWAY, UNKNOWN} <= set(said)
    # Each time is told once. On a busy machine the master may answer late, and so be away again.
    assert all(one != other for one, other in zip(said, said[1:])), child.output
    (loss,) = rosCas.catalog.keyspace.registry.losses()
    assert (loss.topic, loss.kind, loss.count) == ("/a", LossKind.UNHEARD, 0)
    assert loss.first_ns < before < loss.last_ns


@pytest.mark.suite("all", "it kills or cuts something, and waits")
def test_a_node_that_shuts_down_is_not_one_that_is_unknown(
    master, slow_master, cassandra, keyspace
):
    """The master gets the request before the node unregisters, and answers after that."""
    one = RawPublisher(master.uri, "/a", header_of(String))
    behind = SimpleNamespace(env=dict(master.env, ROS_MASTER_URI=slow_master.uri))
    with start_recorder(behind, cassandra, keyspace, "/a") as child:
        one.await_subscribers().publish(text(1))
        child.await_line("recording 1 topic")
        slow_master.holds.set()
        assert slow_master.asked.wait(180)
        node = xmlrpc.client.ServerProxy(listed_node(master, "/recorder"))
        node.shutdown("/test", "asked to")
        assert child.wait() == 0, child.output
    one.close()
    assert slow_master.unregistered.is_set()
    assert "does not know this node" not in child.output


@pytest.mark.suite("all", "it stops its master for a while")
@pytest.mark.fault
def test_a_master_that_stood_still_is_no_loss(master, cassandra, keyspace, rosCas):
    with start_recorder(master, cassandra, keyspace, "/a") as child:
        child.await_line("recording 1 topic")
        one = RawPublisher(master.uri, "/a", header_of(String))
        one.await_subscribers().publish(text(1))
        with frozen(master):
            child.await_line("the ROS master does not answer")
            one.publish(text(2))
        child.await_line("the ROS master answers again")
        one.publish(text(3))
        one.close()
        assert "does not know this node" not in child.output
        assert child.end() == 0, child.output
    assert [row.wire for row in rosCas.getTopic("/a").rows()] == [text(n) for n in (1, 2, 3)]
    assert rosCas.catalog.keyspace.registry.losses() == []


@pytest.mark.suite("all", "it stops its master for a while")
@pytest.mark.fault
def test_a_recording_ends_without_its_master(master, cassandra, keyspace, rosCas):
    """A stopped master is like one out of reach: rospy would wait for it for ever."""
    with start_recorder(master, cassandra, keyspace, "/a") as child:
        child.await_line("recording 1 topic")
        one = RawPublisher(master.uri, "/a", header_of(String))
        one.await_subscribers().publish(text(1))
        with frozen(master):
            one.publish(text(2))
            assert child.end(timeout_sec=180) == 0, child.output
        one.close()
    assert [row.wire for row in rosCas.getTopic("/a").rows()] == [text(1), text(2)]


@pytest.mark.suite("all", "it kills or cuts something, and waits")
def test_a_history_subscriber_hears_who_comes_after_the_master_did(master, cassandra, keyspace):
    env = dict(master.env, CASSANDRA_ROS_HOST=cassandra.host, CASSANDRA_ROS_KEYSPACE=keyspace)
    env["CASSANDRA_ROS_PORT"] = str(cassandra.port)
    words = json.dumps({"topic": "/a", "type": "std_msgs/String"})
    with Child([sys.executable, LISTENER, words], env) as listener:
        listener.await_line("live")
        master.stop()
        master.start()
        new = RawPublisher(master.uri, "/a", header_of(String, "/new"), "/new")
        with new.await_subscribers():
            new.publish(text(1))
            listener.await_line("registering again")
            await_true(lambda: _count(listener) == 1)


def _count(listener):
    before = len(listener.lines)
    print("count", file=listener.process.stdin, flush=True)
    await_true(lambda: any(line.isdigit() for line in listener.lines[before:]))
    return int(next(line for line in listener.lines[before:] if line.isdigit()))


def test_programs_that_start_at_the_same_moment_choose_their_names_one_after_the_other():
    order, begun = [], threading.Event()

    def start_second():
        begun.set()
        with own_name("recorder", []):
            order.append("second")

    second = threading.Thread(target=start_second)
    with own_name("recorder", []) as (_, full_name, _), own_name("player", []):
        second.start()
        assert begun.wait(180)
        time.sleep(0.2)  # it would be in by now
        order.append(full_name)
    second.join()
    assert order == ["/recorder", "second"]


NODES = {
    "recorder": ["-a"],
    "player": ["/odom"],
    "query_server": [],
    "replicator": ["--to", "127.0.0.1:1"],
    "cassandra_bag": [
        *("map", "/scan", "--publish", "/office", "--resolution", "0.5", "--limit", "4"),
    ],
}
"""Program that starts a node -> its arguments."""


@pytest.mark.parametrize(
    "number", sparing([signal.SIGINT, signal.SIGTERM], [signal.SIGTERM], "campaign")
)
@pytest.mark.parametrize("name", sparing(list(NODES), kept=["recorder"]))
def test_a_node_says_which_master_it_waits_for(ros_env, cassandra, rosCas, keyspace, name, number):
    """Its standard error is a pipe, as a log file is: nothing waits in a buffer."""
    Drive().store(rosCas, ("/odom", "/scan"))
    where = ("--host", cassandra.host, "--port", cassandra.port, "--keyspace", keyspace)
    only_errors = ["bash", "-c", 'exec "$0" "$@" > /dev/null', PROGRAMS / name]
    env = {**ros_env, "ROS_MASTER_URI": NO_MASTER}
    with Child([*only_errors, *NODES[name], *where], env) as child:
        line = child.await_line("waiting for the ROS master")
        assert f"{NO_MASTER} (ROS_MASTER_URI): start roscore" in line
        assert child.end(number) == 128 + number, child.output
        assert child.lines == [line]


@pytest.mark.suite("all", "it stops a master, and waits")
def test_a_node_goes_on_when_its_master_comes(master, cassandra, rosCas, keyspace):
    master.stop()
    with start_recorder(master, cassandra, keyspace, "/a") as child:
        child.await_line("waiting for the ROS master")
        master.start()
        child.await_line("recording 1 topic")
        with RawPublisher(master.uri, "/a", header_of(String)) as one:
            one.await_subscribers().publish(text(1))
            assert child.end() == 0, child.output
    assert [row.wire for row in rosCas.getTopic("/a").rows()] == [text(1)]


@pytest.mark.suite("test", "-a leaves out what only the recorder publishes")
def test_a_recorder_of_all_topics_takes_none_that_only_it_publishes(master, cassandra, keyspace):
    with start_recorder(master, cassandra, keyspace, "-a") as child:
        with RawPublisher(master.uri, "/a", header_of(String)) as one:
            one.await_subscribers().publish(text(1))
            assert child.end() == 0, child.output
    assert not any("/diagnostics" in line or "/rosout" in line for line in child.lines)
