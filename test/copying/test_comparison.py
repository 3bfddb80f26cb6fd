# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Two stores are compared, what differs is named and repaired; the books say what waits."""

from __future__ import annotations

import pytest
from copying.test_replicator import SEC, T0, home, messages  # noqa: F401
from std_msgs.msg import String
from suites import FEW_FORMATS, sparing
from upkeep.test_convert import fill

from cassandra_ros.metadata import FORMAT_NAMES
from cassandra_ros.stores.copying.copy_status import copy_status
from cassandra_ros.stores.copying.replicator import Replicator


@pytest.mark.parametrize("there", sparing(FORMAT_NAMES, FEW_FORMATS, "campaign"))
@pytest.mark.parametrize("here", sparing(["ros", "packed"], kept=["packed"]))
def test_copies_are_equal_in_any_format(rosCas, home, here, there):  # noqa: F811
    fill(rosCas, here, 60)
    fill(home, there, 20, writers=((9, "r2"),))
    Replicator(rosCas, home).copy()
    result = Replicator(rosCas, home).compare()
    assert result.equal
    assert result.messages == 120


@pytest.mark.parametrize("fmt", sparing(FEW_FORMATS, kept=["packed"]))
def test_what_is_missing_there_is_named_and_repaired(rosCas, home, fmt):  # noqa: F811
    fill(rosCas, fmt, 60)
    Replicator(rosCas, home).copy()
    low = T0 + SEC
    gone = home.getTopic("/t").removeData(low, low + SEC - 1)
    assert gone
    assert Replicator(rosCas, home).copy().messages == 0
    result = Replicator(rosCas, home).compare()
    assert not result.equal
    assert {(each.topic, each.first_ns) for each in result.differences} == {("/t", low)}
    assert sum(each.here.messages - each.there.messages for each in result.differences) == gone
    assert Replicator(rosCas, home).compare(repair=True).equal
    assert messages(home) == messages(rosCas)
    assert home.getTopic("/t").countTopicData() == 120


def test_a_changed_message_is_found(rosCas, home, cql):  # noqa: F811
    rosCas.addTopic("/t", "ros").addData(String("a"), key=T0)
    rosCas.catalog.adder.close()
    Replicator(rosCas, home).copy()
    (table,) = home.getTopic("/t").tables
    name = f'"{home.keyspace}"."{table.name}"'
    (key,) = cql.execute(f'SELECT "_node", "_bucket", "_t", "_seq" FROM {name}')
    where = '"_node" = %s AND "_bucket" = %s AND "_t" = %s AND "_seq" = %s'
    cql.execute(f"UPDATE {name} SET data = 'b' WHERE {where}", key)
    (difference,) = Replicator(rosCas, home).compare().differences
    assert difference.here.messages == difference.there.messages == 1
    assert Replicator(rosCas, home).compare(repair=True).equal


def test_names_are_compared(rosCas, home):  # noqa: F811
    topic = rosCas.addTopic("/maps", "ros", key_format="manual")
    for name in ("kitchen", "hall", "kitchen"):
        topic.addData(String(name), key=name)
    rosCas.catalog.adder.close()
    assert not Replicator(rosCas, home).compare().equal
    Replicator(rosCas, home).copy()
    assert Replicator(rosCas, home).compare().messages == 3


def test_comparing_makes_nothing(rosCas, home):  # noqa: F811
    fill(rosCas, "ros", 10)
    result = Replicator(rosCas, home).compare()
    assert not result.equal
    assert all(each.there.messages == 0 for each in result.differences)
    assert home.getAllTopics() == []
    assert copy_status(rosCas.catalog) == []


def test_the_books_say_what_is_copied_and_what_waits(rosCas, home):  # noqa: F811
    fill(rosCas, "ros", 30)
    rosCas.addTopic("/maps", "ros", key_format="manual").addData(String("x"), key="x")
    rosCas.addTopic("/no", msg_type="std_msgs/String").addData(String("x"), key=T0)
    home.addTopic("/no", msg_type="std_msgs/Int64")
    rosCas.catalog.adder.close()
    Replicator(rosCas, home).copy()
    fill(rosCas, "ros", 20, writers=((9, "r2"),))
    rosCas.getTopic("/maps").addData(String("y"), key="y")
    rosCas.catalog.adder.close()
    states = {each.topic: each for each in copy_status(rosCas.catalog)}
    assert (states["/t"].copied, states["/t"].waiting) == (60, 20)
    assert states["/t"].waiting_bytes > 0
    assert states["/t"].waiting_sec > 0
    assert (states["/maps"].copied, states["/maps"].waiting) == (1, 1)
    assert (states["/no"].copied, states["/no"].waiting) == (0, 1)
    assert "std_msgs/Int64" in states["/no"].refused
    assert [each.topic for each in copy_status(rosCas.catalog, ["/t"])] == ["/t"]
    Replicator(rosCas, home).copy()
    states = {each.topic: each for each in copy_status(rosCas.catalog)}
    assert (states["/t"].copied, states["/t"].waiting) == (80, 0)
    assert (states["/maps"].copied, states["/maps"].waiting) == (2, 0)


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_keyspace_made_again_has_nothing_of_what_was_copied(rosCas, connect, new_keyspace, cql):
    fill(rosCas, "ros", 10)
    with connect(keyspace=new_keyspace) as home:  # noqa: F811
        assert Replicator(rosCas, home).copy().messages == 20
    cql.execute(f"DROP KEYSPACE {new_keyspace}")
    with connect(keyspace=new_keyspace) as home:
        assert Replicator(rosCas, home).copy().messages == 20
        assert messages(home) == messages(rosCas)
