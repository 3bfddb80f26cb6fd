# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
from __future__ import annotations

import struct

import pytest

from cassandra_ros.errors import DefinitionError
from cassandra_ros.messages.classes import installed_definition, message_class, serialize
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.messages.formats.ros import INLINE_BYTES, CassandraTopic_ros


def rosFormat(definition):
    return CassandraTopic_ros(definition.type, definition.md5sum, definition)


def test_listing_3_of_the_paper():
    storage = rosFormat(installed_definition("geometry_msgs/TransformStamped"))
    columns = storage.getColValidationClasses()
    assert list(columns.items()) == [
        ("header.seq", "bigint"),
        ("header.stamp", "bigint"),
        ("header.frame_id", "text"),
        ("child_frame_id", "text"),  # forgotten by the paper
        ("transform.translation.x", "double"),
        ("transform.translation.y", "double"),
        ("transform.translation.z", "double"),
        ("transform.rotation.x", "double"),
        ("transform.rotation.y", "double"),
        ("transform.rotation.z", "double"),
        ("transform.rotation.w", "double"),
    ]


def test_values_are_in_cqls_encoding():
    definition = installed_definition("geometry_msgs/TransformStamped")
    message = message_class(definition)(child_frame_id="Zoë")
    message.header.stamp.secs = 2**32 - 1
    message.transform.rotation.w = -0.0
    columns, odd, raw = rosFormat(definition).encode(message)
    assert not odd
    assert raw is None
    assert columns[1] == struct.pack(">q", (2**32 - 1) * 10**9)
    assert columns[3] == "Zoë".encode()
    assert columns[-1] == struct.pack(">d", -0.0)


def test_a_definition_is_needed():
    with pytest.raises(DefinitionError, match="binary"):
        CassandraTopic_ros("led_array_msgs/Status", "53a14e6c", None)


def test_a_type_without_a_class_can_be_stored_and_read_as_bytes():
    storage = rosFormat(parse_definition("pkg/T", "int8 serialize"))
    assert storage.decode_wire(*storage.encode_wire(b"\5")[::2]) == b"\5"
    with pytest.raises(DefinitionError, match="genpy"):
        storage.require_class()
    with pytest.raises(DefinitionError, match="genpy"):
        storage.decode(storage.encode_wire(b"\5"))


def test_large_messages_keep_their_scalars():
    definition = installed_definition("sensor_msgs/Image")
    storage = rosFormat(definition)
    names = list(storage.getColValidationClasses())
    for size, odd in ((INLINE_BYTES // 2, False), (INLINE_BYTES, True)):
        wire = serialize(message_class(definition)(height=7, encoding="mono8", data=b"x" * size))
        encoded = storage.encode_wire(wire)
        values = dict(zip(names, encoded.columns))
        assert encoded.odd is odd
        assert encoded.raw == (wire if odd else None)
        assert values["height"] == struct.pack(">q", 7)
        assert values["encoding"] == b"mono8"
        assert (values["data"] is None) is odd


def test_types_with_too_many_fields_keep_the_bytes():
    definition = parse_definition("pkg/T", "\n".join(f"int32 x{i}" for i in range(70)))
    storage = rosFormat(definition)
    assert len(storage.getColValidationClasses()) == 64
    wire = struct.pack("<70i", *range(70))
    encoded = storage.encode_wire(wire)
    assert not encoded.odd
    assert encoded.raw == wire
    assert [d["name"] for d in storage.describe() if d["cql"] is None] == [
        f"x{i}" for i in range(64, 70)
    ]


def test_description_says_which_array_a_list_runs_over():
    storage = rosFormat(installed_definition("tf2_msgs/TFMessage"))
    assert storage.describe()[3] == {
        "name": "transforms.child_frame_id",
        "cql": "frozen<list<text>>",
        "field": "transforms.child_frame_id",
        "type": "string",
        "array": "transforms",
    }
