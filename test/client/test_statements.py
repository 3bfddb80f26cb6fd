# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""DELETE and TRUNCATE on a real Cassandra: what goes, what stays, and what is refused."""

from __future__ import annotations

import operator
import uuid

import pytest
from geometry_msgs.msg import TransformStamped
from hypothesis import given
from hypothesis import strategies as st
from sensor_msgs.msg import Image, NavSatFix
from std_msgs.msg import String
from suites import search, sparing
from tf2_msgs.msg import TFMessage

from cassandra_ros import RosCassandra
from cassandra_ros.client.statements import names_of_indexes
from cassandra_ros.errors import InvalidQuery

SEC = 10**9
T0 = 1_400_000_000 * SEC
STAMPS = [T0 + n * SEC + n for n in range(6)]
NODES = ("", "husky", 'it\'s; "--"')


class Kept:
    """A topic with messages of several nodes at equal stamps, and what it should hold."""

    def __init__(self, store, fmt):
        self.store = store
        self.topic = store.addTopic(f"/{fmt}", format=fmt)
        self.name = f"/{fmt}"
        self.left = set()
        self.fill()

    def fill(self):
        number = 0
        for t in STAMPS:
            for node in NODES:
                for _ in range(2):
                    number += 1
                    if (t, node, number) not in self.left:
                        msg = NavSatFix(latitude=float(number))
                        self.topic.addData(msg, key=t, nodeID=node)
                        self.left.add((t, node, number))

    def stored(self):
        rows = self.store.executeCQL(f"select KEY, NODE, latitude from {self.name}")
        return [(key.ns, node, int(latitude)) for key, node, latitude in rows]

    def delete(self, condition, params, satisfied, **options):
        """Run a DELETE and compare with a plain loop."""
        gone = {row for row in self.left if satisfied(*row)}
        found = self.store.executeCQL(
            f"DELETE FROM {self.name} WHERE {condition}", params, **options
        )
        assert found == [(len(gone),)]
        assert found.columns == ("deleted",)
        self.left -= gone
        assert sorted(self.stored()) == sorted(self.left)
        assert self.topic.countTopicData() == len(self.left)


@pytest.fixture(scope="module")
def rosCas(cassandra, cql):
    """One keyspace for all: making one takes longer than most tests."""
    name = f"t_{uuid.uuid4().hex[:16]}"
    with RosCassandra(cassandra.host, cassandra.port, keyspace=name) as store:
        yield store
    cql.execute(f"DROP KEYSPACE {name}")


@pytest.fixture(scope="module", params=sparing(["ros", "binary"], ["ros"], "campaign"))
def kept(request, rosCas):
    return Kept(rosCas, request.param)


@pytest.mark.parametrize(
    ("condition", "params", "satisfied"),
    [
        ("KEY < ?", [STAMPS[2]], lambda t, node, n: t < STAMPS[2]),
        ("KEY <= ?", [STAMPS[2]], lambda t, node, n: t <= STAMPS[2]),
        ("KEY > ?", [STAMPS[2]], lambda t, node, n: t > STAMPS[2]),
        ("KEY >= ?", [STAMPS[2]], lambda t, node, n: t >= STAMPS[2]),
        ("KEY > ? and KEY < ?", STAMPS[1:3], lambda t, node, n: False),
        ("KEY between ? and ?", STAMPS[1:3], lambda t, node, n: t in STAMPS[1:3]),
        ("KEY in (?, ?)", STAMPS[1:4:2], lambda t, node, n: t in STAMPS[1:4:2]),
        ("KEY = '2014-05-13T16:53:21.000000001Z'", (), lambda t, node, n: t == STAMPS[1]),
        ("KEY = 1400000001.000000001", (), lambda t, node, n: t == STAMPS[1]),
        ("KEY = 1400000001.000000002", (), lambda t, node, n: False),
        ("KEY = ? and NODE = ?", [STAMPS[3], NODES[2]],
         lambda t, node, n: (t, node) == (STAMPS[3], NODES[2])),
        ("NODE = ''", (), lambda t, node, n: node == ""),
        ("NODE = 'it''s; \"--\"'", (), lambda t, node, n: node == NODES[2]),
        ("NODE in ('', 'husky', 'x') and KEY > ?", [STAMPS[3]],
         lambda t, node, n: node != NODES[2] and t > STAMPS[3]),
        ("NODE = 'husky' and NODE = ''", (), lambda t, node, n: False),
        ("KEY != ?", [STAMPS[4]], lambda t, node, n: t != STAMPS[4]),
        ("KEY > -1e30", (), lambda t, node, n: True),
        ("KEY < 1e30", (), lambda t, node, n: True),
        ("KEY > 1e30", (), lambda t, node, n: False),
        ("latitude = 5", (), lambda t, node, n: n == 5),
        ("latitude > 5 and KEY <= ?", [STAMPS[1]], lambda t, node, n: n > 5 and t <= STAMPS[1]),
        ("latitude in ? or NODE = 'husky'", [[1, 2.0, 3.5]],
         lambda t, node, n: n in (1, 2) or node == "husky"),
        ("not latitude < 30", (), lambda t, node, n: n >= 30),
        ("status.status is null", (), lambda t, node, n: False),
    ],
)  # fmt: skip
def test_what_is_deleted(kept, condition, params, satisfied):
    kept.fill()
    kept.delete(condition, params, satisfied)


def test_messages_of_one_node_only(kept):
    kept.fill()
    for node in NODES:
        kept.delete("KEY <= ?", STAMPS[:1], lambda t, n, _, of=node: t == STAMPS[0] and n == of,
                    nodeID=node)  # fmt: skip
        kept.delete("latitude > 30", (), lambda _, n, number, of=node: number > 30 and n == of,
                    nodeID=node)  # fmt: skip
    kept.delete("NODE = 'husky'", (), lambda *row: False, nodeID="")
    kept.delete("KEY > 0", (), lambda *row: False, nodeID="nobody")


SIGNS = {"=": operator.eq, "!=": operator.ne, "<": operator.lt, "<=": operator.le,
         ">": operator.gt, ">=": operator.ge}  # fmt: skip
KEYS = [ns + near for ns in STAMPS[1:4] for near in (-1, 0, 1)]
TERMS = st.one_of(
    *(
        st.tuples(st.just(name), st.sampled_from(list(SIGNS)), st.sampled_from(values))
        for name, values in (("KEY", KEYS), ("NODE", NODES[:2]), ("latitude", [1, 6, 7.5, 36]))
    )
)
CONDITIONS = st.recursive(
    TERMS,
    lambda inner: st.one_of(
        st.tuples(st.just("not"), inner),
        st.tuples(st.sampled_from(["and", "or"]), inner, inner),
    ),
    max_leaves=4,
)


def text_of(tree):
    if tree[0] == "not":
        return f"not ({text_of(tree[1])})"
    if tree[0] in ("and", "or"):
        return (
            f"({text_of(tree[1])}) {tree[0]} {text_of(tree[2])}"
            if tree[0] == "and" and (tree[2][0] != "or")
            else f"({text_of(tree[1])}) {tree[0]} ({text_of(tree[2])})"
        )
    value = f"'{tree[2]}'" if isinstance(tree[2], str) else tree[2]
    return f"{tree[0]} {tree[1]} {value}"


def satisfies(tree, row):
    if tree[0] == "not":
        return not satisfies(tree[1], row)
    if tree[0] == "and":
        return satisfies(tree[1], row) and satisfies(tree[2], row)
    if tree[0] == "or":
        return satisfies(tree[1], row) or satisfies(tree[2], row)
    value = dict(zip(("KEY", "NODE", "latitude"), row))[tree[0]]
    return SIGNS[tree[1]](value, tree[2])


@search(50)
@given(CONDITIONS)
def test_any_condition_deletes_what_it_selects(kept, tree):
    if len(kept.left) < 20:
        kept.fill()
    kept.delete(text_of(tree), (), lambda *row: satisfies(tree, row))


def test_elements_of_arrays_delete_their_message(rosCas):
    topic = rosCas.addTopic("/tf", format="ros")
    for n in range(4):
        frames = [TransformStamped(child_frame_id=f"{name}{n}") for name in "ab"]
        topic.addData(TFMessage(frames[:n]), key=T0 + n)
    statement = "delete from tf where transforms.child_frame_id in ('b2', 'a3', 'b3')"
    assert rosCas.executeCQL(statement) == [(2,)]
    assert [key.ns - T0 for key, _ in topic.items()] == [0, 1]


def test_names_and_versions(rosCas):
    topic = rosCas.addTopic("/maps", format="ros", key_format="manual")
    for n in range(6):
        topic.addData(String(str(n)), key=["hall", "yard"][n % 2], nodeID="xy"[n // 3])
    delete = "delete from maps where "
    assert rosCas.executeCQL(delete + "KEY = 'hall' and NODE = 'x'") == [(2,)]
    assert rosCas.executeCQL(delete + "data = '3'") == [(1,)]
    assert sorted(m.data for _, m in topic.items()) == ["1", "4", "5"]
    assert rosCas.executeCQL(delete + "KEY in ('yard', 'attic')", nodeID="y") == [(1,)]
    assert rosCas.executeCQL(delete + "NODE != 'z'") == [(2,)]
    assert topic.countTopicData() == 0
    with pytest.raises(InvalidQuery, match="no order"):
        rosCas.executeCQL(delete + "KEY > 'a'")


def test_large_messages_go_with_their_pieces(rosCas, cql):
    topic = rosCas.addTopic("/image", format="ros")
    for n in range(3):
        image = Image(data=bytes(600_000), height=n)
        topic.addData(image, key=T0 + n)
    assert rosCas.executeCQL("delete from image where height = 1") == [(1,)]
    assert rosCas.executeCQL("delete from image where KEY > ?", [T0 + 1]) == [(1,)]
    assert [m.height for _, m in topic.items()] == [0]
    (table,) = topic.tables
    pieces = cql.execute(f'SELECT "_t" FROM {rosCas.keyspace}.{table.name}_c').all()
    assert {row[0] for row in pieces} == {T0}


def test_truncate(rosCas):
    for name in ("/a", "/ab"):
        rosCas.addTopic(name, format="ros", comment="kept").addData(String("x"), key=T0)
    result = rosCas.executeCQL("truncate a")
    assert (result, result.columns) == ([], ())
    assert rosCas.executeCQL("select count(*) from /a") == [(0,)]
    assert rosCas.getTopic("/a").getMeta["comment"] == "kept"
    assert rosCas.executeCQL("select data from /ab") == [("x",)]
    rosCas.getTopic("a").addData(String("y"), key=T0)
    assert rosCas.executeCQL("TRUNCATE TABLE /a; -- again") == []
    assert rosCas.executeCQL("select data from a") == []


@pytest.mark.parametrize(
    ("statement", "options", "spot", "word"),
    [
        ("delete from fx where KEY > 0", {}, "fx", "/fix"),
        ("delete from fix", {}, "fix", "TRUNCATE"),
        ("delete from fix where lat > 5", {}, "lat", "did you mean latitude"),
        ("delete from fix where KEY < 0 and lat > 5", {}, "lat", "did you mean latitude"),
        ("delete from fix where latitude = 'x'", {}, "'x'", "number"),
        ("delete from fix where KEY > 'noon'", {}, "'noon'", "time"),
        ("delete from fix where NODE = 5", {}, "5", "text"),
        ("delete from fix where KEY > 1400000000", {}, "1400000000", "1400000000.0"),
        ("delete from fix where latitude > 0 or KEY = 5", {}, "5", "5.0"),
        ("delete from fix where KEY > 0", {"limit": 3}, "delete", "SELECT"),
        (" truncate fix", {"limit": 3}, "truncate", "SELECT"),
        ("truncate fix", {"nodeID": "a"}, "truncate", "NODE"),
        ("create index on fix (altitude)", {"nodeID": "a"}, "create", "all nodes"),
        ("truncate /tf", {}, "/tf", "not stored"),
        ("create index on /tf (a)", {}, "/tf", "not stored"),
        ("create index on fix (lat)", {}, "lat", "did you mean latitude"),
        ("create index on fix (header)", {}, "header", "is a message"),
        ("drop index x", {}, "x", "no index is called x"),
        ("drop index on fix (altitude)", {}, "altitude", "indexes are on nothing"),
        ("drop index on fox (altitude)", {}, "fox", "/fix"),
    ],
)
def test_what_is_refused(kept, statement, options, spot, word):
    if not kept.store.existTopic("/fix"):
        kept.store.addTopic("/fix").addData(NavSatFix(), key=T0, nodeID="a")
    with pytest.raises(InvalidQuery) as caught:
        kept.store.executeCQL(statement, **options)
    assert statement[caught.value.position :].startswith(spot)
    assert word in caught.value.reason
    assert kept.store.executeCQL("select NODE from fix") == [("a",)]


def test_indexes(rosCas):
    topic = rosCas.addTopic("/imu", format="ros")
    for n in range(30):
        topic.addData(NavSatFix(latitude=float(n % 3), altitude=float(n)), key=T0 + n)
    ask = rosCas.executeCQL
    created = ask("CREATE INDEX Fix_Lat ON imu (latitude)")
    assert (created, created.columns) == ([], ())
    assert set(topic.getMeta["indexes"]) == {"latitude"}
    with pytest.raises(InvalidQuery, match="has an index on latitude already"):
        ask("create index on /imu (latitude)")
    assert ask("create index if not exists on /imu (latitude)") == []
    assert ask("delete from imu where latitude = 2") == [(10,)]
    assert ask("select count(*) from imu where latitude >= 1") == [(10,)]
    ask('create index "Alt" on imu (altitude)')
    with pytest.raises(InvalidQuery, match="did you mean Alt") as caught:
        ask("drop index alt")  # in lower case unless it is quoted, as in CQL
    assert caught.value.position == len("drop index ")
    assert ask("drop index if exists alt") == []
    assert ask("DROP INDEX fix_LAT") == []
    assert set(topic.getMeta["indexes"]) == {"altitude"}
    assert ask("drop index on imu (altitude)") == []
    assert not topic.getMeta["indexes"]
    for statement in ('drop index "Alt"', "drop index fix_lat", "drop index on imu (altitude)"):
        with pytest.raises(InvalidQuery):
            ask(statement)
    for statement in ('drop index if exists "Alt"', "drop index if exists on imu (altitude)",
                      "drop index if exists on nowhere (altitude)"):  # fmt: skip
        assert ask(statement) == []
    assert ask("select count(*) from imu where latitude >= 1") == [(10,)]


@pytest.mark.suite("all", "make test asks others of its kind")
def test_names_of_indexes(rosCas, cassandra):
    ask = rosCas.executeCQL
    for name in ("/first", "/b"):
        rosCas.addTopic(name, format="ros").addData(NavSatFix(), key=T0)
    ask("create index lat on first (latitude)")
    for statement in ("create index lat on b (latitude)", "create index lat on first (longitude)"):
        with pytest.raises(
            InvalidQuery, match=r"on /first \(latitude\) is called lat already"
        ) as caught:
            ask(statement)
        assert statement[caught.value.position :].startswith("lat on")
    assert not rosCas.getTopic("b").getMeta["indexes"]
    rosCas.renameTopic("/first", "/c")
    rosCas.truncateTopic("/c")
    with RosCassandra(cassandra.host, cassandra.port, keyspace=rosCas.keyspace) as other:
        assert set(other.getTopic("c").getMeta["indexes"]) == {"latitude"}
        other.executeCQL("drop index lat")
        for client in (rosCas, other):  # what each did is seen by the other at once
            client.executeCQL("create index on c (altitude)")
            (rosCas if client is other else other).executeCQL("drop index on c (altitude)")
    # A name goes with its index, however that is removed.
    ask("create index lat on b (latitude)")
    rosCas.getTopic("b").removeIndex("latitude")
    rosCas.getTopic("b").createIndex("latitude")
    with pytest.raises(InvalidQuery, match="no index is called lat"):
        ask("drop index lat")


def test_what_cannot_have_an_index(rosCas):
    rosCas.addTopic("/halls", key_format="manual").addData(String("x"), key="hall")
    rosCas.addTopic("/named", key_format="msg_part", key_part="data").addData(String("x"))
    for statement, spot, word in (
        ("create index on halls (data)", "data", "kept under names"),
        ("create index m on halls (data)", "data", "kept under names"),
        ("create index on named (data)", "data", "already"),
        ("drop index on named (data)", "data", "key_part"),
    ):
        with pytest.raises(InvalidQuery, match=word) as caught:
            rosCas.executeCQL(statement)
        assert statement[caught.value.position :].startswith(spot)
    assert "m" not in names_of_indexes(rosCas.catalog.keyspace.schema.tables(fresh=True))


def test_integers_of_simulated_time_are_nanoseconds(rosCas):
    topic = rosCas.addTopic("/sim", format="ros")
    for n in range(5):
        topic.addData(String(str(n)), key=n * SEC)
    assert rosCas.executeCQL("delete from sim where KEY >= 3000000000") == [(2,)]
    assert rosCas.executeCQL("delete from sim where KEY = 1 or data = '0'") == [(1,)]
    assert [m.data for _, m in topic.items()] == ["1", "2"]


def test_only_select_is_lazy(kept):
    for statement in ("truncate fix", "delete from fix where KEY > 0", "drop index x"):
        with pytest.raises(InvalidQuery, match="executeCQL runs"):
            kept.store.iterCQL(statement)


def test_a_topic_without_messages(rosCas):
    rosCas.addTopic("/later", msg_type="std_msgs/String")
    rosCas.addTopic("/unknown")
    for name in ("later", "unknown"):
        assert rosCas.executeCQL(f"delete from {name} where KEY > 0") == [(0,)]
        assert rosCas.executeCQL(f"delete from {name} where NODE != 'a'") == [(0,)]
        assert rosCas.executeCQL(f"truncate {name}") == []
    with pytest.raises(InvalidQuery, match="has no type yet"):
        rosCas.executeCQL("create index on unknown (data)")


HOSTILE = ["'; DROP KEYSPACE ros; -- ", '"x"; truncate "/other"', "/* */ ? %s {} \\", "\n ü ☃ '\"`"]


def test_hostile_names_and_values_stay_data(rosCas):
    rosCas.addTopic("/other", format="ros").addData(String("kept"), key=T0)
    for name in HOSTILE:
        check_stays_data(rosCas, name)
        assert rosCas.executeCQL("select data from other") == [("kept",)]
    assert {*HOSTILE, "/other"} <= {topic.name for topic in rosCas.getAllTopics()}


def check_stays_data(rosCas, name):
    quoted = name.replace('"', '""')
    literal = name.replace("'", "''")
    topic = rosCas.addTopic(name, format="ros")
    for number, text in enumerate((name, name * 2, "plain")):
        topic.addData(String(text), key=T0 + number, nodeID=name)
    delete = f'DELETE FROM "{quoted}" WHERE '
    assert rosCas.executeCQL(delete + f"data = '{literal}' and NODE = '{literal}'") == [(1,)]
    assert rosCas.executeCQL(delete + "data = ? and NODE = %s", [name * 2, name]) == [(1,)]
    assert rosCas.executeCQL(f'select data, NODE from "{quoted}"') == [("plain", name)]
    for statement in (
        delete + f'"{quoted}" = 1',
        f'create index "{quoted}" on "{quoted}" ("{quoted}")',
        f'drop index "{quoted}"',
        f'drop index on "{quoted}" ("{quoted}")',
    ):
        with pytest.raises(InvalidQuery):
            rosCas.executeCQL(statement)
    assert rosCas.executeCQL(f'truncate "{quoted}"') == []
    assert rosCas.executeCQL(f'select count(*) from "{quoted}"') == [(0,)]
