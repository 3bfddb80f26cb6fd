# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What every format must do: a new one is tested by its line in the table."""

from __future__ import annotations

import importlib
import inspect
import json
import pkgutil
import re
from collections import Counter

import pytest
import rosbag
from compiled import packed_by_rosbag
from hypothesis import given, settings
from hypothesis import strategies as st
from messages.random_wire import DefinitionMaker, WireMaker, installedTypes
from suites import FEW_FORMATS, sparing

import cassandra_ros.messages.formats
from cassandra_ros.errors import CorruptMessage, DefinitionError, UnknownFormat
from cassandra_ros.messages.classes import (
    deserialize,
    installed_definition,
    message_class,
    serialize,
)
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.messages.formats.cassandra_topic_ import CassandraTopic_
from cassandra_ros.messages.formats.table import format_class
from cassandra_ros.metadata import DEFAULT_FORMAT, FORMAT_NAMES

SEEDS = st.integers(0, 2**32)
every_format = pytest.mark.parametrize("name", FORMAT_NAMES)

# CQL types that a column may have, also in a frozen list, and their bytes where always the same.
SCALARS = "blob text boolean tinyint smallint int bigint varint float double".split()
SIZES = {"boolean": 1, "tinyint": 1, "smallint": 2, "int": 4, "bigint": 8, "float": 4, "double": 8}


def makeFormat(name, definition):
    return format_class(name)(definition.type, definition.md5sum, definition)


def checkWire(storage, wire):
    """Bytes that go in come out, by the columns and raw bytes that a row would hold."""
    columns, odd, raw = storage.encode_wire(wire)
    types = list(storage.getColValidationClasses().values())
    assert len(columns) == len(types)
    assert odd or None not in columns
    if None in columns:
        assert raw == wire
    for column, cql_type in zip(columns, types):
        checkColumn(column, cql_type)
    assert raw in (None, wire)
    assert storage.decode_wire(columns, raw) == wire
    assert storage.decode_wire([None] * len(columns), wire) == wire
    return odd


def checkColumn(column, cql_type):
    if column is None:
        return
    assert type(column) is bytes
    assert len(column) == SIZES.get(cql_type, len(column))
    if cql_type == "text":
        column.decode()
    if cql_type.startswith("frozen<list<"):
        inner, at = cql_type[12:-2], 4
        for _ in range(int.from_bytes(column[:4], "big")):
            size = int.from_bytes(column[at : at + 4], "big")
            checkColumn(column[at + 4 : at + 4 + size], inner)
            at += 4 + size
        assert at == len(column)


def test_every_format_of_the_folder_is_in_the_table():
    classes = set()
    for module in pkgutil.iter_modules(
        cassandra_ros.messages.formats.__path__, "cassandra_ros.messages.formats."
    ):
        for _, found in inspect.getmembers(importlib.import_module(module.name), inspect.isclass):
            if issubclass(found, CassandraTopic_) and not inspect.isabstract(found):
                classes.add(found)
    assert {format_class(name) for name in FORMAT_NAMES} == classes
    assert len(classes) >= 2
    assert DEFAULT_FORMAT in FORMAT_NAMES


def test_unknown_format_names_those_that_are():
    with pytest.raises(UnknownFormat, match=", ".join(FORMAT_NAMES)):
        format_class("xml")


@every_format
def test_a_format_is_one_class_in_a_file_of_its_name(name):
    found = format_class(name)
    assert found.NAME == name
    assert found.__name__ == f"CassandraTopic_{name}"
    assert found.__module__ == f"cassandra_ros.messages.formats.{name}"
    assert found.__doc__


@every_format
def test_columns_are_named_typed_and_described(name):
    for msg_type in installedTypes():
        storage = makeFormat(name, installed_definition(msg_type))
        columns = storage.getColValidationClasses()
        for column, cql_type in columns.items():
            assert re.fullmatch(r"_data|[A-Za-z][A-Za-z0-9_.]*", column)
            inner = re.sub(r"^frozen<list<(.*)>>$", r"\1", cql_type)
            assert inner in SCALARS
        description = storage.describe()
        assert json.loads(json.dumps(description)) == description
        if description:
            assert [(d["name"], d["cql"]) for d in description if d["cql"]] == list(columns.items())


@every_format
def test_every_installed_type_is_exact(name):
    for number, msg_type in enumerate(installedTypes()):
        definition = installed_definition(msg_type)
        storage = makeFormat(name, definition)
        for seed in range(number, number + 4):
            checkWire(storage, WireMaker(definition, seed).make())
            checkWire(storage, WireMaker(definition, seed, odd=True).make())


@pytest.mark.suite("all", "a search over broken messages")
@every_format
@settings(deadline=None)
@given(data=st.data(), msg_type=st.sampled_from(installedTypes()), seed=SEEDS)
def test_changed_columns_are_read_or_corrupt(name, data, msg_type, seed):
    definition = installed_definition(msg_type)
    storage = makeFormat(name, definition)
    columns = list(storage.encode_wire(WireMaker(definition, seed).make()).columns)
    held = [i for i, column in enumerate(columns) if column]
    if not held:
        return
    i = data.draw(st.sampled_from(held))
    at = data.draw(st.integers(0, len(columns[i]) - 1))
    instead = data.draw(st.binary(max_size=3))
    columns[i] = columns[i][:at] + instead + columns[i][at + data.draw(st.integers(0, 9)) :]
    try:
        assert type(storage.decode_wire(columns, None)) is bytes
    except CorruptMessage as exc:
        assert msg_type in str(exc)


@every_format
def test_without_a_definition_there_is_binary(name):
    if name == "binary":
        format_class(name)("pkg/T", "53a14e6c", None)
    else:
        with pytest.raises(DefinitionError, match=f"{name}.*pkg/T.*use binary"):
            format_class(name)("pkg/T", "53a14e6c", None)


@every_format
@settings(deadline=None)
@given(seed=SEEDS, cut=st.integers(0, 500), surplus=st.binary(max_size=5))
def test_random_types_and_broken_messages_are_exact(name, seed, cut, surplus):
    definition = parse_definition(*DefinitionMaker(seed).make())
    storage = makeFormat(name, definition)
    wire = WireMaker(definition, seed, odd=True).make()
    checkWire(storage, wire)
    checkWire(storage, wire[:cut] + surplus)


@every_format
def test_message_objects_go_in_and_come_out(name):
    for msg_type in installedTypes():
        definition = installed_definition(msg_type)
        storage = makeFormat(name, definition)
        storage.require_class()
        cls = message_class(definition)
        message = deserialize(cls, WireMaker(definition, 3, signalling=False).make())
        again = storage.decode(storage.encode(message))
        assert type(again) is cls
        assert serialize(again) == serialize(message)


@pytest.mark.suite("test", "promise 1, on real bags")
@pytest.mark.parametrize("name", sparing(FORMAT_NAMES, kept=FEW_FORMATS))
def test_messages_of_the_bags_are_exact(name, bags):
    large = Counter()
    for path in sorted(bags.glob("*.bag")):
        if path.name == "truncated_header_only.bag":
            continue
        if "lz4" in path.name and "lz4" not in packed_by_rosbag():
            continue
        with rosbag.Bag(str(path)) as bag:
            storages = {}
            for info in bag._get_connections():
                try:
                    definition = parse_definition(info.datatype, info.msg_def, info.md5sum)
                except DefinitionError:
                    assert path.name == "empty_message_definition.bag"
                    continue
                storages[info.datatype] = makeFormat(name, definition)
            for number, (_, raw, _) in enumerate(bag.read_messages(raw=True)):
                if raw[0] in storages and (number < 50 or number % 50 == 0):
                    large[raw[0]] += len(raw[1]) > 4096
                    if name == "yaml" and large[raw[0]] > 5:
                        continue  # a tenth of a second each
                    odd = checkWire(storages[raw[0]], raw[1])
                    if odd and name in ("yaml", "json"):
                        text = storages[raw[0]].encode_wire(raw[1]).columns[0]
                        assert re.search(b"<array type|null|[.]nan", text)
                    elif odd:
                        assert len(raw[1]) > 512 * 1024


@every_format
def test_large_messages_are_exact(name):
    definition = installed_definition("std_msgs/UInt8MultiArray")
    message = message_class(definition)(data=b"x" * (3 << 20))
    message.layout.data_offset = 7
    checkWire(makeFormat(name, definition), serialize(message))


@every_format
def test_rows_without_their_values_are_corrupt(name):
    storage = makeFormat(name, installed_definition("std_msgs/Header"))
    with pytest.raises(CorruptMessage, match="std_msgs/Header"):
        storage.decode_wire([None] * len(storage.getColValidationClasses()), None)
