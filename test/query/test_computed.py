# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is computed of one message: arithmetic, arrays, times; and what is missing in it."""

from __future__ import annotations

import itertools
import math
import random
import time
from collections import Counter
from fractions import Fraction
from types import SimpleNamespace

import pytest
from geometry_msgs.msg import TransformStamped, Twist
from hypothesis import given
from hypothesis import strategies as st
from query.brute_force import Message, Writer, canonical
from query.kinds import KINDS, EdgeMaker
from query.random_statements import Asker
from query.rows import row_of
from query.test_sift import tableOf
from sensor_msgs.msg import JointState, LaserScan, NavSatFix
from std_msgs.msg import Bool, Duration, Float64, Float64MultiArray, Header, UInt8MultiArray, UInt64
from std_msgs.msg import Time as TimeMsg
from suites import random_statements, search
from tf2_msgs.msg import TFMessage

from cassandra_ros import Stamp
from cassandra_ros.errors import InvalidQuery
from cassandra_ros.query.rows.projection import Projections
from cassandra_ros.query.rows.result_groups import analyse_select, columns_of, make_groups
from cassandra_ros.query.tree.parse import parse_select
from cassandra_ros.topics.query_result import Condition

SECOND = 10**9
T0 = 1_400_000_000 * SECOND
NAN, INF = math.nan, math.inf


def matches(msg, text, params=(), **place):
    row = row_of(msg, **place)
    return Condition(text, params).test([row.table])(row)


def shown(msg, text, params=(), t=T0):
    """The one row that a message gives for some columns."""
    row = row_of(msg, t=t)
    select = analyse_select(parse_select(f"select {text} from t", params), [row.table])
    (found,) = Projections(select, [row.table]).of(row.table).rows(row)
    return found if len(found) > 1 else found[0]


def unknown(msg, text, params=()):
    """Neither the condition nor its opposite holds."""
    return not matches(msg, text, params) and not matches(msg, f"not ({text})", params)


SCAN = LaserScan(ranges=[0.5, 0.25, 4.0], range_min=0.3, range_max=3.0, intensities=[])


def test_any_and_all_elements():
    assert matches(SCAN, "ANY(ranges) < 0.3")
    assert not matches(SCAN, "ANY(ranges) < 0.25")
    assert matches(SCAN, "ALL(ranges) > 0.2 and not ALL(ranges) > 0.25")
    assert matches(SCAN, "ANY(ranges) < range_min and ANY(ranges) > range_max")
    assert matches(SCAN, "range_max + 1 >= ALL(ranges)")
    assert matches(SCAN, "ANY(ranges) between 0.4 and 0.6")
    assert not matches(SCAN, "ANY(ranges) between 0.6 and 3.9")  # of the same element
    assert matches(SCAN, "ALL(ranges) not between 0.6 and range_max")
    assert matches(SCAN, "ANY(ranges) in (1, 4) and not ALL(ranges) in (0.5, 4)")
    assert matches(SCAN, "ANY(ranges) != 0.5 and ANY(ranges) = 0.5 and ranges contains 0.5")


def test_arrays_without_elements_and_nan():
    assert not matches(SCAN, "ANY(intensities) > -1")
    assert matches(SCAN, "ALL(intensities) > 7 and not ANY(intensities) > 0")
    assert shown(SCAN, "min(intensities), avg(intensities), len(intensities)") == (None, None, 0)
    assert unknown(SCAN, "min(intensities) < 1")
    assert matches(SCAN, "min(intensities) is null and len(intensities) = 0")
    odd = LaserScan(ranges=[NAN, 2.0, INF])
    assert shown(odd, "min(ranges), max(ranges), sum(ranges)")[:2] == (2.0, INF)
    assert math.isnan(shown(odd, "avg(ranges)"))
    assert not matches(odd, "ALL(ranges) > 1")  # NaN is not
    assert matches(odd, "ANY(ranges) != ANY_ and 1 = 1".replace("ANY_ and 1 = 1", "2"))
    assert shown(LaserScan(ranges=[NAN]), "min(ranges)") is None


def test_arrays_of_other_types():
    joints = JointState(name=["left_wheel", "arm"], position=[1.0, 2.0])
    assert matches(joints, "ANY(name) like '%wheel' and not ALL(name) like '%wheel'")
    assert matches(joints, "ANY(name) not like '%wheel' and ANY(name) = 'arm'")
    assert shown(joints, "min(name), len(name), len(header.frame_id)") == ("arm", 2, 0)
    image = UInt8MultiArray(data=bytes([3, 250]))
    assert shown(image, "max(data), sum(data), avg(data), len(data)") == (250, 253, 126.5, 2)
    assert matches(image, "ANY(data) > 249 and ALL(data) >= 3")
    tree = TFMessage([TransformStamped(), TransformStamped()])
    assert shown(tree, "len(transforms)") == 2
    assert matches(TFMessage(), "len(transforms) = 0")


def test_fields_of_one_message_beside_one_another():
    fix = NavSatFix(latitude=2.0, longitude=2.0, altitude=NAN)
    assert matches(fix, "latitude = longitude and latitude >= longitude")
    assert not matches(fix, "latitude < longitude")
    assert matches(fix, "altitude != altitude and not altitude = altitude")
    assert matches(fix, "status.status < latitude and 1 + status.service < latitude")
    # Exactly, not as floats.
    assert matches(Header(seq=5, stamp=Stamp.from_ns(T0)), "seq != stamp.secs")
    late = TransformStamped(header=Header(stamp=Stamp.from_ns(T0 - 1)))
    assert matches(late, "header.stamp < KEY and KEY - header.stamp = 1ns", t=T0)
    assert matches(late, "header.frame_id = child_frame_id")
    both = TFMessage([TransformStamped(child_frame_id=c) for c in ("", "a")])
    assert matches(both, "transforms.header.frame_id = transforms.child_frame_id")
    assert unknown(both, "transforms[5].child_frame_id = transforms[0].child_frame_id")


NUMBERS = st.floats() | st.sampled_from([0.0, -0.0, 1e308, 5e-324, INF, NAN])


def ieee(sign, x, y):
    if sign != "/":
        return {"+": x + y, "-": x - y, "*": x * y}[sign]
    if y:
        return x / y
    return NAN if x == 0 or x != x else math.copysign(INF, x) * math.copysign(1, y)


def same(x, y):
    return x == y or (x != x and y != y)


@search(200)
@given(NUMBERS, NUMBERS, st.sampled_from("+-*/"))
def test_arithmetic_of_floats(x, y, sign):
    fix = NavSatFix(latitude=x, longitude=y)
    expected = ieee(sign, x, y)
    assert same(shown(fix, f"latitude {sign} longitude"), expected)
    assert same(shown(fix, f"latitude {sign} ?", [y]), expected)
    assert matches(fix, f"latitude {sign} longitude > 0") is (expected > 0)
    root = shown(fix, "sqrt(latitude)")
    assert same(root, math.sqrt(x) if x >= 0 else NAN)
    assert same(shown(fix, "abs(-latitude)"), abs(x))


@search(200)
@given(st.integers(0, 2**64 - 1), st.integers(-(2**64), 2**64), st.integers(0, 2**64 - 1))
def test_arithmetic_of_integers_is_exact(x, y, wanted):
    msg = UInt64(x)
    found = shown(msg, "data + ?, data - ?, data * ? * data", [y, y, y])
    assert found == (x + y, x - y, x * y * x)
    assert matches(msg, "data - ? = ?", [wanted, x - wanted])
    assert matches(msg, "data * data >= data * ?", [wanted]) is (x * x >= x * wanted)
    expected = float(Fraction(x) / y) if y else (INF if x else NAN)
    assert same(shown(msg, "data / ?", [y]), expected)


def test_integers_beyond_floats_beside_floats():
    many = " * ".join(["data"] * 20)
    msg = UInt64(2**64 - 1)
    assert shown(msg, f"{many} + 0.5") == INF
    assert shown(msg, f"0.5 - {many}") == -INF
    assert shown(msg, f"{many} / -2") == -INF
    assert shown(msg, f"sqrt({many})") == float(math.isqrt((2**64 - 1) ** 20))
    assert shown(Bool(True), "data + data, -data, abs(data)") == (2, -1, 1)
    assert type(shown(Float64(1.0), "data * 2")) is float


def test_products_that_nobody_can_write_down_are_missing():
    """Python writes no integer of more than 4300 digits, which a short statement could ask for."""
    square = "data"
    for _ in range(8):
        square = f"({square} * {square})"
    assert shown(UInt64(2**64 - 1), f"{square}, {square} * 1s") == (None, None)
    assert unknown(UInt64(2**64 - 1), f"{square} > 0")
    assert shown(UInt64(1), square) == 1
    many = " * ".join(["9" * 400] * 20)
    for text in (many, f"data + {many}", f"1s * {many}"):
        with pytest.raises(InvalidQuery, match="cannot be computed"):
            parse_select(f"select {text} from t")
    with pytest.raises(InvalidQuery, match="bits"):
        shown(UInt64(1), "data + ?", [10**4299])


def test_times_and_durations():
    msg = Duration(Stamp.from_ns(1_500_000_000) - Stamp.from_ns(0))
    assert matches(msg, "data = 1.5s and data * 2 = 3s and -data < 0s and abs(-data) >= 1500ms")
    assert shown(msg, "data / 500ms") == 3.0
    assert shown(msg, "data * 0.1").to_nsec() == 150_000_000
    assert shown(msg, "data / 7").to_nsec() == round(Fraction(1_500_000_000, 7))
    assert shown(msg, "data / 0, data * ?", [NAN]) == (None, None)
    # Here literals end, and no computed length is told from them.
    assert shown(msg, "data * 1e300, data / 1e-300, data * 1e19 + data * 9e19") == (None,) * 3
    assert matches(msg, "data * 1e19 < ? and data * 1e19 = ?", [1e300, 1.5e19])
    assert unknown(msg, "data / 0 > 0s")
    assert matches(msg, "data / 0 is null")
    at = TimeMsg(Stamp.from_ns(T0 + 7))
    assert shown(at, "data - 7ns, time(1s)", t=T0 + SECOND - 1) == (Stamp.from_ns(T0),) * 2
    assert matches(at, "data - '2014-05-13T16:53:20Z' = 7ns and data > '2014-05-13T16:53:10' + 9s")
    assert matches(at, "data > ? - 1s", [Stamp.from_ns(T0)])
    assert matches(at, "KEY > now() - 1h and now() - KEY < 1h", t=time.time_ns() - 60 * SECOND)
    assert not matches(at, "KEY > now() - 1h", t=time.time_ns() - 3601 * SECOND)
    before = time.time_ns()
    low = Condition("KEY > now() - 1h").bounds().read.time_range.low
    assert low >= before - 3605 * SECOND


def test_what_is_missing_makes_the_rest_so():
    msg = Float64MultiArray(data=[1.0])
    for text in ("data[3] + 1 > 0", "data[0] < data[3]", "ANY(data) < data[3]", "-data[3] != 0"):
        assert unknown(msg, text)
    assert matches(msg, "data[3] * 0 is null and data[0] + 1 is not null")
    cut = row_of(NavSatFix())._replace(wire=b"")
    test = Condition("latitude < longitude or not latitude < longitude").test([cut.table])
    assert not test(cut)


def made(statement, messages, nodes=""):
    rows = [row_of(m, t=T0 + n, node=nodes[n : n + 1]) for n, m in enumerate(messages)]
    tables = list({row.table.name: row.table for row in rows}.values())
    select = analyse_select(parse_select(statement), tables)
    projections = Projections(select, tables)
    found = (columns_of([one]) for row in rows for one in projections.of(row.table).rows(row))
    return list(make_groups(select, projections.names, found, select.limit))


def test_groups():
    floats = [Float64(x) for x in (1.0, NAN, -0.0, NAN, 0.0, 1.0)]
    found = made("select data, count(*) from t group by data", floats)
    assert repr(found) == "[(1.0, 2), (nan, 2), (-0.0, 2)]"
    statement = "select NODE, sum(data) as s from t group by NODE order by s"
    for down in ("", " desc"):
        assert repr(made(statement + down, floats[2:], "aabb")) == "[('b', 1.0), ('a', nan)]"
    arrays = [Float64MultiArray(data=d) for d in ([1.0], [], [2.0], [])]
    assert made("select data[0], count(*) from t group by data[0]", arrays) == [
        (1.0, 1),
        (None, 2),
        (2.0, 1),
    ]
    assert made("select len(data), max(max(data)) from t group by len(data)", arrays) == [
        (1, 2.0),
        (0, None),
    ]
    assert made("select count(*) from t group by len(data) order by len(data)", arrays[:0]) == []


def test_order():
    values = (3.0, NAN, 1.0, 2.0, NAN, 1.0)
    floats = [Float64(x) for x in values]
    ascending = made("select data, KEY from t order by data", floats)
    assert [row[1] - T0 for row in ascending] == [2, 5, 3, 0, 1, 4]
    descending = made("select KEY from t order by data desc", floats)
    assert [row[0] - T0 for row in descending] == [0, 3, 2, 5, 1, 4]
    assert made("select KEY from t order by data desc limit 3", floats) == descending[:3]
    by_two = made("select KEY from t order by abs(data - 2), KEY desc", floats[:1] + floats[2:4])
    assert [row[0] - T0 for row in by_two] == [2, 1, 0]
    many = [Float64(float(n * 7919 % 5003)) for n in range(3000)]
    found = made("select data from t order by data limit 4", many)
    assert found == sorted((m.data,) for m in many)[:4]
    arrays = [Float64MultiArray(data=d) for d in ([1.0], [], [2.0])]
    for down in ("", " desc"):  # what is missing comes last
        assert made(f"select data from t order by data[0]{down}", arrays)[2] == ([],)
    arrays = [Float64MultiArray(data=d) for d in ([], [NAN], [1.0])]
    for down in ("", " desc"):  # NaN comes after all numbers, and before what is missing
        rows = made(f"select KEY from t order by data[0]{down}", arrays)
        assert [row[0] - T0 for row in rows] == [2, 1, 0]


def test_distinct():
    floats = [Float64(x) for x in (1.0, NAN, -0.0, NAN, 0.0, 1.0)]
    assert repr(made("select distinct data from t", floats)) == "[(1.0,), (nan,), (-0.0,)]"
    arrays = [Float64MultiArray(data=d) for d in ([1.0], [], [1.0])]
    assert made("select distinct data from t", arrays) == [([1.0],), ([],)]
    twists = [Twist(), Twist()]
    assert len(made("select distinct * from t", twists)) == 2  # KEY is one of them
    assert made("select distinct linear from t", twists) == [(0.0, 0.0, 0.0)]


@pytest.mark.parametrize("count", [50, 100_000])
def test_what_is_computed_is_bounded(count):
    text = " + ".join(["data"] * count)
    if count == 50:
        assert shown(UInt64(2), text) == 100
        return
    with pytest.raises(ValueError, match="nested deeper"):
        shown(UInt64(2), text)


@pytest.mark.suite("all", "a search; make test asks some of its cases")
@pytest.mark.search
@pytest.mark.filterwarnings("ignore:Do not use the `random` module inside strategies")
@pytest.mark.parametrize("name", ["every", "mixed", "scan", "tf"])
def test_random_statements_without_a_database(name, caplog):
    """What brute_force finds; of how the rows come from the store test_every_plan knows."""
    caplog.set_level("ERROR", "cassandra_ros")
    kind, numbers = KINDS[name], random.Random(name)
    rows, messages = [], []
    for n in range(30):
        types = kind.types[n % len(kind.types)]
        table = tableOf(types)
        wire = EdgeMaker(table.definition, numbers.random(), odd=False).make()
        place = {"node": "ab"[n % 2], "name": "", "run": str(n % 3), "columns": (), "topic": "/t"}
        rows.append(SimpleNamespace(t=T0 + n * SECOND // 3, key=T0 + n * SECOND // 3, **place))
        vars(rows[-1]).update(wire=wire, table=table)
        value = types.root().deserialize(wire)
        messages.append(Message(rows[-1].t, place["node"], (n % 3 + 10, n), types, value))
        rows[-1].run = str(n % 3 + 10)
    tables = list({row.table.name: row.table for row in rows}.values())
    seen = Counter()

    @random_statements(150)
    @given(Asker(kind.types, messages, kind.indexes).statements(), st.integers(0, 2**32))
    def check(statement, seed):
        writer = Writer(seed)
        text = writer.statement(statement, "/topic")
        select = analyse_select(parse_select(text, writer.params), tables)
        projections = Projections(select, tables)
        ordered = rows[::-1] if select.descending else rows
        found = [one for row in ordered for one in projections.of(row.table).rows(row)]
        parts = [columns_of(found[n : n + 7]) for n in range(0, len(found), 7)]
        given_ = make_groups(select, projections.names, parts, select.limit)
        shown = [tuple(map(canonical, row)) for row in itertools.islice(given_, select.limit)]
        assert shown == statement.answer(messages), (text, writer.params)
        seen["gathered"] += select.gathers
        seen["some"] += bool(shown)

    check()
    assert min(seen["some"], seen["gathered"]) > 3, seen
