# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Tables of several topics, made together: by one client, by two at once, after one that died."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest
from geometry_msgs.msg import Twist
from std_msgs.msg import Float64, String, UInt8MultiArray

from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.store.connection.cassandra import Cassandra
from cassandra_ros.store.tables.side_tables import CHANGES_A_RENEWAL, SchemaLock
from cassandra_ros.topics.message_writer import Asked

T0 = 1_500_000_000 * 10**9
KINDS = (String, Float64, Twist, UInt8MultiArray)


def asked(count, **options):
    """Wishes for topics /t0, /t1, ... of different types; of every fourth large messages come."""
    return [
        Asked(
            api_connection(f"/t{n}", definition_of(KINDS[n % 4]), "/x"),
            large=n % 4 == 3,
            **options,
        )
        for n in range(count)
    ]


def tables_by_topic(rosCas):
    listing = rosCas.catalog.keyspace.schema.listing(fresh=True)
    return {topic: list(names) for topic, names in listing.by_topic.items()}


def facts(rosCas):
    """What is known of each table but for its name and the time at which it was made."""
    schema = rosCas.catalog.keyspace.schema
    return {
        m.topic: (m.with_(generation=0, date=""), schema.columns(name))
        for name, m in schema.tables(fresh=True).items()
    }


@pytest.mark.suite("all", "make test asks others of its kind")
@pytest.mark.parametrize("form", ["ros", "packed"])
def test_they_are_those_that_are_made_one_by_one(rosCas, connect, new_keyspace, form):
    with rosCas.messageWriter(format=form) as writer:
        writer.make_tables(asked(9))
    with connect(keyspace=new_keyspace) as store, store.messageWriter(format=form) as writer:
        for each in asked(9):
            writer.connect(each.connection, large=each.large)
        assert facts(rosCas) == facts(store)
        assert len(facts(store)) == 9


def test_one_lock_for_all_and_none_for_what_is_there(rosCas, monkeypatch):
    taken, sent = [], []
    enter, change = SchemaLock.__enter__, Cassandra.change_schema
    monkeypatch.setattr(SchemaLock, "__enter__", lambda lock: taken.append(1) or enter(lock))
    monkeypatch.setattr(
        Cassandra, "change_schema", lambda self, cql: sent.extend(cql) or change(self, cql)
    )
    with rosCas.messageWriter() as writer:
        del taken[:], sent[:]
        writer.make_tables(asked(8))
        assert (len(taken), len(sent)) == (1, 8 + 2)
        handles = [writer.connect(each.connection, large=each.large) for each in asked(8)]
        writer.make_tables(asked(9)[::-1])
        assert (len(taken), len(sent)) == (2, 8 + 2 + 1)
        for number, handle in enumerate(handles):
            writer.write(handle, T0, number, serialize(KINDS[number % 4]()))
    assert {t.name: t.countTopicData() for t in rosCas.getAllTopics()} == {
        **{f"/t{n}": 1 for n in range(8)},
        "/t8": 0,
    }


def test_two_types_of_a_topic_know_of_each_other(rosCas):
    both = [
        Asked(api_connection("/t", definition_of(kind), "/x"), format="ros")
        for kind in (String, Float64)
    ]
    options = {"ttl": 3600, "key_format": "hash"}
    rosCas.addTopic("/t", msg_type="std_msgs/String", **options)
    with rosCas.messageWriter() as writer:
        writer.make_tables([*both, both[1]])
    found = rosCas.catalog.keyspace.schema.tables(fresh=True).values()
    assert sorted((m.msg_type, m.ttl, m.key_format) for m in found) == [
        ("std_msgs/Float64", 3600, "hash"),
        ("std_msgs/String", 3600, "hash"),
    ]


def test_two_clients_make_the_same_tables_at_once(rosCas, connect):
    def make_and_write(client):
        order = asked(12)[:: 1 - 2 * client]
        with connect(keyspace=rosCas.keyspace) as store, store.messageWriter() as writer:
            writer.make_tables(order)
            for number, each in enumerate(order):
                handle = writer.connect(each.connection, large=each.large)
                kind = KINDS[int(each.connection.topic[2:]) % 4]
                writer.write(handle, T0 + client, number, serialize(kind()))

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(make_and_write, (0, 1)))
    assert {len(names) for names in tables_by_topic(rosCas).values()} == {1}
    assert [topic.countTopicData() for topic in rosCas.getAllTopics()] == [2] * 12


KILLED = """
import os, signal, sys
sys.path[:0] = sys.argv[4:]
from test_tables_together import asked
from cassandra_ros import RosCassandra
from cassandra_ros.store.tables import side_tables
from cassandra_ros.store.tables.side_tables import SchemaLock
side_tables.LOCK_RENEWAL_SEC = -1.0
renew, renewals = SchemaLock.renew, []
def renew_or_die(lock):
    renewals.append(lock)
    if len(renewals) == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    renew(lock)
with RosCassandra(sys.argv[1], int(sys.argv[2]), keyspace=sys.argv[3]) as store:
    with store.messageWriter() as writer:
        SchemaLock.renew = renew_or_die
        writer.make_tables(asked(12))
"""


@pytest.mark.suite("all", "it kills or cuts something, and waits")
def test_what_a_killed_client_left_is_completed(rosCas, cassandra, cql):
    rosCas.messageWriter().close()  # makes the side tables
    place = [cassandra.host, str(cassandra.port), rosCas.keyspace, os.path.dirname(__file__)]
    done = subprocess.run([sys.executable, "-c", KILLED, *place], timeout=120, check=False)
    assert done.returncode == -signal.SIGKILL
    left = tables_by_topic(rosCas)
    assert len(left) == CHANGES_A_RENEWAL
    held = cql.execute(f"SELECT owner FROM {rosCas.keyspace}.cr_lock WHERE name = 'schema'")
    assert held.one() is not None
    # It runs out after two minutes.
    cql.execute(f"DELETE FROM {rosCas.keyspace}.cr_lock WHERE name = 'schema' IF EXISTS")
    with rosCas.messageWriter() as writer:
        writer.make_tables(asked(12))
        for number, each in enumerate(asked(12)):
            handle = writer.connect(each.connection, large=each.large)
            writer.write(handle, T0, number, serialize(KINDS[number % 4]()))
    now = tables_by_topic(rosCas)
    assert {topic: now[topic] for topic in left} == left
    assert {len(names) for names in now.values()} == {1}
    assert [topic.countTopicData() for topic in rosCas.getAllTopics()] == [1] * 12
    names = {
        name
        for (name,) in cql.execute(
            "SELECT table_name FROM system_schema.tables WHERE keyspace_name = %s",
            (rosCas.keyspace,),
        )
    }
    assert {f"{now[f'/t{n}'][0]}_c" for n in (3, 7, 11)} <= names
