# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The values of columns are those that the message object has."""

from __future__ import annotations

from functools import reduce

import pytest
from messages.random_wire import SEPARATOR, WireMaker, installedTypes

from cassandra_ros.messages.classes import (
    deserialize,
    installed_definition,
    message_class,
    serialize,
)
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.messages.wire.wire_plan import WirePlan, wire_plan


def attribute(message, path):
    return reduce(
        lambda value, name: getattr(value, name, getattr(value, name + "_", 0)), path, message
    )


def plain(value):
    """A value as a plan gives it."""
    if hasattr(value, "to_nsec"):
        return value.to_nsec()
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if hasattr(value, "_slot_types"):
        return {name: plain(getattr(value, name)) for name in value.__slots__}
    return value


@pytest.mark.parametrize("name", installedTypes())
def test_values_are_those_of_the_message(name):
    definition = installed_definition(name)
    plan = wire_plan(definition)
    read = plan.reader([c.name for c in plan.all_columns])
    for seed in range(4):
        wire = WireMaker(definition, seed, signalling=False).make()
        message = deserialize(message_class(definition), wire)
        for column, value in zip(plan.all_columns, read(wire)):
            if column.array:
                inner = column.name[len(column.array) + 1 :].split(".")
                elements = attribute(message, column.array.split("."))
                expected = [plain(attribute(element, inner)) for element in elements]
            else:
                expected = plain(attribute(message, column.name.split(".")))
            if column.field_type.endswith("Empty[]"):
                expected = len(expected)
            assert repr(value) == repr(expected), column


def test_arrays_in_arrays():
    inner = "MSG: pkg/E\nstring[] s\nP[] p\nint16[2] i\ntime[] t\nN[] n\nP[1] one"
    text = SEPARATOR.join(["E[] e", inner, "MSG: pkg/P\nuint8 x\nbool[] b", "MSG: pkg/N"])
    definition = parse_definition("pkg/T", text)
    cls = message_class(definition)
    messages = (deserialize(cls, WireMaker(definition, seed).make()) for seed in range(99))
    message = next(m for m in messages if any(element.p and element.n for element in m.e))
    plan = WirePlan(definition)
    names = ["e.s", "e.p", "e.i", "e.t", "e.n", "e.one"]
    values = plan.reader(names)(serialize(message))
    assert values == [
        [element.s for element in message.e],
        [[{"x": p.x, "b": p.b} for p in element.p] for element in message.e],
        [list(element.i) for element in message.e],
        [plain(element.t) for element in message.e],
        [len(element.n) for element in message.e],
        [[{"x": p.x, "b": p.b} for p in element.one] for element in message.e],
    ]
    assert plan.reader(names[::-1])(serialize(message)) == values[::-1]
    cut = plan.cutter(names)(serialize(message))
    assert plan.cutter(names[::-1])(serialize(message)) == cut[::-1]
