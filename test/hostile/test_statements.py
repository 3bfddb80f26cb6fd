# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Changed statements, conditions and cursors: parsed, and run on a store with messages in it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from geometry_msgs.msg import Twist
from hostile.mutate import LONGS, changed_text
from mapping.room import Drive

from cassandra_ros.errors import InvalidQuery
from cassandra_ros.keys import Position, encode_cursor
from cassandra_ros.messages.classes import installed_definition
from cassandra_ros.query.tree.parse import parse_condition, parse_statement
from cassandra_ros.query.tree.statement_completion import NameSource, complete
from cassandra_ros.topics.query_result import ResultPlace, read_cursor

ROOT = Path(__file__).resolve().parents[2]
REAL = (
    "select * from /tf",
    "select KEY, linear.x from /cmd_vel where linear.x > 0.5 and KEY > 1400000000.5",
    "select count(*), max(angle_min) from scan where ranges contains 1.0 limit 5",
    "select transforms.transform.translation.x from tf where transforms.child_frame_id = 'base'",
    "select max(ranges), KEY from /scan where KEY between '2014-05-13T16:53:20Z' and 1e10",
    "select distinct NODE, RUN from tf where NODE in ('a', 'b') order by KEY desc limit 3",
    "select linear.x * 2 + abs(linear.y), sqrt(linear.z) as r from cmd_vel group by NODE",
    "select KEY from /odom where NEAR(1.5, 2.5, 3) and not (KEY < 5 or KEY is null)",
    "select KEY from /odom where child_frame_id like 'b%' allow filtering",
    "delete from /cmd_vel where KEY = 5",
    "create index on /cmd_vel (linear.x)",
    "drop index if exists x on /cmd_vel",
    "truncate /cmd_vel",
)
WORDS = (
    "select SELECT * , from /tf tf where and or not ( ) [ ] [0] [99999999999999999999] = != < <= > "
    ">= in between like contains is null order by KEY desc asc limit group having as distinct "
    "count(*) min( max( sum( avg( abs( sqrt( NODE RUN NEAR( INSIDE( 1 -1 0.5 1e400 nan infinity "
    "'a' '' '%' '' \" \"x\" ? %s -- /* */ ; . .. + - / % true false delete truncate drop create "
    "index if exists on allow filtering linear.x ranges transforms.child_frame_id header.stamp"
).split() + [" ", "\n", "(" * 150, ")" * 150, "not " * 300, "9" * 500, "-" * 300, "x." * 200]
PARAMETERS = (None, True, 1, -1, 2**70, 0.5, float("nan"), "a", "%", "", b"x", [1], ["a"], {}, [])


def statements():
    """The statements above, and those of the page of the language."""
    page = (ROOT / "doc/query.md").read_text(encoding="utf-8")
    return [*REAL, *re.findall(r"(?im)^\s*((?:select|delete) .+?);?$", page)]


@pytest.mark.suite("all", "a search over changed inputs")
def test_statements_parsed(give):
    real = statements()
    assert len(real) > len(REAL)

    def attempt(chance):
        text = changed_text(chance, chance.choice(real), WORDS)
        params = chance.choices(PARAMETERS, k=chance.choice((0, 0, 1, 2)))
        try:
            if chance.random() < 0.3:
                parse_condition(text.partition(" where ")[2] or text, params)
            else:
                parse_statement(text, params)
        except InvalidQuery as exc:
            assert 0 <= exc.position <= len(exc.statement)
            raise

    give("statements parsed", 2000, attempt)


@pytest.mark.suite("all", "a search over changed inputs")
def test_cursors(give):
    real = [
        encode_cursor(Position(5, "röbot", 1 << 40, "t_0")),
        ResultPlace(7, 0, Position(5, "", 1, "t_0")).text,
        ResultPlace(10**15, 3, Position(2**62, "a" * 200, 1, "t_" + "0" * 32)).text,
    ]
    words = [".", "=", "AAAA", "____", "0", "-1", "9" * 40, "1.0.", *map(str, LONGS)]

    def attempt(chance):
        read_cursor(changed_text(chance, chance.choice(real), words))

    give("cursors", 3000, attempt)


@pytest.mark.suite("all", "a search over changed inputs")
def test_statements_run(give, rosCas):
    Drive().store(rosCas, ("/tf", "/tf_static", "/odom", "/scan"), "a")
    topic = rosCas.addTopic("/cmd_vel", format="packed")
    real = [text for text in statements() if text.lower().startswith("select")]

    def store_messages():
        for n in range(5):
            topic.addData(Twist(), key=1_400_000_000 * 10**9 + n)

    store_messages()  # from here on the client has its writing thread

    def attempt(chance):
        if not topic.countTopicData():
            store_messages()
        text = changed_text(chance, chance.choice(real), WORDS)
        params = chance.choices(PARAMETERS, k=chance.choice((0, 0, 0, 1)))
        rows = rosCas.executeCQL(text, params)
        assert all(len(row) == len(rows.columns) for row in rows)

    give("statements run", 300, attempt)


@pytest.mark.suite("all", "a search over changed inputs")
def test_completion(give):
    real = statements()
    fields = installed_definition("sensor_msgs/LaserScan")
    known = NameSource(lambda: ["/tf", "/scan"], lambda topic: [fields], list, lambda: ["a run"])

    def attempt(chance):
        text = changed_text(chance, chance.choice(real), WORDS)
        found = complete(text, chance.randrange(-1, len(text) + 2), known)
        assert 0 <= found.start <= len(text)

    give("completion", 1500, attempt)
