# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
from __future__ import annotations

import math

import genmsg
import genmsg.msg_loader
import pytest
import rosbag
from hypothesis import given, settings
from hypothesis import strategies as st
from messages.random_wire import SEPARATOR, DefinitionMaker, installedTypes

from cassandra_ros.errors import DefinitionError
from cassandra_ros.messages.classes import deserialize, installed_definition, message_class
from cassandra_ros.messages.definition import (
    attribute_name,
    definition_of,
    installed_class,
    parse_definition,
    read_definition,
    render_spec,
)
from cassandra_ros.messages.spec import parse_spec
from cassandra_ros.messages.wire.wire_plan import wire_plan


def genmsgMd5(msg_type, text):
    """The md5 as genmsg computes it; only for text that was made here."""
    context = genmsg.MsgContext.create_default()
    parts = text.split(SEPARATOR)
    load = genmsg.msg_loader.load_msg_from_string
    root = load(context, parts[0], msg_type)
    for part in parts[1:]:
        head, _, body = part.partition("\n")
        load(context, body, head[5:])
    genmsg.msg_loader.load_depends(context, root, {})
    return genmsg.compute_md5(context, root)


def test_every_installed_type_has_the_md5_of_genmsg():
    names = installedTypes()
    assert len(names) >= 150
    for name in names:
        found = installed_class(name)
        definition = definition_of(found)
        assert definition.md5sum == found._md5sum
        assert definition.root.type == name
        assert len(definition.root.fields) == len(found.__slots__)
    print(f"{len(names)} installed message types")


def test_every_connection_of_the_bags_is_understood(bags):
    broken, count = [], 0
    for path in sorted(bags.glob("*.bag")):
        try:
            bag = rosbag.Bag(str(path))
        except rosbag.ROSBagException:
            assert path.name == "truncated_header_only.bag"
            continue
        for info in bag._get_connections():
            count += 1
            try:
                definition = parse_definition(info.datatype, info.msg_def, info.md5sum)
                assert definition.md5sum == info.md5sum
            except DefinitionError:
                broken.append(path.name)
        bag.close()
    assert broken == ["empty_message_definition.bag"]
    assert count > 50


@settings(deadline=None)
@given(st.integers(0, 2**32))
def test_random_definitions_have_the_md5_of_genmsg(seed):
    msg_type, text = DefinitionMaker(seed).make()
    definition = parse_definition(msg_type, text)
    assert definition.md5sum == genmsgMd5(msg_type, text)
    assert parse_definition(msg_type, text, definition.md5sum) == definition


@settings(deadline=None)
@given(st.integers(0, 2**32))
def test_rendered_definitions_say_the_same_without_constants(seed):
    definition = parse_definition(*DefinitionMaker(seed).make())
    for name, spec in definition.specs.items():
        rendered = render_spec(spec)
        assert "TEXT" not in rendered
        assert "#" not in rendered
        again = parse_spec(name, rendered)
        assert [(f.name, f.full_type) for f in again.fields] == [
            (attribute_name(f.name), f.full_type) for f in spec.fields
        ]
        assert not again.constants


def test_fields():
    text = """
# comment
Header header
float64[9] covariance # row major
byte b
char[] c
geometry_msgs/Point[2] points
Local local
"""
    others = ["MSG: std_msgs/Header\nuint32 seq", "MSG: geometry_msgs/Point\nfloat64 x"]
    parts = [text, *others, "MSG: pkg/Local\n", "MSG: pkg/Unused\nnonsense that nobody uses"]
    definition = parse_definition("pkg/Type", SEPARATOR.join(parts))
    assert [(f.name, f.type, f.is_array, f.length, f.base) for f in definition.root.fields] == [
        ("header", "std_msgs/Header", False, None, "std_msgs/Header"),
        ("covariance", "float64", True, 9, "float64"),
        ("b", "byte", False, None, "int8"),
        ("c", "char", True, None, "uint8"),
        ("points", "geometry_msgs/Point", True, 2, "geometry_msgs/Point"),
        ("local", "pkg/Local", False, None, "pkg/Local"),
    ]
    used = {"std_msgs/Header", "geometry_msgs/Point", "pkg/Local"}
    assert set(definition.specs) == {"pkg/Type"} | used


def test_constants():
    text = """
string S= it's # no comment\t
string EMPTY=
uint8 A=1 # one
int64   B  =  -9223372036854775808
float32 F=.5e3
float64 N=nan
bool T=True
bool U=0
char C=255
byte D=-128
"""
    constants = parse_definition("pkg/Type", text).root.constants
    values = {constant.name: constant.value for constant in constants}
    assert math.isnan(values.pop("N"))
    assert values == {
        "S": "it's # no comment",
        "EMPTY": "",
        "A": 1,
        "B": -(2**63),
        "F": 500.0,
        "T": True,
        "U": False,
        "C": 255,
        "D": -128,
    }


def test_old_home_of_header():
    new = installed_definition("std_msgs/Header")
    text = "Header header" + SEPARATOR + "MSG: roslib/Header\n" + new.text
    definition = parse_definition("pkg/Old", text)
    assert definition.root.fields[0].type == "std_msgs/Header"


def test_windows_line_ends_and_spaces_do_not_matter():
    text = "  uint8 x \r\n" + SEPARATOR.replace("\n", "\r\n") + "MSG: pkg/Other\r\nint8 y\r\n"
    assert parse_definition("pkg/T", text).md5sum == parse_definition("pkg/T", "uint8 x").md5sum


def test_missing_types_come_from_installed_packages_when_the_md5_agrees():
    whole = installed_definition("geometry_msgs/PoseStamped")
    text = "Header header\nPose pose"
    definition = parse_definition("geometry_msgs/PoseStamped", text, whole.md5sum)
    assert set(definition.specs) == set(whole.specs)
    with pytest.raises(DefinitionError, match="does not define"):
        parse_definition("geometry_msgs/PoseStamped", text)
    with pytest.raises(DefinitionError, match="taken from installed packages"):
        parse_definition("geometry_msgs/PoseStamped", text, "0" * 32)
    with pytest.raises(DefinitionError, match="not installed"):
        parse_definition("pkg/T", "nobody_has/This x", "0" * 32)


def test_definition_of_a_class():
    from std_msgs.msg import String

    assert (
        definition_of(String) == definition_of(String()) == installed_definition("std_msgs/String")
    )
    for wrong in (str, None, 5):
        with pytest.raises(DefinitionError, match="not a ROS message class"):
            definition_of(wrong)


def test_a_type_that_is_not_installed():
    with pytest.raises(DefinitionError, match="not installed"):
        installed_definition("nobody_has/This")
    for package in ("os", "antigravity", "this"):  # modules, but no packages of messages
        with pytest.raises(DefinitionError, match="not installed"):
            installed_definition(f"{package}/Path")


def test_what_installed_packages_complete_is_kept_with_the_text():
    """On another machine the packages may be missing, or newer."""
    from sensor_msgs.msg import NavSatFix

    alone = NavSatFix._full_text.split("\n====")[0]
    definition = parse_definition("sensor_msgs/NavSatFix", alone, NavSatFix._md5sum)
    for used in ("std_msgs/Header", "sensor_msgs/NavSatStatus"):
        assert f"MSG: {used}" in definition.text
    again = parse_definition("sensor_msgs/NavSatFix", definition.text, NavSatFix._md5sum)
    assert again.text == definition.text


def test_a_type_without_fields_is_completed_by_its_name_and_an_empty_line():
    md5sum = parse_definition("pkg/Q", f"std_msgs/Empty e{SEPARATOR}MSG: std_msgs/Empty\n").md5sum
    definition = parse_definition("pkg/Q", "std_msgs/Empty e", md5sum)
    assert definition.text.endswith("MSG: std_msgs/Empty\n")


def test_arrays_that_the_md5_does_not_tell_apart():
    """ROS hashes 'E x' and 'E[] x' alike; what is compiled of one must not serve the other."""
    texts = [f"pkg/E{array} x{SEPARATOR}MSG: pkg/E\nuint8 a" for array in ("", "[]", "[3]")]
    found = [parse_definition("pkg/T", text) for text in texts]
    assert len({d.md5sum for d in found}) == 1
    assert len(set(found)) == 3
    assert [len(wire_plan(d).walk(w)[0]) for d, w in zip(found, (b"1", b"\0" * 4, b"123"))] == [
        1
    ] * 3
    assert wire_plan(found[0]).walk(b"\7")[1] is False
    assert wire_plan(found[1]).walk(b"\7")[1] is True
    messages = [deserialize(message_class(d), w) for d, w in zip(found, (b"\7", b"\0" * 4, b"123"))]
    assert messages[0].x.a == 7
    assert [len(m.x) for m in messages[1:]] == [0, 3]


@pytest.mark.parametrize("inner", ["E", "E[]", "E[3]"])
def test_arrays_of_inner_types_count_too(inner):
    rest = f"{SEPARATOR}MSG: pkg/E\nuint8 a"
    found = parse_definition("pkg/T", f"I i{SEPARATOR}MSG: pkg/I\n{inner} x{rest}")
    other = parse_definition("pkg/T", f"I i{SEPARATOR}MSG: pkg/I\nE[2] x{rest}")
    assert found.md5sum == other.md5sum
    assert found != other


@pytest.mark.parametrize(
    "text", ["int8 A=128", "uint8 A=-1", "char A=256", "uint64 A=1" + "0" * 20]
)
def test_constants_out_of_range(text):
    with pytest.raises(DefinitionError, match="is not a literal of type"):
        parse_definition("pkg/T", text)


TWICE = f"pkg/A a\npkg/B b\n{SEPARATOR}MSG: pkg/A\nint8 x\n\n{SEPARATOR}MSG: pkg/B\npkg/A a\n"
"""A definition whose writer appends a type each time that it is used, with other blank lines."""


@pytest.mark.parametrize("body", ["int8 x", "int8 x\n\n\n", "int8 x\r\n", "int8 x  # a number\n"])
def test_a_type_may_be_defined_twice_in_the_same_words(body):
    once = parse_definition("pkg/T", TWICE)
    twice = parse_definition("pkg/T", f"{TWICE}{SEPARATOR}MSG: pkg/A\n{body}", once.md5sum)
    assert twice == once
    assert twice.specs == once.specs


def test_a_type_that_is_not_used_may_be_defined_in_any_way():
    more = "".join(f"{SEPARATOR}MSG: pkg/C\n{body}\n" for body in ("int8 x", "int9 y", "?"))
    assert parse_definition("pkg/T", TWICE + more) == parse_definition("pkg/T", TWICE)


@pytest.mark.parametrize("stated", ["0" * 32, "*", "", "992ce8a1687cec8c8bd883ec73ca41d1"])
def test_the_text_of_a_connection_counts_where_its_md5sum_is_of_another(stated):
    with pytest.raises(DefinitionError, match="has md5"):
        parse_definition("pkg/T", TWICE, stated)
    assert read_definition("pkg/T", TWICE, stated) == parse_definition("pkg/T", TWICE)


@pytest.mark.parametrize("text", ["", "# none\n", "int8 X=1\n", "std_msgs/Header h\n", "int8\n"])
def test_a_text_that_is_not_complete_does_not_count(text):
    with pytest.raises(DefinitionError, match="has md5|neither|not"):
        read_definition("pkg/T", text, "0" * 32)
