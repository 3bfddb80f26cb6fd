# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Topics with a time to live: rows, chunks and directory go together, and reading goes on."""

from __future__ import annotations

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from std_msgs.msg import UInt8MultiArray

from cassandra_ros.errors import MessageNotFound
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.store.tables.expiry import STEPS, rounded

SEC = 10**9
T0 = 1_500_000_000 * SEC
DAY_SEC = 86_400


def fill(writer, count, size=10):
    handle = writer.connect(api_connection("/a", definition_of(UInt8MultiArray), "/x"))
    for n in range(count):
        writer.write(handle, T0 + n * SEC, n, serialize(UInt8MultiArray(data=bytes(size))))


def ttls(cql, rosCas, table, column):
    rows = cql.execute(f'SELECT TTL("{column}") FROM {rosCas.keyspace}."{table}"')
    return [row[0] for row in rows]


def await_expiry(cql, rosCas, table):
    """Wait until the server shows no row, by its own clock."""
    deadline = time.monotonic() + 180
    while ttls(cql, rosCas, table, "_conn") and time.monotonic() < deadline:
        time.sleep(0.1)


def test_all_that_belongs_to_a_row_has_its_time(rosCas, cql):
    topic = rosCas.addTopic("/a", ttl=1000)
    for size in (10, 600_000):
        topic.addData(UInt8MultiArray(data=bytes(size)), key=T0 + size)
    (table,) = topic.tables
    near = range(900, 1001)
    assert all(left in near for left in ttls(cql, rosCas, table.name, "_conn"))
    assert all(left in near for left in ttls(cql, rosCas, table.name, "data") if left)
    chunks = ttls(cql, rosCas, table.name + "_c", "_data")
    assert len(chunks) == 2
    assert all(left - DAY_SEC in near for left in chunks)
    # The directory outlives the rows: it must list all that may be there.
    buckets = ttls(cql, rosCas, "cr_bucket", "state")
    assert buckets
    assert all(1000 < left < 1000 + DAY_SEC for left in buckets)
    rosCas.catalog.adder.close()  # writes the closing values
    assert all(1000 < left < 1000 + DAY_SEC for left in ttls(cql, rosCas, "cr_bucket", "n"))
    topic.removeData(T0 + 10)
    assert all(1000 < left < 1000 + DAY_SEC for left in ttls(cql, rosCas, "cr_bucket", "deleted"))


def test_without_a_ttl_nothing_goes(rosCas, cql):
    topic = rosCas.addTopic("/a")
    topic.addData(UInt8MultiArray(data=bytes(600_000)), key=T0)
    rosCas.catalog.adder.close()
    (table,) = topic.tables
    for name, column in (
        *((table.name, "_conn"), (table.name + "_c", "_data")),
        *(("cr_bucket", "state"), ("cr_bucket", "n")),
    ):
        found = ttls(cql, rosCas, name, column)
        assert found and set(found) == {None}


@pytest.mark.suite("all", "it waits for seconds")
def test_what_has_expired_is_not_there(rosCas, cql):
    topic = rosCas.addTopic("/a", ttl=20)
    keys = [
        topic.addData(UInt8MultiArray(data=bytes(size)), key=T0 + n * 100 * SEC)
        for n, size in enumerate((10, 600_000, 20))
    ]
    (table,) = topic.tables
    counted = topic.countTopicData()
    # A busy machine may take longer for that than they live.
    assert counted == 3 or len(ttls(cql, rosCas, table.name, "_conn")) < 3
    await_expiry(cql, rosCas, table.name)
    for key in (*keys, *(key.ns for key in keys)):
        assert topic.getData(key, default=None) is None
        with pytest.raises(MessageNotFound):
            topic.getData(key)
    assert topic.getData(T0, nearest="either", default=None) is None
    assert list(topic.items()) == list(topic.items(reverse=True)) == []
    assert topic.getData(T0, keys[2]) == []
    assert topic.first() is topic.last() is None
    assert topic.countTopicData() == topic.countTopicData(T0 + 1, keys[2]) == 0
    assert topic.removeData(T0, keys[2]) == 0
    (info,) = rosCas.info()
    assert (info.count, info.bytes, info.buckets, info.first_ns) == (0, 0, 0, None)
    assert rosCas.executeCQL("select count(*) from /a") == [(0,)]
    # It goes on as a topic: what comes next is there.
    lives = False
    while not lives:
        again = topic.addData(UInt8MultiArray(data=b"new"), key=T0)
        found = topic.getData(again, default=None), [*topic.items()], topic.countTopicData()
        lives = ttls(cql, rosCas, table.name, "_conn")  # as long as the answers took
    assert found[0].data == b"new"
    assert [key for key, _ in found[1]] == [again]
    assert found[2] == 1


@pytest.fixture
def asked(rosCas, monkeypatch):
    """The partitions that were asked for since the list was cleared."""
    found, send = [], rosCas.cassandra.send_raw

    def noting(statement, *rest):
        found.append(statement)
        return send(statement, *rest)

    monkeypatch.setattr(rosCas.cassandra, "send_raw", noting)
    return found


@pytest.mark.suite("all", "it waits for seconds")
def test_reading_an_expired_stretch_asks_for_none_of_it(rosCas, cql, asked):
    with rosCas.messageWriter(ttl=2) as writer:
        fill(writer, 200)
    topic = rosCas.getTopic("/a")
    (table,) = topic.tables
    assert table.metadata.bucket_ns == SEC
    await_expiry(cql, rosCas, table.name)
    # Closed buckets are left out by their age, which two servers may tell a little differently.
    deadline = time.monotonic() + 180
    while time.monotonic() < deadline:
        asked.clear()
        assert list(topic.items()) == []
        if not asked:
            break
        time.sleep(0.2)
    assert len(asked) == 0
    assert topic.countTopicData() == rosCas.info()[0].count == 0
    assert topic.getData(T0, nearest="either", default=None) is None
    assert len(asked) == 0


@given(st.integers(1, 2 * 10**9).flatmap(lambda ttl: st.tuples(st.integers(0, ttl), st.just(ttl))))
def test_a_copy_lives_as_long_as_its_original_and_hardly_longer(times):
    """A lifetime of 0 s would mean for ever."""
    left, ttl = times
    assert max(1, left) <= rounded(left, ttl) <= min(ttl, left + max(1, ttl // STEPS))
