# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the text formats that are read back, yaml and json, have in common."""

from __future__ import annotations

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from suites import sparing

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.classes import installed_definition, message_class
from cassandra_ros.messages.formats.table import format_class
from cassandra_ros.messages.formats.text_column import MAX_COLUMN_BYTES, ParsedFormat
from cassandra_ros.metadata import FORMAT_NAMES

PARSED = [name for name in FORMAT_NAMES if issubclass(format_class(name), ParsedFormat)]
CHARACTERS = {
    "ASCII": "x",
    "two bytes": "é",
    "three bytes": "€",
    "four bytes": "\U0001f600",
    "double quotes": '"',
    "single quotes": "'",
    "backslashes": "\\",
    "line breaks": "\n",
    "unprintable": "\x07",
}


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


@pytest.mark.parametrize("character", CHARACTERS.values(), ids=CHARACTERS)
@pytest.mark.parametrize("name", PARSED)
def test_the_limit_counts_the_bytes_of_a_text(name, character):
    """Not its characters, and not those of the message: quotes and others are escaped."""
    storage = makeFormat(name, "std_msgs/String")
    message = message_class(storage.definition)

    def is_whole(count):
        (text,) = storage.encode(message(data=character * count)).columns
        assert len(text) <= MAX_COLUMN_BYTES
        return b"<string length: %d>" % count not in text

    most, more = 1, MAX_COLUMN_BYTES
    while more - most > 1:
        middle = (most + more) // 2
        most, more = (middle, more) if is_whole(middle) else (most, middle)
    encoded = storage.encode(message(data=character * most))
    # No escape is longer than that of a character of four bytes in YAML.
    assert MAX_COLUMN_BYTES - len("\\U0001F600") < len(encoded.columns[0])
    assert storage.decode(encoded).data == character * most
    shortened = storage.encode(message(data=character * more))
    assert shortened.raw is not None
    assert storage.decode(shortened).data == character * more


@pytest.mark.parametrize("kind", sparing(CHARACTERS, kept=["double quotes", "two bytes"]))
@pytest.mark.parametrize("name", FORMAT_NAMES)
def test_texts_of_any_characters_are_exact_around_64_kib(name, kind):
    character = CHARACTERS[kind]
    storage = makeFormat(name, "std_msgs/String")
    message = message_class(storage.definition)
    for count in (MAX_COLUMN_BYTES // len(character.encode()) - 5, 40_000):
        encoded = storage.encode(message(data=character * count))
        assert storage.decode(encoded).data == character * count
