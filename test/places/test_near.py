# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What was near a place: in statements, in ``near``, with and without the index of places."""

from __future__ import annotations

import math
import threading
from concurrent.futures import Future

import numpy as np
import pytest
import rosbag
import rospy
from conftest import ROOT
from geometry_msgs.msg import TransformStamped
from hypothesis import HealthCheck, given
from hypothesis import strategies as st
from nav_msgs.msg import Odometry
from nodes.children import await_true
from places.runs import (
    GAP,
    SEC,
    T0,
    Clock,
    Writer,
    asked,
    header_of,
    noted_of,
    odometry,
    times_of,
)
from std_msgs.msg import Int32
from suites import search
from tf2_msgs.msg import TFMessage

from cassandra_ros.errors import InvalidOption, InvalidQuery, RunNotFound
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.messages.classes import serialize
from cassandra_ros.places import track_windows
from cassandra_ros.places.regions import DiskRegion
from cassandra_ros.places.rigid import Rigid
from cassandra_ros.places.robots import fixed_text, is_fixed_to
from cassandra_ros.places.track_windows import TRACK_WINDOW_NS
from cassandra_ros.query.protocols import Disk
from cassandra_ros.recording import place_keeper
from cassandra_ros.recording.recording import Recording
from cassandra_ros.store.tables.registry import LossKind


def transform(parent, child, x, y, yaw=0.0):
    made = TransformStamped(child_frame_id=child)
    made.header.frame_id = parent
    made.transform.translation.x, made.transform.translation.y = x, y
    made.transform.rotation.z, made.transform.rotation.w = math.sin(yaw / 2), math.cos(yaw / 2)
    return made


def tf(*transforms):
    return TFMessage(list(transforms))


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
    # Messages that are not near, and messages without a known pose.
    others = husky.executeCQL(f"select count(*) from /joy where not {near}")[0][0]
    unknown = count - len(expected) - others
    assert others > 0
    assert (
        unknown
        == husky.executeCQL(
            "select count(*) from /joy where KEY < ? or KEY > ?",
            [husky.getTopic("/encoder").first(), husky.getTopic("/encoder").last()],
        )[0][0]
    )
    # Everywhere a condition may stand.
    joy = husky.getTopic("/joy")
    assert joy.countTopicData(where=near) == len(expected)
    assert joy.getArrays(["KEY"], where=near)["KEY"].tolist() == expected
    assert len(joy.getData(joy.first(), joy.last(), where=near)) == len(expected)
    assert joy.getData(expected[0], where=near)
    some = husky.executeCQL(f"select KEY from /joy where {near} order by KEY desc limit 3")
    assert [key.to_nsec() for (key,) in some] == expected[::-1][:3]
    # A plot shows these and no others.
    drawn = husky.statements.series(f"select buttons[0] from /joy where {near}")
    assert expected[0] - 10**8 <= drawn.points.times.min()
    assert drawn.points.times.max() <= expected[-1] + 10**8
    told = str(husky.explainCQL(f"select KEY from /joy where {near}"))
    assert "times:         read in 3 time ranges\n" in told
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


SPOTS = st.integers(-3, 3).map(float)
STEPS = st.sampled_from([SEC // 10, SEC, 4 * SEC, GAP, GAP + 1, 200 * SEC])


@st.composite
def drives(draw):
    """One or two runs of a robot: when it was where, and when messages came."""
    runs, t = [], T0
    for _ in range(draw(st.integers(1, 2))):
        poses = []
        for step in draw(st.lists(STEPS, min_size=1, max_size=6)):
            t += step
            poses.append((t, draw(SPOTS) * 5, draw(SPOTS) * 5))
        runs.append(poses)
        t += draw(STEPS)
    every = [pose for poses in runs for pose in poses]
    times = {t for t, _, _ in every} | {t + 1 for t, _, _ in every}
    for (first, *_), (last, *_) in zip(every, every[1:]):
        times |= {first + (last - first) * n // 4 for n in (1, 2, 3)}
    return runs, sorted(times | {T0, t + SEC})


def expected_of(runs, times, x, y, radius):
    """Times at which the robot is on a disk, and times at which that is unknown; by hand."""
    poses = [pose for poses in runs for pose in poses]
    near, unknown = [], []
    for t in times:
        before = max((pose for pose in poses if pose[0] <= t), default=None)
        after = min((pose for pose in poses if pose[0] >= t), default=None)
        if not before or not after or after[0] - before[0] > GAP:
            unknown.append(t)
            continue
        share = (t - before[0]) / ((after[0] - before[0]) or 1)
        place = [b + share * (a - b) for b, a in zip(before[1:], after[1:])]
        if math.hypot(place[0] - x, place[1] - y) <= radius:
            near.append(t)
    return near, unknown


@pytest.fixture(scope="module")
def drive_stores(fresh):
    """A store for each example would take too long: each has a node of its own."""
    with fresh() as store:
        store.addTopic("/n", "binary", msg_type="std_msgs/Int32")
        store.addTopic("/odom", "binary", msg_type="nav_msgs/Odometry")
        store.addTopic("/tf", "binary", msg_type="tf2_msgs/TFMessage")
        yield store


def store_drive(store, node, runs, times, by_tf):
    """Store the poses of runs, by tf or odometry, and messages."""
    with Writer(store, node, f"n of {node}") as writer:
        for t in times:
            writer.put("/n", t, Int32(1))
    for number, poses in enumerate(runs):
        with Writer(store, node, f"{node} {number}") as writer:
            for t, x, y in poses:
                if by_tf:
                    # A chain of which both parts move, and a turn that does not matter.
                    parts = transform("map", "odom", x, 0.0), transform("odom", "base_link", 0.0, y)
                    writer.put("/tf", t, tf(*parts))
                else:
                    writer.put("/odom", t, odometry(x, y, "map"))


@pytest.mark.suite("test", "NEAR, counted by hand")
@given(drives(), st.tuples(SPOTS, SPOTS, st.sampled_from([0.0, 1.0, 5.0, 12.0])), st.booleans())
@search(24, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_near_is_what_is_counted_by_hand(drive_stores, drive, disk, by_tf):
    store, (runs, times) = drive_stores, drive
    x, y, radius = disk[0] * 5, disk[1] * 5, disk[2]
    near, unknown = expected_of(runs, times, x, y, radius)
    node = f"r{Writer.next()}"
    store_drive(store, node, runs, times, by_tf)

    def check():
        condition, params = "NEAR(?, ?, ?)", [x, y, radius]
        assert asked(store, condition, params, nodeID=node) == near
        away = asked(store, f"not {condition}", params, nodeID=node)
        assert away == sorted(set(times) - set(near) - set(unknown))
        both = asked(store, f"{condition} or KEY = ?", [*params, times[0]], nodeID=node)
        assert both == sorted({*near, times[0]})
        down = store.executeCQL(
            f"select KEY from /n where {condition} and NEAR(?, ?, ?) order by KEY desc",
            params * 2,
            nodeID=node,
        )
        assert [key.to_nsec() for (key,) in down] == near[::-1]

    check()
    done = store.upkeep.indexPlaces(nodeID=node)
    assert {each.state for each in done} == {"indexed", "no poses"}
    check()


def lane(store, node="", count=40, run="lane", start=T0, y=0.0, kind="recording"):
    """A robot that drives 10 m a second along x, by tf, and a message each second."""
    with Writer(store, node, run, kind=kind) as writer:
        for n in range(count):
            t = start + n * SEC
            parts = transform("map", "odom", 0.0, y), transform("odom", "base_link", 10.0 * n, 0.0)
            writer.put("/tf", t, tf(*parts))
            writer.put("/n", t + 1, Int32(n))
    return writer.number


def read_keys(monkeypatch, store):
    """Note which stretches of the poses are read."""
    spans, topic = [], type(store.getTopic("/tf"))
    original = topic.getArrays

    def noting(self, fields, key=None, to_key=None, *args, **options):
        spans.append((self.name, key, to_key))
        return original(self, fields, key, to_key, *args, **options)

    monkeypatch.setattr(topic, "getArrays", noting)
    return spans


@pytest.mark.suite("all", "make test asks others of its kind")
def test_the_index_is_asked_and_right(rosCas, monkeypatch):
    hour = 3600 * SEC
    lane(rosCas, run="a")
    lane(rosCas, run="b", start=T0 + hour, y=100.0)
    lane(rosCas, run="c", start=T0 + 2 * hour)
    expected = [T0 + 20 * SEC + 1, T0 + 2 * hour + 20 * SEC + 1]
    condition = "NEAR(200, 0, 2)"
    assert asked(rosCas, condition) == expected
    states = rosCas.upkeep.placesIndex()
    assert {each.state for each in states} == {"not indexed"}
    done = {each.run: each for each in rosCas.upkeep.indexPlaces()}
    assert {each.state for each in done.values()} == {"indexed"}
    assert done["a"].first_ns == T0
    assert done["a"].last_ns == T0 + 39 * SEC
    assert done["a"].visits > 100 / 4
    assert all(not each.visits for each in rosCas.upkeep.indexPlaces())  # again does nothing
    spans = read_keys(monkeypatch, rosCas)
    assert asked(rosCas, condition) == expected
    # Run b is never near: of it, but for the looks at its frames, nothing is read.
    whole = [low for _, low, high in spans if high.to_nsec() - low.to_nsec() > 5 * SEC]
    assert whole
    assert not any(T0 + hour <= low.to_nsec() <= T0 + hour + 40 * SEC for low in whole)
    # Messages of other runs at the same time, other frames, frames that are not robots.
    with Writer(rosCas, "", "late") as writer:
        writer.put("/n", T0 + 20 * SEC + 5, Int32(9))
    assert asked(rosCas, condition) == sorted([*expected, T0 + 20 * SEC + 5])
    assert asked(rosCas, "NEAR(200, 0, 2, 'odom')") != asked(rosCas, condition)
    # Deleted poses are not poses, whatever the index holds.
    rosCas.getTopic("/tf").removeData(T0, T0 + 40 * SEC)
    assert asked(rosCas, condition) == expected[1:]
    rosCas.removeTopic("/tf")
    with pytest.raises(InvalidQuery, match="where robots were is not stored"):
        asked(rosCas, condition)


@pytest.mark.suite("all", "make test asks others of its kind")
def test_poses_that_are_not_in_the_index_count(rosCas):
    lane(rosCas, run="a")
    rosCas.upkeep.indexPlaces()
    # A part of a bag that goes on: the way from its last pose to the next one is not noted.
    lane(rosCas, run="b", start=T0 + 41 * SEC, y=0.0)
    with Writer(rosCas, "", "between") as writer:
        writer.put("/n", T0 + 40 * SEC, Int32(1))  # on the way from 390 m to 0
    assert asked(rosCas, "NEAR(195, 0, 1)") == [T0 + 40 * SEC]
    rosCas.upkeep.indexPlaces()
    assert asked(rosCas, "NEAR(195, 0, 1)") == [T0 + 40 * SEC]
    assert asked(rosCas, "NEAR(200, 0, 2)") == [T0 + n * SEC + 1 for n in (20, 61)]


@pytest.mark.suite("all", "make test asks others of its kind")
def test_who_asks_for_a_time_finds_a_robot_that_came_before_it(rosCas):
    """A robot stands at one place for ten minutes; only a part of that time is asked for."""
    with Writer(rosCas, "", "stands") as writer:
        for n in range(61):
            writer.put("/odom", T0 + 10 * n * SEC, odometry(1.0, 2.0, "map"))
            writer.put("/n", T0 + 10 * n * SEC, Int32(n))
        # It drives away, so that not all of the recording is near the place.
        writer.put("/odom", T0 + 620 * SEC, odometry(900.0, 900.0, "map"))
        writer.put("/n", T0 + 620 * SEC, Int32(61))

    def check():
        for first, last in ((0, 61), (3, 5), (30, 30), (58, 61)):
            times = [T0 + 10 * first * SEC, T0 + 10 * last * SEC]
            found = asked(rosCas, "NEAR(1, 2, 3) and KEY >= ? and KEY <= ?", times)
            assert found == [T0 + 10 * n * SEC for n in range(first, min(last, 60) + 1)]

    check()
    rosCas.upkeep.indexPlaces()
    assert noted_of(rosCas) == [(T0, T0 + 620 * SEC)]
    check()


def test_the_text_of_a_fixed_frame_stays_as_it_is_stored():
    """The index of places has such texts in stores of earlier releases."""
    pose = Rigid(np.array([[1.0, -2.5, 0.0]]), np.array([[0.0, 0.0, 0.0, 1.0]]))
    text = fixed_text("map", pose)
    assert text == "map [[1.0, -2.5, 0.0]] [[0.0, 0.0, 0.0, 1.0]]"
    assert is_fixed_to(text, "map")
    assert not is_fixed_to(text, "ma") and not is_fixed_to(text, "map ")


def test_an_answer_is_shared_inside_another(husky):
    places, disk = husky.catalog.places, Disk(0.0, 0.0, 5.0, "odom_combined")
    with places.shared():
        outer = places.stays(disk)
        with places.shared():
            assert places.stays(disk) is outer
        assert places.stays(disk) is outer
    assert places.stays(disk) is not outer


def test_frames_that_are_fixed_in_another_way_since(rosCas):
    """What was noted holds for the frames as they were: a map that is moved moves the robot."""
    with Writer(rosCas, "", "still") as writer:
        writer.put("/tf_static", T0, tf(transform("map", "odom", 0.0, 0.0)))
    with Writer(rosCas, "", "moves") as writer:
        for n in range(10):
            writer.put("/tf", T0 + n * SEC, tf(transform("odom", "base_link", 10.0 * n, 0.0)))
            writer.put("/n", T0 + n * SEC, Int32(n))
    rosCas.upkeep.indexPlaces()
    assert asked(rosCas, "NEAR(50, 0, 1)") == [T0 + 5 * SEC]
    with Writer(rosCas, "", "later") as writer:
        writer.put("/tf_static", T0 + 99 * SEC, tf(transform("map", "odom", 0.0, 500.0)))
        writer.put("/tf_static", T0 + 99 * SEC, tf(transform("earth", "map", 0.0, 0.0)))
    assert asked(rosCas, "NEAR(50, 0, 1)") == []
    assert asked(rosCas, "NEAR(50, 500, 1)") == [T0 + 5 * SEC]
    assert asked(rosCas, "NEAR(50, 500, 1, 'earth')") == [T0 + 5 * SEC]
    states = {each.run: each.state for each in rosCas.upkeep.placesIndex()}
    assert states == {"still": "no poses", "moves": "not indexed", "later": "no poses"}
    rosCas.upkeep.indexPlaces()
    assert asked(rosCas, "NEAR(50, 500, 1)") == [T0 + 5 * SEC]


def record(store, monkeypatch, moments, **options):
    """Record messages at some times: each a time, a topic, and a message."""
    clock, headers = Clock(), {}
    recording = Recording(store.catalog, clock=clock, name="live", **options)
    keeper = recording._places
    for t, topic, message in moments:
        clock.now = t
        header = headers.setdefault(topic, header_of(message))
        assert recording.received(topic, header, serialize(message))
    return recording, keeper


def drive_moments(count=60, start=T0):
    yield start, "/tf_static", tf(transform("base_footprint", "base_link", 0.0, 0.0))
    for n in range(count):
        t = start + n * SEC
        yield t, "/tf", tf(transform("map", "odom", 0.0, 0.0))
        yield t, "/tf", tf(transform("odom", "base_footprint", 10.0 * n, 0.0))
        yield t, "/odom", odometry(10.0 * n, 0.0)
        yield t + 1, "/n", Int32(n)


def test_a_recorder_notes_places(rosCas, monkeypatch):
    recording, keeper = record(rosCas, monkeypatch, drive_moments(), node="husky")
    assert recording.close()
    tables = [t.name for name in ("/tf", "/odom") for t in rosCas.getTopic(name).tables]
    placed = rosCas.catalog.keyspace.place_index.placed(tables)
    assert {(p.node, p.writer) for p in placed} == {("husky", recording.writer_id)}
    by_robot = {p.robot: p for p in placed}
    assert set(by_robot) == {"base_link", tables[1]}
    assert set(by_robot["base_link"].above) == {"base_link", "base_footprint", "odom", "map"}
    assert (by_robot["base_link"].low, by_robot["base_link"].high) == (T0, T0 + 59 * SEC)
    assert {each.state for each in rosCas.upkeep.placesIndex()} == {"indexed"}
    spans = read_keys(monkeypatch, rosCas)
    near = "NEAR(200, 0, 2)"
    assert asked(rosCas, near) == [T0 + 20 * SEC + 1]
    spans.clear()
    assert asked(rosCas, "NEAR(200, 50, 2)") == []
    # The cell is one in which the robot never was: only its frames were looked for.
    assert all(high.to_nsec() - low.to_nsec() <= SEC for _, low, high in spans)


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_recorder_notes_part_by_part(rosCas, monkeypatch):
    """What is not noted yet is found all the same; a clock that goes back is noted, too."""
    moments = list(drive_moments(60))
    recording, keeper = record(rosCas, monkeypatch, moments[:161])  # 40 s
    await_true(lambda: all(s.handle for s in recording._sources.values()))
    keeper._note(last=False)
    noted = keeper._noted
    assert T0 < noted < T0 + 40 * SEC - GAP + SEC
    clock_back = [(T0 - 100 * SEC + n * SEC, *rest) for n, (_, *rest) in enumerate(moments[:9])]
    for t, topic, message in [*moments[161:], *clock_back]:
        recording._clock.now = t
        recording.received(topic, header_of(message), serialize(message))
    keeper._note(last=False)
    recording.close()
    times = asked(rosCas, "NEAR(200, 0, 2)")
    assert times == [T0 + 20 * SEC + 1]
    assert asked(rosCas, "NEAR(0, 0, 15)") == brute_tf(rosCas, 0, 0, 15)


def brute_tf(store, x, y, radius):
    """Times of messages at which all of tf, read at once, has the robot on a disk."""
    poses = store.catalog.places.robots("map")[0].poses()
    times = store.getTopic("/n").getArrays(["KEY"])["KEY"]
    placed = poses.at(times)
    near = placed.known & (np.hypot(placed.poses.x - x, placed.poses.y - y) <= radius)
    return times[near].tolist()


def test_without_places_nothing_is_noted(rosCas, monkeypatch):
    recording, _ = record(rosCas, monkeypatch, drive_moments(5), places=False)
    recording.close()
    tables = [t.name for t in rosCas.getTopic("/tf").tables]
    assert rosCas.catalog.keyspace.place_index.placed(tables) == []
    assert asked(rosCas, "NEAR(20, 0, 2)") == [T0 + 2 * SEC + 1]


@pytest.mark.suite("all", "make test asks others of its kind")
def test_each_robot_of_a_fleet_by_its_own_poses(rosCas):
    lane(rosCas, "ant", run="a")
    lane(rosCas, "bee", run="b", y=50.0)
    with Writer(rosCas, "cat", "c") as writer:  # a robot without poses
        writer.put("/n", T0 + 20 * SEC + 1, Int32(1))
    for indexed in (False, True):
        rows = rosCas.executeCQL("select NODE, KEY from /n where NEAR(200, 50, 2)")
        assert [(node, key.to_nsec()) for node, key in rows] == [("bee", T0 + 20 * SEC + 1)]
        assert len(list(rosCas.near(200, 25, 30))) == 2 * (3 + 3)
        assert asked(rosCas, "NEAR(200, 50, 2)", nodeID="ant") == []
        rows = list(rosCas.near(200, 0, 2, topics="/n", where={"/n": "data > 5"}, run="a"))
        assert [row.node for row in rows] == ["ant"]
        assert list(rosCas.near(200, 0, 2, topics="/n", where={"/n": ("data < ?", [5])})) == []
        if not indexed:
            rosCas.upkeep.indexPlaces()
    assert rosCas.catalog.places.robots("map", nodes=["bee"])[0].node == "bee"
    assert [(each.node, each.run) for each in rosCas.upkeep.placesIndex(nodeID="bee")] == [
        ("bee", "b")
    ]


def test_two_robots_to_which_nobody_gave_a_name(rosCas):
    """If runs overlap, each message is judged by the poses of its own run."""
    lane(rosCas, run="a")
    lane(rosCas, run="b", y=50.0)
    expected = T0 + 20 * SEC + 1
    for _ in range(2):
        rows = rosCas.executeCQL("select RUN, KEY from /n where NEAR(200, 50, 2)")
        assert [(run, key.to_nsec()) for run, key in rows] == [("b", expected)]
        rows = rosCas.executeCQL("select RUN from /n where NEAR(200, 0, 2)")
        assert rows == [("a",)]
        rosCas.upkeep.indexPlaces()


def test_what_may_be_meant_in_two_ways_is_asked_for(rosCas):
    with Writer(rosCas, "", "turtles") as writer:
        for n in range(3):
            t = T0 + n * SEC
            turtles = transform("world", "turtle1", n, 0.0), transform("world", "turtle2", 0.0, n)
            writer.put("/tf", t, tf(*turtles))
            writer.put("/wheels", t, odometry(float(n), 0.0))
            writer.put("/vision", t, odometry(0.0, float(n)))
            writer.put("/goal", t, odometry(99.0, 0.0, "site"))
            writer.put("/n", t, Int32(n))
    with pytest.raises(InvalidQuery, match=r"turtle1 and turtle2 may be the robot.*'turtle1'\)"):
        asked(rosCas, "NEAR(0, 2, 0.5, 'world')")
    assert asked(rosCas, "NEAR(0, 2, 0.5, 'world', 'turtle2')") == [T0 + 2 * SEC]
    assert asked(rosCas, "NEAR(2, 0, 0.5, '/world', '/turtle1')") == [T0 + 2 * SEC]
    with pytest.raises(InvalidQuery, match=r"/vision and /wheels tell poses in frame 'odom'"):
        asked(rosCas, "NEAR(0, 2, 0.5, 'odom')")
    assert asked(rosCas, "NEAR(0, 2, 0.5, 'odom', '/vision')") == [T0 + 2 * SEC]
    chosen = rosCas.near(0, 2, 0.5, "odom", ["/n"], robot="/vision")
    assert [row.t for row in chosen] == [T0 + 2 * SEC]
    with pytest.raises(InvalidQuery, match="no pose in frame 'site' is stored"):
        asked(rosCas, "NEAR(99, 0, 1, 'site')")  # a goal is not yet a position
    rosCas.upkeep.indexPlaces()
    assert asked(rosCas, "NEAR(0, 2, 0.5, 'odom', '/vision')") == [T0 + 2 * SEC]
    assert asked(rosCas, "NEAR(0, 2, 0.5, 'world', 'turtle2')") == [T0 + 2 * SEC]


def test_a_place_where_no_robot_was_says_so(husky, caplog):
    far = "SELECT KEY FROM gps WHERE NEAR(42.37, -71.14, 0.5, 'world')"
    assert husky.executeCQL(far) == []
    (message,) = caplog.messages
    assert "no robot was within 0.5 m of (42.37, -71.14) in frame world" in message
    assert "metres in this frame, no latitude and longitude" in message
    caplog.clear()
    assert list(husky.near(42.37, -71.14, 0.5, "world")) == []
    assert len(caplog.messages) == 1  # not for each topic
    with pytest.raises(InvalidQuery, match=r"did you mean world\?"):
        husky.executeCQL("SELECT KEY FROM gps WHERE NEAR(1, 2, 3, 'wrld')")


@pytest.fixture
def two_runs(rosCas):
    """Two runs of one robot, each with odometry of its own, and another robot with two of them."""
    for number, (run, topic) in enumerate([("first", "/wheels"), ("second", "/vision")]):
        with Writer(rosCas, "husky", run) as writer:
            for n in range(3):
                t = T0 + number * 100 * SEC + n * SEC
                writer.put(topic, t, odometry(float(n), 0.0))
                writer.put("/n", t, Int32(n))
    with Writer(rosCas, "twins", "third") as writer:
        for n in range(3):
            for topic in ("/left", "/right"):
                writer.put(topic, T0 + n * SEC, odometry(float(n), 0.0))
            writer.put("/n", T0 + n * SEC, Int32(n))
    return rosCas


@pytest.mark.suite("all", "make test asks others of its kind")
def test_near_goes_by_the_poses_of_the_run_and_the_robot_that_are_asked_for(two_runs):
    store, near = two_runs, "NEAR(2, 0, 0.5, 'odom')"
    with pytest.raises(InvalidQuery, match="/vision and /wheels tell poses in frame 'odom'"):
        asked(store, f"{near} and NODE = 'husky'")
    first, second = T0 + 2 * SEC, T0 + 102 * SEC
    topic, n = store.getTopic("/n"), "select data from /n where"
    for run, expected in (("first", first), ("second", second)):
        inside = f"{near} and RUN = '{run}'"
        assert asked(store, inside) == [expected]
        assert asked(store, near, run=run) == [expected]
        assert asked(store, f"not {near}", run=run) == [expected - 2 * SEC, expected - SEC]
        for options in ({"where": inside}, {"where": near, "run": run}):
            assert topic.countTopicData(**options) == 1
            assert topic.getArrays(["KEY"], **options)["KEY"].tolist() == [expected]
            assert [key.to_nsec() for key, _ in topic.items(**options)] == [expected]
        drawn = store.statements.series(f"{n} {inside}")
        assert drawn.points.rows.sum() == 1
        assert [row.t for row in store.near(2, 0, 0.5, "odom", ["/n"], run=run)] == [expected]
    # The choice for another robot does not matter here.
    only = f"RUN = 'first' and NODE = 'husky' and {near}"
    assert topic.getArrays(["KEY"], where=only)["KEY"].tolist() == [first]
    with pytest.raises(InvalidQuery, match="/left and /right tell poses in frame 'odom'"):
        asked(store, f"{near} and NODE = 'twins'")


def test_a_run_without_poses_goes_by_those_of_the_others(two_runs):
    with Writer(two_runs, "husky", "camera") as writer:
        writer.put("/n", T0 + 2 * SEC, Int32(7))
    near = "NEAR(2, 0, 0.5, 'odom', '/wheels')"
    assert asked(two_runs, near, run="camera") == [T0 + 2 * SEC]
    assert asked(two_runs, near, run="second") == []


def test_time_that_begins_at_0_and_a_robot_that_never_moves(rosCas):
    lane(rosCas, start=0, count=5, run="simulated")
    assert asked(rosCas, "NEAR(20, 0, 2)") == [2 * SEC + 1]
    with Writer(rosCas, "post", "fixed") as writer:
        writer.put("/tf_static", T0, tf(transform("map", "base_link", 3.0, 4.0)))
        for t in (T0 - 900 * SEC, T0 + 900 * SEC):
            writer.put("/n", t, Int32(1))
    assert asked(rosCas, "NEAR(0, 0, 5)", nodeID="post") == [T0 - 900 * SEC, T0 + 900 * SEC]
    assert asked(rosCas, "NEAR(0, 0, 4.9)", nodeID="post") == []


def test_messages_under_names_and_deleting(rosCas):
    lane(rosCas)
    topic = rosCas.addTopic("/map_of", key_format="manual", msg_type="std_msgs/Int32")
    topic.addData(Int32(1), key="kitchen")  # now, when no pose is known
    assert rosCas.executeCQL("select KEY from /map_of where NEAR(0, 0, 1000)") == []
    assert rosCas.executeCQL("delete from /n where NEAR(200, 0, 15)") == [(3,)]
    assert rosCas.getTopic("/n").countTopicData() == 37
    with rosCas.iterCQL("select data from /n where NEAR(200, 0, 100)") as result:
        first = [next(result) for _ in range(5)]
        cursor = result.cursor
    rest = list(rosCas.iterCQL("select data from /n where NEAR(200, 0, 100)", after=cursor))
    assert [n for (n,) in first + rest] == [n for n in range(10, 30) if n not in (19, 20, 21)]


DETOUR = T0 + 4 * SEC


def detour(writer, topic="/odom"):
    """A robot that goes from (0, 0) to (100, 0) by (50, 100), and a message on half of the way."""
    for t, x, y in ((T0, 0.0, 0.0), (DETOUR, 50.0, 100.0), (T0 + 8 * SEC, 100.0, 0.0)):
        writer.put(topic, t, odometry(x, y, "map"))
    writer.put("/n", DETOUR, Int32(1))


@pytest.mark.suite("all", "make test asks others of its kind")
def test_where_poses_are_deleted_the_robot_went_straight(rosCas):
    """Between the poses that stay it comes by where the index has never seen it."""
    straight, aside = "NEAR(50, 0, 2)", "NEAR(50, 100, 2)"
    later = {each: T0 + n * 100 * SEC for n, each in enumerate(["cond", "stretch", "run"])}
    for how, start in later.items():
        with Writer(rosCas, how, how) as writer:
            for n, (x, y) in enumerate([(0.0, 0.0), (50.0, 100.0), (100.0, 0.0)]):
                if n == 1 and how == "run":
                    with Writer(rosCas, how, "other") as other:
                        other.put("/odom", start + 4 * SEC, odometry(x, y, "map"))
                else:
                    writer.put("/odom", start + 4 * n * SEC, odometry(x, y, "map"))
        with Writer(rosCas, how, f"{how} messages") as writer:
            writer.put("/n", start + 4 * SEC, Int32(1))
    rosCas.upkeep.indexPlaces()
    assert len(noted_of(rosCas)) == 4
    for how, start in later.items():
        middle = start + 4 * SEC
        assert asked(rosCas, straight, nodeID=how) == []
        assert asked(rosCas, aside, nodeID=how) == [middle]
        if how == "cond":
            gone = "delete from /odom where pose.pose.position.y > 50"
            assert rosCas.executeCQL(gone, nodeID=how) == [(1,)]
        elif how == "stretch":
            assert rosCas.getTopic("/odom").removeData(middle - SEC, middle + SEC, nodeID=how) == 1
        else:
            assert rosCas.upkeep.delete(run="other")["/odom"] == 1
        assert asked(rosCas, straight, nodeID=how) == [middle]
        assert asked(rosCas, aside, nodeID=how) == []
    assert noted_of(rosCas) == []
    rosCas.upkeep.indexPlaces()
    assert all(asked(rosCas, straight, nodeID=how) == [t + 4 * SEC] for how, t in later.items())


@pytest.mark.suite("all", "make test asks others of its kind")
@pytest.mark.parametrize("how", ["condition", "thinned"])
def test_poses_of_two_runs_that_are_deleted_together(rosCas, how):
    """The records of both are withdrawn, although that of the second begins after the first."""
    later = T0 + 20 * SEC
    for run, start in (("first", T0), ("second", later)):
        with Writer(rosCas, "", run) as writer:
            for n, y in enumerate([0.0, 0.0, 100.0, 0.0, 0.0]):
                writer.put("/odom", start + n * SEC, odometry(25.0 * n, y, "map"))
                writer.put("/n", start + n * SEC, Int32(n))
    rosCas.upkeep.indexPlaces()
    assert noted_of(rosCas) == [(T0, T0 + 4 * SEC), (later, later + 4 * SEC)]
    assert asked(rosCas, "NEAR(50, 0, 2)") == []
    if how == "condition":
        assert rosCas.executeCQL("delete from /odom where pose.pose.position.y > 50") == [(2,)]
    else:
        rosCas.upkeep.retain(["/odom"], thin=0.25, now=later + 60 * SEC)
    assert noted_of(rosCas) == []
    assert asked(rosCas, "NEAR(50, 0, 2)") == [T0 + 2 * SEC, later + 2 * SEC]


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_long_stretch_that_is_deleted_leaves_the_index_of_the_rest(rosCas):
    lane(rosCas, count=60)
    rosCas.upkeep.indexPlaces()
    before = noted_of(rosCas, "/tf")
    assert before == [(T0, T0 + 59 * SEC)]
    rosCas.getTopic("/tf").removeData(T0, T0 + 20 * SEC)
    rosCas.executeCQL("delete from /n where data = 3")
    assert noted_of(rosCas, "/tf") == before


def test_what_an_import_brings_back_is_found(rosCas, tmp_path):
    path = tmp_path / "detour.bag"
    with rosbag.Bag(str(path), "w") as bag:
        for t, x, y in ((0, 0.0, 0.0), (4, 50.0, 100.0), (8, 100.0, 0.0)):
            bag.write("/odom", odometry(x, y, "map"), rospy.Time(T0 // SEC + t))
        bag.write("/n", Int32(1), rospy.Time(DETOUR // SEC))
    import_bag(rosCas, path)
    rosCas.executeCQL("delete from /odom where pose.pose.position.y > 50")
    totals = []
    done = rosCas.upkeep.indexPlaces(progress=lambda seconds, total: totals.append(total))
    assert {each.state for each in done} == {"indexed"}
    # The bucket of a day, which is open by that, is not gone through: only where poses lie.
    assert max(totals) <= 120
    import_bag(rosCas, path)
    assert asked(rosCas, "NEAR(50, 100, 2)") == [DETOUR]


@pytest.mark.suite("all", "make test asks others of its kind")
def test_poses_that_come_while_a_window_is_asked_are_seen(rosCas, monkeypatch):
    """The path of a window is complete only when poses after its end are known."""
    monkeypatch.setattr(track_windows, "OPEN_WINDOW_CACHE_SEC", -1.0)  # it is read again at once
    begin = (T0 // TRACK_WINDOW_NS + 1) * TRACK_WINDOW_NS
    region, times = DiskRegion(20.0, 0.0, 2.5), [begin + n * SEC for n in range(30)]
    with Writer(rosCas) as writer:
        for first, end in ((0, 5), (5, 15), (15, 30)):
            for n in range(first, end):
                writer.put("/odom", times[n], odometry(float(n), 0.0, "map"))
            writer.writer.flush()
            if first == 0:
                stays = rosCas.catalog.places.within(region, "map")
            found = [stays.holds("", "run", t) for t in times]
            assert found == [abs(n - 20) <= 2.5 if n < end else None for n in range(30)]


def test_an_index_stays_as_long_as_what_stays_longest(rosCas):
    rosCas.addTopic("/odom", msg_type="nav_msgs/Odometry", ttl=5000)
    with Writer(rosCas, "", "short") as writer:
        detour(writer)
    rosCas.upkeep.indexPlaces()
    ask, cassandra = "SELECT TTL({}) FROM {}.{} LIMIT 1", rosCas.cassandra

    def left(column, table):
        return cassandra.execute(ask.format(column, rosCas.keyspace, table), what="asking")[0][0]

    # Visits must live longer than the record that says that they are complete.
    assert left("t_out", "cr_place") > left("high", "cr_placed") > 4000
    with Writer(rosCas, "", "ever") as writer:
        detour(writer, "/pose")
    rosCas.upkeep.indexPlaces()
    ttls = cassandra.execute(f"SELECT TTL(high) FROM {rosCas.keyspace}.cr_placed", what="asking")
    assert (None,) in {tuple(each) for each in ttls}


def drives_on(recording, first, last, y=0.0):
    """Hand over a robot's odometry, 10 m a second, as if these seconds went by."""
    for n in range(first, last):
        recording._clock.now = T0 + n * SEC
        recording.received("/odom", ODOM, serialize(odometry(10.0 * n, y, "map")))
        recording.received("/n", NUMBER, serialize(Int32(n)))


ODOM, NUMBER = header_of(Odometry()), header_of(Int32())


def begun(store):
    """A recording of which the first part is noted."""
    recording = Recording(store.catalog, clock=Clock(), name="live")
    drives_on(recording, 0, 40)
    await_true(lambda: all(s.handle for s in recording._sources.values()))
    recording._places._note(last=False)
    assert noted_of(store) == [(T0, T0 + 29 * SEC)]
    return recording


def test_a_recorder_notes_poses_that_came_before_the_store_answered(rosCas):
    store = Future()
    recording = Recording(store, clock=Clock(), name="live")
    drives_on(recording, 0, 40)
    recording._places._try_to_note(last=False)
    store.set_result(rosCas.catalog)
    assert {report.lost for report in recording.close()} == {0}
    assert noted_of(rosCas) == [(T0, T0 + 39 * SEC)]


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_recorder_whose_clock_goes_back_takes_back_what_it_noted(rosCas):
    recording = begun(rosCas)
    drives_on(recording, 40, 60)
    recording._places._note(last=False)
    # Among poses that are not held any more: from 50 m to this one and on to 60 m.
    recording._clock.now = T0 + 5 * SEC + SEC // 2
    recording.received("/odom", ODOM, serialize(odometry(55.0, 80.0, "map")))
    recording._clock.now += SEC // 4
    recording.received("/n", NUMBER, serialize(Int32(1)))
    recording._places._note(last=False)
    assert noted_of(rosCas) == []
    drives_on(recording, 60, 90)
    recording.close()
    assert noted_of(rosCas) == [(T0 + 59 * SEC + 1, T0 + 89 * SEC)]
    assert asked(rosCas, "NEAR(57.5, 40, 1)") == [T0 + 5 * SEC + 3 * SEC // 4]
    assert asked(rosCas, "NEAR(700, 0, 1)") == [T0 + 70 * SEC]


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_recorder_says_nothing_of_poses_among_which_some_were_lost(rosCas):
    recording = begun(rosCas)
    source = next(s for s in recording._sources.values() if s.topic == "/odom")
    for n, y in ((40, 0.0), (41, 0.0), (44, 200.0), (47, 0.0)):
        recording._clock.now = T0 + n * SEC
        if n == 44:  # it came, and was not stored: from 410 m to 470 m the robot went straight
            lost = serialize(odometry(440.0, y, "map"))
            recording._counts.received("/odom", lost)
            recording._places.add_message(source, T0 + n * SEC, lost)
            recording._lose("/odom", LossKind.REFUSED, "by a test", T0 + n * SEC)
            recording.received("/n", NUMBER, serialize(Int32(1)))
        else:
            recording.received("/odom", ODOM, serialize(odometry(10.0 * n, y, "map")))
    drives_on(recording, 48, 60)
    recording.close()
    assert noted_of(rosCas) == [(T0 + 44 * SEC + 1, T0 + 59 * SEC)]
    assert asked(rosCas, "NEAR(440, 0, 1)") == [T0 + 44 * SEC]


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_recorder_sees_that_poses_are_deleted_meanwhile(rosCas):
    recording = begun(rosCas)
    await_true(lambda: rosCas.getTopic("/odom").countTopicData() == 40)
    assert rosCas.executeCQL("delete from /odom where pose.pose.position.x = 100") == [(1,)]
    drives_on(recording, 40, 60)
    recording.close()
    assert noted_of(rosCas) == [(T0 + 29 * SEC + 1, T0 + 59 * SEC)]


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_recorder_that_cannot_keep_up_gives_the_index_up(rosCas, monkeypatch):
    recording = begun(rosCas)
    monkeypatch.setattr(place_keeper, "MAX_HELD_BYTES", 40 * len(serialize(odometry(0, 0))))
    drives_on(recording, 40, 90)
    recording.close()
    ((first, last),) = noted_of(rosCas)
    assert first == T0
    assert last < T0 + 60 * SEC
    assert asked(rosCas, "NEAR(800, 0, 1)") == [T0 + 80 * SEC]


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_recorder_without_a_thread_for_places_records_all_the_same(rosCas, monkeypatch):
    start = threading.Thread.start

    def refused(thread):
        if thread.name == "recorder-places":
            raise RuntimeError("can't start new thread")
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", refused)
    recording = Recording(rosCas.catalog, clock=Clock(), name="live")
    drives_on(recording, 0, 5)
    reports = {report.topic: (report.stored, report.lost) for report in recording.close()}
    assert reports == {"/odom": (5, 0), "/n": (5, 0)}
    assert noted_of(rosCas) == []
