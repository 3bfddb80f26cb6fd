# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The simulated robot of the README's pictures: it drives through doors, and sees the walls."""

from __future__ import annotations

import itertools
import math

import numpy as np
import office_patrol
import pytest
from office_patrol import CELL_M, EDGE_M, LASER_X, TOURS, Office

FREE, WALL = 0, 100
TICKS = range(0, 1_300, 7)
"""Moments of a round and a little more, tenths of a second of the second tour."""


@pytest.fixture(scope="module")
def cells():
    msg = Office().map()
    return np.array(msg.data).reshape(msg.info.height, msg.info.width)


def around(cells, x, y, reach_m):
    """Return the cells of the map around a place."""
    column, row, reach = (round(v / CELL_M) for v in (x + EDGE_M, y + EDGE_M, reach_m))
    return cells[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1]


def test_the_robot_keeps_away_from_walls_and_desks(cells):
    for tick in TICKS:
        x, y, _ = office_patrol.pose(TOURS[1][0] + tick / 10)
        assert (around(cells, x, y, 0.2) == FREE).all(), (x, y)


def test_the_robot_turns_little_by_little():
    turns = [abs(Office().command(TOURS[1][0] + tick / 10).angular.z) for tick in TICKS]
    assert 1 < max(turns) < 12


def test_each_ray_of_the_scanner_ends_at_a_wall(cells):
    office = Office()
    for tick in TICKS[::20]:
        seconds = TOURS[1][0] + tick / 10
        x, y, yaw = office_patrol.pose(seconds)
        x, y = x + LASER_X * math.cos(yaw), y + LASER_X * math.sin(yaw)
        msg = office.scan(seconds)
        for number, far in enumerate(msg.ranges):
            angle = yaw + msg.angle_min + number * msg.angle_increment
            end = x + far * math.cos(angle), y + far * math.sin(angle)
            assert (around(cells, *end, 0.15) == WALL).any(), end


def test_messages_come_in_the_order_of_time_and_are_the_same_each_time():
    def begin():
        return list(itertools.islice(Office().messages(), 3_000))

    messages = begin()
    assert messages == begin()
    assert [second for second, _, _ in messages] == sorted(second for second, _, _ in messages)
    topics = {topic for _, topic, _ in messages}
    assert {"/map", "/tf", "/scan", "/camera/image/compressed", "/imu/data"} <= topics
