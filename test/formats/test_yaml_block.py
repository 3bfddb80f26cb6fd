# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is written and read without PyYAML is what PyYAML writes and reads."""

from __future__ import annotations

import itertools
import math

import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st
from messages.random_wire import DefinitionMaker, WireMaker, installedTypes

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.formats.yaml import MAX_DEPTH, CassandraTopic_yaml, _most_depth
from cassandra_ros.formats.yaml_block import printBlock, readBlock
from cassandra_ros.messages.classes import installedDefinition
from cassandra_ros.messages.definition import parseDefinition
from cassandra_ros.messages.tree.read import Budget, treeReader


class Dumper(yaml.CSafeDumper):
    def ignore_aliases(self, data):
        return True


def sequence(dumper, values):
    flow = not values or not isinstance(values[0], (dict, str))
    return dumper.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=flow)


Dumper.add_representer(list, sequence)
Dumper.add_representer(bytes, sequence)


class Loader(yaml.CSafeLoader):
    nan_value = float("nan")


def dumped(tree):
    return yaml.dump(tree, Dumper=Dumper, sort_keys=False, allow_unicode=True, width=1 << 30)


def loaded(text):
    return Loader(text).get_single_data()


def exactly(value):
    """Distinguishes -0.0 from 0.0, true from 1, and the signs of NaNs."""
    if isinstance(value, dict):
        return [(exactly(name), exactly(inner)) for name, inner in value.items()]
    if isinstance(value, list):
        return [exactly(inner) for inner in value]
    sign = math.copysign(1, value) if isinstance(value, float) else None
    return type(value), repr(value), sign


def checkText(text):
    """Whoever reads a text, it says the same."""
    try:
        tree = readBlock(text)
    except ValueError:
        return False
    assert exactly(tree) == exactly(loaded(text))
    assert depthOf(text) <= MAX_DEPTH
    return True


def depthOf(text):
    deepest = depth = 0
    for event in yaml.parse(text, Loader=yaml.CSafeLoader):
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        deepest = max(deepest, depth)
    return deepest


HOSTILE = [
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
strings = st.sampled_from(HOSTILE) | st.text(ALPHABET, max_size=6) | st.text(max_size=20)
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


@settings(deadline=None, max_examples=500)
@given(tree=trees)
def test_random_trees_are_written_and_read_alike(tree):
    text = printBlock(tree)
    assert text == dumped(tree)
    checkText(text)


def test_short_strings_are_written_and_read_alike():
    texts = ["".join(text) for n in (1, 2, 3) for text in itertools.product(ALPHABET, repeat=n)]
    tree = {"a": [text for text in [*HOSTILE, *texts] if text.isascii() and text.isprintable()]}
    text = printBlock(tree)
    assert text == dumped(tree)
    assert readBlock(text) == tree


@pytest.mark.parametrize("text", HOSTILE)
def test_hostile_strings_are_written_and_read_alike(text):
    for tree in ({"a": text}, {"a": {"b": [{"a": text}, {"b": [text]}], "c": text}, "d": [1.0]}):
        assert printBlock(tree) == dumped(tree)
        own = text.isascii() and text.isprintable()
        assert checkText(printBlock(tree)) is own


def checkType(definition, seed):
    wire = WireMaker(definition, seed).make()
    tree = treeReader(definition).read(wire, Budget(1 << 30, 1, 1 << 30, 1 << 30)).tree
    storage = CassandraTopic_yaml(definition.type, definition.md5sum, definition)
    text = storage.printTree(tree)
    assert text == dumped(tree)
    checkText(text)
    return text


def test_installed_types_are_written_and_read_alike():
    for seed, msg_type in enumerate(installedTypes()):
        checkType(installedDefinition(msg_type), seed)


@settings(deadline=None)
@given(seed=st.integers(0, 2**32))
def test_random_types_are_written_and_read_alike(seed):
    checkType(parseDefinition(*DefinitionMaker(seed).make()), seed)


@pytest.mark.parametrize("length", [128, 129, 255])
def test_long_names_are_written_as_pyyaml_does(length):
    name = "a" * length
    text = checkType(
        parseDefinition("p/T", f"p/E {name}" + "\n" + "=" * 80 + "\nMSG: p/E\nbool x"), 1
    )
    assert text.startswith("? ") is (length > 128)


PIECES = [
    *("a:", "b:", "a: ", "on:", "<<:", "y: ", "- ", "-", "? ", ": ", "\n", "\n", "\n  ", "\n    "),
    *("\n- ", "\n  - ", "\na: ", "\n  b: ", "[", "]", "{", "}", ", ", ",", "[]", "{}", "'", "''"),
    *("1", "-1", "1.5", "1e5", "1.0e+20", "01", "-0", "-0.0", ".nan", "-.nan", ".inf", "1" * 21),
    *(
        "true",
        "True",
        "null",
        "~",
        "nan",
        "NaN",
        "Infinity",
        "x",
        "x y",
        "#",
        " #",
        "&a",
        "*a",
        "!",
    ),
    *("\t", "\r", "\x85", "\u2028", "\ufeff", "\0", "é", '"', "\\", "|", ">", "---", "...", " "),
    *("[1, 2]", "[1.0, .nan]", "[1,2]", "[1, [2]]", "[1 , 2]", "[1, ]", "[true, -.inf]", "[x]"),
]


@settings(deadline=None, max_examples=1500)
@given(text=st.lists(st.sampled_from(PIECES), max_size=12).map("".join))
@example(text="- a: 1\n")
@example(text="on: 1\n")
@example(text="a:\n    b: 1\n  b: 1\n")
@example(text="a: x\n  y\n")
@example(text="a:\n  - 1\n")
@example(text="a:\nb: 1\n")
@example(text="a: 1\na: 2\n")
@example(text="a:\n- b: 1\n  a:\n  - x\n- b: 2\n")
def test_any_text_is_read_alike(text):
    for whole in (text, text + "\n", f"a: {text}\n", f"a:\n- b: {text}\nb: 1\n"):
        checkText(whole)


@settings(deadline=None, max_examples=500)
@given(tree=trees, data=st.data())
def test_changed_texts_are_read_alike(tree, data):
    text = printBlock(tree)
    at = data.draw(st.integers(0, len(text)))
    instead = data.draw(st.sampled_from([*PIECES, ""]))
    checkText(text[:at] + instead + text[at + data.draw(st.integers(0, 3)) :])


def test_the_texts_of_messages_are_read_without_pyyaml():
    text = "h:\n  s: ''\n  t: 2 Hz\nr:\n- e: [1.0, .inf]\n- e: []\n  f: {}\nb: true\n"
    tree = {"h": {"s": "", "t": "2 Hz"}, "r": [{"e": [1.0, math.inf]}, {"e": [], "f": {}}]}
    assert readBlock(text) == {**tree, "b": True}


@settings(deadline=None, max_examples=1500)
@given(
    text=st.lists(
        st.sampled_from("[ [ ] { } - ? : , a \n".split(" ") + ["- ", "? ", ": ", "[1, 2]"])
    ).map("".join)
)
@example(text="[a: " * 9 + "]" * 9)
@example(text="- " * 9)
@example(text="? " * 9)
@example(text=": " * 9)
@example(text="a:\n- b:\n  - c:\n    - d:\n      - e: []")
@example(text="[[1], [[1], 2]]")
@example(text="[']', " * 9 + "1" + "]" * 9)
def test_no_text_is_deeper_than_a_glance_says(text):
    try:
        assert depthOf(text) <= _most_depth(text)
    except yaml.YAMLError:
        pass


@pytest.mark.parametrize("kind", ["[{}]", "- {}", "? {}", "{{a: {}}}", "[a: {}]"])
@pytest.mark.parametrize(("depth", "refused"), [(60, False), (300, True), (5000, True)])
def test_texts_too_deep_are_not_composed(kind, depth, refused):
    before, after = kind.format("\0").split("\0")
    storage = CassandraTopic_yaml("p/T", "", parseDefinition("p/T", "string s"))
    text = "s: x\nz:\n " + before * depth + "1" + after * depth
    with pytest.raises(CorruptMessage) as caught:
        storage.decodeWire((text.encode(),), None)
    assert ("nested deeper" in str(caught.value)) is refused
