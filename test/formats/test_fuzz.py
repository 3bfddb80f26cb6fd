# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Broken buffers and broken columns: exactly stored, or CorruptMessage, in bounded memory."""

from __future__ import annotations

import contextlib
import tracemalloc
from functools import lru_cache

import pytest
from hypothesis import given
from hypothesis import strategies as st
from messages.random_wire import DefinitionMaker, WireMaker, fuzzed, installedTypes
from suites import search

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.classes import installed_definition, message_class
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.messages.formats.table import format_class
from cassandra_ros.messages.wire.field_ends import MAX_SURPLUS, compile_object_check
from cassandra_ros.metadata import FORMAT_NAMES

SEEDS = st.integers(0, 2**32)
every_format = pytest.mark.parametrize("name", FORMAT_NAMES)

# What a message object of one byte, in a list, may take, and text about it.
BYTES_A_BYTE = 1500
BYTES_ALWAYS = 4 << 20
BYTES_AN_OBJECT = 100


@contextlib.contextmanager
def bounded(definition, size):
    """Fail where much more memory is taken than the bytes of a message explain."""
    limit = BYTES_ALWAYS + size * BYTES_A_BYTE
    if compile_object_check(definition.type, definition.specs) is not None:
        limit += MAX_SURPLUS * BYTES_AN_OBJECT  # arrays of empty messages
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < limit, definition.type
    finally:
        tracemalloc.stop()


TYPES = installedTypes()


def broken(test):
    """Run a test with every format, and any type, message and damage."""
    numbers = st.integers(0, len(TYPES) + 50)
    test = given(number=numbers, seed=SEEDS, fuzz=SEEDS)(test)
    return every_format(search(500)(test))


@lru_cache(maxsize=None)
def storageOf(name, number):
    """A storage of an installed type, or from their number on of a random one."""
    if number < len(TYPES):
        definition = installed_definition(TYPES[number])
    else:
        definition = parse_definition(*DefinitionMaker(number).make())
    message_class(definition)
    return format_class(name)(definition.type, definition.md5sum, definition)


def makeWire(storage, seed):
    return WireMaker(storage.definition, seed, odd=bool(seed % 2)).make()


@pytest.mark.suite("all", "a search over broken messages")
@broken
def test_broken_buffers_are_stored_exactly(name, number, seed, fuzz):
    storage = storageOf(name, number)
    wire = makeWire(storage, seed)
    damaged = fuzzed(wire, fuzz)
    with bounded(storage.definition, len(wire) + len(damaged)):
        encoded = storage.encode_wire(damaged)
        assert storage.decode_wire(encoded.columns, encoded.raw) == damaged
        try:
            message = storage.decode(encoded)
        except CorruptMessage:
            return
        assert type(message) is message_class(storage.definition)


@pytest.mark.suite("all", "a search over broken messages")
@broken
def test_broken_columns_are_bytes_or_corrupt(name, number, seed, fuzz):
    storage = storageOf(name, number)
    wire = makeWire(storage, seed)
    columns = list(storage.encode_wire(wire).columns)
    if not columns:
        return
    which = fuzz % len(columns)
    columns[which] = fuzzed(columns[which] or b"", fuzz)
    with bounded(storage.definition, sum(len(column or b"") for column in columns)):
        try:
            assert type(storage.decode_wire(columns, None)) is bytes
        except CorruptMessage:
            pass
