# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Beams of scans and clouds, the cells that they go through, and the files of a map."""

from __future__ import annotations

import math
from fractions import Fraction

import nav_msgs.msg
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from sensor_msgs.msg import LaserEcho, LaserScan, MultiEchoLaserScan, PointCloud2, PointField
from suites import search

from cassandra_ros.errors import CorruptMessage, InvalidName, InvalidOption
from cassandra_ros.messages.classes import serialize
from cassandra_ros.viewing.mapping.beams import beams_of_cloud, beams_of_echoes, beams_of_scan
from cassandra_ros.viewing.mapping.grid import LogOddsGrid
from cassandra_ros.viewing.mapping.map_files import map_png, save_map
from cassandra_ros.viewing.mapping.occupancy import OccupancyMap

INF, NAN = math.inf, math.nan
SQUARE = 1 / 4
"""Metres: exact in a double."""


def scan(ranges, **changed):
    made = LaserScan(angle_min=0, angle_increment=math.pi / 2, range_min=0.5, range_max=8.0)
    made.ranges = ranges
    for name, value in changed.items():
        setattr(made, name, value)
    return made


@pytest.mark.parametrize(
    ("seen", "end", "hit"),
    [
        (2.0, 2.0, True),
        (0.5, 0.5, True),
        (0.4, None, None),  # closer than it can see
        (0.0, None, None),
        (-INF, None, None),
        (NAN, None, None),
        (INF, 8.0, False),  # nothing as far as it can see
        (8.0, 8.0, False),  # as older drivers say so
        (8.5, None, None),
        (7.999, 7.999, True),
    ],
)
def test_a_range_means_what_rep_117_says(seen, end, hit):
    ends, hits = beams_of_scan(scan([seen]), None)
    found = (None, None) if not len(ends) else (pytest.approx(ends[0, 0]), bool(hits[0]))
    assert found == (end, hit)


def test_angles_that_are_none_say_nothing():
    assert not len(beams_of_scan(scan([1.0, INF], angle_min=NAN), None).ends)


def test_beams_go_round_and_end_at_the_range_that_is_asked_for():
    ends, hit = beams_of_scan(scan([1.0, 2.0, 3.0, INF]), 2.5)
    assert np.allclose(ends[:, :2], [(1, 0), (0, 2), (-2.5, 0), (0, -2.5)])
    assert hit.tolist() == [True, True, False, False]
    # Without a maximum range a beam that hits nothing gives no information.
    assert beams_of_scan(scan([1.0, INF], range_max=0.0), None).hit.tolist() == [True]
    assert beams_of_scan(scan([1.0, INF], range_max=INF), None).hit.tolist() == [True]
    assert beams_of_scan(scan([1.0, INF], range_max=INF), 4.0).hit.tolist() == [True, False]


def test_scans_of_any_layout_are_read():
    """Turned the other way, with intensities, without ranges, and with several echoes a beam."""
    turned = scan([1.0, 2.0], angle_increment=-math.pi / 2, intensities=[5.0, 6.0])
    assert np.allclose(beams_of_scan(turned, None).ends[:, :2], [(1, 0), (0, -2)])
    assert not len(beams_of_scan(scan([]), None).ends)
    several = MultiEchoLaserScan(angle_increment=math.pi / 2, range_min=0.5, range_max=8.0)
    several.ranges = [LaserEcho([1.0, 3.0]), LaserEcho([]), LaserEcho([INF]), LaserEcho([2.0])]
    ends, hit = beams_of_echoes(several, None)
    assert np.allclose(ends[:, :2], [(1, 0), (-8, 0), (0, -2)])
    assert hit.tolist() == [True, False, True]


def cloud(points, height=1, dtype="<f4", padding=0, names="xyz"):
    """A cloud in which each point has a float in front, and each row some padding at its end."""
    points = np.asarray(points, np.float64).reshape(height, -1, len(names))
    kind = np.dtype(dtype)
    rows = np.zeros(points.shape[:2] + (len(names) + 1,), kind)
    rows[..., 1:] = points
    made = PointCloud2(height=height, width=points.shape[1], is_bigendian=dtype[0] == ">")
    made.point_step = rows.shape[2] * kind.itemsize
    made.row_step = made.width * made.point_step + padding
    made.data = b"".join(row.tobytes() + bytes(padding) for row in rows)
    number = PointField.FLOAT64 if kind.itemsize == 8 else PointField.FLOAT32
    made.fields = [
        PointField(name, (n + 1) * kind.itemsize, number, 1) for n, name in enumerate(names)
    ]
    return made


def test_a_cloud_is_read_whatever_its_form():
    points = [(1, 2, 0.5), (NAN, NAN, NAN), (-3, 4, 0.25), (40, 0, 30)]
    expected = [(1, 2, 0.5), (-3, 4, 0.25), (24, 0, 18)]  # the last one is cut at 30 m
    for form in (
        cloud(points),
        cloud(points, height=2),
        cloud(points, height=2, padding=5),
        cloud(points, dtype=">f8", height=4, padding=3),
    ):
        for message in (form, PointCloud2().deserialize(serialize(form))):
            ends, hit = beams_of_cloud(message, None)
            assert np.allclose(ends, expected)
            assert hit.tolist() == [True, True, False]
    assert np.allclose(beams_of_cloud(cloud([(1, 2)], names="xy"), None).ends, [(1, 2, 0)])
    assert not len(beams_of_cloud(PointCloud2(), None).ends)


KINDS = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}


@pytest.mark.parametrize("sample", KINDS)
@pytest.mark.parametrize("order", ["<", ">"])
def test_coordinates_of_any_type_in_any_order_are_read(sample, order):
    """As z, colour, y, x, with bytes between them, as drivers lay them out."""
    places = {"z": (order + sample, 1), "rgb": (order + "f4", 9), "y": (order + sample, 13)}
    places["x"] = (order + sample, 21)
    names, formats = list(places), [kind for kind, _ in places.values()]
    offsets = [offset for _, offset in places.values()]
    layout = {"names": names, "formats": formats, "offsets": offsets, "itemsize": 32}
    points = np.zeros(2, np.dtype(layout))
    points["x"], points["y"], points["z"], points["rgb"] = (1, 4), (2, 5), (3, 6), NAN
    fields = [
        PointField(name, offset, PointField.FLOAT32 if name == "rgb" else KINDS[sample], 1)
        for name, (_, offset) in places.items()
    ]
    made = PointCloud2(height=1, width=2, fields=fields, is_bigendian=order == ">")
    made.point_step, made.row_step, made.data = 32, 64, points.tobytes()
    assert beams_of_cloud(made, None).ends.tolist() == [[1, 2, 3], [4, 5, 6]]
    made.fields[0].datatype = 9
    with pytest.raises(CorruptMessage, match="do not fit"):
        beams_of_cloud(made, None)


def test_a_cloud_that_is_none_is_refused():
    with pytest.raises(CorruptMessage, match="no x and y: its fields are y, z"):
        beams_of_cloud(cloud([(1, 2)], names="yz"), None)
    short = cloud([(1, 2, 3)] * 4)
    short.data = short.data[:-1]
    with pytest.raises(CorruptMessage, match="4 x 1 points of 16 bytes has 63 bytes"):
        beams_of_cloud(short, None)
    wild = cloud([(1, 2, 3)])
    wild.fields[0].offset = 1000
    with pytest.raises(CorruptMessage, match="do not fit"):
        beams_of_cloud(wild, None)


CELL = st.integers(-40, 40)
RAYS = st.lists(st.tuples(CELL, CELL, st.booleans()), min_size=1, max_size=12)


def way(begin, end):
    """The cells between two, without the second: one for each step of the longer side."""
    (x0, y0), (x1, y1) = begin, end
    steps = max(abs(x1 - x0), abs(y1 - y0))
    halves = {}
    for k in range(steps):
        exact = [a + Fraction(k * (b - a), steps) for a, b in ((x0, x1), (y0, y1))]
        # A cell that lies exactly half way may be either one.
        halves[k] = [{math.floor(c + Fraction(1, 2)), math.ceil(c - Fraction(1, 2))} for c in exact]
    return halves.values()


@search(200)
@given(begin=st.tuples(CELL, CELL), rays=RAYS)
def test_rays_go_through_the_cells_that_bresenham_says(begin, rays):
    grid = LogOddsGrid(SQUARE)
    centre = (np.array([[x, y] for x, y, _ in rays]) + 0.5) * SQUARE
    grid.add((np.array(begin) + 0.5) * SQUARE, centre, np.array([hit for *_, hit in rays]))
    odds, (left, bottom) = grid.trimmed()
    column, row = round(left / SQUARE), round(bottom / SQUARE)
    where = {(int(x) + column, int(y) + row): float(odds[y, x]) for y, x in zip(*np.nonzero(odds))}
    struck = {(x, y) for x, y, hit in rays if hit}
    assert {cell for cell, value in where.items() if value > 0} == struck
    free = {cell for cell, value in where.items() if value < 0}
    certain, possible = set(), set()
    for x, y, hit in rays:
        for columns, rows in way(begin, (x, y)):
            cells = {(c, r) for c in columns for r in rows}
            possible |= cells
            certain |= cells if len(cells) == 1 else set()
        if not hit:
            certain.add((x, y))
    assert certain - struck <= free <= (possible | certain) - struck


def test_a_cell_changes_once_a_scan_and_stays_open_to_doubt():
    grid = LogOddsGrid(1.0)
    ends, hit = np.array([(3.5, 0.5), (3.5, 0.6), (6.5, 0.5)]), np.array([True, True, False])
    grid.add(np.array([0.5, 0.5]), ends, hit)
    once = OccupancyMap.of_grid(grid, "map", 0).cells
    assert once.tolist() == [[40, 40, 40, 70, 40, 40, 40]]
    for _ in range(50):
        grid.add(np.array([0.5, 0.5]), ends, hit)
    assert OccupancyMap.of_grid(grid, "map", 0).cells.tolist() == [[3, 3, 3, 97, 3, 3, 3]]
    for _ in range(12):
        grid.add(np.array([0.5, 0.5]), ends[2:], hit[2:])
    assert OccupancyMap.of_grid(grid, "map", 0).cells[0, 3] < 50


def test_a_grid_grows_to_all_sides_and_not_without_end():
    grid = LogOddsGrid(0.1)
    for x, y in [(0, 0), (30, 0), (-50, 0), (0, 40), (0, -60)]:
        grid.add(np.array([x, y], float), np.array([[x + 0.55, y]]), np.array([True]))
    made = OccupancyMap.of_grid(grid, "map", 0)
    assert (made.width, made.height) == (806, 1001)
    assert (made.x, made.y) == (pytest.approx(-50), pytest.approx(-60))
    assert np.argwhere(made.cells >= 65).tolist() == [
        [0, 505], [600, 5], [600, 505], [600, 805], [1000, 505]
    ]  # fmt: skip
    with pytest.raises(InvalidOption, match="coarser resolution, or a shorter max_range"):
        grid.add(np.zeros(2), np.array([[1e6, 1e6]]), np.array([True]))
    for far in (1e30, -1e30, 3.4e38, NAN):  # beyond all integers
        with pytest.raises(InvalidOption, match="give a shorter max_range"):
            grid.add(np.zeros(2), np.array([[far, far]]), np.array([True]))
    assert grid.trimmed()[0].shape == (1001, 806)
    for wrong in ({"resolution": 0.0}, {"resolution": NAN}, {"resolution": 1, "hit": 0.4}):
        with pytest.raises(InvalidOption):
            LogOddsGrid(**wrong)


def read_as_map_server(path):
    """What map_server's image_loader publishes of a map, by its rules for mode trinary."""
    told = yaml.safe_load(path.read_text())
    with Image.open(path.with_name(told["image"])) as image:
        greys = np.asarray(image, np.float64)
    dark = greys / 255 if told["negate"] else (255 - greys) / 255
    cells = np.full(greys.shape, -1, np.int8)
    cells[dark > told["occupied_thresh"]] = 100
    cells[dark < told["free_thresh"]] = 0
    return cells[::-1], told


def drawn():
    cells = np.array([[-1, 0, 40], [50, 65, 100]], np.int8)
    return OccupancyMap(cells, 0.05, -1.5, 2.25, 0.5, "map", 1_368_021_980_238_582_676)


@pytest.mark.parametrize("name", ["office 1.pgm", "büro.yaml"])
def test_map_server_reads_what_is_written(tmp_path, name):
    image, description = save_map(drawn(), tmp_path / name)
    cells, told = read_as_map_server(description)
    assert cells.tolist() == [[-1, 0, 0], [-1, 100, 100]]
    assert (told["resolution"], told["origin"]) == (0.05, [-1.5, 2.25, 0.5])
    assert sorted(tmp_path.iterdir()) == sorted([image, description])
    with pytest.raises(InvalidName, match=r"NAME\.pgm"):
        save_map(drawn(), tmp_path / "office.png")


def test_what_is_no_probability_is_unknown(tmp_path):
    """As map_saver has it: some keep 255 for what they do not know, which is -1, or 254."""
    odd = OccupancyMap(np.array([[-2, -128, 0, 127]], np.int8), 1.0, 0.0, 0.0, 0.0, "map", 0)
    cells, _ = read_as_map_server(save_map(odd, tmp_path / "odd.pgm")[1])
    assert cells.tolist() == [[-1, -1, 0, 100]]
    (tmp_path / "odd.png").write_bytes(map_png(odd, transparent=True))
    with Image.open(tmp_path / "odd.png") as image:
        assert np.asarray(image)[0].tolist() == [[205, 0], [205, 0], [255, 255], [0, 255]]


def test_a_map_is_a_message_and_back_again():
    message = drawn().message()
    assert type(message) is nav_msgs.msg.OccupancyGrid
    again = OccupancyMap.of_message(nav_msgs.msg.OccupancyGrid().deserialize(serialize(message)))
    assert again.cells.tolist() == drawn().cells.tolist()
    assert (again.x, again.y, again.frame, again.stamp) == (-1.5, 2.25, "map", drawn().stamp)
    assert (again.resolution, again.yaw) == (pytest.approx(0.05), pytest.approx(0.5))
    message.info.width = 7
    with pytest.raises(CorruptMessage, match="7 x 2 cells"):
        OccupancyMap.of_message(message)


def test_a_picture_is_dark_where_something_is(tmp_path):
    for transparent, mode in ((False, "L"), (True, "LA")):
        path = tmp_path / "map.png"
        path.write_bytes(map_png(drawn(), transparent))
        with Image.open(path) as image:
            assert (image.mode, image.size) == (mode, (3, 2))
            assert '"frame": "map"' in image.text["map"]
            pixels = np.asarray(image)
        greys = pixels[..., 0] if transparent else pixels
        assert greys[0].tolist() == [128, 89, 0]  # the first row has the largest y
        assert greys[1].tolist() == [205, 255, 153]
        if transparent:
            assert pixels[..., 1].tolist() == [[255, 255, 255], [0, 255, 255]]
