# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Several stores asked as one: each message once, in order, and who does not answer is named."""

from __future__ import annotations

import contextlib
import random

import pytest
from geometry_msgs.msg import Twist
from hypothesis import given, settings
from hypothesis import strategies as st
from sensor_msgs.msg import Image
from std_msgs.msg import String

from cassandra_ros import Fleet, RosCassandra
from cassandra_ros.copying.replicator import Replicator
from cassandra_ros.errors import (
    InvalidKey,
    InvalidOption,
    InvalidQuery,
    MessageNotFound,
    RunNotFound,
    SchemaConflict,
    StoreUnavailable,
    TopicNotFound,
)
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of

SEC = 10**9
T0 = 1_500_000_000 * SEC
LAYOUTS = [
    [("ros", "packed"), ("packed",), ("binary",)],
    [("packed",), ("packed",), ("packed",)],
    [("ros",), ("ros",), ("ros",)],
    [("json",), ("ros", "packed"), ()],
]
"""Formats of the topic in each of three stores."""


def twist(number):
    msg = Twist()
    msg.linear.x, msg.linear.y = number % 7, float(number)
    return msg


def messages(seed, count=120):
    """(t, node, writer, counter, message) of several robots, with many equal times."""
    rand, found = random.Random(seed), []
    for number in range(count):
        t = T0 + rand.randrange(40) * SEC // 4
        found.append((t, rand.choice(["", "husky"]), rand.choice([3, 7]), number, twist(number)))
    return found


def write(store, topic, format, rows):
    """Store messages as a recorder or a copy would."""
    kinds = {(node, writer) for _, node, writer, _, _ in rows}
    for node, writer_id in sorted(kinds):
        with store.messageWriter(writer_id=writer_id, nodeID=node, format=format) as writer:
            connection = api_connection(topic, definition_of(Twist), f"/{node}")
            handle = writer.connect(connection, bucket_ns=SEC)
            for t, at, by, number, msg in rows:
                if (at, by) == (node, writer_id):
                    writer.write(handle, t, number, serialize(msg))


def place(store):
    return f"{store.cassandra.hosts[0]}:{store.cassandra.port}/{store.keyspace}"


def fleet_of(*stores, **options):
    return Fleet([place(store) for store in stores], **options)


def plain(rows):
    return [(r.t, r.node, r.seq, r.name, r.topic, r.received, r.run, r.wire) for r in rows]


@pytest.fixture
def stores(fresh):
    """Three empty stores."""
    with contextlib.ExitStack() as stack:
        yield [stack.enter_context(fresh()) for _ in range(3)]


@pytest.fixture(scope="module")
def mixed(fresh):
    """A fleet of three stores that overlap, and one store that has all messages."""
    with contextlib.ExitStack() as stack:
        *three, whole = [stack.enter_context(fresh()) for _ in range(4)]
        for number, layout in enumerate(LAYOUTS):
            rows, rand, topic = messages(number), random.Random(number), f"/t{number}"
            write(whole, topic, "ros", rows)
            # Of each message the stores, at least one of those that have the topic.
            having = [n for n, formats in enumerate(layout) if formats]
            spread = [set(rand.sample(having, rand.randint(1, len(having)))) for _ in rows]
            for n in having:
                mine = [row for row, where in zip(rows, spread) if n in where]
                for m, format in enumerate(layout[n]):
                    write(three[n], topic, format, mine[m :: len(layout[n])])
        with fleet_of(*three) as fleet:
            yield fleet, whole


TOPICS = st.sampled_from([f"/t{number}" for number in range(len(LAYOUTS))])
TIMES = st.none() | st.integers(-1, 41).map(lambda n: T0 + n * SEC // 4)
LIMITS = st.none() | st.integers(0, 130)
ROBOTS = st.sampled_from([None, "", "husky", "nobody"])
WHERE = st.sampled_from([None, "linear.x > 3", "linear.y < 50.0 AND NODE = 'husky'", "RUN = '7'"])


@pytest.mark.campaign
@settings(max_examples=150)
@given(topic=TOPICS, low=TIMES, high=TIMES, limit=LIMITS, robot=ROBOTS, where=WHERE, data=st.data())
def test_a_fleet_answers_like_one_store_with_all_messages(
    mixed, topic, low, high, limit, robot, where, data
):
    fleet, whole = mixed
    reverse = data.draw(st.booleans())
    asked = {"nodeID": robot, "limit": limit, "reverse": reverse, "where": where}
    rows = fleet.rows(topic, low, high, **asked)
    finder = whole.getTopic(topic)._finder(robot, where)
    expected = finder.many(low, high, limit=limit, reverse=reverse)
    assert plain(rows) == plain(expected)
    assert not rows.partial
    if not reverse:
        chosen = {} if where is None else {topic: where}
        received = data.draw(st.booleans())
        times = {"nodeID": robot, "where": chosen, "received": received}
        together = fleet.readMessages([topic, "t1"], low, high, **times)
        assert plain(together) == plain(whole.readMessages([topic, "t1"], low, high, **times))


STATEMENTS = [
    "SELECT KEY, NODE, linear.x FROM {} WHERE KEY >= {} {}",
    "SELECT count(*) FROM {} WHERE KEY >= {}",
    "SELECT count(*) FROM {} WHERE KEY < {} AND NODE = 'husky'",
    "SELECT count(*), min(linear.y), max(linear.y), sum(linear.x) FROM {} WHERE KEY <= {}",
    "SELECT linear.x, count(*) FROM {} WHERE KEY > {} GROUP BY linear.x ORDER BY linear.x",
    "SELECT linear.y, RUN FROM {} WHERE KEY > {} AND RUN = '3' {}",
    "SELECT DISTINCT linear.x FROM {} WHERE KEY > {} {}",
]


@pytest.mark.campaign
@settings(max_examples=100)
@given(
    statement=st.sampled_from(STATEMENTS),
    topic=TOPICS,
    t=st.integers(-1, 41),
    order=st.sampled_from(["", "ORDER BY KEY DESC", "ORDER BY KEY LIMIT 7", "LIMIT 7"]),
    limit=st.none() | st.integers(0, 20),
)
def test_statements_are_answered_over_messages_that_count_once(
    mixed, statement, topic, t, order, limit
):
    fleet, whole = mixed
    text = statement.format(topic, T0 + t * SEC // 4, order if "DISTINCT" not in statement else "")
    found, expected = fleet.executeCQL(text, limit=limit), whole.executeCQL(text, limit=limit)
    assert found == expected
    assert found.columns == expected.columns
    assert not found.partial


def test_messages_and_single_ones(mixed):
    fleet, whole = mixed
    topic = whole.getTopic("t0")
    pairs = list(fleet.items("t0"))
    assert [(key, msg) for key, msg in pairs] == list(topic.items())
    assert fleet.getData("t0", T0, T0 + 3 * SEC) == topic.getData(T0, T0 + 3 * SEC)
    for key, msg in pairs[:40]:
        assert fleet.getData("/t0", key) == msg
        assert fleet.getData("/t0", key.ns) == topic.getData(key.ns)
    for nearest in ("before", "after", "either"):
        for t in (T0 - 5, T0 + 1, T0 + 5 * SEC + 7, T0 + 10**12):
            found = fleet.getRow("t0", t, nearest=nearest)
            expected = topic.getRow(t, nearest=nearest)
            assert (found and found.place) == (expected and expected.place)
    assert fleet.getData("t0", T0 - 1, default=None) is None
    with pytest.raises(MessageNotFound, match="no store of the fleet has a message"):
        fleet.getData("t0", T0 - 1)
    with pytest.raises(InvalidKey):
        fleet.getData("t0", 5, nearest="before")
    assert fleet.topics() == ["/t0", "/t1", "/t2", "/t3"]


def test_each_message_counts_once_in_info(mixed):
    fleet, whole = mixed
    found = fleet.info()
    facts = [(i.topic, i.type, i.node, i.count, i.bytes, i.first_ns, i.last_ns) for i in found]
    expected = [
        (i.topic, i.type, i.node, i.count, i.bytes, i.first_ns, i.last_ns) for i in whole.info()
    ]
    assert facts == expected
    assert all(sum(info.stores.values()) > info.count for info in found)
    assert [i.count for i in fleet.info(["t1"], nodeID="husky", run=7)] == [
        i.count for i in whole.info(["t1"], nodeID="husky", run=7)
    ]
