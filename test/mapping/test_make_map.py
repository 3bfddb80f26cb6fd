# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Maps of stored scans and clouds: of a room that is known, and of real bags."""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys

import numpy as np
import pytest
from compiled import compiled
from conftest import ROOT
from mapping.room import OFFSET, SHIFT, T0, Drive, assert_room
from mapping.test_grid import read_as_map_server
from PIL import Image

from cassandra_ros import MapOptions, PoseChoice, Stamp, makeMap
from cassandra_ros.cli import cassandra_bag
from cassandra_ros.errors import (
    InvalidOption,
    MessageNotFound,
    RunNotFound,
    TopicNotFound,
    TransformException,
    TypeMismatch,
)
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.places.rigid import Rigid
from cassandra_ros.viewing.mapping.beams import CLOUD_HEIGHTS, CLOUD_RANGE
from cassandra_ros.viewing.mapping.occupancy import OccupancyMap

SEC = 10**9
YEAR = 365 * 86400 * SEC
LASER = Rigid.planar([OFFSET[0]], [OFFSET[1]], [OFFSET[2]])
ALL = ("/tf", "/tf_static", "/odom", "/scan", "/points")


@pytest.fixture(scope="module")
def store(fresh):
    """Robots that drove the same round at the same time, and recorded it in different ways."""
    with fresh() as made:
        Drive().store(made, ALL, "tidy")
        Drive(slash="/", ahead_ns=YEAR, late_sec=1.0).store(made, ALL, "odd")
        yield made


@pytest.fixture(scope="module")
def wheels(fresh):
    """A robot that recorded no tf."""
    with fresh() as made:
        Drive().store(made, ("/odom", "/scan", "/points"))
        yield made


def test_a_map_of_scans_by_tf(store):
    told = []
    made = makeMap(store, "/scan", nodeID="tidy", progress=lambda *n: told.append(n))
    assert (made.used, made.without_pose, made.unreadable, made.received) == (63, 1, 0, 0)
    assert made.sources == ["tf (map to laser)"]
    assert (made.map.frame, made.map.resolution) == ("map", 0.05)
    assert T0 + 6 * SEC < made.map.stamp < T0 + 7 * SEC
    assert_room(made.map, SHIFT)
    assert told == [(0, 64)]
    odom = makeMap(store, "scan", nodeID="tidy", poses=PoseChoice(frame="/odom"))
    assert odom.map.frame == "odom"
    assert_room(odom.map)
    part = makeMap(store, "/scan", Stamp.from_ns(T0), Stamp.from_ns(T0 + SEC), nodeID="tidy")
    assert part.used == 10
    few = MapOptions(most=10, resolution=0.1)
    made = makeMap(store, "/scan", nodeID="tidy", options=few)
    assert made.used + made.without_pose == 10


def test_a_map_of_clouds_takes_what_stands_between_two_heights(store):
    made = makeMap(store, "/points", nodeID="tidy")
    assert made.used == 16
    assert_room(made.map, SHIFT, walls=0.8)
    low = MapOptions(min_height=-1, max_height=0)
    floor = makeMap(store, "/points", nodeID="tidy", options=low).map.cells
    assert (floor >= 65).sum() > 100
    assert floor.size < made.map.cells.size  # rings about the robot, no walls
    with pytest.raises(InvalidOption, match="does not lie below"):
        MapOptions(min_height=2, max_height=1)


def test_stamps_of_another_clock_and_transforms_that_come_late(store):
    made = makeMap(store, "/scan", nodeID="odd")
    assert (made.used, made.without_pose, made.received) == (53, 11, 0)
    assert_room(made.map, SHIFT)
    # Scans whose stamps nothing else has are placed by when they were received.
    late = Drive(late_sec=1.0)
    for topic, message, _ in late.messages:
        if topic == "/scan":
            message.header.stamp.secs += 86400
    late.store(store, ("/scan",), "tidy", {"/scan": "/wrong_clock"})
    made = makeMap(store, "/wrong_clock")
    assert (made.used, made.received) == (63, 63)
    assert_room(made.map, SHIFT)


def test_robots_draw_one_map_each_by_its_own_poses(store):
    both = makeMap(store, "/scan")
    assert both.used == 63 + 53
    assert_room(both.map, SHIFT)
    assert makeMap(store, "/scan", nodeID=["tidy", "odd"]).used == 63 + 53


def test_a_map_by_odometry(wheels):
    made = makeMap(wheels, "/scan", poses=PoseChoice(sensor_offset=LASER))
    assert (made.used, made.sources) == (63, ["/odom, sensor offset as given"])
    assert made.map.frame == "odom"
    assert_room(made.map)
    named = PoseChoice(odom="/odom", sensor_offset=LASER, frame="odom")
    assert np.array_equal(makeMap(wheels, "/scan", poses=named).map.cells, made.map.cells)
    # Without an offset it is another map, and that is told.
    bare = makeMap(wheels, "/scan")
    assert bare.sources == ["/odom, no sensor offset"]
    assert not np.array_equal(bare.map.cells, made.map.cells)
    cloud = makeMap(wheels, "/points", poses=PoseChoice(sensor_offset=LASER))
    assert_room(cloud.map, walls=0.8)
    with pytest.raises(InvalidOption, match="tells poses in frame odom, not in map"):
        makeMap(wheels, "/scan", poses=PoseChoice(frame="map"))


def test_a_robot_goes_by_its_own_odometry_and_not_by_its_goal(wheels):
    other = {"/odom": "/another/odom", "/scan": "/another/scan"}
    Drive().store(wheels, ("/odom", "/scan"), "another", other)
    Drive().store(wheels, ("/odom",), rename={"/odom": "/a_goal"})
    choice = PoseChoice(sensor_offset=LASER)
    for topic, told in (("/scan", "/odom"), ("/another/scan", "/another/odom")):
        made = makeMap(wheels, topic, poses=choice)
        assert (made.used, made.sources) == (63, [f"{told}, sensor offset as given"])


def poses_of(drive, count, later_ns=0):
    """The first poses that a drive told on /odom, as if they had been told at another time."""
    drive.messages = [m for m in drive.messages if m[0] == "/odom"][:count]
    drive.messages = [(topic, message, key + later_ns) for topic, message, key in drive.messages]
    return drive


@pytest.fixture(scope="module")
def several(fresh):
    """A robot without tf and four topics of its poses, of which one covers each of its scans."""
    with fresh() as made:
        Drive().store(made, ("/odom", "/scan"), rename={"/odom": "/wheels"})
        some = Drive()
        poses_of(some, 20).store(made, ("/odom",), rename={"/odom": "/a_third"})
        hour = poses_of(Drive(), 64, -3600 * SEC)
        hour.store(made, ("/odom",), rename={"/odom": "/an_hour_ago"})
        around = poses_of(Drive(), 1, -60 * SEC)
        around.messages += poses_of(Drive(), 1, 60 * SEC).messages
        around.store(made, ("/odom",), rename={"/odom": "/around"})
        yield made


@pytest.mark.suite("all", "make test asks others of its kind")
def test_the_topic_that_covers_most_of_the_messages_tells_the_poses(several):
    made = makeMap(several, "/scan")
    assert (made.used, made.sources) == (63, ["/wheels, no sensor offset"])
    assert [(offer.topic, offer.taken) for offer in made.offers] == [
        ("/wheels", True),
        ("/a_third", False),
        ("/an_hour_ago", False),
        ("/around", False),
    ]
    shares = [offer.share for offer in made.offers]
    assert shares == pytest.approx([63 / 64, 19 / 64, 0, 0], abs=0.02)
    # In a time range in which two topics are equally good, the first by name is taken.
    first = makeMap(several, "/scan", Stamp.from_ns(T0), Stamp.from_ns(T0 + SEC))
    assert (first.used, first.sources) == (10, ["/a_third, no sensor offset"])
    # What is asked for is taken, and what else there is is told.
    named = makeMap(several, "/scan", poses=PoseChoice(odom="a_third"))
    assert (named.used, named.without_pose) == (19, 45)
    assert [offer.topic for offer in named.offers if offer.taken] == ["/a_third"]
    assert [offer.topic for offer in named.offers][0] == "/wheels"


@pytest.mark.suite("all", "make test asks others of its kind")
def test_each_run_has_the_poses_that_cover_its_messages(fresh):
    with fresh() as made:
        for later, odom in ((0, "/z"), (YEAR, "/y")):
            drive = Drive()
            drive.messages = [(t, m, k + later) for t, m, k in drive.messages]
            drive.store(made, ("/odom", "/scan"), rename={"/odom": odom})
        runs = {row.run for row in made.getTopic("/scan").rows()}
        assert len(runs) == 2
        told = {makeMap(made, "/scan", run=run).sources[0].split(",")[0] for run in runs}
        assert told == {"/y", "/z"}


def test_only_what_has_no_stamp_is_placed_by_its_reception(wheels):
    some = Drive(ahead_ns=YEAR)
    scans = [message for topic, message, _ in some.messages if topic == "/scan"]
    for message in scans[10:13]:
        message.header.stamp.secs = message.header.stamp.nsecs = 0
    some.store(wheels, ("/scan", "/odom"), "new", {"/scan": "/new/scan", "/odom": "/new/odom"})
    made = makeMap(wheels, "/new/scan", poses=PoseChoice(sensor_offset=LASER))
    assert (made.used, made.received) == (63, 3)
    assert_room(made.map)


def test_odometry_beside_tf_knows_where_the_sensor_is(store):
    compiled("tf2_py")
    made = makeMap(store, "/scan", nodeID="tidy", poses=PoseChoice(odom="/odom"))
    assert made.sources == ["/odom, sensor on base as tf has it"]
    assert_room(made.map)


@pytest.mark.suite("all", "make test asks others of its kind")
def test_what_no_map_can_be_made_of_says_why(store, fresh):
    compiled("tf2_py")
    with pytest.raises(TypeMismatch, match="/odom holds nav_msgs/Odometry: a map is made of"):
        makeMap(store, "/odom")
    with pytest.raises(TopicNotFound):
        makeMap(store, "/scam")
    with pytest.raises(RunNotFound):
        makeMap(store, "/scan", run="yesterday")
    with pytest.raises(MessageNotFound):
        makeMap(store, "/scan", Stamp.from_ns(T0 + YEAR), Stamp.from_ns(T0 + 2 * YEAR))
    with pytest.raises(TransformException, match="for none of 64 messages .* 'attic' is not in"):
        makeMap(store, "/scan", nodeID="tidy", poses=PoseChoice(frame="attic"))
    with pytest.raises(TypeMismatch, match="tells no poses"):
        makeMap(store, "/scan", poses=PoseChoice(odom="/points"))
    with pytest.raises(InvalidOption, match="give a coarser resolution"):
        makeMap(store, "/scan", nodeID="tidy", options=MapOptions(resolution=1e-4))
    with fresh() as alone:
        Drive().store(alone, ("/scan",))
        with pytest.raises(
            TransformException, match="neither /tf nor /tf_static is stored, and there is no topic"
        ):
            makeMap(alone, "/scan")


@pytest.fixture
def bag(store, cassandra, capsys, tmp_path, monkeypatch):
    """Run cassandra_bag on the robots' keyspace, in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        where = ("--host", cassandra.host, "--port", str(cassandra.port))
        try:
            status = cassandra_bag.main([*arguments, *where, "--keyspace", store.keyspace])
        except SystemExit as exc:
            status = exc.code
        out, err = capsys.readouterr()
        return status, out, err

    return run


def test_a_map_is_drawn_kept_and_shown_again(bag, store, tmp_path):
    status, out, err = bag("map", "/scan", "--node-id", "tidy")
    assert (status, err) == (0, "")
    lines = out.splitlines()
    assert lines[0].startswith("map of 63 messages of /scan, ")
    assert lines[0].endswith("cells of 0.05 m")
    assert lines[1:] == [
        "poses: tf (map to laser)",
        "left out: 1 message: no pose is known at their times",
        "written: map.png",
    ]
    with Image.open(tmp_path / "map.png") as image:
        size, greys = image.size, np.asarray(image)
    assert (greys < 90).sum() > 100
    words = ("--store", "/maps", "--as", "room", "-o", "room.pgm", "--json", "--limit", "32")
    told = json.loads(bag("map", "/scan", "--node-id", "tidy", *words)[1])
    assert told["stored"] == {"topic": "/maps", "name": "room"}
    assert told["files"] == ["room.pgm", "room.yaml"]
    assert told["used"] == 32
    cells, _ = read_as_map_server(tmp_path / "room.yaml")
    kept = OccupancyMap.of_message(store.getTopic("/maps").getData("room"))
    assert_room(kept, SHIFT)
    assert np.array_equal(cells == 100, kept.cells >= 65)
    # It is shown again as it was kept.
    bag("map", "/scan", "--node-id", "tidy", "--store", "/maps", "--as", "later", "-q")
    status, out, err = bag("map", "/maps", "--as", "room", "-o", "again.pgm")
    assert (status, err) == (0, "")
    assert "poses: stored on /maps" in out
    assert np.array_equal(read_as_map_server(tmp_path / "again.yaml")[0], cells)
    assert bag("map", "/maps", "-o", "newest.png")[0] == 0
    with Image.open(tmp_path / "newest.png") as image:
        assert image.size == size
    assert store.getTopic("/maps").getMeta["key_format"] == "manual"
    # What is there stays, also the file beside the one that is named, unless it is said.
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    (tmp_path / "room.pgm").unlink()
    for words, taken in (((), "map.png"), (("-o", "room.pgm"), "room.yaml")):
        status, out, err = bag("map", "/maps", *words)
        assert (status, out) == (1, "")
        assert f"{taken} exists; choose another name, or replace it with --force" in err
        assert (tmp_path / taken).read_bytes() == before[taken]
    assert not (tmp_path / "room.pgm").exists()
    assert bag("map", "/maps", "-o", "room.pgm", "-f")[0] == 0
    assert (tmp_path / "room.pgm").read_bytes() != before["room.pgm"]


def test_the_topic_of_the_poses_is_printed_beside_the_others(several, cassandra, capsys, tmp_path):
    where = ["--host", cassandra.host, "--port", str(cassandra.port)]
    words = ["map", "/scan", "-o", str(tmp_path / "a.png"), *where, "--keyspace", several.keyspace]
    assert cassandra_bag.main(words) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1] == "poses: /wheels, no sensor offset"
    assert re.fullmatch(
        r"--odom takes another topic of poses: /a_third \((29|30|31) % of the messages\), "
        r"/an_hour_ago \(0 % of the messages\), /around \(0 % of the messages\)",
        lines[2],
    )
    assert cassandra_bag.main([*words, "--force", "--json", "--odom", "/a_third"]) == 0
    told = json.loads(capsys.readouterr().out)["pose_topics"]
    assert [each["topic"] for each in told if each["taken"]] == ["/a_third"]


def test_options_that_make_no_sense_are_refused(bag):
    for words, text in (
        (("-o", "map.gif"), "give a name that ends in .png, .pgm, .yaml"),
        (("-o", "none/map.png"), "none is not a folder in which you may write"),
        (("-o", f"{'x' * 300}.png"), "cannot be written: File name too long"),
        (("--max-height", "-50"), "nothing was seen in 63 messages of topic /scan"),
        (("--resolution", "0"), "not a number above 0"),
        (("--as", "x"), "is that of a stored map; /scan has none"),
        (("--odom", "/points"), "tells no poses"),
    ):
        status, _, err = bag("map", "/scan", "--node-id", "tidy", *words)
        assert status in (1, 2)
        assert text in " ".join(err.split())


def test_the_help_tells_the_defaults_that_the_library_has(bag):
    text = " ".join(bag("map", "--help-all")[1].split())
    for known in (
        f"metres (default: {MapOptions().resolution:g})",
        f"moving transforms (default: {PoseChoice().tf})",
        f"fixed transforms (default: {PoseChoice().tf_static})",
        f"two poses for interpolation, seconds (default: {PoseChoice().longest_gap_sec:g})",
        f"range_max for scans, {CLOUD_RANGE:g} for clouds",
        f"{CLOUD_HEIGHTS[0]:g} for clouds)",
        f"{CLOUD_HEIGHTS[1]:g} for clouds)",
    ):
        assert known in text


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_recorded_map_is_shown_as_it_is(bags, fresh, tmp_path):
    with fresh() as made:
        import_bag(made, bags / "big_occupancy_grid_bz2.bag", topics=["/map"], format="binary")
        found = makeMap(made, "/map").map
        message = made.getTopic("/map").getData(made.getTopic("/map").first())
    assert (found.width, found.height) == (2300, 1800)
    assert np.array_equal(found.cells.ravel(), np.array(message.data, np.int8))


@pytest.mark.suite("all", "a drive of a real lidar")
def test_figure_4_is_drawn_of_a_real_lidar(bags, cassandra, rosCas, ros_env, tmp_path):
    """And of a simulated laser; of both the stamps lie far from the times of reception."""
    words = ("--host", cassandra.host, "--port", str(cassandra.port))
    bag, out = bags / "luminar_stage_lz4.bag", tmp_path / "figure4.png"
    done = subprocess.run(
        [sys.executable, ROOT / "examples/figure4.py", bag, "--out", out, *words]
        + ["--keyspace", rosCas.keyspace],
        env=ros_env, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert re.search(r"^/base_scan: \d+ x \d+ cells of 5 messages; /base_pose", done.stdout, re.M)
    assert re.search(r"^/luminar_pointcloud: \d+ x \d+ cells of 5 messages", done.stdout, re.M)
    with Image.open(out) as image:
        assert image.width > 1.5 * image.height
    # The clouds came before the first pose: they are drawn as if the lidar had stood still.
    with pytest.raises(TransformException, match="for none of 5 .* tells no pose at 2020-03"):
        makeMap(rosCas, "/luminar_pointcloud")
    frame = rosCas.getTopic("/luminar_pointcloud").getData(0, nearest="after").header.frame_id
    coarse = MapOptions(resolution=0.2, max_range=100, min_height=-1, max_height=3)
    still = PoseChoice(frame=frame)
    clouds = makeMap(rosCas, "/luminar_pointcloud", options=coarse, poses=still)
    assert (clouds.used, clouds.map.frame) == (5, frame.strip("/"))
    assert clouds.sources == [f"none: {frame.strip('/')} itself is the frame of the map"]
    assert (clouds.map.cells >= 65).sum() > 1000
    assert math.hypot(clouds.map.width, clouds.map.height) * 0.2 < 400


@pytest.mark.suite("all", "a bag of 500 MB")
def test_first_echoes_of_a_real_backpack(bags, fresh):
    """Without poses the map is in the laser's own frame, as if the laser had stood still."""
    with fresh() as made:
        bag = bags / "backpack_multiecho_bz2.bag"
        import_bag(made, bag, topics=["horizontal_laser_2d"], format="packed")
        topic = made.getTopic("horizontal_laser_2d")
        with pytest.raises(TransformException, match="name a topic with poses by odom="):
            makeMap(made, topic.name)
        first = topic.getData(topic.first())
        still = PoseChoice(frame=first.header.frame_id)
        one = makeMap(made, topic.name, topic.first(), topic.first(), poses=still).map
        seen = [echo.echoes[0] for echo in first.ranges if len(echo.echoes)]
        rows, columns = np.nonzero(one.cells >= 65)
        x, y = one.x + (columns + 0.5) * 0.05, one.y + (rows + 0.5) * 0.05
        far = [echo for echo in seen if first.range_min <= echo < first.range_max]
        assert len(rows) > 100
        assert np.hypot(x, y).max() == pytest.approx(max(far), abs=0.1)
        assert makeMap(made, topic.name, options=MapOptions(most=50), poses=still).used >= 45
