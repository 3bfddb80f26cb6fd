# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""nearest, joints, rate and yaw in SQL give what a plain loop over the messages gives."""

from __future__ import annotations

import math
import random
import struct
from datetime import timedelta

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from suites import examples

from cassandra_ros.client.sql.sql_result import SqlResult
from cassandra_ros.errors import InvalidQuery
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.messages.stamps import Stamp, iso_time, to_ns

pytest.importorskip("duckdb", reason="SQL needs DuckDB")

T0 = 1_600_000_000 * SECOND_NS
STEP_NS = 10_000_001
"""Times are multiples of it, so that equal times and equal distances are frequent."""
ROBOTS = ("r1", "r2")
LENGTHS = [0, 1, 9, 10, 11, 20, 50, 1000, 86_400_000]
"""Lengths of time, ms."""
SEARCH = settings(
    max_examples=examples(100),
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=list(HealthCheck),
)


def iso(ns):
    return iso_time(ns).rstrip("Z")


def messages_of(seed, robots):
    """Return (ns, robot, run, value), some of equal times, with long pauses."""
    rng = random.Random(seed)
    rows = []
    for number, robot in enumerate(robots):
        for run in (1, 2):
            n = 0
            for _ in range(60):
                n += rng.choice([0, 1, 1, 2, 3, 5, 300])
                rows.append((T0 + n * STEP_NS, robot, str(10 * number + run), float(n * n % 17)))
    return rows


ONES = messages_of(1, [*ROBOTS, "alone"])
OTHERS = messages_of(2, ROBOTS)


@pytest.fixture(scope="module")
def stored(fresh):
    with fresh() as store:
        definition = parse_definition("t/Value", "float64 v\nuint8 few\nint32 partner", None)
        for topic, fmt, rows in (("/one", "packed", ONES), ("/other/b", "ros", OTHERS)):
            for robot, run in sorted({row[1:3] for row in rows}):
                options = {"nodeID": robot, "format": fmt, "writer_id": int(run)}
                with store.messageWriter(**options) as writer:
                    handle = writer.connect(api_connection(topic, definition, "/x"))
                    mine = [row for row in rows if row[2] == run]
                    for number, (ns, _, _, value) in enumerate(mine):
                        wire = struct.pack("<dBi", value, int(value), number)
                        writer.write(handle, ns, number, wire)
        named = store.addTopic("/named", key_format="manual", msg_type="std_msgs/String")
        named.addData(String("x"), key="kitchen")
        yield store


def nearest(one, others, within):
    """Return the time of the nearest of other messages, ns, and whether two are equally near."""
    ns, robot = one[:2]
    near = [o[0] for o in others if o[1] == robot and abs(o[0] - ns) <= within]
    if not near:
        return None, False
    least = min(abs(other - ns) for other in near)
    found = {other for other in near if abs(other - ns) == least}
    return min(found), len(found) > 1


@pytest.mark.search
@SEARCH
@given(
    within=st.sampled_from(LENGTHS),
    low=st.integers(-5, 400),
    length=st.integers(0, 4000),
    robot=st.sampled_from([*ROBOTS, None]),
    turned=st.booleans(),
)
def test_the_nearest_message_is_that_of_a_loop(stored, within, low, length, robot, turned):
    first, last = T0 + low * STEP_NS, T0 + (low + length) * STEP_NS
    ones, others = (OTHERS, ONES) if turned else (ONES, OTHERS)
    topics = "'other/b', 'one'" if turned else "'/one', '/other/b'"
    where = f"KEY BETWEEN '{iso(first)}' AND '{iso(last)}'"
    where += "" if robot is None else f" AND NODE = '{robot}'"
    asked = f"""SELECT KEY, NODE, RUN, v, partner_1.KEY, apart, tie
        FROM nearest({topics}, '{within} ms') WHERE {where}"""
    wanted = []
    for one in ones:
        if first <= one[0] <= last and robot in (None, one[1]):
            found, tie = nearest(one, others, within * 1_000_000)
            apart = None if found is None else (found - one[0]) / 1e9
            found = None if found is None else Stamp.from_ns(found)
            wanted.append((Stamp.from_ns(one[0]), *one[1:], found, apart, tie))
    for pushdown in (True, False):
        rows = SqlResult(stored.catalog, asked, pushdown=pushdown).fetchall()
        assert sorted(rows, key=repr) == sorted(wanted, key=repr)


def test_only_what_can_be_near_is_read(stored):
    low, high = T0 + 300 * STEP_NS, T0 + 310 * STEP_NS
    where = f"NODE = 'r1' AND KEY BETWEEN '{iso(low)}' AND '{iso(high)}' AND v > 3"
    asked = f"SELECT n.v, n.partner_1.few FROM nearest('/one', '/other/b', ?) n WHERE {where}"
    one, other = stored.sql(asked, [timedelta(milliseconds=20)]).explain().topics
    assert one.columns == ("KEY", "NODE", "v") or "v" in one.columns
    assert (one.robots, other.robots) == (("r1",), ("r1",))
    assert one.first_ns <= low and one.last_ns >= high and "v >= " in one.condition
    assert 20_000_000 <= one.first_ns - other.first_ns <= 21_000_000
    assert 20_000_000 <= other.last_ns - one.last_ns <= 21_000_000
    assert other.condition == ""


def test_what_is_read_of_a_topic_elsewhere_in_the_statement_does_not_matter(stored):
    """The topic itself is bounded, and so is one of two calls: neither bounds the other call."""
    late = iso(T0 + 310 * STEP_NS)
    asked = f"""SELECT count(*), count(a.apart), count(b.apart),
            (SELECT count(*) FROM "/other/b" WHERE KEY > '{late}' AND NODE = 'r1')
        FROM nearest('/one', '/other/b', '10 ms') a
        JOIN (SELECT * FROM nearest('/one', '/other/b', '1 day') WHERE KEY > '{late}') b
        ON a.KEY = b.KEY AND a.RUN = b.RUN"""
    whole = SqlResult(stored.catalog, asked, pushdown=False).fetchall()
    assert stored.sql(asked).fetchall() == whole
    assert whole[0][0] > whole[0][1] > 0


def test_all_columns_of_both_topics_are_there(stored):
    found = stored.sql("SELECT * FROM nearest('/one', '/other/b', '1 day') WHERE apart = 0")
    own = ("KEY", "NODE", "RUN", "v", "few", "partner")
    assert found.columns == (*own, "partner_1", "apart", "tie")
    rows = found.fetchall()
    assert set(rows[0][6]) == set(own)
    asked = "SELECT n FROM nearest('/one', '/other/b', '1 day') n WHERE apart = 0"
    assert len(stored.sql(asked).fetchall()) == len(rows) > 0
    ((count,),) = stored.sql("SELECT count(*) FROM nearest('/one', '/one', '1 day')").fetchall()
    assert count == len(ONES)


@pytest.mark.search
@SEARCH
@given(
    gap=st.sampled_from(LENGTHS),
    low=st.integers(-5, 400),
    field=st.sampled_from(["v", "few"]),
    per=st.sampled_from(["", ", per := v > 5"]),
)
def test_rate_is_that_of_a_loop(stored, gap, low, field, per):
    first = T0 + low * STEP_NS
    asked = f"""SELECT KEY, RUN, rate({field}, gap := '{gap} ms'{per})
        FROM "/other/b" WHERE KEY >= '{iso(first)}'"""
    wanted = []
    latest = {}
    for ns, _, run, value in sorted(OTHERS):
        if ns >= first:
            series = run, bool(per) and value > 5
            before, old = latest.get(series, (None, None))
            near = before is not None and 0 < ns - before <= gap * 1_000_000
            change = (value - old) / (ns - before) * 1e9 if near else None
            wanted.append((Stamp.from_ns(ns), run, change))
            latest[series] = ns, value
    assert sorted(stored.sql(asked).fetchall(), key=repr) == sorted(wanted, key=repr)


def test_a_gap_is_two_seconds_unless_it_is_said(stored):
    gaps = ("", ", gap := INTERVAL 2 SECOND", ", gap := '1.9 s'", ", gap := '1 hour'")
    counts = ", ".join(f"count(r{n})" for n in range(len(gaps)))
    rates = ", ".join(f"rate(n{gap}) AS r{n}" for n, gap in enumerate(gaps))
    keys = "SELECT KEY, NODE, RUN, v AS n FROM one UNION ALL SELECT "
    keys += f"make_timestamp_ns(i * {SECOND_NS}), 'x', 'y', i FROM range(0, 9, 2) AS numbers(i)"
    found = stored.sql(f"SELECT {counts} FROM (SELECT {rates} FROM ({keys}) WHERE NODE = 'x')")
    assert found.fetchall() == [(4, 4, 0, 4)]
    fast = "SELECT count(*) FROM (FROM one SELECT rate(v) AS r QUALIFY abs(rate(v)) > 100)"
    assert stored.sql(fast).fetchall()[0][0] > 0


def test_the_arrays_of_joint_states_become_rows(rosCas):
    topic = rosCas.addTopic("/joint_states", msg_type="sensor_msgs/JointState", nodeID="arm")
    whole = {"name": ["a", "b"], "position": [1.0, 2.0], "velocity": [3.0, 4.0]}
    topic.addData(JointState(**whole, effort=[5.0, math.inf]), key=T0)
    topic.addData(JointState(name=["a", "b"], position=[6.0]), key=T0 + SECOND_NS)
    topic.addData(JointState(), key=T0 + 2 * SECOND_NS)
    found = rosCas.sql("SELECT * FROM joints('joint_states') ORDER BY KEY, name")
    assert found.columns == ("KEY", "NODE", "RUN", "name", "position", "velocity", "effort")
    assert [(to_ns(row[0]) - T0, row[1], *row[3:]) for row in found.fetchall()] == [
        (0, "arm", "a", 1.0, 3.0, 5.0),
        (0, "arm", "b", 2.0, 4.0, math.inf),
        (SECOND_NS, "arm", "a", 6.0, None, None),
        (SECOND_NS, "arm", "b", None, None, None),
    ]
    bounded = f"FROM joints('/joint_states') WHERE KEY > '{iso(T0 + 1_000_000)}' AND name = ?"
    (report,) = rosCas.sql(f"SELECT effort {bounded}", ["a"]).explain().topics
    assert report.messages == 2 and "header.stamp" not in report.columns
    rates = "SELECT KEY, rate(position, per := name) AS r FROM joints('/joint_states')"
    assert rosCas.sql(f"SELECT r FROM ({rates}) WHERE r IS NOT NULL").fetchall() == [(5.0,)]
    wide = "PIVOT (SELECT KEY, name, position FROM joints('/joint_states')) ON name"
    rows = rosCas.sql(f"FROM ({wide} USING first(position)) ORDER BY KEY").fetchall()
    assert [row[1:] for row in rows] == [(1.0, 2.0), (6.0, None)]


def test_yaw_is_the_rotation_about_z(stored):
    """Quaternions may have any length, and roll and pitch; for one of zeros it is NULL."""
    for scale in (1.0, 0.5, 1e-9):
        for angle in (0.0, 0.1, 1.5, -3.0, math.pi):
            z, w = scale * math.sin(angle / 2), scale * math.cos(angle / 2)
            asked = f"SELECT yaw({{'x': 0.0, 'y': 0.0, 'z': {z!r}::DOUBLE, 'w': {w!r}::DOUBLE}})"
            assert stored.sql(asked).fetchall()[0][0] == pytest.approx(angle, abs=1e-12)
    turned = "{'x': 0.5, 'y': -0.1, 'z': 0.3, 'w': 0.8}"
    wanted = math.atan2(2 * (0.8 * 0.3 - 0.5 * 0.1), 0.8**2 + 0.5**2 - 0.1**2 - 0.3**2)
    zeros = "{'x': 0.0, 'y': 0.0, 'z': 0.0, 'w': 0.0}"
    asked = f"SELECT yaw(q), yaw({zeros}), yaw(NULL) FROM (SELECT {turned} AS q)"
    assert stored.sql(asked).fetchall() == [(pytest.approx(wanted), None, None)]


def test_a_difference_of_times_is_seconds_by_epoch(stored):
    ((length,),) = stored.sql("SELECT epoch(max(KEY) - min(KEY)) FROM one").fetchall()
    keys = [row[0] for row in ONES]
    assert length == pytest.approx((max(keys) - min(keys)) / 1e9, abs=2e-6)


REFUSED = {
    "SELECT * FROM nearest('/one', '/other/b')": "nearest takes two topics and a length of time",
    "SELECT * FROM nearest('/one', '/other/b', within := '1s')": "nearest takes two topics",
    "SELECT * FROM nearest(one, '/other/b', '1s')": "nearest takes two topics",
    "SELECT * FROM nearest('/' || 'one', '/other/b', '1s')": "nearest takes two topics",
    "SELECT nearest('/one', '/other/b', '1s')": "nearest takes two topics",
    "SELECT * FROM one, LATERAL nearest('/one', '/other/b', '1s')": "nearest takes two topics",
    "SELECT * FROM nearest('/one', '/othr/b', '1s')": "did you mean /other/b",
    "SELECT * FROM nearest('/one', '/named', '1s')": "keys of /named are names",
    "SELECT * FROM nearest('/one', '/other/b', 'soon')": "soon",
    "SELECT * FROM joints()": "joints takes a topic",
    "SELECT * FROM joints('/one')": "joints reads JointState, and /one has no name",
    "SELECT * FROM joints('/named')": "keys of /named are names",
    "SELECT * FROM nearest_1_2F6F6E65": "not stored",
    "SELECT rate() FROM one": "rate takes a column",
    "SELECT rate(v, '1s') FROM one": "rate takes a column",
    "SELECT rate(v, every := '1s') FROM one": "rate takes a column",
    "SELECT rate(v, gap := 'soon') FROM one": "soon",
    "SELECT KEY FROM one WHERE rate(v) > 1": "WHERE clause cannot contain window",
    "SELECT max(rate(v)) FROM one": "select it in a table in FROM",
    "SELECT rate(a.v) FROM one a, one b": "mbiguous",
    "SELECT rate(vv) FROM one": "no column vv",
    "WITH rate(a) AS (SELECT 1) SELECT a FROM rate": "rate takes a column",
    "SELECT yaw(v) FROM one": "struct",
}


@pytest.mark.parametrize("text", REFUSED)
def test_what_is_refused(stored, text):
    with pytest.raises(InvalidQuery, match=REFUSED[text]):
        stored.sql(text).fetchall()
