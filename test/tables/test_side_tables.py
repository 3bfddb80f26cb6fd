# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Reading makes nothing; what first writes makes the keyspace and its side tables."""

from __future__ import annotations

import re
from concurrent import futures

import pytest
from nodes.children import await_true
from std_msgs.msg import String
from suites import sparing
from threads import together

from cassandra_ros.errors import KeyspaceNotFound, TopicNotFound
from cassandra_ros.store.tables import side_tables
from cassandra_ros.store.tables.context_blob import RunContext
from cassandra_ros.store.tables.registry import Loss, LossKind, Run
from cassandra_ros.store.tables.side_tables import LATER_TABLES, SIDE_TABLES

EVERY = {"cr_lock", *SIDE_TABLES}


@pytest.fixture
def tables(cql):
    """Lists the tables of a keyspace; None where it is missing."""

    def look(keyspace):
        where = "WHERE keyspace_name = %s"
        if not cql.execute(f"SELECT * FROM system_schema.keyspaces {where}", (keyspace,)).one():
            return None
        rows = cql.execute(f"SELECT table_name FROM system_schema.tables {where}", (keyspace,))
        return {name for (name,) in rows}

    return look


@pytest.fixture
def foreign(cql, new_keyspace):
    """A keyspace of another program."""
    cql.execute(
        f"CREATE KEYSPACE {new_keyspace} WITH replication = "
        "{'class': 'SimpleStrategy', 'replication_factor': 1}"
    )
    cql.execute(f"CREATE TABLE {new_keyspace}.users (name text PRIMARY KEY)")
    return new_keyspace


def read_all(store):
    assert store.getAllTopics() == store.info() == store.runs() == store.losses() == []
    assert list(store.readMessages()) == []
    assert not store.existTopic("/a")
    with pytest.raises(TopicNotFound):
        store.getTopic("/a")


def test_reading_makes_nothing_and_sees_what_a_writer_makes(connect, foreign, tables):
    with connect(keyspace=foreign) as reader, connect(keyspace=foreign) as writer:
        read_all(reader)
        topic = writer.addTopic("/a")
        assert tables(foreign) == {"users"}
        topic.addData(String("1"), key=1)
        assert tables(foreign) > EVERY
        assert reader.getTopic("/a").getData(1).data == "1"
        assert [info.count for info in reader.info()] == [1]


def test_a_wrong_name_makes_no_keyspace(connect, keyspace, new_keyspace, tables):
    with connect(keyspace=new_keyspace) as store:
        read_all(store)
        with pytest.raises(TopicNotFound, match=f"there is no keyspace '{new_keyspace}'"):
            store.getTopic("/a")
        store.connectToKeyspace(keyspace)
        typo = keyspace[:-1] + "x"
        with pytest.raises(KeyspaceNotFound, match=f"did you mean .*{keyspace}"):
            store.connectToKeyspace(typo, make=False)
        assert store.keyspace == keyspace
        assert tables(new_keyspace) is tables(typo) is None
        store.connectToKeyspace(new_keyspace)
        assert tables(new_keyspace) == set()


def test_what_first_writes_makes_the_keyspace(connect, new_keyspace, tables):
    with connect(keyspace=new_keyspace) as reader, connect(keyspace=new_keyspace) as store:
        assert reader.runs() == []
        store.messageWriter(run=Run("robot", 7, "api")).close()
        assert tables(new_keyspace) == EVERY
        assert [run.node for run in reader.runs()] == ["robot"]


def test_later_tables_are_made_by_what_first_writes_to_them(connect, new_keyspace, tables):
    with connect(keyspace=new_keyspace) as reader, connect(keyspace=new_keyspace) as store:
        store.messageWriter(writer_id=7, run=Run("robot", 7, "api", name="x")).close()
        assert reader.runContext("x") is None
        assert reader.losses(run="x") == []
        assert tables(new_keyspace) == EVERY
        registry, loss = (
            store.catalog.keyspace.registry,
            Loss("/a", "robot", 7, LossKind.NO_CLOCK, 1, 2, 3),
        )
        registry.put_loss(loss)
        assert tables(new_keyspace) == EVERY | {"cr_loss"}
        registry.put_context(7, "robot", RunContext({"p": 1}))
        assert tables(new_keyspace) == EVERY | {"cr_loss", "cr_context"} < set(LATER_TABLES) | EVERY
        assert reader.losses(run="x") == [loss]
        assert reader.runContext("x").params == {"p": 1}


DIRECTORY = ("cr_active", "cr_bucket", "cr_node")
"""The tables that list the buckets: without one of them no message is found, until a repair."""


@pytest.mark.parametrize("name", sparing(sorted(EVERY), kept=["cr_bucket", "cr_lock"]))
def test_a_keyspace_that_lacks_a_side_table(connect, cql, new_keyspace, tables, name):
    with connect(keyspace=new_keyspace) as store:
        store.addTopic("/a").addData(String("1"), key=1)
    cql.execute(f"DROP TABLE {new_keyspace}.{name}")
    left = tables(new_keyspace)
    with connect(keyspace=new_keyspace) as store:
        topic = store.getTopic("/a")
        store.info()
        assert store.runs() == []
        found = topic.countTopicData()
        assert found == (0 if name in DIRECTORY else 1)
        if name not in ("cr_connection", "cr_definition"):
            assert len(list(topic.items())) == found
        assert tables(new_keyspace) == left
        topic.addData(String("2"), key=2)
        assert tables(new_keyspace) == left | {name}
        assert topic.getData(2).data == "2"
        if name in DIRECTORY:
            store.upkeep.check(repair=True)
            assert [msg.data for _, msg in topic.items()] == ["1", "2"]
            assert topic.countTopicData() == 2


@pytest.mark.suite("all", "it waits for seconds")
def test_who_waits_for_the_lock_of_a_killed_program_says_so(rosCas, cql, monkeypatch, caplog):
    monkeypatch.setattr(side_tables, "TELL_SEC", 0.2)
    rosCas.addTopic("/a").addData(String("1"), key=1)
    locks = f"{rosCas.keyspace}.cr_lock"

    def take(ttl):
        # A lightweight transaction, as the lock is taken: other writes have another clock.
        values = "(name, owner) VALUES ('schema', uuid())"
        cql.execute(f"INSERT INTO {locks} {values} IF NOT EXISTS USING TTL {ttl}")

    def warnings():
        texts = [record.getMessage() for record in caplog.records]
        return [text for text in texts if "lock" in text]

    def wait_and_run_out():
        await_true(warnings)
        cql.execute(f"DELETE FROM {locks} WHERE name = 'schema' IF EXISTS")
        take(1)

    take(100)
    together(lambda: rosCas.addTopic("/b").addData(String("2"), key=2), wait_and_run_out)
    assert rosCas.getTopic("/b").getData(2).data == "2"
    (told,) = warnings()
    assert told.startswith(f'waiting for the schema lock in "{rosCas.keyspace}"."cr_lock": another')
    left = re.search(r"killed meanwhile, its lock runs out in ([0-9]+) s; else .* 150 s$", told)
    assert 0 < int(left[1]) <= 100


def test_a_table_that_is_listed_before_it_can_be_read_is_waited_for(rosCas, cql, keyspace):
    """As another client's new table: here one that is dropped, and made again during the read."""
    registry = rosCas.catalog.keyspace.registry
    registry.put_loss(Loss("/t", "", 7, LossKind.BUFFER_FULL, 1, 2, 3))
    cql.execute(f"DROP TABLE {keyspace}.cr_loss")
    with futures.ThreadPoolExecutor(1) as pool:
        losses = pool.submit(registry.losses)
        with pytest.raises(futures.TimeoutError):
            losses.result(timeout=0.3)
        cql.execute(f"CREATE TABLE {keyspace}.cr_loss ({LATER_TABLES['cr_loss']})")
        assert losses.result(timeout=60) == []
