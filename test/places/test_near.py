# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What was near a place: in statements, in ``near``, with and without the index of places."""

from __future__ import annotations

import math

import genpy
import numpy as np
import pytest
from campaign import campaign
from conftest import ROOT
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TransformStamped
from hypothesis import HealthCheck, given
from hypothesis import strategies as st
from nav_msgs.msg import Odometry
from std_msgs.msg import Int32
from tf2_msgs.msg import TFMessage

from cassandra_ros.bag.importer import import_bag
from cassandra_ros.errors import InvalidOption, InvalidQuery, RunNotFound
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection import live_connection
from cassandra_ros.recording.recording import Recording
from cassandra_ros.store.registry import Run

SEC = 10**9
T0 = 1_700_000_000 * SEC
GAP = 10 * SEC


def header_of(message):
    kind = type(message)
    return {
        "type": kind._type,
        "md5sum": kind._md5sum,
        "message_definition": kind._full_text,
        "callerid": "/test",
    }


def transform(parent, child, x, y, yaw=0.0):
    made = TransformStamped(child_frame_id=child)
    made.header.frame_id = parent
    made.transform.translation.x, made.transform.translation.y = x, y
    made.transform.rotation.z, made.transform.rotation.w = math.sin(yaw / 2), math.cos(yaw / 2)
    return made


def tf(*transforms):
    return TFMessage(list(transforms))


def odometry(x, y, frame="odom"):
    made = Odometry()
    made.header.frame_id = frame
    made.pose.pose.position.x, made.pose.pose.position.y = x, y
    made.pose.pose.orientation.w = 1
    return made


class Writer:
    """One run that stores messages at given times."""

    def __init__(self, store, node="", name="run", number=None, kind="recording"):
        self.store, self.node = store, node
        self.number = number or Writer.next()
        run = Run(node, self.number, kind, name=name)
        self.writer = store.messageWriter(writer_id=self.number, nodeID=node, run=run)
        self.handles, self.count = {}, 0

    @classmethod
    def next(cls):
        cls.last = getattr(cls, "last", 0) + 1
        return cls.last

    def put(self, topic, t, message):
        if topic not in self.handles:
            self.handles[topic] = self.writer.connect(live_connection(topic, header_of(message)))
        self.writer.write(self.handles[topic], t, self.count, serialize(message))
        self.count += 1

    def __enter__(self):
        return self

    def __exit__(self, *exc_info):
        self.writer.close()


def times_of(rows):
    return sorted(row.t for row in rows)


def asked(store, condition, params=(), **options):
    rows = store.executeCQL(f"select KEY from /n where {condition}", params, **options)
    return sorted(key.to_nsec() for (key,) in rows)


# -------------------------------------------------------------------- a real robot


@pytest.fixture(scope="module")
def husky(fresh):
    with fresh() as store:
        bag = ROOT / "examples/data/husky_gps_data.bag"
        import_bag(store, bag, topics=["/encoder", "/gps", "/tf", "/fix", "/joy"])
        yield store


def brute(store, topic, x, y, radius, source):
    """Times of a topic's messages at which odometry, joined by straight lines, is on a disk."""
    fields = ["KEY", "pose.pose.position.x", "pose.pose.position.y"]
    keys, xs, ys = (np.asarray(v) for v in store.getTopic(source).getArrays(fields).values())
    times = store.getTopic(topic).getArrays(["KEY"])["KEY"]
    known = times[(times >= keys[0]) & (times <= keys[-1])]
    base = keys[0]
    at_x, at_y = (np.interp(known - base, keys - base, values) for values in (xs, ys))
    return known[np.hypot(at_x - x, at_y - y) <= radius].tolist()


def test_a_real_robot_by_its_odometry(husky):
    frame = husky.executeCQL("select distinct header.frame_id from /encoder")[0][0]
    x, y = husky.executeCQL(
        "select pose.pose.position.x, pose.pose.position.y from /encoder limit 1"
    )[0]
    expected = brute(husky, "/joy", x, y, 2.0, "/encoder")
    count = husky.getTopic("/joy").countTopicData()
    assert 0 < len(expected) < count
    near = f"NEAR({x}, {y}, 2, '{frame}', '/encoder')"
    found = husky.executeCQL(f"select KEY from /joy where {near}")
    assert [key.to_nsec() for (key,) in found] == expected
    # The same in Python, of all topics, by time.
    rows = list(husky.near(x, y, 2, frame, ["/joy", "/fix"], robot="/encoder"))
    assert [row.t for row in rows if row.topic == "/joy"] == expected
    assert [row.t for row in rows] == times_of(rows)
    assert times_of(r for r in rows if r.topic == "/fix") == brute(
        husky, "/fix", x, y, 2.0, "/encoder"
    )
    # What is not near, and what nobody knows.
    others = husky.executeCQL(f"select count(*) from /joy where not {near}")[0][0]
    unknown = count - len(expected) - others
    assert others > 0
    assert unknown == husky.executeCQL(
        "select count(*) from /joy where KEY < ? or KEY > ?",
        [husky.getTopic("/encoder").first(), husky.getTopic("/encoder").last()],
    )[0][0]
    # Everywhere a condition may stand.
    joy = husky.getTopic("/joy")
    assert joy.countTopicData(where=near) == len(expected)
    assert joy.getArrays(["KEY"], where=near)["KEY"].tolist() == expected
    assert len(joy.getData(joy.first(), joy.last(), where=near)) == len(expected)
    assert joy.getData(expected[0], where=near)
    some = husky.executeCQL(f"select KEY from /joy where {near} order by KEY desc limit 3")
    assert [key.to_nsec() for (key,) in some] == expected[::-1][:3]
    told = str(husky.explainCQL(f"select KEY from /joy where {near}"))
    assert "near:" in told
    assert f"rows read:     {len(expected)}\n" in told


def test_errors_say_what_there_is(husky):
    with pytest.raises(InvalidQuery, match=r"no pose in frame 'map' is stored.*base_link") as told:
        husky.executeCQL("select KEY from /joy where NEAR(0, 0, 5)")
    assert told.value.position == len("select KEY from /joy where ")
    with pytest.raises(InvalidOption, match="no pose in frame 'map' is stored"):
        husky.near(0, 0, 5)
    for wrong, text in (
        ("NEAR(1, 2)", "3 to 5 values, not 2"),
        ("NEAR(1, 2, -1)", "the radius is negative"),
        ("NEAR(1, 'x', 1)", "y is a number of metres"),
        ("NEAR(1, 2, 1, 5)", "the frame is a name in quotes"),
        ("NEAR(axes, 2, 1)", "differs from row to row"),
        ("NEAR(1, 2, 1e400)", "the radius is a number of metres"),
    ):
        with pytest.raises(InvalidQuery, match=text):
            husky.executeCQL(f"select KEY from /joy where {wrong}")
    with pytest.raises(InvalidQuery, match="x is a number of metres"):
        husky.executeCQL("select KEY from /joy where NEAR(?, 0, 1)", [math.nan])
    with pytest.raises(RunNotFound):
        husky.near(0, 0, 5, run="nobody")
