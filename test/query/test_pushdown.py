# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the server does for a statement, as explainCQL tells; test_every_plan compares answers."""

from __future__ import annotations

import logging
from operator import eq, ge, gt, le, lt

import pytest
from std_msgs.msg import ColorRGBA, Int8
from suites import FEW_FORMATS, sparing
from topics.by_index import await_built

from cassandra_ros.errors import InvalidOption
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.query.plan.pushdown import PLANS

SEC = 10**9
T0 = 1_500_000_000 * SEC
BUCKETS, ROWS = 8, 600


@pytest.fixture(scope="module")
def rosCas(fresh):
    """Colours over 8 buckets of a second; r counts, g is r modulo 10, b has an index."""
    with fresh() as store:
        with store.messageWriter(format="ros") as writer:
            connection = api_connection("/c", definition_of(ColorRGBA), "/x")
            handle = writer.connect(connection, bucket_ns=SEC)
            for n in range(BUCKETS * ROWS):
                wire = serialize(ColorRGBA(n, n % 10, n % 100, 0.5))
                writer.write(handle, T0 + n * SEC // ROWS, n, wire)
        index(store, "b")
        yield store


def index(rosCas, field):
    """Make an index, and wait until it can be asked: createIndex waits until that has begun."""
    rosCas.getTopic("c").createIndex(field)
    await_built(rosCas)


def explained(rosCas, condition, **wanted):
    found = rosCas.explainCQL(f"select KEY from c where {condition}")
    assert found.rows_returned == len(
        list(rosCas.statements.select(f"select KEY from c where {condition}", plan="client"))
    )
    assert {name: getattr(found, name) for name in wanted} == wanted, str(found)
    return found


@pytest.mark.suite("all", "make test asks others of its kind")
def test_an_index_is_used_in_every_bucket(rosCas):
    found = explained(rosCas, "b = 7", buckets=8, indexed=8, filtered=0, whole=0, rows_read=48)
    assert found.server == ("b = 7 (index)",) and found.client == ()


def test_a_filter_beside_an_index(rosCas):
    found = explained(rosCas, "b = 7 and r < 1000 and not g = 3", indexed=8, rows_read=10)
    assert found.server == ("b = 7 (index)", "r < 1000 (filter)")
    assert found.client == ("NOT g = 3",)


def test_of_two_indexes_that_on_what_is_equal_is_used(rosCas):
    index(rosCas, "r")
    found = explained(rosCas, "r > 100 and b = 7", indexed=8, rows_read=47)
    assert found.server == ("b = 7 (index)", "r > 100 (filter)")
    rosCas.getTopic("c").removeIndex("r")


def test_without_an_index_the_server_filters(rosCas):
    explained(rosCas, "r >= 4790", indexed=0, filtered=8, whole=0, rows_read=10)


def test_key_chooses_the_buckets(rosCas):
    found = explained(rosCas, f"r > 0 and KEY < {T0 + SEC}", buckets=8, filtered=1)
    assert found.client == ()
    times = f"{T0 + 10 * SEC // ROWS}, {T0 + 20 * SEC // ROWS}"
    explained(rosCas, f"KEY in ({times})", rows_read=11, rows_returned=2)


@pytest.mark.parametrize(
    ("condition", "most"),
    [
        ("r > 1 and r > 4700", 4799),
        ("r = 5 and r > 1", 1),
        ("r between 0 and 50 and r >= 40", 51),
        ("r in (1, 2) and r > 1", 2),
        ("r > 4000 and r > 4100 and b = 3 and b < 50", 48),
    ],
)
def test_several_bounds_of_one_field_are_not_refused(rosCas, caplog, condition, most):
    with caplog.at_level(logging.DEBUG):
        found = explained(rosCas, condition, whole=0)
    assert 0 < found.rows_read <= most
    assert "read whole" not in caplog.text and "Error preparing" not in caplog.text


def test_many_values_of_two_fields_are_not_multiplied(rosCas):
    found = explained(rosCas, "r in (1, 2, 3) and g in (1, 2, 3)", whole=0, rows_read=3)
    assert found.server == ("r IN (1, 2, 3) (filter)",)
    assert found.client == ("g IN (1, 2, 3)",)
    found = explained(rosCas, "g in (1, 2, 3, 4) and b in (11, 12, 13)", whole=0)
    assert "b IN (11, 12, 13) (index)" in found.server


def test_many_values_are_asked_as_their_span(rosCas):
    explained(rosCas, "r in (3, 5, 7, 11, 13, 17)", whole=0, rows_read=15)


def test_either_is_united(rosCas):
    explained(rosCas, "r < 10 or r > 4790 or b = 3", whole=0, rows_read=68)
    # One side that the server cannot check: nothing is left out.
    explained(rosCas, "r < 10 or not g = 3", whole=8, rows_read=4800)


def test_an_index_that_finds_much_gives_way_to_the_filter(rosCas):
    found = explained(rosCas, "b >= 1")
    assert found.indexed + found.filtered == 8 and found.filtered > 3


def test_several_queries_that_find_much_give_way_to_reading_once(rosCas):
    found = explained(rosCas, "r >= 0 or g >= 0", rows_read=4800)
    assert found.whole > 3


def test_what_no_value_can_be_is_not_looked_for(rosCas):
    found = explained(rosCas, "r = 1e300", skipped=8, rows_read=0)
    assert "8 known to hold nothing" in str(found)


@pytest.mark.parametrize("format", sparing(FEW_FORMATS, kept=["ros"]))
def test_the_ends_of_integers(rosCas, format):
    """A bound at, or beyond, the smallest and the largest value of a column."""
    values = (-128, -127, 0, 126, 127)
    topic = rosCas.addTopic(f"/ends/{format}", format, msg_type="std_msgs/Int8")
    for number, value in enumerate(values):
        topic.addData(Int8(value), key=T0 + number)
    for operator, holds in {"<": lt, "<=": le, "=": eq, ">=": ge, ">": gt}.items():
        for bound in (-129, *values, 128):
            statement = f"select data from /ends/{format} where data {operator} {bound}"
            expected = [(value,) for value in values if holds(value, bound)]
            for plan in PLANS:
                assert list(rosCas.statements.select(statement, plan=plan)) == expected, statement


def test_a_count_by_the_directory(rosCas):
    found = rosCas.explainCQL("select count(*) from c")
    assert found.counted and found.rows_read == 0
    assert "rows read:     0, the directory counts" in str(found)


def test_the_text(rosCas):
    statement = "select KEY from c where b = 7 and not g = 3"
    assert str(rosCas.explainCQL(statement)) == (
        f"{statement}\n"
        "topic:         /c\n"
        "buckets:       8 of 8: 8 by an index\n"
        "server:        b = 7 (index)\n"
        "client alone:  NOT g = 3\n"
        "rows read:     48\n"
        "rows returned: 48"
    )


def test_names_that_no_message_can_have(rosCas):
    rosCas.addTopic("/named", key_format="manual", format="ros").addData(ColorRGBA(), key="a")
    for name in ("", "x" * 5000, "\ud800"):
        assert rosCas.executeCQL("select KEY from named where KEY = ?", [name]) == []


def test_a_page_after_an_aggregate_is_empty(rosCas):
    first = rosCas.statements.select("select max(r) from c", limit=1)
    assert list(first) == [(4799.0,)]
    assert list(rosCas.statements.select("select max(r) from c", limit=1, after=first.cursor)) == []


def test_a_limit_is_a_number_of_rows(rosCas):
    for ask in (rosCas.executeCQL, rosCas.iterCQL):
        with pytest.raises(InvalidOption, match="limit=-1"):
            ask("select KEY from c", limit=-1)
    with pytest.raises(InvalidOption, match="limit=-1"):
        list(rosCas.getTopic("c").items(limit=-1))
