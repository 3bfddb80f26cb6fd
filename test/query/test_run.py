# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Statements against a real Cassandra that holds a real robot's bag, beside loops over the bag."""

from __future__ import annotations

import math
import uuid
from fractions import Fraction

import pytest
import rosbag
from geometry_msgs.msg import Twist
from query.brute_force import Types
from query.kinds import serialized
from sensor_msgs.msg import NavSatFix
from std_msgs.msg import Float32, String
from suites import sparing

from cassandra_ros import RosCassandra, Stamp
from cassandra_ros.errors import InvalidKey, InvalidQuery
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.read import Read, TimeRange
from cassandra_ros.topics.query_result import Condition

TOPICS = ("/diagnostics", "/encoder", "/fix", "/joy", "/tf")
T0 = 1_400_000_000 * 10**9


def key(ns):
    return Stamp.from_ns(ns)


class Recorded:
    """A bag in the store, and its messages as the rosbag module reads them."""

    def __init__(self, store, path):
        self.store = store
        self.messages = {}
        writer = store.messageWriter(format=store.wanted_format, nodeID="husky")
        handles = {}
        with rosbag.Bag(str(path)) as bag:
            for number, (topic, raw, t, header) in enumerate(
                bag.read_messages(TOPICS, raw=True, return_connection_header=True)
            ):
                if topic not in handles:
                    handles[topic] = writer.connect(live_connection(topic, header))
                writer.write(handles[topic], t.to_nsec(), number, raw[1])
                found = self.messages.setdefault(topic, [])
                found.append((t.to_nsec(), raw[4]().deserialize(raw[1])))
        writer.close()

    def ask(self, statement, params=(), **options):
        return list(self.store.statements.select(statement, params, **options))


@pytest.fixture(scope="module", params=sparing(["binary", "ros"], kept=["ros"]))
def husky(request, cassandra, cql, bags):
    name = f"t_{uuid.uuid4().hex[:16]}"
    with RosCassandra(cassandra.host, cassandra.port, keyspace=name) as store:
        store.wanted_format = request.param
        yield Recorded(store, bags / "husky_gps_data.bag")
    cql.execute(f"DROP KEYSPACE {name}")


@pytest.mark.suite("all", "it reads each message of whole bags")
def test_fields_of_every_message(husky):
    expected = [(key(t), m.latitude, m.header.frame_id) for t, m in husky.messages["/fix"]]
    assert husky.ask("select KEY, latitude, header.frame_id from fix") == expected
    assert husky.ask("SELECT KEY, latitude, header.frame_id FROM /fix;") == expected


def test_conditions(husky):
    expected = [
        (key(t), m.pose.pose.position.x)
        for t, m in husky.messages["/encoder"]
        if m.pose.pose.position.x > -3 and m.twist.twist.linear.x != 0
    ]
    found = husky.ask(
        "select KEY, pose.pose.position.x from encoder "
        "where pose.pose.position.x > ? and twist.twist.linear.x != 0",
        [-3],
    )
    assert found == expected
    assert 0 < len(found) < len(husky.messages["/encoder"])


def test_the_statement_of_the_paper(husky):
    """Listing of design 4: a time range of one frame, min and max of a column."""
    times = [t for t, _ in husky.messages["/tf"]]
    t1, t2 = Stamp.from_ns(times[1000]), Stamp.from_ns(times[1500])
    statement = (
        "select transforms.transform.translation.x from tf where transforms.child_frame_id='"
        + "/base_link"
        + "' and KEY > "
        + str(t1 - 1)
        + " and KEY < "
        + str(t2 + 1)
    )
    x_list = husky.store.executeCQL(statement)
    expected = [
        (transform.transform.translation.x,)
        for t, message in husky.messages["/tf"]
        if times[1000] - 10**9 < t < times[1500] + 10**9
        for transform in message.transforms
        if transform.child_frame_id == "/base_link"
    ]
    assert x_list == expected
    assert x_list
    assert x_list.columns == ("transforms.transform.translation.x",)
    assert (min(x_list)[0], max(x_list)[0]) == (min(expected)[0], max(expected)[0])


def test_select_star(husky):
    result = husky.store.statements.select("select * from tf limit 3")
    assert result.columns[:3] == ("KEY", "transforms.header.seq", "transforms.header.stamp")
    for row, (t, message) in zip(result, husky.messages["/tf"]):
        assert row[0] == key(t)
        assert row[4] == [transform.child_frame_id for transform in message.transforms]
    unnested = husky.ask("select * from tf where transforms.child_frame_id = '/base_link' limit 2")
    assert [row[4] for row in unnested] == ["/base_link"] * 2


def test_keys_carry_their_row(husky):
    ((found,),) = husky.ask("select KEY from fix limit 1")
    assert isinstance(found, Stamp)
    t, message = husky.messages["/fix"][0]
    assert (found.ns, found.node) == (t, "husky")
    assert husky.store.getTopic("fix").getData(found).latitude == message.latitude
    ((stamp,),) = husky.ask("select header.stamp from fix limit 1")
    assert stamp == message.header.stamp


def test_counts(husky):
    for topic, messages in husky.messages.items():
        assert husky.ask(f"select count(*) from {topic}") == [(len(messages),)]
    half = husky.messages["/tf"][1500][0]
    assert husky.ask("select count(*) from tf where KEY < ?", [half]) == [
        (sum(t < half for t, _ in husky.messages["/tf"]),)
    ]
    assert husky.ask("select count(*) from tf where transforms.child_frame_id = '/base_link'") == [
        (sum(f.child_frame_id == "/base_link" for _, m in husky.messages["/tf"]
             for f in m.transforms),)
    ]  # fmt: skip
    assert husky.ask("select count(*) from fix where latitude > 90") == [(0,)]
    assert husky.ask("select count(*) from fix where KEY < 0") == [(0,)]


def test_aggregates(husky):
    fixes = [m.latitude for _, m in husky.messages["/fix"]]
    statement = (
        "select min(latitude), MAX(latitude) as top, sum(latitude), avg(latitude), "
        "count(latitude), count(*) as n, min(header.frame_id), max(KEY), sum(header.seq) from fix"
    )
    result = husky.store.statements.select(statement)
    assert result.columns[:3] == ("min(latitude)", "top", "sum(latitude)")
    assert result.columns[5] == "n"
    ((*numbers, frame, last, total),) = list(result)
    mean = float(sum(map(Fraction, fixes)) / len(fixes))
    assert numbers == [min(fixes), max(fixes), math.fsum(fixes), mean, len(fixes), len(fixes)]
    t, message = husky.messages["/fix"][-1]
    assert (frame, last) == (min(m.header.frame_id for _, m in husky.messages["/fix"]), key(t))
    assert husky.store.getTopic("fix").getData(last).latitude == message.latitude
    assert total == sum(m.header.seq for _, m in husky.messages["/fix"])


def test_aggregates_of_elements(husky):
    values = [
        (f.transform.translation.x, f.header.stamp)
        for _, m in husky.messages["/tf"]
        for f in m.transforms
        if f.child_frame_id.endswith("wheel") and f.transform.translation.y > 0
    ]
    x = "transforms.transform.translation.x"
    assert husky.ask(
        f"select min({x}), max({x}), sum({x}), count({x}), count(*), "
        "min(transforms.header.stamp) from tf where transforms.child_frame_id like '%wheel' "
        "and transforms.transform.translation.y > 0 limit 5"
    ) == [
        (min(values)[0], max(values)[0], math.fsum(v for v, _ in values), len(values), len(values),
         min(stamp for _, stamp in values))
    ]  # fmt: skip
    assert values


def test_aggregates_of_nothing(husky):
    nothing = [(0, 0, None, None, None, None)]
    names = "count(*), count(latitude), min(latitude), max(latitude), sum(latitude), avg(latitude)"
    assert husky.ask(f"select {names} from fix where latitude > 90") == nothing
    assert husky.ask(f"select {names} from fix where KEY < 0") == nothing
    many = len(husky.messages["/joy"])
    assert husky.ask("select count(axes[99]), count(*), avg(axes[99]) from joy") == [
        (0, many, None)
    ]
    assert husky.ask("select count(*), count(*) as n from joy") == [(many, many)]


def test_patterns_arrays_and_null(husky):
    joys = husky.messages["/joy"]
    pressed = [(key(t),) for t, m in joys if 1 in m.buttons]
    assert husky.ask("select KEY from joy where buttons contains 1") == pressed
    some = joys[len(joys) // 2][1].axes[1]
    pushed = [(key(t),) for t, m in joys if some in m.axes]
    assert husky.ask("select KEY from joy where axes contains ?", [some]) == pushed
    assert 0 < len(pushed) < len(joys)
    assert husky.ask("select count(*) from joy where axes[99] is null") == [(len(joys),)]
    assert husky.ask("select count(*) from joy where NODE like 'hus__'") == [(len(joys),)]
    assert husky.ask("select count(*) from joy where NODE like 'hus_'") == [(0,)]
    renamed = husky.store.statements.select("select KEY as time, buttons[0] as b from joy limit 1")
    assert renamed.columns == ("time", "b")
    assert list(renamed) == [(key(joys[0][0]), joys[0][1].buttons[0])]


def test_order_and_limit(husky):
    times = [(key(t),) for t, _ in husky.messages["/joy"]]
    assert husky.ask("select KEY from joy order by KEY desc") == times[::-1]
    assert husky.ask("select KEY from joy order by KEY desc limit 3") == times[:-4:-1]
    assert husky.ask("select KEY from joy limit 5", limit=3) == times[:3]
    assert husky.ask("select KEY from joy limit 3", limit=5) == times[:3]
    assert husky.ask("select KEY from joy", limit=0) == []


STATEMENTS = (
    "select KEY, axes[1] from joy limit 50",
    "select KEY from joy order by KEY desc limit 50",
    "select KEY, transforms.child_frame_id from tf limit 60",
    "select transforms.child_frame_id, KEY from tf where transforms.transform.rotation.w < 1 "
    "order by KEY desc limit 60",
    "select status.values.key, status.name from diagnostics where status.level = 0 limit 60",
)


@pytest.mark.parametrize("size", sparing([1, 7, 5000], kept=[7]))
@pytest.mark.parametrize("statement", STATEMENTS)
def test_pages_give_the_same_rows(husky, statement, size):
    whole = husky.ask(statement)
    assert len(whole) > 7
    pages, cursor = [], None
    for _ in range(len(whole) + 2):
        with husky.store.statements.select(statement, limit=size, after=cursor) as result:
            page = list(result)
            cursor = result.cursor
        if not page:
            break
        pages += page
    assert pages == whole


def test_cursors_from_elsewhere(husky):
    with pytest.raises(InvalidKey, match="not a cursor"):
        husky.store.statements.select("select KEY from joy", after="x")


def test_condition_for_getdata_and_range(husky):
    topic = husky.store.getTopic("encoder")
    rows = list(Condition("pose.pose.position.x > -3").rows(topic))
    assert [row.t for row in rows] == [
        t for t, m in husky.messages["/encoder"] if m.pose.pose.position.x > -3
    ]
    low, high = rows[5].t, rows[9].t
    again = Condition("pose.pose.position.x > ?", [-3]).rows(topic, Read(TimeRange(low, high)))
    assert [row.t for row in again] == [row.t for row in rows[5:10]]
    behind = Read(after=rows[9].position)
    after = Condition("pose.pose.position.x > -3").rows(topic, behind)
    assert [row.t for row in after] == [row.t for row in rows[10:]]


@pytest.mark.parametrize(
    ("statement", "spot", "word"),
    [
        ("select lat from fix", "lat", "did you mean latitude?"),
        ("select latitude from fixx", "fixx", "did you mean /fix?"),
        ("select latitude from fix where KEY > 'noon'", "'noon'", "KEY is a time"),
        ("select latitude from fix where longitud > 0", "longitud", "did you mean longitude"),
        ('select KEY from "\'; drop table x; --"', "\"'", "not stored"),
        ("select sum(header.frame_id) from fix", "header.frame_id", "sum is for numbers"),
        ("select avg(header.stamp) from fix", "header.stamp", "is a time"),
        ("select max(latitude), avg(KEY) from fix", "KEY", "avg is for numbers"),
        ("select sum(NODE) from fix", "NODE", "sum is for numbers"),
        ("select count(axes) from joy", "axes", "axes[0]"),
        ("select count(*), latitude from fix", "count", "stands alone"),
        ("select KEY, max(latitude) from fix", "max", "not beside KEY"),
        ("select min(max(latitude)) from fix", "latitude", "not an array"),
        ("select KEY from fix where max(latitude) > 3", "latitude", "not an array"),
        ("select KEY from fix where latitude > header.stamp", "> header", "cannot be compared"),
        ("select KEY from fix where header.frame_id = base", "base", "in quotes: 'base'"),
        ("select KEY from fix where latitude > 1s", "1s", "compare it with a number"),
        ("select KEY from fix where header.stamp > 1s", "1s", "now() - 1s would be one"),
        ("select KEY from fix where KEY - now() > now()", "now", "a duration"),
        ("select KEY from fix where ANY(latitude) > 3", "latitude", "not an array"),
        ("select KEY from joy where ANY(axes) > header.frame_id", "ANY", "cannot be compared"),
        # Although one of the two ends is a number.
        ("select KEY from fix where latitude between header.frame_id and 5", "header", "cannot be"),
        ("select KEY from fix where latitude between altitude and NODE", "NODE", "cannot be"),
        ("select KEY from joy where ANY(axes) between header.seq and NODE", "ANY", "cannot be"),
        ("select KEY from joy where ALL(axes) like 'a'", "axes", "LIKE is for text"),
        ("select KEY from joy where len(axes) like 'a'", "len", "is an integer, and LIKE"),
        ("select sum(name) from joy", "name", "no field name"),
        ("select len(latitude) from fix", "len", "for arrays and text"),
        ("select len(header) from fix", "header", "is a message"),
        (
            "select len(transforms), transforms.child_frame_id from tf",
            "transforms)",
            "each element",
        ),
        ("select time(0s) from fix", "0s", "longer than 0"),
        ("select time(5) from fix", "5", "a duration"),
        ("select * from fix group by NODE", "NODE", "instead of *"),
        ("select latitude, count(*) from fix group by NODE", "latitude", "max(latitude)"),
        ("select NODE from fix group by NODE order by altitude", "altitude", "select it, too"),
        ("select distinct NODE from fix order by altitude", "altitude", "select it, too"),
        ("select altitude from fix order by count(*)", "count(*)", "by which groups are ordered"),
        ("select count(*) from fix group by axes", "axes", "no field axes"),
        ("select count(*) from joy group by axes", "axes", "is an array"),
        ("select KEY from joy order by axes", "axes", "is an array"),
        ("select KEY from fix order by header", "header", "is a message"),
        ("select count(*) from fix group by 5", "5", "the same in every row"),
        ("select latitude from fix order by 1", "1", "the same in every row"),
        ("select min(header) from fix", "header", "is a message"),
        ("select header as h from fix", "header as", "AS gives a name to one"),
        ("select KEY from fix where KEY like '2%'", "KEY like", "LIKE is for text"),
        ("select transforms.x, transforms.child_frame_id from tf", "x", "no field transforms.x"),
    ],
)
def test_errors_come_at_once_with_the_statement(husky, statement, spot, word):
    with pytest.raises(InvalidQuery) as caught:
        husky.store.statements.select(statement)
    assert statement[caught.value.position :].startswith(spot)
    assert word in caught.value.reason
    assert statement in str(caught.value)


def test_several_rows_make_one(husky):
    """GROUP BY, DISTINCT and ORDER BY beside loops over the bag, whole and page by page."""
    fixes, encoders = husky.messages["/fix"], husky.messages["/encoder"]
    second = 10**9
    groups = {}
    for t, m in encoders:
        groups.setdefault(t - t % (10 * second), []).append(m.twist.twist.linear.x)
    statement = "select time(10s) as t, count(*), max(twist.twist.linear.x) as m "
    statement += "from encoder group by t"
    expected = [(key(t), len(found), max(found)) for t, found in groups.items()]
    assert len(expected) > 3
    assert husky.ask(statement) == expected
    assert (
        husky.ask(statement + " order by m desc limit 2")
        == sorted(expected, key=lambda row: -row[2])[:2]
    )

    by_height = sorted(fixes, key=lambda found: (-found[1].altitude, found[0]))
    statement = "select KEY, header.seq from fix order by altitude desc"
    expected = [(key(t), m.header.seq) for t, m in by_height]
    assert husky.ask(statement) == expected
    assert husky.ask(statement + ", KEY limit 7") == expected[:7]

    frames = dict.fromkeys(
        (x.header.frame_id, x.child_frame_id)
        for _, m in husky.messages["/tf"]
        for x in m.transforms
    )
    statement = "select distinct transforms.header.frame_id, transforms.child_frame_id from tf"
    expected = list(frames)
    assert husky.ask(statement) == expected
    pages, cursor = [], None
    for _ in range(len(expected) + 1):
        with husky.store.statements.select(statement, limit=2, after=cursor) as result:
            pages += result
            cursor = result.cursor
    assert pages == expected

    ((least, most, mean),) = husky.ask(
        "select min(min(axes)), max(max(axes)), avg(len(axes)) from joy"
    )
    axes = [m.axes for _, m in husky.messages["/joy"]]
    assert (least, most) == (min(map(min, axes)), max(map(max, axes)))
    assert mean == sum(map(len, axes)) / len(axes)


def test_memory_is_bounded(husky, monkeypatch):
    monkeypatch.setattr("cassandra_ros.query.rows.result_groups.MEMORY_BYTES", 2**16)
    for statement, remedy in (
        ("select KEY, pose.covariance from encoder order by pose.pose.position.x", "add a LIMIT"),
        ("select count(*) from tf group by KEY", "time(1h)"),
        ("select distinct KEY, transforms.transform.rotation.w from tf", "fewer columns"),
    ):
        with pytest.raises(InvalidQuery, match="more than 0 MiB would have to be kept") as caught:
            husky.ask(statement)
        assert remedy in caught.value.reason
    few = "select KEY from encoder order by pose.pose.position.x limit 5"
    assert len(husky.ask(few)) == 5
    # The memory of rows that LIMIT drops is free again.
    monkeypatch.setattr("cassandra_ros.query.rows.result_groups.LEAST_KEPT", 10)
    few = "select KEY from tf order by transforms.transform.rotation.w limit 5"
    assert len(husky.ask(few)) == 5
    # What is grouped by time is given as soon as it is complete.
    assert len(husky.ask("select count(*) from tf group by time(10ms)")) > 500


def test_several_nodes(rosCas):
    topic = rosCas.addTopic("/pose", format="ros")
    for n in range(6):
        topic.addData(Twist(), key=T0 + n // 2, nodeID="ab"[n % 2])
    rows = rosCas.executeCQL("select KEY, NODE from pose")
    assert rows == [(key(T0 + n // 2), "ab"[n % 2]) for n in range(6)]
    assert rosCas.executeCQL("select NODE from pose where NODE = 'b'") == [("b",)] * 3
    assert rosCas.executeCQL("select NODE from pose", nodeID="a") == [("a",)] * 3
    assert rosCas.executeCQL("select NODE from pose where NODE = 'a'", nodeID="b") == []
    assert rosCas.executeCQL("select count(*) from pose where NODE in ('a', 'b')") == [(6,)]


def test_definitions_are_united(rosCas):
    writer = rosCas.messageWriter(format="ros")

    def write(msg, t):
        from cassandra_ros.messages.classes import serialize

        header = {"type": msg._type, "md5sum": msg._md5sum, "message_definition": msg._full_text}
        writer.write(writer.connect(live_connection("/x", header)), t, t - T0, serialize(msg))

    write(Float32(1.5), T0)
    write(NavSatFix(latitude=5.0), T0 + 1)
    write(String("text"), T0 + 2)
    writer.close()
    rows = rosCas.executeCQL("select KEY, data, latitude from x")
    assert rows == [(key(T0), 1.5, None), (key(T0 + 1), None, 5.0), (key(T0 + 2), "text", None)]
    everything = rosCas.statements.select("select * from x")
    assert set(everything.columns) >= {"KEY", "data", "latitude", "header.frame_id"}
    assert len(list(everything)) == 3
    assert rosCas.executeCQL("select data from x where data = 'text'") == [("text",)]
    assert rosCas.executeCQL("select data from x where data > 1") == [(1.5,)]
    with pytest.raises(InvalidQuery, match="no field"):
        rosCas.executeCQL("select nothing from x")
    assert rosCas.executeCQL("select count(data), sum(data), max(latitude), count(*) from x") == [
        (2, 1.5, 5.0, 3)
    ]
    assert rosCas.executeCQL("select KEY from x where latitude is null") == [
        rows[0][:1],
        rows[2][:1],
    ]
    with pytest.raises(InvalidQuery, match="different kinds") as caught:
        rosCas.executeCQL("select count(*), min(data) from x")
    assert caught.value.position == len("select count(*), ")
    assert rosCas.executeCQL("select min(data) from x where data > 1") == [(1.5,)]


ITEMS = "pkg/Item[] items\n{}\n" + "=" * 80 + "\nMSG: pkg/Item\nint32 n\n{}"


@pytest.mark.parametrize("format", ["packed", "ros", "binary"])
def test_every_definition_is_unnested_whatever_it_lacks_beside(rosCas, format):
    """Each message has two items; those of the first definition lack fb, or have it otherwise."""
    older = Types("pkg/T", ITEMS.format("string[] loose\nint32 only_older", "float64[] w"))
    newer = Types("pkg/T", ITEMS.format("int32[] loose\nint32[] fb", "float64 w"))
    with rosCas.messageWriter(format=format) as writer:
        for n, types in enumerate((older, older, newer)):
            item = types.classes["pkg/Item"]
            message = types.root(items=[item(n=1), item(n=5)])
            if types is newer:
                message.fb, message.loose = [3], [3]
            header = {"type": types.name, "md5sum": types.md5sum}
            header["message_definition"] = types.text
            connection = live_connection("/t", header)
            writer.write(writer.connect(connection), T0 + n, n, serialized(message))

    def count(condition):
        return rosCas.executeCQL(f"select count(*) from t where {condition}")[0][0]

    every = "or KEY > 0"
    assert count(f"ALL(fb) <= items.n {every}") == 6
    assert count("ALL(fb) <= items.n") == 1
    assert count(f"ANY(fb) BETWEEN 0 AND items.n + 1 {every}") == 6
    assert count(f"sum(loose) + items.n > 0 {every}") == 6
    assert count("sum(loose) + items.n > 0") == 2
    assert count(f"items.w = 0 {every}") == count(f"items.w contains 0 {every}") == 6
    # Each definition lacks one of the fields: nothing matches, and nothing is refused.
    assert count("ANY(fb) = only_older") == count("sum(loose) + only_older = 5") == 0


def test_odd_values(rosCas):
    topic = rosCas.addTopic("/fix", format="ros")
    for n, value in enumerate([math.nan, math.inf, -math.inf, -0.0, 1e-320]):
        topic.addData(NavSatFix(latitude=value), key=T0 + n)
    assert rosCas.executeCQL("select KEY from fix where latitude = 0") == [(key(T0 + 3),)]
    assert rosCas.executeCQL("select KEY from fix where latitude > 0") == [
        (key(T0 + 1),),
        (key(T0 + 4),),
    ]
    assert rosCas.executeCQL("select KEY from fix where latitude != 0 and not latitude < 0") == [
        (key(T0),), (key(T0 + 1),), (key(T0 + 4),)
    ]  # fmt: skip


def test_hostile_names_and_values_stay_data(rosCas):
    name = '\'; DROP KEYSPACE ros; -- "x" \n ü'
    quoted = name.replace('"', '""')
    topic = rosCas.addTopic(name, format="ros")
    topic.addData(String(name), key=T0)
    assert rosCas.executeCQL(f'select data from "{quoted}" where data = ?', [name]) == [(name,)]
    literal = name.replace("'", "''")
    assert rosCas.executeCQL(f"select data from \"{quoted}\" where data = '{literal}'") == [(name,)]


def test_a_topic_without_messages(rosCas):
    rosCas.addTopic("/later", format="ros", msg_type="std_msgs/String")
    assert rosCas.executeCQL("select data from later") == []
    assert rosCas.executeCQL("select count(*) from later") == [(0,)]
    rosCas.addTopic("/unknown")
    assert rosCas.statements.select("select KEY from unknown").columns == ("KEY",)


def test_names_match_patterns(rosCas):
    topic = rosCas.addTopic("/maps", format="ros", key_format="manual")
    for name in ("hall_1", "hall_2", "Hall_3", "yard", "100%"):
        topic.addData(String(name[::-1]), key=name)
    ask = rosCas.executeCQL
    assert sorted(ask("select KEY, data from maps where KEY like 'hall%'")) == [
        ("hall_1", "1_llah"),
        ("hall_2", "2_llah"),
    ]
    assert ask("select count(*) as n from maps where KEY not like '%_'") == [(0,)]
    assert ask("select KEY from maps where KEY = 'yard' and KEY like 'h%'") == []
    assert ask("select min(KEY), max(KEY), count(KEY), min(data) from maps") == [
        ("100%", "yard", 5, "%001")
    ]
    for condition in ("KEY contains 'x'", "KEY like 5", "KEY > 'x'"):
        with pytest.raises(InvalidQuery):
            ask(f"select KEY from maps where {condition}")
    with pytest.raises(InvalidQuery, match="sum is for numbers"):
        ask("select sum(KEY) from maps")
