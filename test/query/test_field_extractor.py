# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Every field of every message of the bags: taken from the bytes, and as genpy finds it."""

from __future__ import annotations

import math

import pytest
import rosbag
from compiled import compiled
from query.rows import attribute, row_of, table_of
from suites import sparing

from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.query.rows.name_resolution import Findings
from cassandra_ros.query.rows.projection import Extractor, Projection
from cassandra_ros.query.tree.field_names import all_fields
from cassandra_ros.query.tree.parse import parse_select

BAGS = (
    "backpack_multiecho_bz2",
    "big_occupancy_grid_bz2",
    "grid_map_nan_year2100",
    "husky_gps_data",
    "luminar_stage_lz4",
    "primitive_arrays",
    "ros_numpy_types",
    "turtlesim_tf",
)
EACH = 20
"""Messages of each topic: the layout is the same in all."""


def messages(path):
    """Yield definition, wire bytes and message object."""
    seen = {}
    with rosbag.Bag(str(path)) as bag:
        texts = {c.id: c.msg_def for c in bag._get_connections()}
        types = {c.topic: (c.datatype, texts[c.id], c.md5sum) for c in bag._get_connections()}
        for topic, raw, _ in bag.read_messages(raw=True):
            seen[topic] = seen.get(topic, 0) + 1
            if seen[topic] <= EACH:
                msg_type, wire, _, _, msg_class = raw
                yield parse_definition(*types[topic]), wire, msg_class().deserialize(wire)


def same(left, right):
    if isinstance(left, list) and isinstance(right, (list, tuple)):
        return len(left) == len(right) and all(map(same, left, right))
    if isinstance(left, float) and math.isnan(left):
        return math.isnan(right)
    return left == right


@pytest.mark.parametrize("name", sparing(BAGS, kept=BAGS[3:]))
def test_all_fields(bags, name):
    if "lz4" in name:
        compiled("roslz4")
    count = 0
    for definition, wire, msg in messages(bags / f"{name}.bag"):
        fields = all_fields(definition)
        row = row_of(wire=wire, table=table_of(definition))
        (values,) = Extractor(definition, fields, []).values(row)
        for ref, value in zip(fields, values):
            expected = attribute(msg, ref.column)
            assert same(value, expected), (definition.type, ref.name)
            count += 1
    assert count


def test_rows_per_element(bags):
    """Unnesting beside loops over the message, on each tf of a real robot."""
    text = "select transforms.child_frame_id, transforms.transform.rotation.w, KEY from tf"
    plans, rows = {}, 0
    for definition, wire, msg in messages(bags / "husky_gps_data.bag"):
        if definition.type != "tf/tfMessage":
            continue
        plan = plans.setdefault(
            definition.md5sum,
            Projection.compile(parse_select(text), table_of(definition), Findings(text)),
        )
        found = list(plan.rows(row_of(wire=wire, t=5, table=table_of(definition))))
        expected = [(t.child_frame_id, t.transform.rotation.w, 5) for t in msg.transforms]
        assert found == expected
        rows += len(found)
    assert rows > EACH


def test_fixed_arrays_of_nothing_are_empty():
    definition = parse_definition("pkg/T", "int32[0] none\nint32 x", None)
    row = row_of(wire=b"\5\0\0\0", table=table_of(definition))
    (values,) = Extractor(definition, all_fields(definition), []).values(row)
    assert values == [[], 5]
