# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The launch files: each argument an option of its program, and what they start."""

from __future__ import annotations

import fcntl
import json
import re
import signal
import struct
import subprocess
import time
import urllib.request
import xmlrpc.client
from concurrent.futures import ThreadPoolExecutor

import pytest
from nodes.children import Child, await_true, start_client
from nodes.raw_publisher import RawPublisher, header_of, message
from nodes.raw_subscriber import RawSubscriber
from std_msgs.msg import String, UInt32
from suites import sparing

from cassandra_ros import RosCassandra
from cassandra_ros.local_server import free_port
from cassandra_ros.messages.connection_header import live_connection


@pytest.fixture
def launched(roscore, cassandra, keyspace, tmp_path):
    started = []

    def launch(file, **arguments):
        where = {"host": cassandra.host, "port": cassandra.port, "keyspace": keyspace}
        words = [f"{key}:={value}" for key, value in {**where, **arguments}.items()]
        command = ["roslaunch", "--wait", "cassandra_ros", file, *words]
        child = Child(command, {**roscore.env, "ROS_LOG_DIR": str(tmp_path)})
        started.append(child)
        return child

    yield launch
    for child in started:
        with child:
            assert child.end(signal.SIGINT) == 0, child.output
    # roslaunch leaves them, and the next node of the name would take them.
    master = xmlrpc.client.ServerProxy(roscore.uri)
    for node in ("/cassandra_ros", "/player", "/recorder"):
        master.deleteParam("/test", node)


@pytest.mark.suite("test", "the launch file")
def test_cassandra_ros_launch_records_all_at_once(launched, roscore, rosCas):
    child = launched(
        "cassandra_ros.launch",
        local="false",
        node_id="robot 1",
        name="patrol",
        label="'site=the lab', operator=ann",
        where="'/launched/n: data > 1'",
        exclude="/rosout.*",
        ttl=86400,
        viewer="true",
        viewer_port=0,
    )
    child.await_line("services under /recorder")
    header = header_of(UInt32, "/numbers")
    with RawPublisher(roscore.uri, "/launched/n", header, "/numbers") as publisher:
        publisher.await_subscribers().publish(*(struct.pack("<I", n) for n in range(4)))
        await_true(
            lambda: (
                rosCas.existTopic("/launched/n")
                and rosCas.getTopic("/launched/n").countTopicData() == 2
            )
        )
    (run,) = rosCas.runs()
    assert (run.name, run.node, run.state) == ("patrol", "robot 1", "recording")
    assert run.labels == {"site": "the lab", "operator": "ann"}
    assert rosCas.getTopic("/launched/n").getMeta["ttl"] == 86400
    assert "/rosout" not in [topic.name for topic in rosCas.getAllTopics()]
    address = re.search(r"http://127\.0\.0\.1:\d+", child.await_line(" is at http"))[0]
    with urllib.request.urlopen(address + "/api/runs", timeout=180) as answer:  # noqa: S310 (our own)
        assert json.load(answer)["runs"][0]["run"] == "patrol"


WAITS = [
    (["local:=true"], False),
    (["local:=true", "secure:=true"], True),
    (["local:=false"], False),
]


@pytest.mark.parametrize(("arguments", "waits_before"), sparing(WAITS, kept=WAITS[1:2]))
def test_the_recorder_waits_by_itself_unless_it_needs_the_files_of_a_login(
    ros_env, arguments, waits_before
):
    command = ["roslaunch", "--args", "/recorder", "cassandra_ros", "cassandra_ros.launch"]
    done = subprocess.run(
        [*command, *arguments], env=ros_env, stdout=subprocess.PIPE, text=True, check=True
    )
    assert "__name:=recorder" in done.stdout
    assert ("status --wait" in done.stdout) == waits_before


@pytest.mark.suite("all", "it starts a Cassandra")
def test_a_local_launch_records_what_comes_before_its_cassandra_answers(roscore, tmp_path):
    folder, port = tmp_path / "data", free_port()
    folder.mkdir()
    env = {**roscore.env, "ROS_LOG_DIR": str(tmp_path)}
    where = ["local:=true", f"dir:={folder}", f"port:={port}", "heap:=512M", "keyspace:=early"]
    command = ["roslaunch", "--wait", "cassandra_ros", "cassandra_ros.launch", *where]
    with (folder / "lock").open("w") as lock, start_client(roscore) as client:
        fcntl.flock(lock, fcntl.LOCK_EX)  # the Cassandra is not started before it is free
        with Child([*command, "topics:=/early"], env) as child:
            child.await_line("services under /recorder")
            header = header_of(UInt32, "/numbers")
            with RawPublisher(roscore.uri, "/early", header, "/numbers") as publisher:
                publisher.await_subscribers().publish(*(struct.pack("<I", n) for n in range(5)))
                await_true(lambda: received(client, "/early") == 5)
            assert client.call("/recorder/status")["state"] == "waiting"
            child.await_line("no store yet: ")
            fcntl.flock(lock, fcntl.LOCK_UN)
            child.await_line("the store answers after ", timeout_sec=300)
            await_true(lambda: client.call("/recorder/status")["state"] == "recording")
            with RosCassandra("127.0.0.1", port, keyspace="early") as store:
                await_true(lambda: store.existTopic("/early"))
                topic = store.getTopic("/early")
                await_true(lambda: topic.countTopicData() == 5)
                assert [row.message().data for row in topic.rows()] == list(range(5))
            assert child.end(signal.SIGINT) == 0, child.output
    xmlrpc.client.ServerProxy(roscore.uri).deleteParam("/test", "/recorder")


def received(client, topic):
    topics = client.call("/recorder/status")["topics"]
    return sum(each["received"] for each in topics if each["topic"] == topic)


@pytest.mark.suite("test", "the launch file")
def test_play_launch_plays(launched, roscore, rosCas):
    begin = time.time_ns() // 10**9 * 10**9 - 10**11
    with rosCas.messageWriter(nodeID="robot 1") as writer:
        for topic in ("/launched/a", "/launched/b"):
            handle = writer.connect(live_connection(topic, header_of(String)))
            for n in range(5):
                writer.write(handle, begin + n * 10**7, n, message(String(str(n))))
    child = launched(
        "play.launch",
        topics="/launched/a /launched/b",
        node_id="robot 1",
        where="/launched/a: data > '1' and data != '3'",
        pause_topics="/other /more",
        wait_for_subscribers="true",
        clock="true",
        hz="50",
        rate="0.02",
        quiet="true",
        required="true",
        align_nodes="true",
    )
    with ThreadPoolExecutor(3) as pool:
        topics = ("/launched/a", "/launched/b", "/clock")
        heard = [pool.submit(hear, roscore.uri, topic) for topic in topics]
        a, b, clock = (each.result() for each in heard)
    assert a == [message(String(text)) for text in "24"]
    assert b == [message(String(text)) for text in "01234"]
    times = [secs * 10**9 + nsecs for secs, nsecs in map(struct.Struct("<II").unpack, clock)]
    assert len(times) > 1  # of 100, in 2 s; a busy machine tells fewer
    assert times == sorted(times)
    assert begin <= times[0] <= times[-1] <= begin + 10**8
    child.await_line("REQUIRED process [player")
    assert child.wait() == 0, child.output  # by itself: a signal would end it amid its own end
    assert "messages of" not in child.output
    assert "no topic /more is played" in child.output
    assert "Traceback" not in child.output


@pytest.mark.suite("all", "make test asks others of its kind")
def test_play_launch_plays_several_stores_and_names_one_that_is_away(
    launched, roscore, rosCas, cassandra, tmp_path
):
    begin = time.time_ns() // 10**9 * 10**9 - 10**11
    with rosCas.messageWriter(nodeID="robot 1") as writer:
        handle = writer.connect(live_connection("/launched/a", header_of(String)))
        for n in range(3):
            writer.write(handle, begin + n * 10**7, n, message(String(str(n))))
    stores = tmp_path / "stores"
    place = f"{cassandra.host}:{cassandra.port}/{rosCas.keyspace}"
    stores.write_text(f"[home]\nplace = {place}\n[away]\nplace = {cassandra.host}:1\n")
    child = launched(
        "play.launch",
        host="",
        port="",
        stores="home away",
        store_file=stores,
        store_timeout="180",
        topics="/launched/a",
        wait_for_subscribers="true",
        required="true",
    )
    assert hear(roscore.uri, "/launched/a") == [message(String(text)) for text in "012"]
    child.await_line("store away did not answer")
    child.await_line("REQUIRED process [player")
    assert child.wait() == 0, child.output


def hear(uri, topic):
    with RawSubscriber(uri, topic) as subscriber:
        return subscriber.rest()
