# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Transforms out of the store, beside a tf2 buffer that was given everything."""

from __future__ import annotations

import math
import subprocess
import sys
import uuid
from pathlib import Path

import genpy
import pytest
import rosbag
from compiled import compiled
from geometry_msgs.msg import TransformStamped
from hypothesis import HealthCheck, given
from hypothesis import strategies as st
from std_msgs.msg import String
from suites import search, sparing
from tf2_msgs.msg import TFMessage

from cassandra_ros import RosCassandra, Stamp
from cassandra_ros.errors import (
    CassandraRosError,
    ConnectivityException,
    ExtrapolationException,
    InvalidKey,
    InvalidName,
    LookupException,
    RunNotFound,
    TopicNotFound,
    TransformException,
    TypeMismatch,
)
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.messages.stamps import iso_time
from cassandra_ros.places.transforms import transform_samples as samples
from cassandra_ros.store.tables.registry import Run

tf2_py = compiled("tf2_py")

SEC = 10**9
HOUR = 3600 * SEC
T0 = 1_400_000_000 * SEC
OURS = {
    tf2_py.LookupException: LookupException,
    tf2_py.ConnectivityException: ConnectivityException,
    tf2_py.ExtrapolationException: ExtrapolationException,
}


def transform(parent, child, stamp, x=0.0, turned=0.0):
    """A transform with a translation along x, and a turn about z by an angle."""
    made = TransformStamped(child_frame_id=child)
    made.header.frame_id = parent
    made.header.stamp = genpy.Time(0, stamp)
    made.transform.translation.x = float(x)
    made.transform.rotation.z = math.sin(turned / 2)
    made.transform.rotation.w = math.cos(turned / 2)
    return made


class Whole:
    """tf2's buffer with all transforms of a recording, in its order.

    Times are moved to a base near 0: tf2_py takes them through a double.
    """

    def __init__(self, moving, fixed, base):
        self.base = base - 1000 * SEC
        self.core = tf2_py.BufferCore(genpy.Duration(1_000_000))
        for made in fixed:
            self.core.set_transform_static(self.moved(made, fixed=True), "test")
        for made in moving:
            self.core.set_transform(self.moved(made), "test")

    def moved(self, made, fixed=False):
        stamp = 0 if fixed else made.header.stamp.to_nsec() - self.base
        copy = transform(made.header.frame_id, made.child_frame_id, stamp)
        for part in ("translation", "rotation"):
            for name in getattr(copy.transform, part).__slots__:
                value = getattr(getattr(made.transform, part), name)
                setattr(getattr(copy.transform, part), name, value)
        return copy

    def lookup(self, target, source, time):
        time = genpy.Time(0, time - self.base if time else 0)
        return self.core.lookup_transform_core(target, source, time)


def numbers(found):
    moved, turned = found.transform.translation, found.transform.rotation
    return [moved.x, moved.y, moved.z, turned.x, turned.y, turned.z, turned.w]


def assert_same(store, whole, target, source, time, **options):
    """Both give the same transform, or the same error; return what it was."""
    try:
        expected = whole.lookup(target, source, time)
    except tf2_py.TransformException as exc:
        with pytest.raises(OURS[type(exc)]):
            store.lookupTransform(target, source, Stamp.from_ns(time), **options)
        return type(exc)
    found = store.lookupTransform(target, source, Stamp.from_ns(time), **options)
    assert numbers(found) == pytest.approx(numbers(expected), abs=1e-9)
    assert (found.header.frame_id, found.child_frame_id) == (target, source)
    if time:
        assert found.header.stamp.to_nsec() == time
    else:
        moved = expected.header.stamp.to_nsec()
        assert found.header.stamp.to_nsec() == (moved + whole.base if moved else 0)
    return None


class Recorded:
    """The transforms of a bag in a store, and in tf2."""

    def __init__(self, store, path):
        self.store = store
        moving, fixed, self.times = [], [], []
        writer = store.messageWriter(format=store.wanted_format, nodeID="robot")
        handles = {}
        with rosbag.Bag(str(path)) as bag:
            for number, (topic, raw, t, header) in enumerate(
                bag.read_messages(["/tf", "/tf_static"], raw=True, return_connection_header=True)
            ):
                if (topic, raw[2]) not in handles:
                    handles[topic, raw[2]] = writer.connect(live_connection(topic, header))
                writer.write(handles[topic, raw[2]], t.to_nsec(), number, raw[1])
                for made in raw[4]().deserialize(raw[1]).transforms:
                    (fixed if topic == "/tf_static" else moving).append(made)
                    self.times.append(made.header.stamp.to_nsec())
        writer.close()
        self.whole = Whole(moving, fixed, min(self.times))


@pytest.fixture(scope="module", params=["binary", "ros"])
def stored(request, cassandra, cql, bags):
    """Imports the transforms of a bag."""
    made = {}

    def get(bag):
        if bag not in made:
            name = f"t_{uuid.uuid4().hex[:16]}"
            store = RosCassandra(cassandra.host, cassandra.port, keyspace=name)
            store.wanted_format = request.param
            made[bag] = Recorded(store, bags / bag)
        return made[bag]

    yield get
    for recorded in made.values():
        recorded.store.close()
        cql.execute(f"DROP KEYSPACE {recorded.store.keyspace}")


CASES = {
    "husky_gps_data.bag": ["base_footprint", "imu_link", "back_left_wheel", "base_link"],
    "turtlesim_tf.bag": ["world", "turtle1", "turtle2", "carrot", "nobody"],
}


@pytest.mark.suite("all", "it asks whole bags at random times")
@pytest.mark.parametrize("bag", sparing(CASES, kept=["turtlesim_tf.bag"]))
@search(60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_real_robots_at_any_time(stored, bag, data):
    recorded = stored(bag)
    first, last = min(recorded.times), max(recorded.times)
    frames = [data.draw(st.sampled_from(CASES[bag])) for _ in range(2)]
    times = st.integers(first - SEC // 10, last + SEC // 10)
    time = data.draw(st.one_of(times, st.sampled_from(recorded.times), st.just(0)))
    assert_same(recorded.store, recorded.whole, *frames, time)


@pytest.mark.suite("all", "it asks each pair of frames of whole bags")
@pytest.mark.parametrize("bag", CASES)
def test_every_pair_of_frames(stored, bag):
    recorded = stored(bag)
    middle = sorted(recorded.times)[len(recorded.times) // 2] + 12_345
    frames = [name for name in CASES[bag] if name != "nobody"]
    results = {
        assert_same(recorded.store, recorded.whole, target, source, middle)
        for target in frames
        for source in frames
    }
    assert results == {None}


def test_only_what_is_needed_is_read(stored, monkeypatch):
    recorded = stored("husky_gps_data.bag")
    middle = sorted(recorded.times)[len(recorded.times) // 2]
    read = []
    take = samples.TransformTopic.read
    monkeypatch.setattr(
        samples.TransformTopic,
        "read",
        lambda self, nearest, low, high, **options: (
            read.append((low, high)),
            take(self, nearest, low, high, **options),
        ),
    )
    recorded.store.lookupTransform("base_link", "imu_link", Stamp.from_ns(middle))
    assert read == [(middle - 2 * SEC, middle + 2 * SEC)]


class Store:
    """Transforms in a store, and in tf2."""

    def __init__(self, rosCas, nodeID=None):
        self.rosCas = rosCas
        self.nodeID = nodeID
        self.topics = {}
        self.moving, self.fixed = [], []

    def add(self, *made, key=None, topic="/tf", nodeID=None):
        """Store a message, received when it was stamped if nothing else is said."""
        key = made[0].header.stamp.to_nsec() if key is None else key
        if topic not in self.topics:
            self.topics[topic] = self.rosCas.addTopic(topic, msg_type="tf2_msgs/TFMessage")
        self.topics[topic].addData(TFMessage(list(made)), key=key, nodeID=nodeID or self.nodeID)
        (self.fixed if "static" in topic else self.moving).extend(
            (key, len(self.moving), one) for one in made
        )

    def track(
        self, parent, child, start=T0, count=40, step=SEC // 4, delay=0, speed=1.0, **options
    ):
        """Store a straight track: x is the seconds since T0, times speed."""
        for n in range(count):
            stamp = start + n * step
            made = transform(parent, child, stamp, (stamp - T0) / SEC * speed)
            self.add(made, key=stamp + delay, **options)

    def look(self, target, source, time, **options):
        options.setdefault("nodeID", self.nodeID)
        return self.rosCas.lookupTransform(target, source, time, **options)

    def x(self, target, source, time, **options):
        return self.look(target, source, time, **options).transform.translation.x

    def same(self, target, source, time):
        """Compare with tf2, which gets all in the order of the row keys."""
        moving, fixed = (
            [made for _, _, made in sorted(part, key=lambda one: one[:2])]
            for part in (self.moving, self.fixed)
        )
        base = min((made.header.stamp.to_nsec() for made in moving), default=T0)
        whole = Whole(moving, fixed, base)
        return assert_same(self.rosCas, whole, target, source, time, nodeID=self.nodeID)


@pytest.fixture(scope="module")
def shared(cassandra, cql):
    name = f"t_{uuid.uuid4().hex[:16]}"
    with RosCassandra(cassandra.host, cassandra.port, keyspace=name) as rosCas:
        yield rosCas
    cql.execute(f"DROP KEYSPACE {name}")


@pytest.fixture
def store(shared):
    """Each test is a robot of its own, for a keyspace takes longer than most of them."""
    return Store(shared, nodeID=uuid.uuid4().hex)


@pytest.fixture
def alone(rosCas):
    """A keyspace of its own."""
    return Store(rosCas)


def test_between_two_transforms(store):
    store.track("map", "base")
    assert store.x("map", "base", T0 + 1_100_000_000) == pytest.approx(1.1)
    assert store.x("base", "map", T0 + 1_100_000_000) == pytest.approx(-1.1)
    store.same("map", "base", T0 + 1_100_000_001)


@pytest.mark.parametrize("time", [genpy.Time(T0 // SEC + 1, 5), T0 + SEC + 5, T0 / SEC + 1.5])
def test_times_of_all_kinds(store, time):
    store.track("map", "base")
    ns = (
        time
        if isinstance(time, int)
        else (Stamp(0, 0) + time).ns
        if isinstance(time, float)
        else time.to_nsec()
    )
    found = store.look("map", "base", time)
    assert found.header.stamp == genpy.Time(0, ns)
    assert found.transform.translation.x == pytest.approx((ns - T0) / SEC)
    assert store.x("map", "base", "2014-05-13T16:53:21.000000005Z") == pytest.approx(1.000000005)


@pytest.mark.parametrize("ns", [1, 123_456_789, 999_999_999, 500_000_001])
def test_the_stamp_is_the_one_that_was_asked_for(store, ns):
    store.track("map", "base")
    time = genpy.Time(T0 // SEC + 2, ns)
    assert store.look("map", "base", time).header.stamp == time


def test_a_transform_at_the_time_itself_is_given_as_it_is(store):
    store.add(transform("map", "base", T0, 1.0))
    store.add(transform("map", "base", T0 + 1, 2.0))
    store.add(transform("map", "base", T0 + 2, 3.0))
    assert [store.x("map", "base", T0 + n) for n in range(3)] == [1.0, 2.0, 3.0]


def test_a_single_transform_holds_at_its_time_only(store):
    store.add(transform("map", "base", T0, 1.0))
    assert store.same("map", "base", T0) is None
    assert store.same("map", "base", T0 + 1) is tf2_py.ExtrapolationException
    assert store.same("map", "base", T0 - 1) is tf2_py.ExtrapolationException


def test_fixed_and_moving_frames_in_one_chain(store):
    store.track("map", "odom", step=SEC, count=20)
    store.track("odom", "base", speed=2.0, count=80)
    store.add(transform("base", "laser", T0 - HOUR, 0.5), topic="/tf_static")
    store.add(transform("base", "camera", T0 + 5 * HOUR, 0.25, math.pi), topic="/tf_static")
    for target, source in [("map", "laser"), ("camera", "map"), ("laser", "camera")]:
        assert store.same(target, source, T0 + 7_654_321_000) is None
    assert store.x("map", "laser", T0 + SEC) == pytest.approx(1 + 2 + 0.5)


def test_fixed_frames_alone(store):
    store.add(transform("base", "arm", T0, 1.0), topic="/tf_static")
    store.add(transform("arm", "hand", T0 + 9, 2.0), topic="/tf_static")
    for time in (1, T0 - HOUR, T0, T0 + 5, 2**32 * SEC - 1):
        assert store.x("base", "hand", time) == 3.0
        assert store.look("base", "hand", time).header.stamp.to_nsec() == time
    assert store.look("base", "hand", 0).header.stamp == genpy.Time(0)
    store.same("base", "hand", 0)


def test_the_fixed_transform_that_was_recorded_last_counts(store):
    store.add(transform("base", "arm", T0 + 20, 1.0), key=T0, topic="/tf_static")
    store.add(transform("base", "arm", T0 + 20, 1.0), key=T0 + SEC, topic="/tf_static")
    store.add(transform("base", "arm", T0 + 10, 2.0), key=T0 + 2 * SEC, topic="/tf_static")
    store.same("base", "arm", T0)
    assert store.x("base", "arm", T0) == 2.0


def test_a_frame_of_tf_static_is_fixed(store):
    store.track("map", "base")
    store.add(transform("map", "base", T0, 77.0), topic="/tf_static")
    assert store.x("map", "base", T0 + SEC) == 77.0
    assert store.x("map", "base", 0) == 77.0
    store.add(transform("odom", "arm", T0, 1.0), topic="/tf_static")
    store.track("map", "arm")
    assert store.x("odom", "arm", T0 + SEC) == 1.0
    with pytest.raises(ConnectivityException):
        store.look("map", "arm", T0 + SEC)


def test_without_tf_static(alone):
    alone.track("map", "base")
    with pytest.raises(LookupException) as error:
        alone.look("map", "laser", T0 + SEC)
    assert "topic /tf_static (which is not stored)" in str(error.value)


def test_without_tf(alone):
    alone.add(transform("base", "arm", T0, 1.0), topic="/tf_static")
    assert alone.x("base", "arm", T0) == 1.0
    for time in (T0, 0):
        with pytest.raises(LookupException) as error:
            alone.look("map", "arm", time)
        assert "topic /tf (which is not stored)" in str(error.value)


def test_without_both(rosCas):
    with pytest.raises(TopicNotFound) as error:
        rosCas.lookupTransform("map", "base", T0)
    assert "'/tf' is not stored" in str(error.value)


def test_empty_topics(rosCas):
    for topic in ("/tf", "/tf_static"):
        rosCas.addTopic(topic, msg_type="tf2_msgs/TFMessage")
        for time in (T0, 0):
            with pytest.raises(LookupException) as error:
                rosCas.lookupTransform("map", "base", time)
            assert "there is no transform at all" in str(error.value)


def test_topics_of_other_names_and_types(alone):
    alone.track("map", "base", topic="/robot/tf")
    alone.add(transform("base", "arm", T0, 1.0), topic="/robot/tf_static")
    topics = {"tf": "robot/tf", "tf_static": "/robot/tf_static"}
    assert alone.x("map", "arm", T0 + SEC, **topics) == pytest.approx(2.0)
    alone.rosCas.addTopic("/tf").addData(String(data="x"), key=T0)
    with pytest.raises(TypeMismatch) as error:
        alone.look("map", "arm", T0)
    assert "topic /tf holds std_msgs/String" in str(error.value)


def test_outside_of_what_was_recorded(store):
    store.track("map", "base")
    end = T0 + 39 * SEC // 4
    with pytest.raises(ExtrapolationException) as error:
        store.look("map", "base", end + SEC // 2)
    text = str(error.value)
    assert "from base to map" in text
    assert f"({end + SEC // 2} ns)" in text
    assert (
        f"last transform of frame base on topic /tf of node {store.nodeID} is at {iso_time(end)}"
        in text
    )
    assert "0.5 s before" in text
    with pytest.raises(ExtrapolationException) as error:
        store.look("map", "base", T0 - 1)
    text = str(error.value)
    assert "first transform of frame base on topic /tf of node" in text
    assert f"({T0} ns), 1e-09 s after" in text
    assert isinstance(error.value, (TransformException, CassandraRosError))
    assert isinstance(error.value.__cause__, tf2_py.ExtrapolationException)


def test_seconds_as_an_integer(store):
    store.track("map", "base")
    with pytest.raises(ExtrapolationException) as error:
        store.look("map", "base", T0 // SEC + 1)
    assert "did you mean seconds (a float)?" in str(error.value)


def test_two_runs_of_the_same_robot(rosCas):
    kind = TFMessage
    header = {"type": kind._type, "md5sum": kind._md5sum, "message_definition": kind._full_text}
    for number, (name, x) in enumerate((("morning", 1.0), ("evening", 5.0)), 7):
        run = Run("", number, "recording", name=name)
        with rosCas.messageWriter(writer_id=number, run=run) as writer:
            for topic, child in (("/tf", "base"), ("/tf_static", "laser")):
                parent = {"base": "map", "laser": "base"}[child]
                handle = writer.connect(live_connection(topic, header))
                msg = TFMessage([transform(parent, child, T0, x)])
                writer.write(handle, T0, len(topic), serialize(msg))
    for run, x in (("morning", 2.0), ("evening", 10.0), (7, 2.0)):
        found = rosCas.lookupTransform("map", "laser", 0, run=run)
        assert found.transform.translation.x == x
    with pytest.raises(RunNotFound):
        rosCas.lookupTransform("map", "laser", 0, run="noon")


def test_unknown_frames(store):
    store.track("map", "base_link")
    with pytest.raises(LookupException) as error:
        store.look("map", "base_lnk", T0 + SEC)
    assert "frame 'base_lnk' is not in topic /tf" in str(error.value)
    assert "did you mean base_link?" in str(error.value)
    with pytest.raises(LookupException) as error:
        store.look("quite_other", "base_link", 0)
    assert "the frames are base_link, map" in str(error.value)
    assert isinstance(error.value.__cause__, tf2_py.LookupException)


def test_one_frame_to_itself(store):
    store.track("map", "base")
    for frame in ("map", "base", "nobody"):
        for time in (T0 + SEC, T0 + HOUR, 0):
            assert store.same(frame, frame, time) is None


def test_two_trees(store):
    store.track("map", "base")
    store.track("earth", "moon")
    for time in (T0 + SEC, 0):
        assert store.same("map", "moon", time) is tf2_py.ConnectivityException
    with pytest.raises(ConnectivityException) as error:
        store.look("map", "moon", T0 + SEC)
    assert "moon hangs on earth" in str(error.value)


def test_frames_that_tf2_remembers(store):
    """Known only from a transform that does not count: there is such a frame all the same."""
    store.add(transform("c", "d", T0))
    store.add(transform("b", "d", T0), key=T0 + 1)
    assert store.same("b", "d", T0) is tf2_py.ConnectivityException
    assert store.same("b", "d", T0 - 1) is tf2_py.ExtrapolationException
    assert store.same("nobody", "d", T0 - 1) is tf2_py.LookupException


def test_a_loop(store):
    for stamp in (T0, T0 + SEC):
        store.add(transform("a", "b", stamp), transform("b", "a", stamp))
        store.add(transform("b", "c", stamp), transform("y", "z", stamp))
    with pytest.raises(LookupException) as error:
        store.look("z", "c", T0 + 5)
    assert "b -> a -> b form a loop" in str(error.value)
    assert store.x("b", "c", T0 + 5) == 0.0


@pytest.mark.parametrize("frame", ["", "/", None, 7, "a\0b", "\udcff"])
def test_what_is_no_frame(store, frame):
    store.track("map", "base", count=3)
    with pytest.raises(InvalidName):
        store.look("map", frame, T0)
    with pytest.raises(InvalidName):
        store.look(frame, "map", T0)


@pytest.mark.parametrize("time", ["noon", None, -1, 2**32 * SEC])
def test_what_is_no_time(store, time):
    with pytest.raises(InvalidKey):
        store.look("map", "base", time)


def test_slashes_in_front_on_both_sides(store):
    for n in range(3):
        store.add(
            transform("/map", "/base", T0 + n * SEC, n), transform("base", "/arm", T0 + n * SEC, 1)
        )
    for target in ("map", "/map"):
        for source in ("arm", "/arm"):
            found = store.look(target, source, T0 + SEC // 2)
            assert found.transform.translation.x == pytest.approx(1.5)
            assert (found.header.frame_id, found.child_frame_id) == ("map", "arm")


def test_another_parent(store):
    """Between two parents the older one holds, without interpolation."""
    store.track("world", "shelf", speed=0.0, count=60)
    store.track("world", "robot", speed=0.0, count=60)
    for n in range(10):
        store.add(transform("shelf", "cup", T0 + n * SEC // 2, 1 + n))
    for n in range(10):
        store.add(transform("robot", "cup", T0 + (5 + n) * SEC, 50 + n))
    assert store.x("shelf", "cup", T0 + 4_700_000_000) == 10.0
    for time in (
        T0 + 4 * SEC,
        T0 + 4_500_000_000,
        T0 + 4_700_000_000,
        T0 + 5 * SEC,
        T0 + 5_500_000_000,
    ):
        for target in ("shelf", "robot", "world"):
            assert store.same(target, "cup", time) is None


def test_the_first_of_equal_stamps_counts(store):
    store.add(transform("map", "base", T0, 1.0), transform("map", "base", T0, 2.0))
    store.add(transform("map", "base", T0, 3.0), key=T0 - 5)
    store.add(transform("map", "base", T0 + SEC, 4.0), transform("map", "base", T0 + SEC, 6.0))
    assert store.x("map", "base", T0) == 3.0
    assert store.x("map", "base", T0 + SEC // 2) == pytest.approx(3.5)
    for time in (T0, T0 + SEC // 2, T0 + SEC):
        assert store.same("map", "base", time) is None


@search(50, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_order_any_parent(shared, data):
    """Few stamps, so that they are often equal, received in any order; one node an example.

    All lie in the window that is read first: what comes later out of order may be missed.
    """
    unit = SEC // 20
    stamps = st.integers(0, 12)
    one = st.tuples(st.sampled_from(["ab", "bc", "ac", "cd", "bd"]), stamps, st.integers(-5, 5))
    messages = data.draw(st.lists(st.lists(one, min_size=1, max_size=3), min_size=1, max_size=25))
    store = Store(shared, nodeID=uuid.uuid4().hex)
    for n, message in enumerate(messages):
        made = [transform(e[0], e[1], T0 + s * unit, x, x / 3) for e, s, x in message]
        store.add(*made, key=T0 + n * unit)
    for _ in range(6):
        frames = [data.draw(st.sampled_from("abcd")) for _ in range(2)]
        exact = stamps.map(lambda stamp: stamp * unit)
        time = T0 + data.draw(st.one_of(exact, st.integers(0, 12 * unit)))
        store.same(*frames, time)


def broken(kind, stamp):
    made = transform("map", "base", stamp, 99.0)
    if kind == "nan":
        made.transform.translation.y = math.nan
    elif kind == "rotation":
        made.transform.rotation.w = 2.0
    elif kind == "zero":
        made.transform.rotation.w = 0.0
    elif kind == "parent":
        made.header.frame_id = "/"
    else:
        made.header.frame_id = "/base"
    return made


@pytest.mark.parametrize("kind", ["nan", "rotation", "zero", "parent", "itself"])
def test_what_tf2_leaves_out(store, kind):
    store.track("map", "base", step=SEC, count=3)
    store.add(broken(kind, T0 + SEC // 2))
    store.add(broken(kind, T0 + 3 * SEC))
    assert store.same("map", "base", T0 + SEC // 2 + 1) is None
    assert store.same("map", "base", T0 + 2 * SEC + 1) is tf2_py.ExtrapolationException
    with pytest.raises(ExtrapolationException) as error:
        store.look("map", "base", T0 + 2 * SEC + 1)
    assert "some of frame base are left out, as tf2 does: " in str(error.value)


def test_a_fixed_transform_that_is_broken_replaces_none(store):
    store.add(transform("map", "base", T0, 1.0), topic="/tf_static")
    store.add(broken("nan", T0 + 5), topic="/tf_static")
    assert store.same("map", "base", T0 + SEC) is None


def test_rotations_that_tf2_just_takes(store):
    for w, taken in ((1.0049, True), (1.0051, False)):
        child = f"c{taken}"
        for n in range(2):
            made = transform("map", child, T0 + n * SEC)
            made.transform.rotation.w = w
            store.add(made)
        assert (store.same("map", child, T0 + 5) is None) == taken


@pytest.mark.suite("all", "make test asks others of its kind")
@pytest.mark.parametrize("delay", [HOUR, -HOUR, 3 * SEC, 10**17, -(10**17)])
def test_stamps_far_from_the_row_keys(store, delay):
    start = T0 + 40 * SEC
    store.track("map", "base", start=start, delay=delay)
    store.track("base", "arm", start=start, delay=delay // 2)
    for n in range(5):  # beside them, what has no delay
        store.add(transform("map", "other", start + n * SEC, n))
    assert store.same("map", "arm", start + 5 * SEC + 1) is None
    assert store.same("arm", "other", start + 2 * SEC + 1) is None
    assert store.same("map", "arm", start + HOUR) is tf2_py.ExtrapolationException
    assert store.same("map", "arm", 0) is None


def test_far_stamps_are_found_and_no_message_is_read_twice(store, monkeypatch):
    store.track("map", "base", count=400, delay=5 * HOUR)
    read = []
    take = samples.TransformTopic._add
    monkeypatch.setattr(
        samples.TransformTopic,
        "_add",
        lambda self, nearest, row: (read.append(row.t), take(self, nearest, row)),
    )
    assert store.x("map", "base", T0 + 50 * SEC + 1) == pytest.approx(50.000000001)
    assert T0 + 5 * HOUR + 50 * SEC in read
    assert len(set(read)) == len(read)


def test_rare_transforms(store):
    """Wider than the first window, to both sides."""
    store.track("map", "odom", step=30 * SEC, count=6)
    store.track("odom", "base", step=SEC, count=150)
    assert store.x("map", "base", T0 + 75 * SEC) == pytest.approx(150.0)
    assert store.same("map", "base", T0 + 75 * SEC + 7) is None
    assert store.same("map", "base", 0) is None


def test_a_nearer_transform_that_came_late(store):
    """The first window brackets the time; the delays say that nearer ones may lie elsewhere."""
    store.add(transform("map", "base", T0 - 100 * SEC, 1.0), key=T0 - SEC)
    store.add(transform("map", "base", T0 + 100 * SEC, 2.0), key=T0 + SEC)
    store.add(transform("map", "base", T0 - SEC, 3.0), key=T0 - 60 * SEC)
    store.add(transform("map", "base", T0 + SEC, 5.0), key=T0 + 60 * SEC)
    assert store.x("map", "base", T0) == pytest.approx(4.0)
    assert store.same("map", "base", T0) is None


@pytest.mark.parametrize("side", [-1, 1])
def test_how_late_the_nearest_transforms_came_says_where_nearer_ones_may_lie(store, side):
    """The two in the first window (2 s) bracket the time, and one of them came 3 s late: so may one
    between them, the last of which came just before 4 s. Or their stamps lie as far ahead."""
    store.add(transform("map", "base", T0 - side * SEC, 1.0), key=T0 + side * 2 * SEC)
    store.add(transform("map", "base", T0 + side * SEC, 9.0))
    nearest = T0 + side * (SEC - 1)
    store.add(transform("map", "base", nearest, 5.0), key=nearest + side * 3 * SEC)
    assert store.x("map", "base", T0) == pytest.approx(3.0)
    assert store.same("map", "base", T0) is None


def test_out_of_order(store):
    stamps = [(n * 7) % 40 for n in range(40)]
    for n, stamp in enumerate(stamps):
        store.add(transform("map", "base", T0 + stamp * SEC, stamp), key=T0 + n * SEC)
    for time in (T0 + SEC // 2, T0 + 20 * SEC + 1, T0 + 38 * SEC + 999):
        assert store.same("map", "base", time) is None


def test_years_between_two_transforms(store):
    """Further apart than tf2 is given times: only how the distances compare counts."""
    day = 24 * HOUR
    store.add(transform("map", "base", T0, 0.0))
    store.add(transform("map", "base", T0 + 4000 * day, 4000.0))
    assert store.x("map", "base", T0 + 1000 * day) == pytest.approx(1000.0, rel=1e-12)
    assert store.x("map", "base", T0 + 1) == pytest.approx(0.0, abs=1e-6)
    assert store.x("map", "base", T0) == 0.0
    assert store.x("map", "base", T0 + 4000 * day) == 4000.0


def test_the_newest_time_is_the_newest_that_all_have(store):
    store.track("map", "odom", count=20)
    store.track("odom", "base", count=30)
    found = store.look("map", "base", genpy.Time(0))
    assert found.header.stamp.to_nsec() == T0 + 19 * SEC // 4
    assert store.same("map", "base", 0) is None
    assert store.same("odom", "base", 0) is None


def test_two_robots(alone):
    alone.track("map", "base", nodeID="red")
    alone.track("map", "base", start=T0 + SEC // 8, speed=-1.0, nodeID="blue")
    alone.add(transform("base", "arm", T0, 1.0), topic="/tf_static", nodeID="red")
    alone.add(transform("base", "hand", T0, 1.0), topic="/tf_static", nodeID="blue")
    time = T0 + SEC + 1
    assert alone.x("map", "base", time, nodeID="red") == pytest.approx(1.000000001)
    assert alone.x("map", "base", time, nodeID="blue") == pytest.approx(-1.000000001)
    assert alone.x("map", "arm", time, nodeID="red") == pytest.approx(2.000000001)
    assert alone.same("map", "base", time) is None
    assert alone.same("arm", "hand", time) is None
    with pytest.raises(LookupException) as error:
        alone.look("map", "arm", time, nodeID="blue")
    assert "of node blue" in str(error.value)
    with pytest.raises(LookupException):
        alone.look("map", "base", time, nodeID="green")


BEYOND = """
import sys
from cassandra_ros import RosCassandra
with RosCassandra(sys.argv[1], int(sys.argv[2]), keyspace=sys.argv[3]) as rosCas:
    for time in map(int, sys.argv[5:]):
        found = rosCas.lookupTransform("map", "arm", time, nodeID=sys.argv[4])
        print(found.header.stamp.to_nsec(), found.transform.translation.x)
"""


@pytest.mark.suite("all", "make test asks others of its kind")
def test_stamps_over_2_to_the_31(store, cassandra):
    """They end a process that gives them to tf2, so another one asks."""
    start = (2**31 + 1000) * SEC
    for n in range(20):
        store.add(transform("map", "base", start + n * SEC, n), key=start + n * SEC)
    store.add(transform("base", "arm", 2**32 * SEC - 1, 0.5), topic="/tf_static")
    times = [start + SEC // 2, start + 7 * SEC + 1, start + 19 * SEC]
    where = [cassandra.host, str(cassandra.port), store.rosCas.keyspace, store.nodeID]
    root = Path(__file__).resolve().parents[2]
    done = subprocess.run(
        [sys.executable, "-c", BEYOND, *where, *map(str, times)],
        cwd=root / "src",
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    lines = [line.split() for line in done.stdout.splitlines()]
    assert [int(stamp) for stamp, _ in lines] == times
    assert [float(x) for _, x in lines] == pytest.approx([1.0, 7.500000001, 19.5])


def test_an_unknown_robot_is_told_with_similar_ones(store):
    store.track("map", "base_link", nodeID="husky")
    with pytest.raises(LookupException) as error:
        store.look("map", "base_link", 0, nodeID="huskey")
    assert "is of robot 'huskey'; did you mean husky?" in str(error.value)


def test_a_topic_without_a_message_and_an_unknown_robot_have_no_transform(rosCas):
    rosCas.addTopic("/tf")
    with pytest.raises(LookupException, match="no transform at all"):
        rosCas.lookupTransform("map", "base_link", 0, nodeID="husky")
