# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
from __future__ import annotations

import struct

import pytest
import rosbag
from hypothesis import given
from hypothesis import strategies as st

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.classes import installed_definition
from cassandra_ros.messages.connection_header import (
    Connection,
    api_connection,
    cut_definition,
    join_definition,
    live_connection,
)

HEADER = {
    "callerid": "/talker",
    "latching": "1",
    "md5sum": "992ce8a1687cec8c8bd883ec73ca41d1",
    "message_definition": "string data\n",
    "topic": "/chatter",
    "type": "std_msgs/String",
}


def test_live_header_is_kept_field_by_field():
    connection = live_connection("/chatter", HEADER)
    assert connection.fields == {name: value.encode() for name, value in HEADER.items()}
    assert list(connection.fields) == list(HEADER)
    assert connection.type == "std_msgs/String"
    assert connection.md5sum == HEADER["md5sum"]
    assert connection.definition_text == "string data\n"
    assert connection.callerid == "/talker"
    assert connection.latching is True
    assert connection.number == -1


def test_missing_fields_are_empty():
    connection = live_connection("/chatter", {})
    assert connection.header == b""
    assert (connection.type, connection.md5sum, connection.callerid) == ("", "", "")
    assert connection.definition_text == ""
    assert connection.latching is False


def test_api_connection_says_what_it_stores():
    definition = installed_definition("std_msgs/String")
    connection = api_connection("/chatter", definition, "/me")
    assert connection.type == "std_msgs/String"
    assert connection.md5sum == definition.md5sum
    assert connection.definition_text == definition.text
    assert connection.callerid == "/me"


def test_values_may_hold_any_bytes():
    raw = "d\udce9fini".encode("utf-8", "surrogateescape")
    connection = live_connection("/x", {"message_definition": "d\udce9fini", "a": b"=\0="})
    assert connection.fields == {"message_definition": raw, "a": b"=\0="}
    assert connection.definition_text == "d\udce9fini"


NAMES = st.text(st.characters(exclude_characters="="), min_size=1)


@given(st.dictionaries(NAMES.filter(lambda name: name != "message_definition"), st.binary()))
def test_cut_and_join_are_inverse(fields):
    header = live_connection("/x", fields).header
    without, offset, definition = cut_definition(header)
    assert offset == -1
    assert (without, definition) == (header, b"")
    header = live_connection("/x", {**fields, "message_definition": b"int8 x", "z": b"1"}).header
    without, offset, definition = cut_definition(header)
    assert definition == b"int8 x"
    assert len(without) == len(header) - 6
    assert join_definition(without, offset, definition) == header


@given(st.binary(max_size=200))
def test_any_bytes_survive_cutting(header):
    assert join_definition(*cut_definition(header)) == header
    try:
        Connection("/x", header).fields  # noqa: B018
    except CorruptMessage:
        pass


@pytest.mark.parametrize(
    "header",
    [b"\1", struct.pack("<I", 5) + b"a=b", struct.pack("<I", 3) + b"abc", b"\xff\xff\xff\xff"],
)
def test_malformed_headers_are_named(header):
    with pytest.raises(CorruptMessage, match="/chatter"):
        Connection("/chatter", header).type  # noqa: B018
    assert cut_definition(header) == (header, -1, b"")


def test_two_definitions_in_one_header():
    one = live_connection("/x", {"message_definition": b"first"}).header
    two = live_connection("/x", {"message_definition": b"second!"}).header
    without, offset, definition = cut_definition(one + two)
    assert definition == b"second!"
    assert join_definition(without, offset, definition) == one + two


def test_headers_of_real_bags(bags):
    with rosbag.Bag(str(bags / "turtlesim_tf.bag")) as bag:
        seen = list(bag._get_connections())
    assert len(seen) == 12
    for info in seen:
        connection = live_connection(info.topic, info.header)
        assert connection.type == info.datatype
        assert connection.definition_text == info.msg_def
        assert join_definition(*cut_definition(connection.header)) == connection.header
