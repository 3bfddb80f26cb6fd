# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What was near a latitude and longitude, beside a plain loop with the haversine formula."""

from __future__ import annotations

import math

import numpy as np
import pytest
from conftest import ROOT
from genpy.dynamic import generate_dynamic
from hypothesis import HealthCheck, given
from hypothesis import strategies as st
from nodes.children import await_true
from places.runs import (
    GAP,
    SEC,
    T0,
    Clock,
    Writer,
    asked,
    haversine,
    header_of,
    noted_of,
    odometry,
    times_of,
)
from sensor_msgs.msg import NavSatFix
from std_msgs.msg import Int32
from suites import search

from cassandra_ros.errors import InvalidOption, InvalidQuery
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.messages.classes import serialize
from cassandra_ros.places import track_windows
from cassandra_ros.places.earth import METRES_PER_UNIT, UNITS_PER_DEGREE, EarthDisk, cut_at_180
from cassandra_ros.places.ground_cells import SIZES_M, cells_of, visits_of
from cassandra_ros.places.paths import LONGEST_WAY_M, RobotPath
from cassandra_ros.places.regions import Lines
from cassandra_ros.recording.recording import Recording

CLOSE_M = 1e-5
"""Distance from the rim of a disk within which rounding decides, metres."""

GEO_POINT = "float64 latitude\nfloat64 longitude\nfloat64 altitude\n"
HEADER = "uint32 seq\ntime stamp\nstring frame_id\n"
QUATERNION = "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
PARTS = {
    "geographic_msgs/GeoPoint": GEO_POINT,
    "geographic_msgs/GeoPose": "GeoPoint position\ngeometry_msgs/Quaternion orientation\n",
    "std_msgs/Header": HEADER,
    "geometry_msgs/Quaternion": QUATERNION,
}
GEO_TYPES = {
    "geographic_msgs/GeoPoint": GEO_POINT,
    "geographic_msgs/GeoPointStamped": "std_msgs/Header header\nGeoPoint position\n",
    "geographic_msgs/GeoPose": PARTS["geographic_msgs/GeoPose"],
    "geographic_msgs/GeoPoseStamped": "std_msgs/Header header\nGeoPose pose\n",
}
"""Types of geographic_msgs, as a recorded topic tells them: the package need not be installed."""


def geo_message(kind, latitude, longitude):
    """A message of a type of geographic_msgs, made of its definition alone."""
    used = [name for name in PARTS if name != kind]
    if "Pose" not in kind:
        used = [name for name in used if "Pose" not in name and "Quaternion" not in name]
    if "Stamped" not in kind:
        used = [name for name in used if "Header" not in name]
    rule = "=" * 80
    parts = [f"{rule}\nMSG: {name}\n{PARTS[name]}" for name in used]
    message = generate_dynamic(kind, "\n".join([GEO_TYPES[kind], *parts]))[kind]()
    place = message
    for name in ("pose", "position"):
        place = getattr(place, name, place)
    place.latitude, place.longitude, place.altitude = latitude, longitude, math.nan
    return message


def fix(latitude, longitude, status=0):
    made = NavSatFix(latitude=latitude, longitude=longitude, altitude=math.nan)
    made.status.status = status
    return made


def shorter(degrees):
    """A difference of longitudes, by the shorter way around the Earth."""
    return (degrees + 180) % 360 - 180


def place_at(poses, t):
    """Latitude and longitude at a time, by hand; None if unknown."""
    before = max((pose for pose in poses if pose[0] <= t), default=None)
    after = min((pose for pose in poses if pose[0] >= t), default=None)
    if before is None or after is None or after[0] - before[0] > GAP:
        return None
    if before[0] == after[0]:
        return before[1:]
    up, across = after[1] - before[1], shorter(after[2] - before[2])
    if max(abs(up), abs(across)) * UNITS_PER_DEGREE > LONGEST_WAY_M:
        return None
    share = (t - before[0]) / (after[0] - before[0])
    return before[1] + share * up, before[2] + share * across


CENTRES = st.one_of(
    st.tuples(
        st.sampled_from([0.0, 43.47, -33.9, 60.0, 89.9999, 90.0, -90.0, -89.9, 89.0]),
        st.sampled_from([0.0, -80.54, 180.0, -180.0, 179.99999, -179.9999, 90.0]),
    ),
    st.tuples(st.floats(-90, 90), st.floats(-180, 180)),
)
RADII = st.one_of(
    st.sampled_from([0.0, 0.5, 20.0, 100.0, 1500.0, 100_000.0]), st.floats(0, 100_000)
)
STEPS = st.sampled_from([1, 2, SEC // 10, SEC, 4 * SEC, GAP, GAP + 1, 200 * SEC])


@st.composite
def drives(draw):
    """A disk, and a robot's positions around it: (t, latitude, longitude), in the order of time."""
    centre, radius = draw(CENTRES), draw(RADII)
    # The size of steps: some of the disk's own, others of a slow robot.
    size = draw(st.sampled_from([max(radius, 1.0), 3.0, 300.0, 20_000.0])) / 111_195
    poses, t = [], T0
    for step in draw(st.lists(STEPS, min_size=1, max_size=6)):
        t += step
        up, right = (draw(st.integers(-3, 3)) * size / 2 for _ in range(2))
        latitude = max(-90.0, min(90.0, centre[0] + up))
        longitude = centre[1] + right / max(0.01, math.cos(math.radians(centre[0])))
        poses.append((t, latitude, (longitude + 180) % 360 - 180))
    times = {t for t, *_ in poses} | {T0, t + SEC}
    for (first, *_), (last, *_) in zip(poses, poses[1:]):
        times |= {first + 1, first + (last - first) // 2, first + (last - first) * 4 // 5}
    return centre, radius, poses, sorted(times)


def expected_of(poses, times, centre, radius):
    """Times on the disk, and times so near its rim that rounding decides; by hand."""
    inside, rim = [], []
    for t in times:
        place = place_at(poses, t)
        if place is None:
            continue
        away = haversine(place, centre)
        if abs(away - radius) <= CLOSE_M:
            rim.append(t)
        elif away < radius:
            inside.append(t)
    return inside, rim


def path_of(poses):
    times, latitudes, longitudes = (np.array(column) for column in zip(*poses))
    plane = (longitudes * UNITS_PER_DEGREE, latitudes * UNITS_PER_DEGREE)
    return RobotPath(*cut_at_180(times.astype(np.int64), *plane, GAP, LONGEST_WAY_M))


@given(drives())
@search(300)
def test_disks_and_cells_beside_haversine(drive):
    centre, radius, poses, times = drive
    path, disk = path_of(poses), EarthDisk(*centre, radius)
    inside, rim = expected_of(poses, times, centre, radius)
    stays, visits, cells = list(path.stays(disk)), list(visits_of(path)), cells_of(disk.boxes)
    for t in times:
        place = path.at(t)
        assert (place is None) == (place_at(poses, t) is None)
        if place is None:
            continue
        assert abs(place[0]) <= 180 * UNITS_PER_DEGREE * (1 + 1e-12)
        holds = disk.holds(*place)
        assert holds is (t in inside) or t in rim
        if holds:
            assert any(low <= t <= high for low, high in stays)
            assert cells is None or any(v.cell in cells and v.low <= t <= v.high for v in visits), (
                t,
                place,
            )


def test_a_stay_is_hardly_longer_than_it_is():
    centre, second = (43.47, -80.54), 1e-5 * 111_195.08
    poses = [(T0 + n * SEC, 43.47 + (n - 50) * 1e-5, -80.54) for n in range(101)]
    ((low, high),) = path_of(poses).stays(EarthDisk(*centre, 20.0))
    for end, sign in ((low, -1), (high, 1)):
        assert (end - T0) / SEC == pytest.approx(50 + sign * 20 / second, abs=0.05)
    # Over longitude 180, in one piece.
    poses = [(T0 + n * SEC, 0.0, shorter(179.999 + n * 1e-4)) for n in range(21)]
    ((low, high),) = path_of(poses).stays(EarthDisk(0.0, 180.0, 30.0))
    assert (high - low) / SEC == pytest.approx(60 / (1e-4 * 111_195.08), abs=0.01)


def test_a_line_past_a_disk_has_no_part_of_it():
    disk = EarthDisk(60.0, 10.0, 100.0)
    north = (60.0 + 101 / 111_195.08) * UNITS_PER_DEGREE
    x = np.array([9.9 * UNITS_PER_DEGREE])
    line = Lines(x, np.array([north]), np.array([0.2 * UNITS_PER_DEGREE]), np.zeros(1))
    assert not list(disk.shares(line))
    assert EarthDisk(60.0, 10.0, 102.0).holds(10.0 * UNITS_PER_DEGREE, north)


def test_cells_cover_the_earth_without_a_rest():
    assert all(360 * UNITS_PER_DEGREE % size == 0 for size in SIZES_M)
    assert METRES_PER_UNIT == pytest.approx(0.848, abs=1e-3)
    assert len(EarthDisk(0, 180, 10).boxes) == len(EarthDisk(0, -179.99999, 10).boxes) == 2
    assert len(EarthDisk(0, 179, 10).boxes) == 1
    assert cells_of(EarthDisk(89.9999, 0, 20).boxes) is None  # all longitudes at the pole
    assert len(EarthDisk(0, 0, 3e7).boxes) == 1  # all of the Earth


@pytest.fixture(scope="module")
def husky(fresh):
    with fresh() as store:
        import_bag(store, ROOT / "examples/data/husky_gps_data.bag", topics=["/fix", "/joy"])
        yield store


def test_a_real_robot_by_its_fixes(husky):
    arrays = husky.getTopic("/fix").getArrays(["KEY", "latitude", "longitude"])
    keys, latitudes, longitudes = (np.asarray(array) for array in arrays.values())
    joy = husky.getTopic("/joy").getArrays(["KEY"])["KEY"]
    centre = float(latitudes[30]), float(longitudes[30])
    known = joy[(joy >= keys[0]) & (joy <= keys[-1])]
    at = [np.interp(known - keys[0], keys - keys[0], column) for column in (latitudes, longitudes)]
    near = [t for t, *place in zip(known.tolist(), *at) if haversine(place, centre) <= 1.5]
    assert 0 < len(near) < len(known)
    condition = f"NEAR({centre[0]!r}, {centre[1]!r}, 1.5m)"
    found = husky.executeCQL(f"select KEY from /joy where {condition}")
    assert [key.to_nsec() for (key,) in found] == near
    others = husky.executeCQL(f"select count(*) from /joy where not {condition}")
    assert others == [(len(known) - len(near),)]
    # The same in Python, with a text or with the frame; and as a parameter.
    assert times_of(husky.near(*centre, "1.5m", topics=["/joy"])) == near
    assert times_of(husky.near(*centre, 1.5, "WGS84", topics=["/joy"], robot="/fix")) == near
    joy_topic = husky.getTopic("/joy")
    assert joy_topic.countTopicData(where=condition) == len(near)
    for text, params in (
        ("NEAR(?, ?, ?)", [*centre, "1.5 m"]),
        ("NEAR(?, ?, 0.0015km)", centre),
        ("NEAR(?, ?, 1.5 IN 'WGS84')", centre),
        ("near(?, ?, ? in ?, ?)", [*centre, 1.5, "WGS84", "/fix"]),
        ("NEAR(?, ?, 1.5, 'WGS84')", centre),
    ):
        assert joy_topic.countTopicData(where=(text, params)) == len(near)
    whole = husky.executeCQL("select count(*) from /joy where NEAR(0, 0, 20100km)")
    assert whole == [(len(known),)]


def test_errors_say_what_there_is(husky, caplog):
    for wrong, text in (
        ("NEAR(1, 2, -5m)", "the radius '-5m' is not a length of 0 or more, like 20m or 1.5km"),
        ("NEAR(1, 2, 'near')", "'near' is not a length"),
        ("NEAR(1, 2, 5s)", "the radius is a number of metres, not the duration 5s"),
        ("NEAR('a', 2, 5m)", "the latitude is a number of degrees, not 'a'"),
        ("NEAR(-80.54, 180.1, 5m)", "no place on the Earth: give -90 to 90"),
        ("NEAR(90.1, 0, 5m)", "no place on the Earth"),
        ("NEAR(1, 2 IN 'map')", "IN comes after x, y and the radius, not after 2 values"),
        ("NEAR(1, 2, 3, 'map' IN 'odom')", "not after 4 values"),
        ("NEAR(1, 2, 3m IN 'WGS84', '/fxi')", r"'/fxi' is no stored topic of .*mean /fix\?"),
        ("NEAR(1, 2, 3m IN 'map')", "where robots were is not stored: neither tf"),
        ("NEAR(43.47, -80.54, 20)", r"/fix tells latitude and longitude: NEAR\(latitude, lon"),
    ):
        with pytest.raises(InvalidQuery, match=text):
            husky.executeCQL(f"select KEY from /joy where {wrong}")
    with pytest.raises(InvalidOption, match="is not a length"):
        husky.near(1, 2, "3 miles")
    assert husky.executeCQL("select KEY from /joy where NEAR(43.47, 80.54, 20m)") == []
    (message,) = caplog.messages
    assert "no robot was within 20 m of latitude 43.47, longitude 80.54 at" in message


def test_a_question_without_a_position_is_refused(rosCas):
    rosCas.addTopic("/n", "binary", msg_type="std_msgs/Int32")
    with Writer(rosCas, "ant", "n") as writer:
        writer.put("/n", T0, Int32(1))
        writer.put("/odom", T0, odometry(1, 2))
    with pytest.raises(InvalidQuery, match="no topic of sensor_msgs/NavSatFix or geographic_msgs/"):
        asked(rosCas, "NEAR(43.47, -80.54, 20m)")
    with Writer(rosCas, "ant", "no fix") as writer:
        for n in range(50):
            writer.put("/fix", T0 + n * 20 * SEC, fix(43.47, -80.54, status=-1))
        writer.put("/fix", T0 + 7, fix(math.nan, math.nan))
        writer.put("/fix", T0 + 8, fix(91.0, 0.0))
    with pytest.raises(InvalidQuery, match="no message of /fix has a fix"):
        asked(rosCas, "NEAR(43.47, -80.54, 20m)")
    with Writer(rosCas, "ant", "fix") as writer:
        writer.put("/fix", T0 + 1000 * SEC, fix(43.47, -80.54))
        writer.put("/n", T0 + 1000 * SEC, Int32(1))
    assert asked(rosCas, "NEAR(43.47, -80.54, 20m)") == [T0 + 1000 * SEC]
    with pytest.raises(InvalidQuery, match=r"no pose of robot 'bee' is stored"):
        asked(rosCas, "NEAR(43.47, -80.54, 20m)", nodeID="bee")


def test_messages_without_a_fix_are_no_positions(rosCas):
    rosCas.addTopic("/n", "binary", msg_type="std_msgs/Int32")
    with Writer(rosCas) as writer:
        for n in range(5):
            writer.put("/n", T0 + n * SEC + 1, Int32(n))
            # Between two fixes are messages that the robot would be elsewhere by.
            message = fix(0.0, 0.001 * n) if n % 2 == 0 else fix(0.0, 0.0, status=-1)
            writer.put("/fix", T0 + n * SEC, message)
        writer.put("/fix", T0 + 2 * SEC + 7, fix(math.nan, 0.0))
    assert asked(rosCas, "NEAR(0, 0.001, 5m)") == [T0 + SEC + 1]
    assert asked(rosCas, "NEAR(0, 0, 5m)") == [T0 + 1]


@pytest.mark.parametrize("kind", GEO_TYPES)
def test_types_of_geographic_msgs_by_their_definition_alone(rosCas, kind):
    rosCas.addTopic("/n", "binary", msg_type="std_msgs/Int32")
    with Writer(rosCas) as writer:
        for n in range(5):
            writer.put("/n", T0 + n * SEC, Int32(n))
            writer.put("/where", T0 + n * SEC, geo_message(kind, 43.47, -80.54 + n / 1000))
    rosCas.upkeep.indexPlaces()
    assert asked(rosCas, "NEAR(43.47, -80.538, 20m)") == [T0 + 2 * SEC]


def test_the_source_is_chosen_as_for_poses(rosCas):
    """By type, then by name in the statement; each robot and run by its own."""
    rosCas.addTopic("/n", "binary", msg_type="std_msgs/Int32")
    east = geo_message("geographic_msgs/GeoPointStamped", 0.0, 1.0)
    with Writer(rosCas, "ant", "one") as writer:
        for n in range(3):
            writer.put("/n", T0 + n * SEC, Int32(n))
            writer.put("/fused", T0 + n * SEC, east)
            writer.put("/goal", T0 + n * SEC, fix(5.0, 5.0))
    assert len(asked(rosCas, "NEAR(0, 1, 1m)")) == 3  # a goal is no position of a robot
    assert len(asked(rosCas, "NEAR(5, 5, 1m IN 'WGS84', '/goal')")) == 3
    with Writer(rosCas, "ant", "two") as writer:
        for n in range(3):
            writer.put("/n", T0 + (n + 60) * SEC, Int32(n))
            writer.put("/fix", T0 + (n + 60) * SEC, fix(0.0, 2.0))
    assert asked(rosCas, "NEAR(0, 2, 1m)") == [T0 + (60 + n) * SEC for n in range(3)]
    assert asked(rosCas, "NEAR(0, 1, 1m)") == []
    assert len(asked(rosCas, "NEAR(0, 1, 1m)", run="one")) == 3  # the run's own source
    assert len(asked(rosCas, "NEAR(0, 1, 1m) and RUN = 'one'")) == 3
    with Writer(rosCas, "bee", "three") as writer:
        writer.put("/fix", T0 + 61 * SEC, fix(0.0, 3.0))
        writer.put("/n", T0 + 61 * SEC, Int32(9))
    rows = rosCas.executeCQL("select NODE from /n where NEAR(0, 3, 1m)")
    assert rows == [("bee",)]
    assert asked(rosCas, "NEAR(0, 3, 1m)", nodeID="ant") == []
    with Writer(rosCas, "ant", "four") as writer:
        writer.put("/gps/fix", T0 + 90 * SEC, fix(0.0, 2.0))
    example = r"NEAR\(latitude, longitude, radius IN 'WGS84', '/fix'\)"
    with pytest.raises(InvalidQuery, match=f"/fix and /gps/fix tell poses.*{example}"):
        asked(rosCas, "NEAR(0, 2, 1m)", nodeID="ant")
    assert len(asked(rosCas, "NEAR(0, 2, 1m IN 'WGS84', '/fix')", nodeID="ant")) == 3


@pytest.fixture(scope="module")
def drive_store(fresh):
    """A store for each example would take too long: each has a robot of its own."""
    with fresh() as store:
        store.addTopic("/n", "binary", msg_type="std_msgs/Int32")
        store.addTopic("/fix", "binary", msg_type="sensor_msgs/NavSatFix")
        yield store


@pytest.mark.suite("test", "NEAR, counted by hand")
@given(drives())
@search(20, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_near_beside_a_plain_loop_indexed_or_not(drive_store, drive):
    centre, radius, poses, times = drive
    node = f"robot{Writer.next()}"
    with Writer(drive_store, node, f"n of {node}") as writer:
        for t in times:
            writer.put("/n", t, Int32(1))
    with Writer(drive_store, node, node) as writer:
        for t, latitude, longitude in poses:
            writer.put("/fix", t, fix(latitude, longitude))
    inside, rim = expected_of(poses, times, centre, radius)

    def found():
        near = asked(drive_store, "NEAR(?, ?, ?)", [*centre, f"{radius:.9f}m"], nodeID=node)
        return sorted(set(near) - set(rim))

    assert found() == inside
    (state,) = drive_store.upkeep.indexPlaces(nodeID=node, run=node)
    assert state.state == "indexed"
    assert found() == inside


@pytest.mark.suite("all", "20 minutes of a drive; make test asks an index in the test above")
def test_the_index_of_an_import_is_used(rosCas, monkeypatch):
    """A robot that drives east for 20 minutes, over longitude 180 in the middle."""
    poses = [(T0 + n * SEC, 10.0, shorter(179.88013 + n * 2e-4)) for n in range(1200)]
    times = [T0 + n * SEC + SEC // 3 for n in range(1199) if n % 10 in (5, 9)]
    rosCas.addTopic("/n", "binary", msg_type="std_msgs/Int32")
    with Writer(rosCas) as writer:
        for t, *place in poses:
            writer.put("/fix", t, fix(*place))
        for t in times:
            writer.put("/n", t, Int32(1))
    # The fourth and the fifth reach far over longitude 180, from either side.
    disks = [(179.95, 150), (180.0, 30), (-179.9995, 150), (179.9999, 3000), (-179.9999, 3000)]
    conditions = [f"NEAR(10, {longitude}, {radius}m)" for longitude, radius in disks]
    before = [asked(rosCas, condition) for condition in conditions]
    assert before == [
        expected_of(poses, times, (10.0, longitude), radius)[0] for longitude, radius in disks
    ]
    assert all(before)
    assert {state.state for state in rosCas.upkeep.placesIndex()} == {"not indexed"}
    (state,) = rosCas.upkeep.indexPlaces()
    assert (state.state, state.first_ns, state.last_ns) == ("indexed", T0, T0 + 1199 * SEC)
    read = []
    original = track_windows.Windows._read
    monkeypatch.setattr(
        track_windows.Windows, "_read", lambda self, n: read.append(n) or original(self, n)
    )
    assert [asked(rosCas, condition) for condition in conditions] == before
    assert len(read) < 80  # of 40 windows for each of 5 conditions
    monkeypatch.undo()
    # Fixes that are deleted take the index back, and the answers are those of what is left.
    rosCas.executeCQL("delete from /fix where KEY > ?", [T0 + 100 * SEC])
    assert {state.state for state in rosCas.upkeep.placesIndex()} == {"not indexed"}
    assert asked(rosCas, conditions[-1]) == []


def test_a_recorder_keeps_the_index(rosCas):
    recording = Recording(rosCas.catalog, clock=Clock(), name="live")
    headers = {"/fix": header_of(NavSatFix()), "/n": header_of(Int32())}
    for n in range(100):
        recording._clock.now = T0 + n * SEC
        # A receiver that has no fix at first: what it tells then is no position.
        status = -1 if n < 20 else 0
        recording.received("/fix", headers["/fix"], serialize(fix(0.0, 1e-4 * n, status)))
        recording.received("/n", headers["/n"], serialize(Int32(n)))
        if n == 70:
            await_true(lambda: all(s.handle for s in recording._sources.values()))
            recording._places._note(last=False)
            assert noted_of(rosCas, "/fix") == [(T0, T0 + 60 * SEC)]
    recording.close()
    assert noted_of(rosCas, "/fix") == [(T0, T0 + 99 * SEC)]
    assert asked(rosCas, "NEAR(0, 0.005, 6m)") == [T0 + 50 * SEC]
    assert asked(rosCas, "NEAR(0, 0.001, 500m)")[0] == T0 + 20 * SEC
    (state,) = rosCas.upkeep.placesIndex()
    assert state.state == "indexed"
