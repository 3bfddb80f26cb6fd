# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The player around hits, and with several robots at once."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import pytest
from nodes.children import start_node
from nodes.raw_subscriber import RawSubscriber
from playing.robots import Robot


@pytest.fixture
def play(roscore, cassandra, keyspace):
    """Play with options; return the texts of each topic, and what the player said."""

    def play(topics, *options):
        where = ("--host", cassandra.host, "--port", cassandra.port, "--keyspace", keyspace)
        options += ("--wait-for-subscribers",)
        with start_node(roscore, "player", *where, *options) as child:

            def hear(topic):
                with RawSubscriber(roscore.uri, topic) as heard:
                    return [wire[4:].decode() for wire in heard.rest()]

            with ThreadPoolExecutor(len(topics)) as pool:
                found = dict(zip(topics, pool.map(hear, topics)))
            assert child.wait() == 0, child.output
        return found, child.output

    return play


@pytest.mark.suite("all", "make test asks others of its kind")
def test_gaps_between_windows_are_jumped_over(rosCas, play):
    with Robot(rosCas, 1, "r1") as robot:
        for hour in range(5):
            t = 3600 * hour
            robot.send("/map", t - 1, f"m{hour}", latched=True)
            robot.send("/battery", t, "low" if hour in (1, 4) else "high")
            for n in range(-3, 4):
                robot.send("/tick", t + n / 10, f"{hour}:{n}")
    around = ("--around", "/battery: data = 'low'", "--before", "0.15", "--after", "0.25")
    # At its own pace: four hours would outlast every test.
    found, said = play(("/map", "/battery", "/tick"), *around)
    assert found == {
        # The message that was latched last in the gap.
        "/map": ["m1", "m4"],
        "/battery": ["low", "low"],
        "/tick": ["1:-1", "1:0", "1:1", "1:2", "4:-1", "4:0", "4:1", "4:2"],
    }
    assert "played 12 messages of 3 topics" in said


def test_two_topics_may_go_out_as_one(rosCas, play):
    with Robot(rosCas, 1) as robot:
        robot.send("/a", 0, "a")
        for n, topic in enumerate(("/b", "/a", "/b")):
            robot.send(topic, n + 1, f"{topic}{n}", latched=topic == "/b")
    found, said = play(("/c",), "/a:=/c", "/b:=/c", "-i")
    assert found == {"/c": ["a", "/b0", "/a1", "/b2"]}
    assert "played 4 messages of 1 topic" in said.splitlines()
    assert "1 latched" in said


@pytest.mark.suite("all", "make test asks others of its kind")
def test_robots_of_different_days_play_at_once(rosCas, play):
    for writer, node, begin in ((1, "robot-1", 0), (2, "robot-2", 86_400)):
        with Robot(rosCas, writer, node) as robot:
            for n in range(5):
                robot.send("/tick", begin + n / 10, f"{node}:{n}")
    topics = ("/fleet/robot_1/tick", "/fleet/robot_2/tick")
    found, _ = play(topics, "--align-start", "--node-prefix", "-p", "/fleet", "--clock")
    assert found == {
        topics[0]: [f"robot-1:{n}" for n in range(5)],
        topics[1]: [f"robot-2:{n}" for n in range(5)],
    }
