# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Poses of many times at once, beside tf2, which answers them one by one."""

from __future__ import annotations

import math

import numpy as np
import pytest
from compiled import compiled
from conftest import ROOT
from geometry_msgs.msg import PoseStamped
from hypothesis import given
from hypothesis import strategies as st
from suites import search
from transforms.test_transforms import SEC, T0, Whole, numbers, transform

from cassandra_ros import Stamp
from cassandra_ros.errors import InvalidOption, TopicNotFound, TransformException, TypeMismatch
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.places import poses as poses_module
from cassandra_ros.places.frame_poses import TF, FrameChain, TfRecording
from cassandra_ros.places.pose_samples import Samples
from cassandra_ros.places.pose_topic import PoseTopic
from cassandra_ros.places.poses import Poses
from cassandra_ros.places.rigid import Rigid, between

tf2_py = compiled("tf2_py")

HUSKY = ROOT / "examples/data/husky_gps_data.bag"
TURTLES = ROOT / "examples/data/turtlesim_tf.bag"


@pytest.fixture(scope="module")
def store(fresh):
    """Two robots: a Husky and two turtles, recorded years apart."""
    with fresh() as made:
        wanted = ["/tf", "/encoder"]
        import_bag(made, HUSKY, topics=wanted, nodeID="husky", format="packed")
        wanted = ["/tf", "/turtle1/pose", "/turtle1/color_sensor"]
        import_bag(made, TURTLES, topics=wanted, nodeID="turtles", format="ros")
        yield made


def poses_in_frame(find, of, frame, node=None, tf=TF):
    return Poses(FrameChain(TfRecording(find, node, tf=tf), of, frame))


def poses_of_topic(find, topic, node=None, offset=None, **gap):
    return Poses(PoseTopic(find, topic, node, offset=offset), **gap)


def seven(poses):
    return np.concatenate([poses.moved, poses.turned], 1)


def as_numbers(found):
    made = np.array([numbers(found)])
    return made if made[0, 6] >= 0 else made * ([1] * 3 + [-1] * 4)


def same(poses, row, found):
    """Say whether a pose is a transform of tf2; q and -q are the same rotation."""
    mine, other = seven(poses)[row], as_numbers(found)[0]
    turned = min(np.abs(mine[3:] - other[3:]).max(), np.abs(mine[3:] + other[3:]).max())
    return np.abs(mine[:3] - other[:3]).max() < 1e-9 and turned < 1e-9


FRAMES = "abcde"
TRANSFORMS = st.lists(
    st.tuples(
        st.integers(1, 4),  # the child; its parent comes before it in FRAMES: there is no loop
        st.integers(0, 3),
        st.integers(0, 8),  # half seconds
        st.floats(-9, 9),
        # Steps of 1e-6 rad: tf2 takes turns that differ by less than 1e-8 rad as equal, and gives
        # the earlier one instead of what lies between.
        st.integers(-6_000_000, 6_000_000).map(lambda steps: steps / 1e6),
    ),
    max_size=14,
)


class FramesAlone:
    """Names and fixed transforms, without a store."""

    def __init__(self, fixed):
        self.fixed = {
            FRAMES.index(each.child_frame_id): (FRAMES.index(each.header.frame_id), rigid([each]))
            for each in fixed
        }

    def code(self, name):
        return FRAMES.index(name)


def rigid(made):
    return Rigid.of_numbers(np.array([numbers(each) for each in made]).reshape(-1, 7))


def made_of(described):
    found = []
    for child, parent, half, x, turned in described:
        made = transform(FRAMES[min(parent, child - 1)], FRAMES[child], T0 + half * SEC // 2, x)
        made.transform.rotation.x = math.sin(turned / 2)
        made.transform.rotation.w = math.cos(turned / 2)
        found.append(made)
    return found


@search(200)
@given(
    described=TRANSFORMS,
    still=st.lists(TRANSFORMS.map(lambda found: found[:1]), max_size=2),
    target=st.sampled_from(FRAMES),
    source=st.sampled_from(FRAMES),
)
def test_random_frames_are_where_tf2_says(described, still, target, source):
    fixed = made_of([each for some in still for each in some])
    fixed = list({each.child_frame_id: each for each in fixed}.values())
    names = {each.child_frame_id for each in fixed}
    moving = [each for each in made_of(described) if each.child_frame_id not in names]
    samples = Samples.checked(
        np.arange(len(moving)),
        np.array([each.header.stamp.to_nsec() for each in moving], np.int64),
        np.array([FRAMES.index(each.header.frame_id) for each in moving], np.int64),
        np.array([FRAMES.index(each.child_frame_id) for each in moving], np.int64),
        np.array([numbers(each) for each in moving], np.float64).reshape(-1, 7),
    )
    times = T0 + np.arange(-1, 18) * SEC // 4
    chain = FrameChain(FramesAlone(fixed), source, target)
    poses, known = chain.placed(samples, times, stamped=True, longest_gap_ns=100 * SEC)
    whole = Whole(moving, fixed, T0)
    for row, time in enumerate(times.tolist()):
        try:
            found = whole.lookup(target, source, time)
        except tf2_py.TransformException:
            # To itself a frame has a pose, also one that tf2 has not heard of.
            assert not known[row] or target == source
        else:
            assert known[row]
            assert same(poses, row, found)


def test_a_half_way_turn_goes_the_shorter_way():
    ends = Rigid.planar([0, 0], [0, 2], [math.radians(170), math.radians(-170)])
    for flipped in (1, -1):
        second = Rigid(ends.moved[1:], flipped * ends.turned[1:])
        middle = between(ends.take(slice(0, 1)), second, np.array([0.5]))
        assert abs(middle.yaw[0]) == pytest.approx(math.pi)
        assert middle.y[0] == 1
    there = ends.take(slice(0, 1)) @ ends.take(slice(1, 2))
    back = there @ there.inverse()
    assert np.allclose(seven(back), seven(Rigid.none(1)))
    assert np.allclose(there.inverse().apply(there.apply(np.eye(3))), np.eye(3))


@pytest.mark.suite("all", "it looks at each time of a bag")
def test_all_times_of_a_recording_are_where_lookups_say(store, monkeypatch):
    """In stretches of 7 s, so that there are several."""
    monkeypatch.setattr(poses_module, "MAX_SPAN_NS", 7 * SEC)
    turtles = poses_in_frame(store.getTopic, "/turtle1", "turtle2", node="turtles")
    topic = store.getTopic("/turtle1/color_sensor")
    keys = topic.getArrays(["KEY"])["KEY"][5:-5]
    shuffled = np.random.default_rng(1).permutation(keys)
    poses, known = turtles.at(shuffled, shuffled)
    assert known.mean() > 0.9
    for row in range(0, len(keys), 97):
        time = Stamp.from_ns(int(shuffled[row]))
        if not known[row]:
            with pytest.raises(TransformException):
                store.lookupTransform("turtle2", "turtle1", time, nodeID="turtles")
            continue
        found = store.lookupTransform("turtle2", "turtle1", time, nodeID="turtles")
        assert same(poses, row, found)


def test_each_robot_has_its_own_poses(store):
    frames = store.executeCQL("select transforms.child_frame_id from /tf where NODE = 'husky'")
    child = sorted({name.strip("/") for (name,) in frames})[0]
    keys = store.getTopic("/tf").getArrays(["KEY"], nodeID="turtles")["KEY"][100:200]
    turtles = poses_in_frame(store.getTopic, "turtle1", "world", node="turtles")
    assert turtles.at(keys).known.all()
    assert not poses_in_frame(store.getTopic, "turtle1", "world", node="husky").at(keys).known.any()
    assert not poses_in_frame(store.getTopic, child, "nowhere").at(keys).known.any()
    assert "nowhere" in poses_in_frame(store.getTopic, child, "nowhere").explain(int(keys[0]))


def test_a_topic_tells_poses(store):
    rows = store.executeCQL("select KEY, pose.pose.position.x, pose.pose.position.y from /encoder")
    keys = np.array([int(str(key)) for key, _, _ in rows])
    wheels = poses_of_topic(store.getTopic, "/encoder", node="husky")
    found, known = wheels.at(keys)
    assert known.all()
    assert np.allclose(found.moved[:, :2], [row[1:] for row in rows])
    middle, known = wheels.at((keys[:-1] + keys[1:]) // 2)
    assert known.all()
    assert np.allclose(middle.x, (found.x[:-1] + found.x[1:]) / 2, atol=1e-6)
    # Poses are unknown before and after the recording, and between poses too far apart.
    assert not wheels.at(np.array([keys[0] - 1, keys[-1] + 1])).known.any()
    assert str(wheels.explain(int(keys[-1]) + 1)).startswith("topic /encoder tells no pose of node")
    rare = poses_of_topic(store.getTopic, "/encoder", node="husky", longest_gap_sec=1e-3)
    assert not rare.at((keys[:-1] + keys[1:]) // 2).known.any()
    assert rare.at(keys).known.all()
    # A sensor half a metre in front of the robot.
    ahead = poses_of_topic(store.getTopic, "/encoder", offset=Rigid.planar([0.5], [0], [0]))
    away = ahead.at(keys).poses.moved - found.moved
    assert np.allclose(np.linalg.norm(away, axis=1), 0.5)
    assert np.allclose(np.arctan2(away[:, 1], away[:, 0]), found.yaw)


def test_poses_in_another_frame_are_left_out(fresh):
    with fresh() as made:
        topic = made.addTopic("/robot_pose", msg_type="geometry_msgs/PoseStamped")
        for n, frame in enumerate(["odom", "/odom", "map", "odom", ""]):
            pose = PoseStamped()
            pose.header.frame_id, pose.pose.orientation.w = frame, 1.0
            pose.pose.position.x = float(n)
            topic.addData(pose, key=T0 + n * SEC // 10)
        poses = poses_of_topic(made.getTopic, "/robot_pose")
        assert poses.frame == "odom"
        (track,) = poses.tracks(0, 2 * T0)
        assert track.poses.x.tolist() == [0.0, 1.0, 3.0, 4.0]


def test_samples_that_came_later_are_read_when_the_held_ones_are_forgotten(fresh):
    with fresh() as made:
        topic = made.addTopic("/robot_pose", msg_type="geometry_msgs/PoseStamped")
        upright = PoseStamped()
        upright.pose.orientation.w = 1.0
        topic.addData(upright, key=T0)
        poses = poses_of_topic(made.getTopic, "/robot_pose")
        assert sum(len(track.times) for track in poses.tracks(T0, T0 + SEC)) == 1
        topic.addData(upright, key=T0 + 1)
        assert sum(len(track.times) for track in poses.tracks(T0, T0 + SEC)) == 1
        poses.forget()
        assert sum(len(track.times) for track in poses.tracks(T0, T0 + SEC)) == 2


def test_a_turtle_tells_its_pose_in_the_plane(store):
    topic = store.getTopic("/turtle1/pose")
    told = topic.getArrays(["KEY", "x", "y", "theta"])
    found, known = poses_of_topic(store.getTopic, "/turtle1/pose").at(told["KEY"])
    assert known.all()
    assert np.allclose(found.x, told["x"])
    assert np.allclose(np.exp(1j * found.yaw), np.exp(1j * told["theta"]))


def test_tracks_hold_every_recorded_pose_once(store, monkeypatch):
    monkeypatch.setattr(poses_module, "MAX_SPAN_NS", 5 * SEC)
    told = store.getTopic("/encoder").getArrays(["KEY", "pose.pose.position.x"])
    wheels = poses_of_topic(store.getTopic, "/encoder")
    tracks = list(wheels.tracks(0, 2**62))
    assert len(tracks) > 3
    assert np.array_equal(np.concatenate([t.times for t in tracks]), np.unique(told["KEY"]))
    assert np.allclose(np.concatenate([t.poses.x for t in tracks]), told["pose.pose.position.x"])
    # Years lie between the two robots: they are leapt over.
    world = poses_in_frame(store.getTopic, "turtle1", "world")
    times = np.concatenate([track.times for track in world.tracks(0, 2**62)])
    heard = store.executeCQL("select KEY from /tf where transforms.child_frame_id = 'turtle1'")
    assert times.tolist() == sorted({int(str(key)) for (key,) in heard})


def test_what_tells_no_poses_is_refused(store):
    with pytest.raises(TypeMismatch, match="tells no poses: give one of nav_msgs/Odometry"):
        poses_of_topic(store.getTopic, "/turtle1/color_sensor")
    with pytest.raises(TypeMismatch, match="no transforms"):
        poses_in_frame(store.getTopic, "a", "b", tf="/encoder")
    with pytest.raises(TopicNotFound):
        poses_in_frame(store.getTopic, "a", "b", tf="/tff")
    with pytest.raises(InvalidOption, match="longest_gap"):
        poses_of_topic(store.getTopic, "/encoder", longest_gap_sec=0)
