# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is recorded is copied all the time, and again after a link was away."""

from __future__ import annotations

import pytest
from copying.test_replicator import T0, home, messages  # noqa: F401
from nodes.children import await_true
from std_msgs.msg import Int64

from cassandra_ros import RosCassandra
from cassandra_ros.stores.copying.follower import AWAY, FOLLOWING, PAUSED, Follower
from cassandra_ros.stores.copying.replicator import Replicator
from cassandra_ros.stores.copying.rules import read_rules


@pytest.fixture
def follow(connect, keyspace, home, proxy):  # noqa: F811
    """Makes a follower whose target is behind the proxy."""

    def make(source, target, rules=None):
        return Replicator(source, target, rules=rules and read_rules(rules))

    def start(rules=None):
        return Follower(
            lambda: connect(keyspace=keyspace),
            lambda: RosCassandra(proxy.host, proxy.port, keyspace=home.keyspace),
            lambda source, target: make(source, target, rules),
            period_sec=0.2,
        )

    return start


def add(store, *numbers):
    topic = store.addTopic("/t", "ros")
    for n in numbers:
        topic.addData(Int64(n), key=T0 + n)
    store.catalog.adder.close()


def count(store):
    return store.getTopic("/t").countTopicData() if store.existTopic("/t") else 0


def test_new_messages_are_copied_until_it_is_paused(rosCas, home, follow):  # noqa: F811
    add(rosCas, 1, 2)
    with follow() as follower:
        await_true(lambda: count(home) == 2)
        add(rosCas, 3)
        await_true(lambda: count(home) == 3)
        await_true(lambda: [topic.copied for topic in follower.status.topics] == [3])
        await_true(lambda: follower.status.state == FOLLOWING)
        (topic,) = follower.status.topics
        assert (topic.topic, topic.copied, topic.waiting) == ("/t", 3, 0)
        assert follower.status.left_sec == 0
        follower.pause()
        await_true(lambda: follower.status.state == PAUSED)
        add(rosCas, 4)
        await_true(lambda: follower.status.waiting == 1)
        assert count(home) == 3
        follower.resume()
        await_true(lambda: count(home) == 4)
    assert messages(home) == messages(rosCas)
    assert not follower.problem


@pytest.mark.suite("all", "it kills or cuts something, and waits")
def test_it_goes_on_after_the_link_was_away(rosCas, home, follow, proxy):  # noqa: F811
    add(rosCas, 1)
    with follow() as follower:
        await_true(lambda: count(home) == 1)
        proxy.cut()
        add(rosCas, 2)
        await_true(lambda: follower.status.state == AWAY, 120)
        assert follower.status.reason
        assert follower.status.place
        proxy.mend()
        await_true(lambda: count(home) == 2, 120)
        await_true(lambda: follower.status.state == FOLLOWING)
    assert messages(home) == messages(rosCas)


def test_a_rule_that_matches_nothing_is_told(rosCas, home, follow, caplog):  # noqa: F811
    add(rosCas, 1)
    with follow("topics: [{pattern: /never}, {pattern: /t}]") as follower:
        await_true(lambda: count(home) == 1)
        await_true(lambda: follower.status.unused == ["/never"])
    assert [r.message for r in caplog.records].count("no topic matches '/never' yet") == 1


def test_what_no_repetition_can_help_ends_it(connect, keyspace, rosCas):
    add(rosCas, 1)
    with Follower(
        lambda: connect(keyspace=keyspace), lambda: connect(keyspace=keyspace), Replicator
    ) as follower:
        await_true(lambda: follower.ended)
    assert "is the store itself" in follower.problem
