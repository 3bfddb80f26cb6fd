# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Every message of every bag, through the columns and back."""

from __future__ import annotations

import pytest
import rosbag
from compiled import compiled
from suites import sparing

from cassandra_ros.errors import DefinitionError
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.messages.wire.wire_plan import wire_plan

# Counted with the rosbag module; every one of them is exactly held in its columns.
MESSAGES = {
    "backpack_multiecho_bz2.bag": 2704,
    "big_occupancy_grid_bz2.bag": 463,
    "grid_map_nan_year2100.bag": 1,
    "husky_gps_data.bag": 12303,
    "luminar_stage_lz4.bag": 15,
    "primitive_arrays.bag": 20,
    "ros_numpy_types.bag": 9,
    "turtlesim_tf.bag": 8647,
}


@pytest.mark.suite("all", "it reads each message of whole bags")
@pytest.mark.parametrize("name", sparing(MESSAGES, kept=list(MESSAGES)[3:]))
def test_messages_of_a_bag(bags, name):
    if "lz4" in name:
        compiled("roslz4")
    count = 0
    with rosbag.Bag(str(bags / name)) as bag:
        texts = {info.id: info.msg_def for info in bag._get_connections()}
        types = {info.datatype: texts[info.id] for info in bag._get_connections()}
        for _, (type_, wire, md5sum, _, _), _ in bag.read_messages(raw=True):
            plan = wire_plan(parse_definition(type_, types[type_], md5sum))
            columns, odd = plan.walk(wire)
            assert not odd
            assert plan.build(columns) == wire
            count += 1
    assert count == MESSAGES[name]


def test_the_bag_whose_definition_is_missing(bags):
    with rosbag.Bag(str(bags / "empty_message_definition.bag")) as bag:
        for info in bag._get_connections():
            with pytest.raises(DefinitionError, match="led_array_msgs/Status"):
                parse_definition(info.datatype, info.msg_def, info.md5sum)
