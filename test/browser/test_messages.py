# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Messages are read in the browser as genpy reads them, whatever their type is."""

from __future__ import annotations

import base64
import math
import struct

import genpy
import pytest
from hypothesis import given
from hypothesis import settings as examples
from hypothesis import strategies as st
from messages.random_wire import DefinitionMaker, WireMaker, installedTypes

from cassandra_ros.errors import DefinitionError
from cassandra_ros.messages.classes import deserialize, installed_definition, message_class
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.viewing.message_frames import describe_schema

# Each message as the list of its numbers (the bits of a double) and texts.
READ = """
const [schema, wires] = arguments;
const bits = new DataView(new ArrayBuffer(8));
const exact = BigInt(Number.MAX_SAFE_INTEGER);
function leaves(value) {
  if (typeof value === "string") return [value];
  if (typeof value === "bigint" && (value > exact || value < -exact)) return [String(value)];
  if (["number", "bigint", "boolean"].includes(typeof value)) {
    const number = Number(value);
    if (Number.isNaN(number)) return ["nan"];
    bits.setFloat64(0, number);
    return [bits.getBigUint64(0).toString(16)];
  }
  const parts = Object.values(value).flatMap(leaves);
  return ArrayBuffer.isView(value) || Array.isArray(value) ? [`#${value.length}`, ...parts] : parts;
}
return import("/modules/messages.js").then(({ reader }) => {
  const read = reader(schema);
  return wires.map((wire) => {
    try {
      return leaves(read(Uint8Array.from(atob(wire), (each) => each.charCodeAt(0))));
    } catch (error) {
      return error.name;
    }
  });
});
"""
EXACT = 2**53 - 1


def leaves(value):
    if isinstance(value, str):
        return [value]
    if isinstance(value, (int, float)):
        if isinstance(value, int) and abs(value) > EXACT:
            return [str(value)]
        if math.isnan(value):
            return ["nan"]
        return [f"{int.from_bytes(struct.pack('>d', float(value)), 'big'):x}"]
    if isinstance(value, genpy.rostime.TVal):
        return [*leaves(value.secs), *leaves(value.nsecs)]
    if isinstance(value, genpy.Message):
        return [leaf for name in value.__slots__ for leaf in leaves(getattr(value, name))]
    return [f"#{len(value)}", *(leaf for each in value for leaf in leaves(each))]


@pytest.fixture(scope="module")
def read(window, viewer):
    window.driver.get(viewer.at("/index.html"))

    def read(definition, wires):
        texts = [base64.b64encode(wire).decode() for wire in wires]
        return window.run(READ, describe_schema(definition), texts)

    return read


def check(read, definition, seed):
    makers = [WireMaker(definition, seed + number) for number in range(4)]
    wires = [maker.make() for maker in makers]
    cls = message_class(definition)
    assert read(definition, wires) == [leaves(deserialize(cls, wire)) for wire in wires]
    # What is cut short, or goes on, is not a message.
    cut = [wire[:-1] for wire in wires if wire]
    longer = [wire + b"\0" for wire in wires]
    assert set(read(definition, [*cut, *longer])) == {"RangeError"}


@given(st.integers(0, 2**32))
@examples(max_examples=20)
def test_random_types(read, seed):
    check(read, parse_definition(*DefinitionMaker(seed).make()), seed)


@given(st.sampled_from(installedTypes()), st.integers(0, 2**32))
@examples(max_examples=20)
def test_installed_types(read, msg_type, seed):
    try:
        definition = installed_definition(msg_type)
    except DefinitionError:
        return
    check(read, definition, seed)


def test_claims_of_a_length_are_not_believed(read):
    empties = parse_definition("p/A", "p/E[] all\n" + "=" * 80 + "\nMSG: p/E\n")
    numbers = parse_definition("p/A", "float64[] all\n")
    most = struct.pack("<I", 2**32 - 1)
    assert read(empties, [most]) == ["RangeError"]
    assert read(numbers, [most]) == ["RangeError"]
    assert read(empties, [struct.pack("<I", 2)]) == [["#2"]]
    three = parse_definition("p/A", "p/E[3] all\n" + "=" * 80 + "\nMSG: p/E\n")
    assert read(three, [b""]) == [["#3"]]
    line = "=" * 80 + "\n"
    nested = f"p/B[400] all\n{line}MSG: p/B\np/E[400] all\n{line}MSG: p/E\n"
    assert read(parse_definition("p/A", nested), [b""]) == ["RangeError"]
