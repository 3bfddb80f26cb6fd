# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Buckets that the server filters: the same rows and order as when all are read."""

from __future__ import annotations

import struct

import pytest
from std_msgs.msg import UInt32
from suites import sparing

from cassandra_ros.errors import SchemaConflict
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.store.rows import reader, row_stream

SEC = 10**9
T0 = 1_500_000_000 * SEC


class Chooser:
    """Asks for the same in each bucket."""

    checks = True

    def __init__(self, *queries, indexed=False, few=False):
        self.few_found = few
        self.queries = [(terms, indexed) for terms in queries]
        self.asked = 0
        self.found = []

    def choose(self, table, bucket):
        self.asked += 1
        return self.queries

    def few(self, table):
        return self.few_found

    def learn(self, table, bucket, found):
        self.found.append(found)


def bound(sign, value):
    return (("data", sign, struct.pack(">q", value)),)


@pytest.fixture(scope="module")
def topic(fresh):
    """600 numbers of two nodes over 30 buckets of a second, with equal stamps."""
    with fresh() as rosCas:
        yield filled(rosCas)


def filled(rosCas):
    for node, writer_id in (("", 5), ("r1", 3)):
        with rosCas.messageWriter(format="ros", writer_id=writer_id, nodeID=node) as writer:
            handle = writer.connect(
                api_connection("/n", definition_of(UInt32), "/x"), bucket_ns=SEC, format="ros"
            )
            for n in range(300):
                writer.write(handle, T0 + n // 2 * SEC // 5, n, serialize(UInt32(data=n)))
    return rosCas.getTopic("/n")


def numbers(rows):
    return [(row.position, row.wire) for row in rows]


def wanted(topic, test, **reading):
    every = topic.rows(**reading)
    return [(r.position, r.wire) for r in every if test(struct.unpack("<I", r.wire)[0])]


@pytest.mark.parametrize("reverse", [False, True])
def test_equal_stamps_at_the_start_of_a_bucket_come_in_one_order(rosCas, reverse):
    """Each of two tables, whatever their names are, has the first message of one bucket."""
    for t, formats in ((T0, ("binary", "yaml")), (T0 + SEC, ("yaml", "binary"))):
        for writer_id, format_name in enumerate(formats, 1):
            with rosCas.messageWriter(writer_id=writer_id) as writer:
                connection = api_connection("/n", definition_of(UInt32), "/x")
                handle = writer.connect(connection, bucket_ns=SEC, format=format_name)
                writer.write(handle, t, 0, serialize(UInt32()))
    topic = rosCas.getTopic("/n")
    assert len(topic.tables) == 2
    wanted = [(t, writer_id) for t in (T0, T0 + SEC) for writer_id in (1, 2)]
    found = [(row.t, row.seq >> 32) for row in topic.rows(reverse=reverse)]
    assert found == (wanted[::-1] if reverse else wanted)


@pytest.mark.suite("all", "make test asks others of its kind")
@pytest.mark.parametrize("page_bytes", [1, 10**6])
@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("few", sparing([False, True], kept=[True]))
def test_filtered_rows_come_in_the_one_order(topic, monkeypatch, page_bytes, reverse, few):
    monkeypatch.setattr(reader, "PAGE_BYTES", page_bytes)
    monkeypatch.setattr(row_stream, "KEYS_AT_ONCE", 3)
    chooser = Chooser(bound("<=", 120), bound(">=", 100), few=few)  # both give 100 to 120
    rows = numbers(topic.rows(reverse=reverse, chooser=chooser))
    assert rows == wanted(topic, lambda n: True, reverse=reverse)
    assert chooser.asked == 60
    chooser = Chooser(bound("=", 120), bound(">=", 290), few=few)
    rows = numbers(topic.rows(reverse=reverse, chooser=chooser))
    assert rows == wanted(topic, lambda n: n == 120 or n >= 290, reverse=reverse)
    assert sum(chooser.found) == len(rows) == 22


def test_what_an_index_finds_is_turned_here(topic):
    chooser = Chooser(bound(">=", 250), indexed=True)
    rows = numbers(topic.rows(reverse=True, chooser=chooser))
    assert rows == wanted(topic, lambda n: n >= 250, reverse=True)


def test_a_cursor_goes_on_between_filtered_rows(topic):
    every = wanted(topic, lambda n: n % 2 == 0)
    chooser = Chooser(*(bound("=", n) for n in range(0, 300, 2)))
    at = every[30][0]
    assert numbers(topic.rows(chooser=chooser, after=at, limit=5)) == every[31:36]


def test_buckets_without_a_query_are_not_read(topic):
    assert numbers(topic.rows(chooser=Chooser())) == []


def test_the_first_row_does_not_cost_all_buckets(topic):
    chooser = Chooser(bound(">=", 0))
    assert len(numbers(topic.rows(chooser=chooser, limit=1))) == 1
    assert chooser.asked < 12


@pytest.mark.parametrize("reverse", [False, True])
def test_what_the_server_refuses_to_filter_is_read_whole(topic, reverse):
    unknown = (("no such column", "=", b"x"),)
    rows = numbers(topic.rows(reverse=reverse, chooser=Chooser(unknown, few=True)))
    assert rows == wanted(topic, lambda n: True, reverse=reverse)
    refused = (("data", "CONTAINS", b"\0"),)  # prepared or run: it is not a list
    rows = numbers(topic.rows(reverse=reverse, chooser=Chooser(refused, bound("=", 3), few=True)))
    assert rows == wanted(topic, lambda n: True, reverse=reverse)


def test_a_value_of_the_wrong_size_is_refused_when_it_is_run(topic):
    rows = numbers(topic.rows(chooser=Chooser((("data", "=", b"123"),), indexed=True)))
    assert rows == wanted(topic, lambda n: True)


def test_a_row_of_few_columns_fetches_the_rest(topic):
    rows = list(topic.rows(columns=lambda table: ()))
    assert {row.columns for row in rows} == {()}
    assert numbers(rows) == wanted(topic, lambda n: True)


def test_a_column_that_somebody_dropped_is_said_at_once(fresh, cql):
    with fresh() as rosCas:
        topic = filled(rosCas)
        (table,) = topic.tables
        cql.execute(f'ALTER TABLE {rosCas.keyspace}."{table.name}" DROP data')
        with pytest.raises(SchemaConflict):
            list(topic.rows())
