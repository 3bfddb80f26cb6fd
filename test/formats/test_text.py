# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the text formats that are read back, yaml and json, have in common."""

from __future__ import annotations

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.classes import installed_definition, message_class
from cassandra_ros.messages.formats.table import format_class


def makeFormat(name, msg_type):
    definition = installed_definition(msg_type)
    return format_class(name)(definition.type, definition.md5sum, definition)


@pytest.mark.parametrize(
    ("name", "texts"),
    [("json", (b"%s", b'{"data":"%s"}')), ("yaml", (b"%s", b"data: %s", b'data: "%s"'))],
    ids=["json", "yaml"],
)
@settings(deadline=None)
@given(text=st.binary(max_size=40))
def test_any_bytes_are_read_or_corrupt(name, texts, text):
    storage = makeFormat(name, "std_msgs/String")
    for column in texts:
        try:
            storage.decode_wire((column % text,), None)
        except CorruptMessage:
            pass


@pytest.mark.parametrize(
    ("name", "size", "exact"),
    [
        ("json", 48_000, True),
        ("json", 49_200, False),
        ("json", 65_536, False),
        ("json", 1 << 20, False),
        ("yaml", 21_000, True),
        ("yaml", 22_000, False),
        ("yaml", 400_000, False),
    ],
)
def test_texts_are_never_over_64_kib(name, size, exact):
    storage = makeFormat(name, "std_msgs/UInt8MultiArray")
    encoded = storage.encode(message_class(storage.definition)(data=bytes(size)))
    assert len(encoded.columns[0]) <= 65536
    assert encoded.odd is not exact
    if not exact:
        words = f"<array type: uint8, length: {size}>"
        assert yaml.safe_load(encoded.columns[0])["data"] == words
        with pytest.raises(CorruptMessage, match="UInt8MultiArray"):
            storage.decode_wire(encoded.columns, None)


@pytest.mark.parametrize("name", ["json", "yaml", "string"])
def test_a_text_of_64_kib_is_kept_and_one_byte_more_is_not(name):
    storage = makeFormat(name, "std_msgs/String")
    message = message_class(storage.definition)
    around = len(storage.encode(message(data="x")).columns[0]) - 1
    for length, fits in ((65536 - around, True), (65537 - around, False)):
        encoded = storage.encode(message(data="x" * length))
        assert (b"x" * length in encoded.columns[0]) is fits
        assert len(encoded.columns[0]) <= 65536
        assert storage.decode(encoded).data == "x" * length
