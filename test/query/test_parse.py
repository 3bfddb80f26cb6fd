# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The grammar: what it takes, and that whatever it is given it answers with a tree or a caret."""

from __future__ import annotations

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from query.carets import check_caret
from suites import search

from cassandra_ros.errors import InvalidQuery
from cassandra_ros.query.tree.parse import parse_condition, parse_select, parse_statement
from cassandra_ros.query.tree.syntax import (
    All,
    Compare,
    CreateIndex,
    Delete,
    DropIndex,
    DurationNs,
    Either,
    IsNull,
    KeyOperand,
    Literal,
    Negation,
    NodeOperand,
    OneOf,
    Select,
    Truncate,
)


def columns(text):
    found = parse_select(text).columns
    return found if found is None else [column.text for column in found]


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("select * from tf", None),
        ("SELECT KEY, NODE, linear.x FROM /cmd_vel;", ["KEY", "NODE", "linear.x"]),
        ("select key, node from t", ["key", "node"]),  # fields, for they are in lower case
        ('select "KEY", "a.b"[2].c from t', ['"KEY"', "a.b[2].c"]),
        ('select "NODE"[1].x, a.KEY from t', ['"NODE"[1].x', "a.KEY"]),
        ('select min("KEY") from t', ['min("KEY")']),
        ("select from, count, select, limit from t", ["from", "count", "select", "limit"]),
        ("select\n  a [ 3 ] . b\nfrom\tt", ["a[3].b"]),
        ("select count(*) from t", ["count(*)"]),
        ("select COUNT ( * ) from t", ["count(*)"]),
        ("select min(x), MAX(a.b[1]) as top, avg(KEY) from t", ["min(x)", "top", "avg(KEY)"]),
        ('select count(*) as n, sum("x") AS "my sum" from t', ["n", "my sum"]),
        ("select KEY as when, a as as, as from t", ["when", "as", "as"]),
        (
            "select min, max, sum, avg, like, contains, is, null from t",
            ["min", "max", "sum", "avg", "like", "contains", "is", "null"],
        ),
    ],
)
def test_columns(text, names):
    assert columns(text) == names


@pytest.mark.parametrize(
    ("text", "topic"),
    [
        ("select * from tf", "tf"),
        ("select * from /husky/data/encoders limit 1", "/husky/data/encoders"),
        ("select * from where where where = 1", "where"),
        ("select * from limit limit 3", "limit"),
        ("select * from ~private", "~private"),
        ('select * from "weird \'topic\'; -- ""quoted"""', "weird 'topic'; -- \"quoted\""),
    ],
)
def test_topics(text, topic):
    assert parse_select(text).topic == topic


def test_conditions_bind_as_they_read():
    tree = parse_condition("a = 1 or b = 2 and not (c = 3 or KEY > 4)")
    assert isinstance(tree, Either)
    first, second = tree.items
    assert (first.operand.text, second.items[0].operand.text) == ("a", "b")
    assert isinstance(second, All)
    assert isinstance(second.items[1], Negation)
    assert isinstance(second.items[1].item.items[1].operand, KeyOperand)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("x = 5", 5),
        ("x = -5", -5),
        ("x = 123456789012345678901234567890", 123456789012345678901234567890),
        ("x = .5", 0.5),
        ("x = 5.", 5.0),
        ("x = -1.5E-3", -0.0015),
        ("x = 'it''s'", "it's"),
        ("x = ''", ""),
        ("x = 'drop table; -- \"'", 'drop table; -- "'),
        ("x = TRUE", True),
        ("x = false", False),
        ("x = -Infinity", float("-inf")),
    ],
)
def test_values(text, value):
    found = parse_condition(text).value.value
    assert found == value
    assert isinstance(found, type(value))


def test_operators_and_lists():
    for sign in ("=", "!=", "<", "<=", ">", ">="):
        assert parse_condition(f"x {sign} 1").operator == sign
        assert parse_condition(f"x{sign}1").operator == sign
    assert parse_condition("x <> 1").operator == "!="
    between = parse_condition("x between 1 and 2 and y = 3")
    assert [item.operator for item in between.items[0].items] == [">=", "<="]
    assert isinstance(parse_condition("NODE in ('a', 'b')").operand, NodeOperand)
    assert isinstance(parse_condition("x not in (1)"), Negation)


def test_patterns_arrays_and_null():
    tree = parse_condition("a like 'x%' and b not like ? and c contains 5 and d.e is null", ["y"])
    like, unlike, contains, null = tree.items
    assert (like.operator, like.value.value) == ("LIKE", "x%")
    assert isinstance(unlike, Negation)
    assert (unlike.item.operator, unlike.item.value.value) == ("LIKE", "y")
    assert (contains.operator, contains.value.value) == ("CONTAINS", 5)
    assert isinstance(null, IsNull)
    assert parse_condition("d is not null").item.operand.text == "d"
    words = parse_condition("like like 'x' or is is null or contains contains 1 or min is null")
    assert [item.operand.text for item in words.items] == ["like", "is", "contains", "min"]


def test_parameters_are_values():
    hostile = "'; drop keyspace ros; --"
    select = parse_select(
        "select a from t where a = ? and b in %s limit ?", [hostile, [1, 2.5, hostile], 7]
    )
    first, second = select.condition.items
    assert first.value == Literal(hostile, 26)
    assert isinstance(second, OneOf)
    assert [value.value for value in second.values] == [1, 2.5, hostile]
    assert select.limit == 7


def test_arithmetic_binds_as_it_reads():
    for text, shown in (
        ("a + b * c - d", "a + b * c - d"),
        ("(a + b) * c", "(a + b) * c"),
        ("a - (b - c)", "a - (b - c)"),
        ("a / b / c", "a / b / c"),
        ("-(a + b)", "-(a + b)"),
        ("- -a", "-(-a)"),
        ("a -1", "a - 1"),
        ("abs(a-b)/2", "abs(a - b) / 2"),
        ("MIN(ranges) + Len(ranges)", "min(ranges) + len(ranges)"),
        ("a + 2 * 3", "a + 6"),
        ("a * (1.5h + 30m)", "a * 2h"),
    ):
        assert parse_condition(f"{text} < b").operand.text == shown
    assert parse_condition("5 < a + 1").operator == ">"
    assert parse_condition("a > 2 + 3 * 4").value.value == 14
    assert parse_condition("a > ? - ?", [5, 3]).value.value == 2


def test_any_and_all():
    found = parse_condition("ANY(a) = 5")  # of which the planner knows what it can do
    assert (type(found), found.operand.text, found.operator) == (Compare, "a", "CONTAINS")
    found = parse_condition("0.2 > any(ranges)")
    assert (found.text, found.every) == ("ANY(ranges) < 0.2", False)
    found = parse_condition("ALL(a) NOT BETWEEN b AND 3")
    assert found.text == "ALL(a) NOT (>= b AND <= 3)"
    assert parse_condition("any = 1 and all.any > 2").items[1].operand.text == "all.any"


@pytest.mark.parametrize(
    ("text", "ns"),
    [
        ("1h", 3600 * 10**9),
        ("1h30m", 5400 * 10**9),
        ("1.5s", 15 * 10**8),
        ("-500ms", -5 * 10**8),
        (".1us", 100),
        ("2d", 2 * 86400 * 10**9),
        ("7ns", 7),
    ],
)
def test_durations(text, ns):
    found = parse_condition(f"x > {text}").value.value
    assert isinstance(found, DurationNs)
    assert found == ns


def test_now_is_one_moment_of_each_parsing():
    before = time.time_ns()
    first, second = parse_condition("KEY > now() - 1h and KEY < now()").items
    assert second.value.value - first.value.value == 3600 * 10**9
    assert before <= second.value.value <= time.time_ns()
    again = parse_condition("KEY > now() - 1h and KEY < now()").items[1].value.value
    assert again > second.value.value


def test_groups_and_distinct():
    select = parse_select(
        "select distinct a, time(10s), b + ? as s from t where c > ? "
        "group by time(10s), a order by s desc, count(*), a limit ?",
        [1, 2, 3],
    )
    assert select.distinct
    assert [term.text for term in select.group] == ["time(10s)", "a"]
    assert [(part.what.text, part.descending) for part in select.order] == [
        ("s", True),
        ("count(*)", False),
        ("a", False),
    ]
    assert (select.columns[2].what.text, select.limit) == ("b + 1", 3)
    for text in ("select distinct from t", "select distinct, a from t", "select distinct.x from t"):
        assert not parse_select(text).distinct


def test_limit_and_order():
    select = parse_select("select a from t order by KEY desc limit 10 allow filtering")
    assert (select.descending, select.limit) == (True, 10)
    assert not parse_select("select a from t order by KEY").descending


@pytest.mark.parametrize(
    ("text", "params", "spot", "word"),
    [
        ("select a form t", (), "form", "did you mean FROM?"),
        ("select a from t wher x = 1", (), "wher", "did you mean WHERE?"),
        ("select a, from t where", (), "t where", "FROM"),
        ("select a from t where x == 1", (), "= 1", "a number"),
        ("select a from t where x = 'open", (), "'open", "not closed"),
        ("select a from t where x = ?", (), "?", "1 parameters, 0 were given"),
        ("select a from t", [1], "", "0 parameters, 1 were given"),
        ("select a from t where x in ?", [3], "?", "list"),
        ("select a from t limit 0", (), "0", "at least 1"),
        ("select a from t limit ?", [True], "?", "at least 1"),
        ("select a from t limit 5.5", (), ".5", "ALLOW"),
        ("select count(*) + 1 from t", (), "count", "stands alone in SELECT"),
        ("select *, KEY from t", (), ",", "* stands alone: it gives KEY and every field"),
        ("select * frm t", (), "frm", "did you mean FROM?"),
        ("select *", (), "", "the statement ends here; expected FROM"),
        ("select min(*) from t", (), "*", "min takes one field"),
        ("select floor(x) from t", (), "floor", "there is no function floor; the functions are "),
        ("select su(x) from t", (), "su", "there is no function su (did you mean sum?); the"),
        (
            "select a from t where b.lenn (x) = 1",
            (),
            "lenn",
            "lenn (did you mean len?)",
        ),
        (
            "select a from t where x > 1 + tim(1s)",
            (),
            "tim",
            "tim (did you mean time?)",
        ),
        (
            "select a from t where nearr(1, 2)",
            (),
            "nearr",
            "nearr (did you mean near?)",
        ),
        ("select a from t group by cont(x)", (), "cont", "cont (did you mean count?)"),
        ("create index foo (x)", (), "(", "found '('; expected ON"),
        ("select a from t where b = 1 and count(c) > 3", (), "count", "count(c) is made of all"),
        ("select a from t where 1 < 2", (), "1", "names no field"),
        ("select a from t where 'x' like 'x%'", (), "'x'", "names no field"),
        ("select a from t where 1 + 1 in (2, 3)", (), "+ 1 in", "names no field"),
        ("select a from t where 7 in ?", ([1, 7],), "7", "names no field"),
        ("select a from t where 'x' contains 1", (), "'x'", "names no field"),
        ("select a from t where not 1 is null", (), "1 is", "names no field"),
        ("select a from t where ANY(b) + 1 > 2", (), "ANY", "stands alone on one side"),
        ("select ALL(b) from t", (), "ALL", "stands alone on one side"),
        ("select a from t where ANY(b + 1) > 2", (), "+", "takes an array, not b + 1"),
        ("select a from t where ANY(b) > ALL(c)", (), "ALL", "stands alone"),
        ("select a from t where a like b", (), "b", "text stands in quotes"),
        ("select a from t where a in (1, b)", (), "b", "differs from row to row"),
        ("select a from t where a > now(1)", (), "now", "takes nothing"),
        ("select a from t where KEY > now() - 1", (), "- 1", "a duration is written 5s"),
        ("select a from t where KEY > now() + now()", (), "+ now", "cannot be computed of a time"),
        ("select a from t where a > 1s / 0", (), "/ 0", "cannot be computed"),
        ("select a from t where a > 1 + ?", ["x"], "+", "an integer and a string"),
        ("select a from t where a > -?", [True], "?", "true is not a number"),
        ("select a from t where a = " + "(" * 9 + "-a" + ")" * 8, (), "", "')'"),
        ("select time(*) from t", (), "*", "time takes one duration"),
        ("select a from t group a", (), "a", "BY"),
        ("select a from t where x like", (), "", "the statement ends here"),
        ("select a from t where x is 5", (), "5", "NULL"),
        ("select a as 5 from t", (), "5", "a field"),
        ("  delete from t where a = 1", (), "delete", "executeCQL runs"),
        ("truncate t", (), "truncate", "executeCQL runs"),
        ("select a from t where x = null", (), "null", "IS NULL"),
        ("select a from t where x in (1", (), "", "','"),
        ("select a from t /* where", (), "/*", "not closed"),
        ("", (), "", "SELECT"),
        ("select a from t order by *", (), "*", "a field"),
        ("select a from t where x = " + "9" * 500, (), "9", "digits"),
        ("select a from t where key = 1; select b from t", (), "select b", "found"),
    ],
)
def test_errors_point_at_the_spot(text, params, spot, word):
    with pytest.raises(InvalidQuery) as caught:
        parse_select(text, params)
    assert text[caught.value.position :].startswith(spot)
    assert word in caught.value.reason
    lines = str(caught.value).split("\n")
    assert lines[-1].strip() == "^"


@pytest.mark.parametrize("blank", [" ", "\n", "\n\n   ", "\t", "\n\t", " \t\n \t  \t", "\r\n  "])
@pytest.mark.parametrize(
    ("words", "spot"),
    [
        ("select a frm t where x is 5", "frm"),
        ("select a from t where x is 5 limit 3", "5"),
        ("select a, \"ü\", b from t where a = 'é' oder b = 2", "oder"),
        ("select a from t where x like", ""),
        ("delete from t wher a = 1", "wher"),
    ],
)
def test_the_caret_stands_under_the_spot(words, spot, blank):
    text = words.replace(" ", blank)
    with pytest.raises(InvalidQuery) as caught:
        parse_statement(text)
    assert caught.value.position == (text.index(spot) if spot else len(text))
    check_caret(caught.value)


def test_statements_that_change_the_store():
    deleted = parse_statement("DELETE FROM /tf WHERE KEY < ? AND NODE = %s;", [5, "a"])
    assert isinstance(deleted, Delete)
    assert deleted.topic == "/tf"
    assert [item.value.value for item in deleted.condition.items] == [5, "a"]
    assert isinstance(parse_statement("select a from t"), Select)


@pytest.mark.parametrize(
    ("text", "topic"),
    [
        ("truncate tf", "tf"),
        ("TRUNCATE TABLE /tf;", "/tf"),
        ("truncate table", "table"),  # a topic called so
        ("truncate table;", "table"),
        ("truncate table table", "table"),
        ("truncate tables", "tables"),
        ('truncate "; drop keyspace x; --"', "; drop keyspace x; --"),
    ],
)
def test_truncate(text, topic):
    found = parse_statement(text)
    assert isinstance(found, Truncate)
    assert found.topic == topic
    assert text[found.topic_position :].startswith(topic[:1] if '"' not in text else '"')


@pytest.mark.parametrize(
    ("text", "topic", "field", "name", "condition"),
    [
        ("create index on imu (angular_velocity.x)", "imu", "angular_velocity.x", None, False),
        ('CREATE INDEX Imu_X ON /imu("a.b".c);', "/imu", "a.b.c", "imu_x", False),
        ("create index if not exists on on (on)", "on", "on", None, True),
        ('create index if not exists "If" on t (a)', "t", "a", "If", True),
        ("create index index on index (index)", "index", "index", "index", False),
    ],
)
def test_create_index(text, topic, field, name, condition):
    found = parse_statement(text)
    assert isinstance(found, CreateIndex)
    assert (found.on.topic, found.on.field.text) == (topic, field)
    assert (found.name and found.name.text) == name
    assert found.unless_exists == condition


def test_drop_index():
    named = parse_statement("DROP INDEX IF EXISTS Imu_X")
    assert isinstance(named, DropIndex)
    assert (named.index.text, named.if_exists) == ("imu_x", True)
    assert parse_statement('drop index "if"').index.text == "if"
    by_field = parse_statement("drop index on on (a.b)")
    assert (by_field.index.topic, by_field.index.field.text) == ("on", "a.b")
    assert not by_field.if_exists


@pytest.mark.parametrize(
    ("text", "spot", "word"),
    [
        ("delete from t", "t", "removed by TRUNCATE"),
        ("delete a from t where a = 1", "a from", "removed whole"),
        ("delete * from t", "*", "removed whole"),
        ("delete from t where", "", "the statement ends here"),
        ("delete from t where a = ?", "?", "1 parameters, 0"),
        ("delete from t where KEY = 1 limit 5", "limit", "the end"),
        ("delete from t where a = 1; truncate t", "truncate", "found"),
        ("truncat t", "truncat", "did you mean TRUNCATE?"),
        ("truncate t where a = 1", "where", "the end"),
        ("create index on t", "", "'('"),
        ("create index on t ()", ")", "a field"),
        ("create index on t (KEY)", "KEY", "needs no index"),
        ("create index on t (a[3].b)", "a[3]", "leave [3] out"),
        ("create index on t (a, b)", ", b", "')'"),
        ("create index if exists a on t (b)", "exists", "NOT"),
        ("drop index", "", "a name"),
        ("drop index if not exists a", "not", "EXISTS"),
        ("INSERT INTO t (a) VALUES (1)", "INSERT", "addData"),
        (" update t set a = 1", "update", "never changed"),
        ("drop table t", "table", "removeTopic"),
        ("create table t (a int)", "table", "addTopic"),
        ("create keyspace k", "keyspace", "connectToKeyspace"),
        ("alter table t", "alter", "setMeta"),
        ("use ros", "use", "connectToKeyspace"),
    ],
)
def test_errors_of_other_statements_point_at_the_spot(text, spot, word):
    with pytest.raises(InvalidQuery) as caught:
        parse_statement(text)
    assert text[caught.value.position :].startswith(spot)
    assert word in caught.value.reason


def test_no_parameters_where_nothing_takes_them():
    for text in ("truncate t", "create index on t (a)", "drop index a"):
        with pytest.raises(InvalidQuery, match="0 parameters, 1"):
            parse_statement(text, [1])


@pytest.mark.parametrize(
    "text",
    [
        "/* all of it; */ select a -- , b\nfrom /t // of\nwhere x = 1 /* and y = 2 */",
        "select a from/**/t/*** / **/where x=1--",
        "select a from // a topic\n/t where x = 1",
        '--\n//\nselect a from "t"--x\n where x = 1;--;',
    ],
)
def test_comments(text):
    select = parse_select(text)
    assert select.topic.lstrip("/") == "t"
    assert select.condition == Compare(select.condition.operand, "=", select.condition.value)
    assert columns(text) == ["a"]


def test_what_looks_like_a_comment_is_text_where_it_is_quoted():
    select = parse_select('select "a--b" from "//t/*" where x = \'/* -- \'')
    assert (select.topic, select.columns[0].text) == ("//t/*", "a--b")
    assert select.condition.value.value == "/* -- "
    assert parse_select("select a from /a//b").topic == "/a//b"


def test_lists_without_elements():
    assert parse_condition("x in ()").values == ()
    assert parse_condition("x not in ( )").item.values == ()
    assert parse_condition("x in ?", [[]]).values == ()


@pytest.mark.suite("all", "it parses statements of great depth")
@pytest.mark.parametrize("count", [10_000, 100_000])
def test_depth_is_bounded(count):
    assert isinstance(parse_condition("(" * 1000 + "x = 1" + ")" * 1000), Compare)
    with pytest.raises(InvalidQuery, match="deeper than"):
        parse_condition("not " * count + "x = 1")
    wide = parse_condition(" or ".join(["x = 1"] * (count // 10)))
    assert len(wide.items) == count // 10


def test_text_that_is_no_text():
    for statement in (None, b"select * from t", 5, ["select"]):
        with pytest.raises(InvalidQuery):
            parse_select(statement)
    with pytest.raises(InvalidQuery, match="not one value: give"):
        parse_select("select a from t where a = ?", "x")


def answers(parse, text, params=()):
    try:
        parse(text, params)
    except InvalidQuery as exc:
        assert 0 <= exc.position <= len(text)
        assert str(exc)


WORDS = st.sampled_from(
    "select from where and or not in between order by KEY NODE asc desc limit allow filtering "
    "count min max sum avg like contains is null as min( "
    "delete truncate create drop index table on if exists ix // */ "
    "( ) * , . [ ] = != <> < <= > >= ? %s ; ' \" '' 'a' \"b\" a a.b x[3] /tf tf ~ 1 -1 1e400 "
    "1. .5 nan infinity true false 2013-05-08 '2013-05-08' \n -- /* é \0 \ud800".split(" ")
)


@search(600)
@given(st.lists(WORDS, max_size=25), st.lists(st.integers() | st.text(), max_size=3))
def test_fuzz_of_words(words, params):
    answers(parse_select, " ".join(words), params)
    for start in ("delete from t where", "truncate", "create index", "drop index", "delete"):
        answers(parse_statement, f"{start} {' '.join(words)}", params)
    answers(parse_select, "select * from t where " + " ".join(words), params)
    answers(parse_condition, "".join(words), params)


@search(400)
@given(st.text())
def test_fuzz_of_text(text):
    answers(parse_select, text)
    answers(parse_statement, text)
    answers(parse_condition, text)
    answers(parse_statement, "drop index " + text)
    answers(parse_select, "select a from t where a = '" + text)


@search(200)
@given(st.text(min_size=1), st.text())
def test_quoted_text_stays_data(name, value):
    quoted = name.replace('"', '""')
    literal = value.replace("'", "''")
    select = parse_select(f'select "{quoted}" from "{quoted}" where "{quoted}" = \'{literal}\'')
    assert select.topic == name
    assert select.columns[0].text == name
    assert select.condition.value.value == value
    deleted = parse_statement(f'delete from "{quoted}" where "{quoted}" = \'{literal}\'')
    assert (deleted.topic, deleted.condition.value.value) == (name, value)
    assert parse_statement(f'truncate "{quoted}"').topic == name
    indexed = parse_statement(f'create index "{quoted}" on "{quoted}" ("{quoted}")')
    assert (indexed.name.text, indexed.on.topic, indexed.on.field.text) == (name, name, name)
    assert parse_statement(f'drop index "{quoted}"').index.text == name


def test_m_is_a_metre_in_near_and_a_minute_elsewhere():
    text = "select a from t where t > now() - 20m and near(43.47, -80.54, 20m) and d = 20m"
    later, near, wait = parse_select(text).condition.items
    assert near.text == "NEAR(43.47, -80.54, 20m)"
    assert near.values[2].value == "20m"
    assert later.value.value > 0
    assert wait.value.value == DurationNs(20 * 60 * 10**9)
    # A duration that is no length stays one, which no radius is.
    assert parse_select("select a from t where near(1, 2, 20ms)").condition.values[2].text == "20ms"


def test_in_names_the_frame_of_near():
    """It is the comma before the frame; a radius may have a unit there, too."""
    text = "select a from t where near(1, 2, 3m in 'odom', '/odom') and NODE in ('a', 'b')"
    near, _ = parse_select(text).condition.items
    assert near.text == "NEAR(1, 2, 3m, 'odom', '/odom')"
    bound = parse_select("select a from t where near(1, ?, ? in ?)", [2, 3, "odom"]).condition
    assert bound.text == "NEAR(1, 2, 3, 'odom')"
