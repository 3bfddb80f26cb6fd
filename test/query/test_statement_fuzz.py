# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Whatever is said to a store with messages in it: rows, or InvalidQuery."""

from __future__ import annotations

import uuid
from collections import Counter

import pytest
from geometry_msgs.msg import TransformStamped
from hypothesis import HealthCheck, given
from hypothesis import strategies as st
from sensor_msgs.msg import LaserScan, NavSatFix
from std_msgs.msg import String
from suites import CAMPAIGN, search
from tf2_msgs.msg import TFMessage

from cassandra_ros import RosCassandra
from cassandra_ros.errors import InvalidQuery

T0 = 1_400_000_000 * 10**9
FRAMES = [TransformStamped(child_frame_id=name) for name in ("a", "text", "")]

FIELDS = {
    "fix": {
        "number": "latitude status.status header.seq header.stamp.secs position_covariance[0]",
        "time": "header.stamp KEY",
        "text": "header.frame_id NODE RUN",
        "array": "position_covariance",
        "wrong": "header position_covariance[9] nothing",
    },
    "/tf": {
        "number": "transforms[9].transform.rotation.w transforms.transform.translation.x",
        "time": "transforms.header.stamp KEY",
        "text": "transforms.child_frame_id transforms[0].child_frame_id NODE",
        "wrong": "transforms transforms.x",
    },
    "scan": {
        "number": "ranges[1] ranges[7] angle_min scan_time header.stamp.nsecs",
        "time": "KEY",
        "text": "NODE RUN",
        "array": "ranges intensities",
        "wrong": "scan.ranges",
    },
    '"/names"': {"text": "data KEY NODE", "wrong": "data.x"},
}
PARAMETERS = {
    "number": st.integers() | st.floats() | st.sampled_from([0, 1, -1.0]),
    "time": st.sampled_from([T0, T0 + 1, T0 / 1e9, "2014-05-13T16:53:20Z", 0, -1, 2**70]),
    "text": st.text(max_size=3) | st.sampled_from(["a", "text", ""]),
    "array": st.sampled_from([0, 0.0, 1, float("nan")]),
    "wrong": st.booleans() | st.none() | st.binary() | st.sampled_from([[], {}, [[]], object()]),
}
WORDS = {
    "number": "1 0 -0.0 1e400 nan -infinity 99999999999999999999999 -.5",
    "time": "1400000000.0 1400000000000000001 '2014-05-13T16:53:20Z' 1e30 -7 infinity",
    "text": "'text' '' 'a' 't%' '%\\' 'é☃''' '--\"/*'",
    "array": "0 1 0.0 nan",
    "wrong": "true false null \"x\" '2014' nan 'noon' '2014-02-30' 5",
}
VALUES = {
    kind: st.sampled_from(words.split()).map(lambda text: (text, []))
    | PARAMETERS[kind].map(lambda value: ("?", [value]))
    for kind, words in WORDS.items()
}
SIGNS = {
    "number": "= != <> < <= > >=",
    "time": "= != < <= > >=",
    "text": "= != < like",
    "array": "contains",
    "wrong": "= contains like",
}
BROKEN = st.lists(
    st.sampled_from(
        "= <> < like contains in between and or not ( ) is null , . ; -- /* */ min max( count( ' "
        "[0] [99999999999999999999] order by KEY desc limit 3 as where from allow filtering 'a' 1 "
        'x " KEY NODE RUN drop index truncate table if exists on create index data fix'.split()
    ),
    max_size=8,
).map(lambda words: (" ".join(words), []))


def written(pattern, *parts):
    """Put texts where a pattern has {}, and join their parameters."""
    params = [value for _, given_ in parts for value in given_]
    return pattern.format(*(text for text, _ in parts)), params


def rarely(draw, one_of):
    return draw(st.integers(1, one_of)) == one_of


@st.composite
def comparisons(draw, fields):
    if rarely(draw, 20):
        return draw(BROKEN)
    kind = draw(st.sampled_from([kind for kind in fields if kind != "wrong"]))
    operand = (draw(st.sampled_from(fields["wrong" if rarely(draw, 20) else kind].split())), [])
    kind = "wrong" if rarely(draw, 6) else kind
    values = VALUES[kind]
    pattern = draw(st.sampled_from(["{} in ({}, {})", "{} between {} and {}", "in", "", "", "is"]))
    if pattern == "is":
        return written(draw(st.sampled_from(["{} is null", "{} is not null"])), operand)
    if kind == "array" or not pattern:
        sign = draw(st.sampled_from(SIGNS[kind].split()))
        return written("{} " + sign + " {}", operand, draw(values))
    if pattern == "in":
        listed = draw(st.lists(PARAMETERS[kind], max_size=3))
        return written("{} in {}", operand, ("?", [listed]))
    return written(pattern, operand, draw(values), draw(values))


@st.composite
def computed(draw, fields):
    """Something that is computed, of whatever there is."""
    every = " ".join(fields[kind] for kind in fields).split()
    atom = st.sampled_from([*every, "now()", "1h", "-5", "0.5", "''", "true", "KEY"])
    pattern = draw(
        st.sampled_from(
            ["{0} + {1}", "{0} - {1}", "{0} * {1}", "{0} / {1}", "-{0}", "abs({0})", "sqrt({0})"]
            + ["len({0})", "min({0})", "sum({0})", "time({1})", "({0} - {1}) * {0}", "{0}"] * 2
        )
    )
    return pattern.format(draw(atom), draw(atom))


@st.composite
def other_comparisons(draw, fields):
    """Sides that are computed, ANY and ALL, fields beside one another."""
    left, right = draw(computed(fields)), draw(computed(fields))
    quantified = draw(st.sampled_from(["{}", "{}", "ANY({})", "ALL({})"]))
    sign = draw(st.sampled_from("= != < >= like contains between in is".split()))
    tail = {"between": f"between {right} and 5", "in": f"in ({right}, 2)", "is": "is null"}
    text = quantified.format(left) + " " + tail.get(sign, f"{sign} {right}")
    return text, []


def conditions(fields):
    return st.recursive(
        st.one_of(comparisons(fields), comparisons(fields), other_comparisons(fields)),
        lambda inner: st.one_of(
            inner.map(lambda one: written("not ({})", one)),
            st.tuples(inner, inner).map(lambda two: written("{} and {}", *two)),
            st.tuples(inner, inner).map(lambda two: written("({}) or {}", *two)),
        ),
        max_leaves=3,
    )


@st.composite
def statements(draw):
    topic = draw(st.sampled_from(list(FIELDS)))
    where = written(" where {}", draw(conditions(FIELDS[topic])))
    known = " ".join(FIELDS[topic][kind] for kind in FIELDS[topic] if kind != "wrong").split()
    fields = FIELDS[topic]["wrong"].split() if rarely(draw, 20) else known
    if rarely(draw, 20):
        topic = draw(st.sampled_from(["nowhere", '"', "fix;", "/*", '"fix""']))
    if draw(st.booleans()):
        return written(f"delete from {topic}{{}}", where)
    function = draw(st.sampled_from(["{}"] * 3 + "min({}) max({}) sum({}) avg({})".split()))
    some = draw(st.lists(st.sampled_from(fields), min_size=1, max_size=3))
    columns = [function.format(field) for field in some]
    if rarely(draw, 5):
        columns = draw(st.sampled_from([["*"], ["count(*)"], ["KEY", "*"], ["KEY as k", "KEY"]]))
    columns += [draw(computed(FIELDS.get(topic, FIELDS["fix"])))] * rarely(draw, 4)
    tail = draw(st.sampled_from(["", ";", " order by KEY desc limit 2", " limit 1", " -- x;"]))
    if rarely(draw, 3):
        by = draw(st.sampled_from([*some, "time(10s)", "NODE", "RUN", "len(data)", "count(*)"]))
        tail = draw(
            st.sampled_from([" group by {0}", " order by {0}", " group by {0} order by {0}"])
        )
        tail = tail.format(by)
        columns = draw(st.sampled_from([columns, [by, "count(*)"], [f"distinct {by}"]]))
    return written(
        f"select {', '.join(columns)} from {topic}{{}}{tail}",
        where if draw(st.booleans()) else ("", []),
    )


@pytest.fixture(scope="module")
def store(cassandra, cql):
    name = f"t_{uuid.uuid4().hex[:16]}"
    with RosCassandra(cassandra.host, cassandra.port, keyspace=name) as rosCas:
        rosCas.addTopic("/fix", format="ros")
        rosCas.addTopic("/tf", format="ros")
        rosCas.addTopic("/scan", format="binary")
        rosCas.addTopic("/names", format="json", key_format="manual")
        yield rosCas
    cql.execute(f"DROP KEYSPACE IF EXISTS {name}")


def refill(rosCas):
    """Put messages in again where they were deleted."""
    made = {
        "/fix": lambda n: NavSatFix(latitude=n - 1.0),
        "/tf": lambda n: TFMessage(FRAMES[:n]),
        "/scan": lambda n: LaserScan(ranges=[0.0, float("nan"), 1.0][:n]),
        "/names": lambda n: String("text" * n),
    }
    for name, make in made.items():
        topic = rosCas.getTopic(name)
        if not topic.countTopicData():
            for n in range(4):
                topic.addData(make(n), key="at"[n % 2] if name == "/names" else T0 + n, nodeID="a")


@search(500, suppress_health_check=[HealthCheck.too_slow])
@given(st.one_of(statements(), statements(), statements(), BROKEN), st.booleans())
def fuzz(store, answered, asked, short):
    refill(store)
    statement, params = asked
    word = statement.split(" ")[0]
    try:
        rows = store.executeCQL(statement, params[1:] if short and len(params) > 2 else params)
    except InvalidQuery as exc:
        assert 0 <= exc.position <= len(statement)
        assert str(exc)
        answered[word, "refused"] += 1
    else:
        assert all(len(row) == len(rows.columns) for row in rows)
        answered[word, "some" if rows and rows[0][0] not in (0, None) else "none"] += 1


@pytest.mark.suite("all", "a search over changed statements")
@pytest.mark.search
def test_fuzz_of_statements(store):
    answered = Counter()
    fuzz(store, answered)
    least = 10 if CAMPAIGN else 3
    for outcome in ("some", "refused"):  # not all of it was nonsense, and not all was right
        # A search may find few with one outcome, because each example resembles the one before.
        assert answered["select", outcome] + answered["delete", outcome] >= least, answered


@search(200)
@given(
    st.text() | st.text("'\"%?;-/*()[].,=<> aKEY0\n"),
    st.lists(st.one_of(*PARAMETERS.values()), max_size=2),
)
def test_fuzz_of_text(store, text, params):
    for start in ("", "select * from fix where ", "delete from fix where data = '", 'truncate "'):
        try:
            store.executeCQL(start + text, params)
        except InvalidQuery:
            pass
