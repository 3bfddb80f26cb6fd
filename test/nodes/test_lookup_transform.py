# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The service ~lookupTransform of a real node."""

from __future__ import annotations

import signal
import subprocess
import uuid

import pytest
from compiled import compiled
from geometry_msgs.msg import TransformStamped
from nodes.children import start_client, start_node
from tf2_msgs.msg import TFMessage

from cassandra_ros import RosCassandra

compiled("tf2_py")

SEC = 10**9
T0 = 1_405_015_391 * SEC + 123_456_789


def transform(parent, child, stamp, x):
    made = TransformStamped(child_frame_id=child)
    made.header.frame_id = parent
    made.header.stamp.secs, made.header.stamp.nsecs = divmod(stamp, SEC)
    made.transform.translation.x = x
    made.transform.rotation.w = 1.0
    return TFMessage([made])


@pytest.fixture(scope="module")
def client(roscore, cassandra, cql):
    name = f"t_{uuid.uuid4().hex[:16]}"
    with RosCassandra(cassandra.host, cassandra.port, keyspace=name) as rosCas:
        for topic in ("/tf", "/red/tf", "/tf_static", "/red/tf_static"):
            rosCas.addTopic(topic, msg_type="tf2_msgs/TFMessage")
        for n in range(5):
            t = T0 + n * SEC
            rosCas.getTopic("/tf").addData(transform("map", "base", t, n), key=t, nodeID="a")
            rosCas.getTopic("/red/tf").addData(transform("map", "base", t, 10 * n), key=t)
        for topic, x in (("/tf_static", 0.5), ("/red/tf_static", 5.0)):
            rosCas.getTopic(topic).addData(transform("base", "arm", T0, x), key=T0, nodeID="a")
    where = ("--host", cassandra.host, "--port", cassandra.port, "--keyspace", name)
    with start_node(roscore, "query_server", *where) as server:
        server.await_line("serving keyspace")
        with start_client(roscore) as child:
            yield child
        assert server.end(signal.SIGINT) == 0
    cql.execute(f"DROP KEYSPACE {name}")


@pytest.fixture
def look(client):
    def call(target, source, time, **request):
        frames = {"target_frame": target, "source_frame": source}
        return client.call("/cassandra_ros/lookupTransform", **frames, time=time, **request)

    return call


def test_a_transform(look):
    answer = look("/map", "arm", T0 + SEC // 2 + 1, node_id="a")
    assert (answer["success"], answer["message"]) == (True, "")
    found = answer["transform"]
    assert (found["header"]["frame_id"], found["child_frame_id"]) == ("map", "arm")
    assert found["header"]["stamp"] == T0 + SEC // 2 + 1
    assert found["transform"]["translation"]["x"] == pytest.approx(1.000000001)
    assert found["transform"]["rotation"]["w"] == 1.0


def test_the_newest_and_other_topics(look):
    assert look("map", "base", 0)["transform"]["header"]["stamp"] == T0 + 4 * SEC
    other = look("map", "arm", T0 + SEC // 2, tf="/red/tf", tf_static="red/tf_static")
    assert other["transform"]["transform"]["translation"]["x"] == pytest.approx(10.0)


@pytest.mark.parametrize(
    ("target", "source", "time", "more", "word"),
    [
        ("map", "bass", T0, {}, "did you mean base?"),
        ("map", "base", T0 + 9 * SEC, {}, "5 s before"),
        ("map", "base", T0, {"node_id": "b"}, "of node b"),
        ("map", "", T0, {}, "not a name of a frame"),
        ("map", "base", T0, {"tf": "/tff", "tf_static": "/tfs"}, "topic '/tff' is not stored"),
    ],
)
def test_bad_requests_are_answered(look, target, source, time, more, word):
    answer = look(target, source, time, **more)
    assert not answer["success"]
    assert word in answer["message"]
    assert answer["transform"]["child_frame_id"] == ""


def test_on_the_command_line(client, roscore):
    secs, nsecs = divmod(T0 + SEC, SEC)
    request = f"{{target_frame: map, source_frame: base, time: {{secs: {secs}, nsecs: {nsecs}}}}}"
    words = ["rosservice", "call", "/cassandra_ros/lookupTransform", request]
    done = subprocess.run(words, env=roscore.env, capture_output=True, text=True, check=True)
    assert "success: True" in done.stdout
    assert f"nsecs: {nsecs}" in done.stdout
    assert "x: 1.0" in done.stdout
