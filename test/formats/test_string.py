# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
from __future__ import annotations

import pytest
from messages.random_wire import WireMaker, installedTypes

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.classes import (
    deserialize,
    installed_definition,
    message_class,
    serialize,
)
from cassandra_ros.messages.formats.string import CassandraTopic_string


def stringFormat(msg_type):
    definition = installed_definition(msg_type)
    return CassandraTopic_string(definition.type, definition.md5sum, definition)


def test_the_text_is_what_rostopic_echo_prints():
    for seed, msg_type in enumerate(installedTypes()):
        storage = stringFormat(msg_type)
        wire = WireMaker(storage.definition, seed, signalling=False).make()
        (text,), odd, raw = storage.encode_wire(wire)
        assert (odd, raw) == (False, wire)
        expected = str(deserialize(message_class(storage.definition), wire)).encode()
        if len(wire) < 8192:
            assert text == expected
        else:
            assert text == expected or b"<array type" in text


def test_the_text_is_never_read():
    storage = stringFormat("std_msgs/String")
    wire = serialize(message_class(storage.definition)(data="a"))
    text = storage.encode_wire(wire).columns[0]
    assert text == b'data: "a"'
    assert storage.decode_wire((b"data: b",), wire) == wire
    with pytest.raises(CorruptMessage, match="std_msgs/String.*string"):
        storage.decode_wire((text,), None)


def test_what_is_no_message_has_no_text():
    storage = stringFormat("std_msgs/String")
    assert storage.encode_wire(b"\5\0\0\0ab") == ((None,), True, b"\5\0\0\0ab")


def test_what_is_shown_of_odd_messages():
    storage = stringFormat("std_msgs/String")
    assert storage.encode_wire(b"\2\0\0\0\xffa++").columns == (b'data: "\\uFFFDa"',)
    storage = stringFormat("std_msgs/Time")
    wire = b"\1\0\0\0\xff\xff\xff\xff"
    assert storage.encode_wire(wire).columns == (b"data: \n  secs: 1\n  nsecs: 4294967295",)


def test_large_messages_are_shortened_to_rostopics_words():
    storage = stringFormat("sensor_msgs/Image")
    message = message_class(storage.definition)(height=480, encoding="rgb8", data=bytes(921_600))
    text = storage.encode(message).columns[0].decode()
    assert "height: 480\n" in text
    assert text.endswith('\ndata: "<array type: uint8, length: 921600>"')
