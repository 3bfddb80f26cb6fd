# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is offered while a statement is typed; | is the cursor."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cassandra_ros.errors import InvalidQuery
from cassandra_ros.messages.classes import installed_definition
from cassandra_ros.query.tree.parse import parse_select
from cassandra_ros.query.tree.statement_completion import NameSource, complete

TOPICS = {
    "/fix": "sensor_msgs/NavSatFix",
    "/tf": "tf2_msgs/TFMessage",
    "/odd name": "std_msgs/String",
}


def definitions(topic):
    kind = TOPICS.get(topic) or TOPICS.get("/" + topic)
    return [installed_definition(kind)] if kind else []


KNOWN = NameSource(
    lambda: list(TOPICS), definitions, lambda: ["husky", "o'neill"], lambda: ["drive"]
)


def offered(text, known=KNOWN):
    return complete(text.replace("|", ""), text.index("|"), known)


def texts(text):
    return [offer.text for offer in offered(text).offers]


def taken(text, choice):
    """The statement once an offer was taken."""
    found = offered(text)
    assert choice in [offer.text for offer in found.offers], found
    before, after = text.split("|")
    return before[: found.start] + choice + after


@pytest.mark.parametrize(
    ("typed", "wanted"),
    [
        ("|", ["SELECT"]),
        ("sel|", ["SELECT"]),
        ("select altitude |", ["FROM", "AS"]),
        ("select altitude f|", ["FROM"]),
        ("select * from |", ["/fix", "/tf", '"/odd name"']),
        ("select * from fi|", ["/fix"]),
        ("select * from /t|", ["/tf"]),
        ("select alt| from /fix", ["altitude"]),
        ("select KEY, header.st| from fix", ["header.stamp"]),
        ("select child| from tf", ["transforms.child_frame_id"]),
        ("select transforms[0].tra| from tf", ["transforms[0].transform.translation.x"]),
        ('select data| from "/odd name"', []),  # it is whole
        ("select * from /fix w|", ["WHERE"]),
        ("select * from /fix where lati|", ["latitude"]),
        ("select * from /fix where altitude > 3 |", ["AND", "OR", "LIMIT", "ORDER BY", "GROUP BY"]),
        ("select * from /fix where NODE = |", ["'husky'", "'o''neill'"]),
        ("select * from /fix where RUN = 'd|", ["'drive'"]),
        ("select ma| from /fix", ["max("]),
        ("select * from /fix where an|", ["any("]),
        ("select * from /fix order by altitude d|", ["DESC"]),
        ("select * from /fix where NODE i|", ["IN (", "IS NULL"]),
        ("select * from /fix where NEAR(1, 2, 3 |", ["IN '"]),
    ],
)
def test_what_may_come_is_offered(typed, wanted):
    found = texts(typed)
    assert all(each in found for each in wanted), found
    assert bool(found) == bool(wanted)


@pytest.mark.parametrize(
    ("typed", "unwanted"),
    [
        ("select * from |", "altitude"),
        ("select altitude |", "altitude"),
        ("select altitude as | from /fix", "latitude"),  # a new name
        ("select * from /fix |", "altitude"),
        ("|", "DELETE"),
        ("select altitude | from /fix", "*"),
        ("select | from /fix", "any("),
        ("select * from /fix where NEAR(1, 2, 3 |", "IN ("),
        ("select * from /fix where NODE |", "IN '"),
    ],
)
def test_what_may_not_come_is_not(typed, unwanted):
    assert unwanted not in texts(typed)


def test_fields_say_their_types_and_what_begins_so_comes_first():
    offers = offered("select position| from /fix").offers
    assert offers[0][:3] == ("position_covariance", "field", "float64[]")
    offers = offered("select id| from /fix").offers
    assert {offer.text for offer in offers} >= {"header.frame_id"}
    assert offered("select lat| from /fix").offers[0].text == "latitude"


def test_what_is_taken_can_be_parsed():
    text = taken("select lat| from fix", "latitude")
    text = taken(text + " wh|", "WHERE")
    text = taken(text + " stat|", "status.status")
    assert parse_select(text + " > 0").topic == "fix"
    assert parse_select(taken("select * from odd|", '"/odd name"')).topic == "/odd name"


def test_a_statement_that_is_wrong_before_gets_no_offers():
    assert offered("select , |").offers == ()
    assert offered("select 'open |").offers == ()
    assert complete("select", 10**9, KNOWN).start == 0


def test_a_topic_that_is_not_stored_offers_no_fields():
    assert not [o for o in offered("select | from /nowhere").offers if o.kind == "field"]


WORDS = ["select", "KEY", "*", ",", "from", "/fix", "where", "altitude", "<", "3", "and", "(", ")"]


@given(st.lists(st.sampled_from(WORDS), max_size=9), st.integers(0, 60))
def test_whatever_is_typed_offers_go_on_from_there(words, cursor):
    text = " ".join(words)
    found = complete(text, cursor, KNOWN)
    assert 0 <= found.start <= min(cursor, len(text))
    before = text[: found.start]
    for offer in found.offers:
        if offer.kind != "keyword":
            continue
        try:
            parse_select(f"{before}{offer.text} \x00")
        except InvalidQuery as exc:  # not what was offered is wrong, but what follows
            assert exc.position >= len(before) + len(offer.text)


def test_a_long_text_is_gone_through_once():
    """Quickly: it took minutes while the word at the cursor was looked for at each character."""
    word = "x" * 100_000
    assert complete(f"select {word} ", len(word) + 8, KNOWN).start == len(word) + 8
    assert complete(f"select {word}", len(word) + 7, KNOWN).start == len("select ")
