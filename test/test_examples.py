# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The examples run as they stand (the demo and its listing: make demo)."""

from __future__ import annotations

import math
import os
import re
import subprocess
import sys

import pytest
import rosbag
from compiled import compiled
from conftest import ROOT
from nodes.children import Child, start_recorder

from cassandra_ros import RosCassandra
from cassandra_ros.files.bag.importer import import_bag

HUSKY = ROOT / "examples/data/husky_gps_data.bag"
TURTLES = ROOT / "examples/data/turtlesim_tf.bag"
SENSORS = ["/turtle1/cmd_vel", "/turtle1/color_sensor", "/turtle1/pose"]


def storyboard(cassandra, keyspace, *arguments):
    store = ("--host", cassandra.host, "--port", cassandra.port, "--keyspace", keyspace)
    return [sys.executable, ROOT / "examples/storyboard.py", *store, *arguments]


def messages_of_the_turtles():
    with rosbag.Bag(str(TURTLES)) as bag:
        return [(topic, msg, t.to_nsec()) for topic, msg, t in bag.read_messages()]


def looks(messages, robot):
    """When a turtle saw bare floor, [first, last] ns, as the bag tells."""
    found = []
    for topic, msg, t in messages:
        if topic == f"/{robot}/color_sensor" and (msg.r, msg.g, msg.b) == (69, 86, 255):
            if not found or t - found[-1][1] > 500_000_000:
                found.append([t, t])
            found[-1][1] = t
    return found


def positions(messages, robot, low, high):
    """Where tf says that a turtle was: {t: (x, y)}."""
    return {
        t: (tf.transform.translation.x, tf.transform.translation.y)
        for topic, msg, t in messages
        if topic == "/tf" and low <= t <= high
        for tf in msg.transforms
        if tf.child_frame_id == robot
    }


@pytest.mark.suite("all", "make test asks others of its kind")
def test_results_under_names(cassandra, keyspace, ros_env, tmp_path):
    """The place of the store comes out of a cqlshrc here, and the login out of its file."""
    cqlshrc, credentials = tmp_path / "cqlshrc", tmp_path / "credentials"
    cqlshrc.write_text(f"[connection]\nhostname = {cassandra.host}\nport = {cassandra.port}\n")
    credentials.write_text("[PlainTextAuthProvider]\nusername = ann\npassword = secret\n")
    credentials.chmod(0o600)
    command = [sys.executable, str(ROOT / "examples/named_results.py")]
    options = ["--cqlshrc", str(cqlshrc), "--credentials", str(credentials), "--keyspace", keyspace]
    for name in ("CASSANDRA_ROS_HOST", "CASSANDRA_ROS_PORT"):
        ros_env = {**ros_env, name: ""}
    for run in (1, 2):
        done = subprocess.run(
            [*command, *options], env=ros_env, capture_output=True, text=True, timeout=300
        )
        assert done.returncode == 0, done.stderr
        assert f"kitchen: 81 x 60 cells, newest of {2 * run} versions" in done.stdout
        assert "the first was 80 cells wide" in done.stdout
        assert "4000000 cells" in done.stdout
        assert "names:   ['hall', 'kitchen']" in done.stdout
        assert "64 triangles" in done.stdout
        assert "50 points" in done.stdout
        assert done.stdout.count("('to the door', 5.0)") == run
        assert not done.stderr


@pytest.mark.suite("all", "make test asks others of its kind")
def test_the_listing_reads_what_the_environment_names(cassandra, keyspaces, connect, ros_env):
    topics = ["/fix", "/tf", "/imu/time_reference", "/husky/data/encoders"]
    with keyspaces.lend() as recorded, keyspaces.lend() as notes:
        with connect(keyspace=recorded) as rosCas:
            with rosbag.Bag(str(HUSKY)) as bag:
                topics = [topic for topic in topics if topic in bag.get_type_and_topic_info()[1]]
            import_bag(rosCas, HUSKY, topics=topics)
            before = {topic.name: topic.countTopicData() for topic in rosCas.getAllTopics()}
        env = {
            **ros_env,
            "CASSANDRA_ROS_HOST": cassandra.host,
            "CASSANDRA_ROS_PORT": str(cassandra.port),
            "CASSANDRA_ROS_KEYSPACE": recorded,
        }
        done = subprocess.run(
            [sys.executable, str(ROOT / "examples/listing.py"), "--notes", notes],
            env=env, capture_output=True, text=True, timeout=300,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert "'left turn at the gate'" in done.stdout
        with connect(keyspace=recorded) as rosCas:
            after = {topic.name: topic.countTopicData() for topic in rosCas.getAllTopics()}
            assert after == before
            rosCas.connectToKeyspace(notes)
            assert [topic.name for topic in rosCas.getAllTopics()] == ["/operator/notes"]


def test_every_example_takes_the_files_of_a_login():
    for name in ("figure3b", "figure4", "listing", "named_results", "storyboard", "track"):
        text = (ROOT / f"examples/{name}.py").read_text(encoding="utf-8")
        assert all(f'"--{file}"' in text for file in ("cqlshrc", "credentials")), name
        assert '{"cqlshrc": args.cqlshrc, "credentials": args.credentials}' in text, name
        assert "RosCassandra(args.host, args.port" in text and "**login)" in text, name


@pytest.mark.suite("all", "it starts many programs")
@pytest.mark.parametrize("name", ["figure3b", "figure4", "named_results", "storyboard"])
def test_what_writes_does_so_into_a_keyspace_of_its_own(ros_env, name):
    done = subprocess.run(
        [sys.executable, str(ROOT / f"examples/{name}.py"), "--help"],
        env={**ros_env, "CASSANDRA_ROS_KEYSPACE": "precious"},
        capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert f"default: {name}" in done.stdout
    assert "precious" not in done.stdout


@pytest.mark.suite("all", "make test asks others of its kind")
def test_the_storyboard_finds_what_the_bag_holds(cassandra, keyspace, ros_env):
    compiled("tf2_py")
    messages = messages_of_the_turtles()
    first, last = max(looks(messages, "turtle1"), key=lambda look: look[1] - look[0])
    low, high = first - 5 * 10**9, last + 5 * 10**9
    xs, ys = zip(*positions(messages, "turtle1", low, high).values())
    others = [
        t
        for t, (x, y) in positions(messages, "turtle2", low, high).items()
        if min(xs) <= x <= max(xs) and min(ys) <= y <= max(ys)
    ]
    wanted = [
        f"/{robot}/color_sensor, a turtlesim/Color, saw it {len(looks(messages, robot))} times"
        for robot in ("turtle1", "turtle2")
    ]
    wanted += [
        "who:      turtle1",
        f"when:     {first} to {last}, {(last - first) / 1e9:.2f} s",
        f"x {min(xs):.2f} to {max(xs):.2f} m, y {min(ys):.2f} to {max(ys):.2f} m",
        f"turtle2, {len(others)} transforms in {(others[-1] - others[0]) / 1e9:.2f} s",
        "carried:  carrot, then at x ",
    ]
    for name in SENSORS:
        count = sum(topic == name and low <= t <= high for topic, _, t in messages)
        wanted.append(f"{name}, {count} messages")
    done = subprocess.run(
        list(map(str, storyboard(cassandra, keyspace))),
        env=ros_env,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    for text in wanted:
        assert text in done.stdout
    # The carrot is 1 m ahead of the turtle, which moves 3 cm between two transforms.
    pose = next(tf for topic, tf, t in messages if topic == "/turtle1/pose" and t >= first)
    at = re.search(r"then at x (\S+) m, y (\S+) m", done.stdout)
    assert abs(float(at[1]) - pose.x - math.cos(pose.theta)) < 0.05
    assert abs(float(at[2]) - pose.y - math.sin(pose.theta)) < 0.05
    assert done.stdout.partition("replay:")[0] in (ROOT / "doc/examples.md").read_text()


@pytest.mark.suite("all", "it starts many programs")
def test_the_storyboard_replays_the_window(cassandra, keyspace, rosCas, roscore):
    compiled("tf2_py")
    rosCas.connectToKeyspace(keyspace + "_again")
    try:
        recorder = start_recorder(roscore, cassandra, rosCas.keyspace, *SENSORS)
        with recorder, Child(storyboard(cassandra, keyspace, "--replay"), roscore.env) as player:
            recorder.await_line("recording 3 topics")
            assert player.wait(300) == 0, player.output
            assert recorder.end() == 0, recorder.output
        found = re.search(r"when:     (\d+) to (\d+),", player.output)
        low, high = int(found[1]) - 5 * 10**9, int(found[2]) + 5 * 10**9
        with rosbag.Bag(str(TURTLES)) as bag:
            sent = [
                (topic, raw[1])
                for topic, raw, t in bag.read_messages(SENSORS, raw=True)
                if low <= t.to_nsec() <= high
            ]
        assert f"replayed: {len(sent)} messages" in player.output
        for name in SENSORS:
            assert [row.wire for row in rosCas.getTopic(name).rows()] == [
                wire for topic, wire in sent if topic == name
            ]
    finally:
        rosCas.cassandra.schema_change(f'DROP KEYSPACE "{rosCas.keyspace}"', what="cleaning up")


@pytest.mark.suite("campaign", "it takes minutes; what it shows, test/fleet and test/copying test")
def test_two_robots_copy_themselves_home(ros_env):
    done = subprocess.run(
        [sys.executable, str(ROOT / "examples/demo.py"), "--fleet"],
        env={**os.environ, **ros_env},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=1800,
    )
    assert done.returncode == 0, done.stdout[-3000:]
    assert done.stdout.count("of 12,303 messages") == done.stdout.count("of 8,647 messages") == 1
    assert "Nothing is left running." in done.stdout


@pytest.mark.suite("all", "make test asks others of its kind")
def test_figure_3b_has_a_map_of_the_scans_and_says_where_to_look(cassandra, new_keyspace, bags):
    """The bag has no tf: its odometry tells where the scans lie, and that is stored as tf."""
    store = ("--host", cassandra.host, "--port", str(cassandra.port), "--keyspace", new_keyspace)
    command = [
        sys.executable,
        ROOT / "examples/figure3b.py",
        bags / "luminar_stage_lz4.bag",
        *store,
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert "cells of 5 scans" in done.stdout
    (address,) = re.findall(r"look at:  (http://\S+)", done.stdout)
    state = dict(part.split("=") for part in address.split("?")[1].split("&"))
    assert state["topics"] == "/map,/base_scan,/tf"
    with RosCassandra(cassandra.host, cassandra.port, keyspace=new_keyspace) as rosCas:
        info = rosCas.getTopic("/map").getData("figure3b").info
        assert (info.width, info.height) > (100, 100)
        scan = rosCas.getTopic("/base_scan").getData(int(state["time"]), nearest="before")
        at = rosCas.lookupTransform("odom", scan.header.frame_id, scan.header.stamp)
        assert at.transform.translation.z == pytest.approx(0.1)
