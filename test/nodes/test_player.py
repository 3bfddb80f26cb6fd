# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The player as a node: what it plays is recorded by rosbag and compared."""

from __future__ import annotations

import pytest
import rosbag
from nodes.children import Child, start_node

from cassandra_ros.bag.importer import import_bag

SEC = 10**9
T0 = 1_405_015_391 * SEC


@pytest.fixture
def player(roscore, cassandra, keyspace):
    """Start players of the test's keyspace; they are gone afterwards."""
    started = []

    def start(*arguments, ready="services under ", **options):
        where = ("--host", cassandra.host, "--port", cassandra.port, "--keyspace", keyspace)
        child = start_node(roscore, "player", *where, *arguments, **options)
        started.append(child)
        if ready:
            child.await_line(ready)
        return child

    yield start
    for child in started:
        with child:
            pass


def recorded(path):
    """What a bag holds by topic: type, md5, definition, latching and bytes of each message."""
    found = {}
    with rosbag.Bag(str(path)) as bag:
        for topic, raw, _, header in bag.read_messages(raw=True, return_connection_header=True):
            kind, wire, md5sum = raw[:3]
            definition = header["message_definition"]
            latching = header.get("latching", b"0") in (b"1", "1")
            found.setdefault(topic, []).append((kind, md5sum, definition, latching, wire))
    return found


def test_a_played_bag_is_recorded_as_it_was(bags, roscore, player, rosCas, tmp_path):
    original = bags / "turtlesim_tf.bag"
    import_bag(rosCas, original)
    target = tmp_path / "again.bag"
    topics = [t.name for t in rosCas.getAllTopics() if not t.name.startswith("/rosout")]
    names = [f"/p{topic}" for topic in topics]
    # A higher rate would be too much for the queues of 100 messages in rosbag record.
    with Child(["rosbag", "record", "-O", target, "-b", "0", *names], roscore.env) as record:
        child = player(*topics, "-r", "6", "-p", "/p", "--wait-for-subscribers", ready=None)
        assert child.wait() == 0, child.output
        record.end()
    expected = {topic: each for topic, each in recorded(original).items() if topic in topics}
    found = recorded(target)
    assert sorted(found) == sorted(names)
    for topic in topics:
        assert found["/p" + topic] == expected[topic], topic
    assert child.lines[-1] == f"played {sum(map(len, expected.values()))} messages of 8 topics"
