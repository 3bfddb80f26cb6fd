# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
from __future__ import annotations

import itertools
import math
import struct
from functools import partial

import genpy
import pytest
import yaml
from formats.storages import check_kept_beside, check_refused, storage_of
from hypothesis import given, settings
from hypothesis import strategies as st
from messages.random_wire import SEPARATOR, WireMaker, installedTypes
from suites import search

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.classes import message_class, serialize
from cassandra_ros.messages.definition import attribute_name, parse_definition
from cassandra_ros.messages.formats.yaml import CassandraTopic_yaml

yaml_format = partial(storage_of, CassandraTopic_yaml)


class Loader(yaml.SafeLoader):
    nan_value = float("nan")  # rostopic's has the sign that the processor gives it


def checkPublished(msg_type, seed):
    """The message that `rostopic pub -f` would send of the text is the message."""
    storage = yaml_format(msg_type)
    specs = storage.definition.specs.values()
    if any(attribute_name(f.name) != f.name for spec in specs for f in spec.fields):
        return  # rostopic knows such fields by another name only
    wire = WireMaker(storage.definition, seed, signalling=False).make()
    encoded = storage.encode_wire(wire)
    if b"<array type" in encoded.columns[0]:
        return
    assert not encoded.odd
    message = message_class(storage.definition)()
    genpy.message.fill_message_args(message, [Loader(encoded.columns[0]).get_single_data()])
    assert serialize(message) == wire


@pytest.mark.suite("all", "it writes each installed type")
def test_rostopic_publishes_every_installed_type():
    for seed, msg_type in enumerate(installedTypes()):
        checkPublished(msg_type, seed)


@settings(deadline=None)
@given(msg_type=st.sampled_from(installedTypes()), seed=st.integers(0, 2**32))
def test_rostopic_publishes_installed_types(msg_type, seed):
    checkPublished(msg_type, seed)


def test_the_text_is_block_style_with_numbers_in_one_line():
    storage = yaml_format(
        parse_definition(
            "p/T",
            "time t\nfloat64[] f\nuint8[3] b\nstring[] s\nE[] a\nE on\nint8[] n\nbool y\nE[] z"
            + SEPARATOR
            + "MSG: p/E\nstring x",
        )
    )
    wire = b"".join(
        [
            struct.pack("<II", 7, 8),
            struct.pack("<I6d", 6, 1e20, -0.0, math.inf, -math.inf, 1e-7, 2),
            b"\0\1\2",
            struct.pack("<II", 2, 3) + b"yes" + struct.pack("<I", 0),
            struct.pack("<II", 1, 4) + "Zoë".encode(),
            struct.pack("<I", 3) + b"1e5",
            struct.pack("<I", 0) + b"\1" + struct.pack("<I", 0),
        ]
    )
    (text,), odd, raw = storage.encode_wire(wire)
    assert (odd, raw) == (False, None)
    assert text.decode() == (
        "t:\n  secs: 7\n  nsecs: 8\n"
        "f: [1.0e+20, -0.0, .inf, -.inf, 1.0e-07, 2.0]\n"
        "b: [0, 1, 2]\n"
        "s:\n- 'yes'\n- ''\n"
        "a:\n- x: Zoë\n"
        "'on':\n  x: 1e5\n"
        "n: []\ny: true\nz: []\n"
    )
    assert storage.decode_wire((text,), None) == wire


@pytest.mark.parametrize(
    ("text", "wire"),
    [
        ("string x", b"\1\0\0\0\xff"),
        ("string x", b"\1\0\0\0a surplus"),
        ("bool x", b"\2"),
        ("time x", struct.pack("<II", 1, 10**9)),
        ("duration x", struct.pack("<ii", 1, -1)),
        ("float32 x", struct.pack("<I", 0x7F800001)),
        ("float64 x", struct.pack("<Q", 0xFFF8 << 48)),
        ("float64[] x", struct.pack("<IQ", 1, 0x7FF8 << 48 | 5)),
    ],
)
def test_what_the_text_cannot_say_is_kept_beside_it(text, wire):
    check_kept_beside(CassandraTopic_yaml, text, wire)


def test_pythons_nan_is_exact():
    storage = yaml_format("std_msgs/Float64")
    wire = struct.pack("<Q", 0x7FF8 << 48)
    assert storage.encode_wire(wire) == ((b"data: .nan\n",), False, None)
    assert storage.decode_wire((b"data: .nan\n",), None) == wire


@settings(deadline=None)
@given(
    text=st.text(st.characters(codec="utf-8"), max_size=200)
    | st.text("-?:,[]{}#&*!|>'\"%@`~ \n\t\r\x85\u2028\ufeff.0123456789xobeE_=<yYnNofu", max_size=9)
)
def test_strings_are_exact_or_kept(text):
    storage = yaml_format("std_msgs/String")
    wire = serialize(message_class(storage.definition)(data=text))
    columns, odd, raw = storage.encode_wire(wire)
    assert raw == (wire if odd else None)
    if not odd:
        assert storage.decode_wire(columns, None) == wire


BOMB = "a0: &a0 [x]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 40))
MERGES = "m0: &m0 {x: 1}\n" + "".join(
    f"m{i}: &m{i} {{<<: [*m{i - 1}, *m{i - 1}]}}\n" for i in range(1, 40)
)
HOSTILE = [
    "",
    "[]",
    "a",
    BOMB,
    MERGES,
    "layout: {dim: &d [], data_offset: 0}\ndata: *d",
    "[" * 65000,
    "{a: " * 16000,
    "- " * 32000,
    "? " * 32000,
    "!!python/object/apply:os.system [ls]",
    "!!timestamp x",
    "!!int ''",
    "!!float x",
    "!!bool x",
    "layout: {dim: [], data_offset: 0}\ndata: [" + ":".join("1" * 20000) + ".0]",
    "layout: {dim: [], data_offset: 0}\ndata: [" + "1" * 5000 + "]",
    "layout: {dim: [], data_offset: 0}\ndata: [true]",
    "layout: {dim: [], data_offset: 0}\ndata: [nan]",
    "layout: {dim: [], data_offset: 0}\ndata: [2001-01-01]",
    "layout: {dim: [], data_offset: 0}\ndata: !!set {}",
    "layout: {dim: [], data_offset: 4294967296}\ndata: []",
    "layout: {dim: [], data_offset: 0}\ndata: []\nmore: 1",
    "layout: {dim: [], data_offset: 0}",
    "layout: {dim: [], data_offset: 0}\ndata: []\n---\n",
    "? [a]\n: 1",
    "\0",
    "layout: {dim: [], data_offset: 0}\ndata: []" + "\n" * 65536,
]


@pytest.mark.parametrize("text", HOSTILE, ids=range(len(HOSTILE)))
def test_texts_that_are_no_message(text):
    check_refused(CassandraTopic_yaml, text)


def test_texts_of_people_are_read():
    storage = yaml_format("std_msgs/UInt8MultiArray")
    text = "# mine\ndata: !!binary AAEC\nlayout:\n  data_offset: 0x10\n  dim: []\n"
    assert storage.decode_wire((text.encode(),), None) == bytes(4) + struct.pack(
        "<II3s", 16, 3, b"\0\1\2"
    )


STRINGS = [
    *"- ? : -x ?x :x a: a:b a :b #x a# --- ---x ... ...x ' '' 'a' it's \" ~ = << ! !x &x".split(),
    *"| > % @ ` yes No null y n true 1 1.0 1e5 1.0e+20 -1 .5 .nan .inf -.inf +.inf 0x10".split(),
    *"*x 0b1 010 1_000 1:30 2001-01-01 [1.0] {} [] {a:1} a,b [ ] { } f:[1] \\ \\n".split(),
    *"nan inf None".split(),
    *("", " ", " a", "a ", "a  b", "a #b", "a: b", "- a", "? a", ": a", "f: [1.0, 2.0]", "a:\n- b"),
    *("\n", "a\nb", "a\n\nb\n", "\ta", "a\tb", "a\rb", "\0", "\x7f", "\x85", "a\u2028b", "\ufeff"),
    *("Zoë", "𝄞", "'x:", "a\n  x: b", "x: a", "x:\n  x: 'a'", "<array type: uint8, length: 9>"),
]
ALPHABET = "-?: #&*!|>'\"%@`~=<,[]{}.0_aeny\n\té"
NAMES = ["a", "y", "n", "on", "no", "null", "true", "x", "Off", "time_x", "a" * 128]

floats = st.floats(allow_nan=False) | st.sampled_from([math.inf, -math.inf, float("nan")])
integers = st.integers(-(2**63), 2**64 - 1)
strings = st.sampled_from(STRINGS) | st.text(ALPHABET, max_size=6) | st.text(max_size=20)
leaves = (
    *(floats, integers, st.booleans(), strings, st.binary(max_size=5)),
    *(st.lists(one, max_size=4) for one in (floats, integers, st.booleans(), strings)),
)


def mappings(inner):
    return st.dictionaries(st.sampled_from(NAMES), inner, max_size=4)


trees = mappings(
    st.recursive(
        st.one_of(*leaves),
        lambda inner: mappings(inner) | st.lists(mappings(inner), max_size=3),
        max_leaves=20,
    )
)


def exactly(value):
    """Distinguishes -0.0 from 0.0, true from 1, and the signs of NaNs."""
    if isinstance(value, dict):
        return [(exactly(name), exactly(inner)) for name, inner in value.items()]
    if isinstance(value, (list, bytes)):
        return [exactly(inner) for inner in value]
    sign = math.copysign(1, value) if isinstance(value, float) else None
    return type(value), repr(value), sign


def checkTree(tree):
    """A text says its tree, and what is taken for faithful says it to the bit."""
    storage = yaml_format("std_msgs/Empty")
    text = storage.print_tree(tree)
    said = storage.parse(text)
    assert exactly(said) == exactly(storage.parse_own(text))
    if storage.is_faithful(text):
        assert exactly(said) == exactly(tree)
    return said, text


@pytest.mark.suite("all", "a search over random trees")
@search(600)
@given(tree=trees)
def test_random_trees_are_read_as_they_were_written(tree):
    checkTree(tree)


@pytest.mark.parametrize("text", STRINGS)
def test_hostile_strings_are_read_as_they_were_written(text):
    for tree in ({"a": text}, {"a": {"b": [{"a": text}, {"b": [text]}], "c": text}, "d": [1.0]}):
        said, _ = checkTree(tree)
        assert said == tree


def test_short_strings_are_read_as_they_were_written():
    texts = ["".join(text) for n in (1, 2) for text in itertools.product(ALPHABET, repeat=n)]
    assert checkTree({"a": texts})[0] == {"a": texts}
    for text in texts:
        checkTree({"a": text})


@pytest.mark.parametrize("length", [128, 129, 255])
def test_long_names_are_no_simple_keys(length):
    said, text = checkTree({"a" * length: {"x": True}})
    assert said == {"a" * length: {"x": True}}
    assert text.startswith("? ") is (length > 128)


@pytest.mark.parametrize("kind", ["[{}]", "- {}", "? {}", "{{a: {}}}", "[a: {}]"])
@pytest.mark.parametrize(("depth", "refused"), [(60, False), (300, True), (5000, True)])
def test_texts_too_deep_are_not_composed(kind, depth, refused):
    before, after = kind.format("\0").split("\0")
    storage = CassandraTopic_yaml("p/T", "", parse_definition("p/T", "string s"))
    text = "s: x\nz:\n " + before * depth + "1" + after * depth
    with pytest.raises(CorruptMessage) as caught:
        storage.decode_wire((text.encode(),), None)
    assert ("nested deeper" in str(caught.value)) is refused
