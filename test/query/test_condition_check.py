# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What conditions mean: our evaluator beside plain Python, on messages of every kind of value."""

from __future__ import annotations

import math
import operator
import struct

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import TransformStamped
from hypothesis import given
from hypothesis import strategies as st
from query.rows import row_of, table_of
from sensor_msgs.msg import JointState, LaserScan, NavSatFix
from std_msgs.msg import Bool, Float32, Float64MultiArray, Int64, String, UInt8MultiArray, UInt64
from std_msgs.msg import Duration as DurationMsg
from std_msgs.msg import Time as TimeMsg
from suites import search
from tf2_msgs.msg import TFMessage

from cassandra_ros import Stamp
from cassandra_ros.errors import InvalidQuery
from cassandra_ros.messages.definition import definition_of, parse_definition
from cassandra_ros.topics.query_result import Condition

OPERATORS = {
    "=": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}


def matches(msg, text, params=(), **place):
    row = row_of(msg, **place)
    return Condition(text, params).test([row.table])(row)


def fails(msg_class, text, params=()):
    with pytest.raises(InvalidQuery) as caught:
        Condition(text, params).test([table_of(definition_of(msg_class))])
    return caught.value


NUMBERS = st.one_of(
    st.integers(-(2**63), 2**63 - 1),
    st.integers(2**53 - 3, 2**53 + 3),
    st.floats(),
    st.sampled_from([0.0, -0.0, math.nan, math.inf, -math.inf, 2.0**53, 2.0**63, 1e308]),
)


@search(400)
@given(st.floats(), st.sampled_from(list(OPERATORS)), NUMBERS)
def test_doubles_compare_as_python_does(value, sign, wanted):
    msg = NavSatFix(latitude=value)
    expected = OPERATORS[sign](value, wanted)
    assert matches(msg, f"latitude {sign} ?", [wanted]) is expected
    assert matches(msg, f"not latitude {sign} ?", [wanted]) is not expected
    assert matches(msg, f"latitude {sign} {wanted!r}") is expected


@search(300)
@given(st.integers(-(2**63), 2**63 - 1), st.sampled_from(list(OPERATORS)), NUMBERS)
def test_integers_compare_exactly(value, sign, wanted):
    assert matches(Int64(value), f"data {sign} ?", [wanted]) is OPERATORS[sign](value, wanted)


def test_numbers_beyond_floats():
    assert matches(UInt64(2**64 - 1), "data = 18446744073709551615")
    assert not matches(UInt64(2**64 - 1), "data = 18446744073709551615.0")
    assert matches(UInt64(2**64 - 1), "data < 18446744073709551616")
    assert matches(Int64(2**53 + 1), "data > 9007199254740992.0")


@search(200)
@given(st.floats(width=32), st.sampled_from(list(OPERATORS)), st.floats())
def test_float32_is_widened_not_the_bound_rounded(value, sign, wanted):
    stored = struct.unpack("<f", struct.pack("<f", value))[0]
    msg = Float32(value)
    assert matches(msg, f"data {sign} ?", [wanted]) is OPERATORS[sign](stored, wanted)


def test_zero_and_nan():
    assert matches(NavSatFix(latitude=-0.0), "latitude = 0")
    assert not matches(NavSatFix(latitude=-0.0), "latitude < 0")
    nan = NavSatFix(latitude=math.nan)
    assert not matches(nan, "latitude > 5")
    assert matches(nan, "latitude != 5")
    assert matches(nan, "not latitude > 5")
    assert not matches(nan, "latitude = nan")
    assert not matches(nan, "latitude in ?", [[math.nan, 1]])
    assert matches(nan, "latitude not in (1, 2)")


@search(200)
@given(st.text(), st.sampled_from(list(OPERATORS)), st.text())
def test_text_compares_by_code_point(value, sign, wanted):
    expected = OPERATORS[sign](list(map(ord, value)), list(map(ord, wanted)))
    literal = wanted.replace("'", "''")
    assert matches(String(value), f"data {sign} ?", [wanted]) is expected
    assert matches(String(value), f"data {sign} '{literal}'") is expected


def test_text_of_any_length():
    long = "ä" * 20_000
    assert matches(String(long), "data = ?", [long])
    assert not matches(String(long), "data = ?", [long[:-1]])


def test_bools():
    assert matches(Bool(True), "data = true")
    assert matches(Bool(False), "data != true and data = 0 and data in (false)")


def test_times():
    msg = TimeMsg(Stamp.from_ns(1_400_000_000_123_456_789))
    for text in (
        "data = 1400000000123456789",
        "data = 1400000000.123456789",  # a float would miss it by 45 ns
        "data = '2014-05-13T16:53:20.123456789Z'",
        "data = '2014-05-13 18:53:20.123456789+02:00'",
        "data.secs = 1400000000 and data.nsecs = 123456789",
        "data > -1 and data < 99999999999999999999999 and data < infinity",
        "KEY = 77 and KEY = 0.000000077 and KEY >= '1970-01-01'",
    ):
        assert matches(msg, text, t=77), text
    assert matches(msg, "data = ?", [Stamp.from_ns(1_400_000_000_123_456_789)])


def test_durations():
    import genpy

    msg = DurationMsg(genpy.Duration(-1, 500_000_000))
    assert matches(msg, "data = -0.5 and data = -500000000 and data < 0")
    assert matches(msg, "data.secs = -1 and data.nsecs = 500000000")
    assert matches(msg, "data = ?", [genpy.Duration(-1, 500_000_000)])


def test_nodes():
    msg = Bool(True)
    assert matches(msg, "NODE = 'husky' and KEY = 5", t=5, node="husky")
    assert not matches(msg, "NODE = 'husky'", node="turtle")
    assert matches(msg, "NODE != 'husky' and NODE in ('turtle', 'x')", node="turtle")


def like(text, pattern):
    """The definition of LIKE, one code point after the other."""
    if not pattern:
        return not text
    if pattern[0] == "%":
        return any(like(text[n:], pattern[1:]) for n in range(len(text) + 1))
    return bool(text) and pattern[0] in ("_", text[0]) and like(text[1:], pattern[1:])


@search(500)
@given(st.text("aB.\n*", max_size=8), st.text("aB.\n*%_", max_size=7))
def test_like(text, pattern):
    assert matches(String(text), "data like ?", [pattern]) is like(text, pattern)
    assert matches(String(text), "data not like ?", [pattern]) is not like(text, pattern)


@search(200)
@given(st.text(), st.text())
def test_what_is_in_a_pattern_is_data(text, tail):
    pattern = "".join("_" if c in "%_" else c for c in text)
    assert matches(String(text + tail), "data like ?", [pattern + "%"])
    assert matches(String(text), "data like '" + pattern.replace("'", "''") + "'")


def test_patterns_that_would_take_for_ever():
    assert not matches(String("a" * 5000), "data like ?", ["%a" * 50 + "%b"])
    assert matches(String("a" * 5000), "data like ?", ["%a_" * 50 + "%"])


def test_parts_of_a_pattern_do_not_overlap():
    for text, pattern in (("aba", "ab%ba"), ("a", "a%a"), ("abc", "ab%b%bc"), ("aa", "a%a%a")):
        assert not matches(String(text), "data like ?", [pattern])
        assert matches(String(text), "data not like ?", [pattern])
    assert matches(String("abba"), "data like 'ab%ba'") and matches(String("aa"), "data like 'a%a'")


def test_like_on_nodes():
    assert matches(Bool(True), "NODE like 'husky_%'", node="husky_1")
    assert not matches(Bool(True), "NODE like 'Husky%'", node="husky_1")


VALUES = st.sampled_from([0, -1, 1, 1.5, -0.0, 255, 256, 255.0, 0.1, 1e300, math.nan, math.inf])


@search(300)
@given(st.lists(VALUES.map(float), max_size=4), VALUES)
def test_contains_in_arrays_of_numbers(values, wanted):
    msg = Float64MultiArray(data=values)
    expected = any(value == wanted for value in values)
    assert matches(msg, "data contains ?", [wanted]) is expected
    assert matches(msg, f"data contains {wanted!r}") is expected
    assert matches(msg, "data not contains ?", [wanted]) is not expected


@search(300)
@given(st.binary(max_size=4) | st.sampled_from([b"\0\xff", b"\1"]), VALUES)
def test_contains_in_bytes(values, wanted):
    expected = any(value == wanted for value in values)
    assert matches(UInt8MultiArray(data=values), "data contains ?", [wanted]) is expected


def test_contains_in_arrays_of_other_types():
    joints = JointState(name=["elbow", "wrist"], position=[1.0, 2.0])
    assert matches(joints, "name contains 'wrist' and position contains 2")
    assert not matches(joints, "name contains 'Wrist' or name contains 'wris'")
    definition = parse_definition("pkg/T", "bool[] b\ntime[] t\nchar[2] c\nduration[] d", None)
    table = table_of(definition)
    wire = struct.pack("<I??III2sIii", 2, True, True, 1, 7, 5, b"\1\2", 1, -1, 500_000_000)
    row = row_of(wire=wire, table=table)
    for text in ("b contains true", "t contains 7.000000005", "c contains 2", "d contains -0.5"):
        assert Condition(text).test([table])(row), text
        assert not Condition("not " + text).test([table])(row), text
    for text in ("b contains false", "t contains 7", "c contains 3", "d contains 0"):
        assert not Condition(text).test([table])(row), text


def test_contains_inside_of_elements():
    text = "MSG: pkg/E"
    definition = parse_definition(
        "pkg/T", f"pkg/E[] e\n{'=' * 80}\n{text}\nint32 x\nint32[] many", None
    )
    table = table_of(definition)
    row = row_of(wire=struct.pack("<IiIiiIi", 2, 1, 1, 10, 2, 1, 20), table=table)
    assert Condition("e.x = 1 and e.many contains 10").test([table])(row)
    assert not Condition("e.x = 1 and e.many contains 20").test([table])(row)
    assert Condition("e[1].many contains 20").test([table])(row)
    for missing in ("e[2].many contains 20", "not e[2].many contains 20"):
        assert not Condition(missing).test([table])(row)
    assert Condition("e[2].many is null and e[1].many is not null").test([table])(row)


def test_null_is_what_is_missing():
    scan = LaserScan(ranges=[1.0, math.nan], intensities=[])
    assert matches(scan, "ranges[2] is null and not ranges[2] is not null")
    assert matches(scan, "ranges[1] is not null and intensities is not null")
    assert matches(scan, "KEY is not null and NODE is not null and header.frame_id is not null")
    assert matches(scan, "ranges[2] = 0 or ranges[2] is null")
    assert not matches(scan, "ranges[0] is null")
    broken = row_of(wire=b"\1\2", table=table_of(definition_of(LaserScan)))
    assert Condition("range_min is null").test([broken.table])(broken)
    assert not Condition("KEY is null or range_min is not null").test([broken.table])(broken)
    tables = [table_of(definition_of(Float32)), table_of(definition_of(NavSatFix))]
    older = Condition("latitude is null").test(tables)
    assert older(row_of(Float32(7)))
    assert not older(row_of(NavSatFix()))


def test_arrays_of_messages_without_elements_give_no_null():
    assert not matches(tf(), "transforms.child_frame_id is null")
    assert matches(tf(), "transforms[0].child_frame_id is null")
    assert not matches(tf(("a", 1.0)), "transforms.child_frame_id is null")


def test_what_is_missing_never_matches():
    scan = LaserScan(ranges=[1.0, 2.0])
    assert matches(scan, "ranges[1] = 2")
    for text in ("ranges[2] = 0", "ranges[2] != 0", "not ranges[2] = 0", "not ranges[2] != 0"):
        assert not matches(scan, text), text
    assert not matches(scan, "ranges[2] not in (1, 2)")
    assert matches(scan, "ranges[2] = 0 or ranges[0] = 1")
    assert not matches(scan, "not (ranges[2] = 0 or ranges[0] = 5)")
    assert matches(scan, "not (ranges[2] = 0 and ranges[0] = 5)")


def test_bytes_that_are_no_message_have_no_fields():
    row = row_of(wire=b"\1\2", table=table_of(definition_of(LaserScan)))
    for text in ("range_min = 0", "not range_min = 0"):
        assert not Condition(text).test([row.table])(row)
    assert Condition("KEY = 1").test([row.table])(row)


def tf(*pairs):
    message = TFMessage()
    for child, x in pairs:
        transform = TransformStamped(child_frame_id=child)
        transform.transform.translation.x = x
        message.transforms.append(transform)
    return message


def test_one_element_must_satisfy_the_whole_condition():
    msg = tf(("a", 1.0), ("b", 2.0))
    both = "transforms.child_frame_id = ? and transforms.transform.translation.x = ?"
    assert matches(msg, both, ["b", 2])
    assert not matches(msg, both, ["a", 2])
    assert not matches(tf(), "transforms.child_frame_id != 'x'")
    assert matches(msg, "transforms[1].child_frame_id = 'b'")
    assert not matches(msg, "transforms[2].child_frame_id != 'b'")


def test_arrays_in_arrays():
    def status(name, *values):
        return DiagnosticStatus(name=name, values=[KeyValue(k, v) for k, v in values])

    msg = DiagnosticArray(
        status=[status("a", ("x", "1"), ("y", "2")), status("b"), status("c", ("x", "3"))]
    )
    text = "status.name = ? and status.values.key = ? and status.values.value = ?"
    assert matches(msg, text, ["a", "y", "2"])
    assert matches(msg, text, ["c", "x", "3"])
    assert not matches(msg, text, ["a", "x", "3"])
    assert not matches(msg, text, ["b", "x", "1"])
    assert matches(msg, "status.name = 'b'")
    assert matches(msg, "status.values[1].key = 'y' and status.name = 'a'")
    assert matches(msg, "status[2].values.value = '3'")
    assert not matches(msg, "status[1].values.value = '3'")


@pytest.mark.parametrize(
    ("msg_class", "text", "spot", "word"),
    [
        (NavSatFix, "lat > 5", "lat", "did you mean latitude?"),
        (NavSatFix, "Latitude > 5", "Latitude", "did you mean latitude"),
        (NavSatFix, "frame_id = 'x'", "frame_id", "did you mean header.frame_id?"),
        (NavSatFix, "header.stam > 5", "stam", "did you mean stamp?"),
        (NavSatFix, "key > 5", "key", "no field key (did you mean KEY?)"),
        (NavSatFix, "Node = 'r1'", "Node", "no field Node (did you mean NODE?)"),
        (NavSatFix, "header.key > 5", "key", "no field header.key; header fields are seq"),
        (DiagnosticArray, "key > 5", "key", "did you mean KEY or status.values.key?"),
        (NavSatFix, "latitude = 'x'", "'x'", "number"),
        (NavSatFix, "latitude = true", "true", "number"),
        (NavSatFix, "header.frame_id = 5", "5", "'text'"),
        (NavSatFix, "header.stamp = 'noon'", "'noon'", "is a time"),
        (NavSatFix, "header.stamp = nan", "nan", "is a time"),
        (NavSatFix, "KEY > 'noon'", "'noon'", "KEY is a time"),
        (NavSatFix, "NODE = 5", "5", "NODE is text"),
        (NavSatFix, "header = 5", "header", "is a message"),
        (NavSatFix, "position_covariance = 5", "position_covariance", "position_covariance[0]"),
        (NavSatFix, "position_covariance[9] = 5", "position_covariance", "9 elements"),
        (NavSatFix, "latitude[0] = 5", "latitude", "not an array"),
        (NavSatFix, "latitude.x = 5", "x", "no field x"),
        (NavSatFix, "header.stamp.ns = 5", "ns", "no field ns"),
        (NavSatFix, "latitude in (1, 'x')", "'x'", "number"),
        (TFMessage, "transforms = 5", "transforms", "is a message"),
        (TFMessage, "transforms.child = 'x'", "child", "did you mean child_frame_id?"),
        (Bool, "data = 'true'", "'true'", "true or false"),
        (DurationMsg, "data = '5 s'", "'5 s'", "number"),
        (NavSatFix, "latitude like '5%'", "latitude", "LIKE is for text"),
        (NavSatFix, "header.stamp like '2014%'", "header.stamp", "is a time"),
        (NavSatFix, "KEY like '2014%'", "KEY", "LIKE is for text"),
        (NavSatFix, "header.frame_id like 5", "5", "'text'"),
        (JointState, "name like 'x'", "name", "name[0]"),
        (NavSatFix, "latitude contains 5", "latitude", "not an array; compare it with ="),
        (NavSatFix, "NODE contains 'x'", "NODE", "not an array"),
        (JointState, "name contains 5", "5", "name is a string[]"),
        (TFMessage, "transforms contains 5", "transforms", "is a message"),
        (TFMessage, "transforms is null", "transforms", "is a message"),
        (NavSatFix, "lat is null", "lat", "did you mean latitude?"),
    ],
)
def test_errors_name_what_was_meant(msg_class, text, spot, word):
    error = fails(msg_class, text)
    assert text[error.position :].startswith(spot)
    assert word in error.reason


def test_parameters_of_any_type_are_refused_with_their_spot():
    for value in (None, b"x", object(), {"a": 1}, [1], 1j):
        error = fails(NavSatFix, "latitude = ?", [value])
        assert error.position == len("latitude = ")


def test_fields_of_two_arrays_are_not_paired():
    text = "MSG: pkg/E"
    definition = parse_definition(
        "pkg/T", f"pkg/E[] a\npkg/E[] b\n{'=' * 80}\n{text}\nint32 x", None
    )
    with pytest.raises(InvalidQuery, match="two arrays"):
        Condition("a.x = 1 and b.x = 2").test([table_of(definition)])
    Condition("a.x = 1 and b[0].x = 2").test([table_of(definition)])


def test_a_topic_without_definition_has_only_key_and_node():
    table = table_of(None)
    with pytest.raises(InvalidQuery, match="no definition"):
        Condition("x = 1").test([table])
    assert Condition("KEY = 1").test([table])(row_of(wire=b"", table=table))


def test_a_field_that_one_definition_lacks_is_missing_there():
    tables = [table_of(definition_of(Float32)), table_of(definition_of(NavSatFix))]
    test = Condition("latitude = 5 or data = 7").test(tables)
    assert test(row_of(NavSatFix(latitude=5)))
    assert test(row_of(Float32(7)))
    assert not test(row_of(Float32(5)))
    # data is a number here and text there: text never equals 7.
    test = Condition("data != 7").test([*tables, table_of(definition_of(String))])
    assert not test(row_of(String("x")))
    assert test(row_of(Float32(5)))


def test_in_means_equal_to_one_of_them_also_where_definitions_differ_in_kind():
    rows = [row_of(String(data="a")), row_of(Int64(data=1))]

    def found(text):
        test = Condition(text).test([row.table for row in rows])
        return [test(row) for row in rows]

    assert found("data != 'b'") == found("data NOT IN ('b')") == [True, False]
    assert found("data IN ('a', 1)") == [True, True]
    # Neither equal to 'b' nor comparable with it.
    assert found("data NOT IN ('b', 2)") == found("data != 'b' AND data != 2") == [False, False]
    assert found("NOT data IN ('b')") == [True, False]


def test_names_that_are_keywords_of_python():
    definition = parse_definition("pkg/T", "int32 from\nint32 class\nint32 limit", None)
    wire = struct.pack("<iii", 1, 2, 3)
    row = row_of(wire=wire, table=table_of(definition))
    assert Condition("from = 1 and class = 2 and limit = 3").test([row.table])(row)
