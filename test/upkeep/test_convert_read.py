# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Others read, write and delete while a topic is converted; the conversion is killed."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import threading
import time

import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from suites import SUITE, sparing
from upkeep.test_convert import SEC, T0, facts, fill, formats, joint_state, seen

from cassandra_ros.errors import CassandraRosError, SchemaConflict
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.store.tables import replacement, schema
from cassandra_ros.topics.upkeep import conversion as convert
from cassandra_ros.topics.upkeep import table_copy as copying

pytestmark = pytest.mark.suite("all", "other clients read and write while it converts")

TARGETS = {"test": ["packed", "ros"], "all": ["binary", "packed", "yaml", "ros"]}
TARGETS["campaign"] = TARGETS["all"] * 3


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """What a client knows is at most half a second old."""
    monkeypatch.setattr(schema, "CACHE_SEC", 0.5)
    monkeypatch.setattr(replacement, "SETTLE_SEC", 1.5)  # a second more, as usual


class Reading:
    """Reads again and again, each way on a thread and by a client of its own."""

    def __init__(self, connect, keyspace, wanted, keys):
        self.wanted = wanted
        self.keys = keys
        self.failures = []
        self.rounds = {}
        self._stop = threading.Event()
        self._clients = []
        self._threads = []
        for way in (self.scan, self.slowly, self.count, self.look_up, self.ask):
            client = connect(keyspace=keyspace)
            self._clients.append(client)
            self._threads.append(threading.Thread(target=self._run, args=(way, client)))

    def __enter__(self):
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *exc_info):
        self._stop.set()
        for thread in self._threads:
            thread.join()
        for client in self._clients:
            client.close()

    def _run(self, way, client):
        topic = client.getTopic("/t")
        try:
            while not self._stop.is_set() and not self.failures:
                way(client, topic)
                self.rounds[way.__name__] = self.rounds.get(way.__name__, 0) + 1
        except BaseException as exc:  # noqa: BLE001 - the test fails by it
            self.failures.append(f"{way.__name__}: {type(exc).__name__}: {exc}")

    def check(self, what, found, wanted):
        if found != wanted:
            sizes = [len(each) if isinstance(each, list) else each for each in (found, wanted)]
            raise AssertionError(f"{what}: {sizes[0]} instead of {sizes[1]}")

    def scan(self, client, topic):
        self.check("scan", seen(topic.rows()), self.wanted)

    def slowly(self, client, topic):
        """Read over more than one conversion."""
        found, reverse = [], random.random() < 0.5
        for number, row in enumerate(topic.rows(reverse=reverse)):
            found.append(row)
            if number % 50 == 0:
                self._stop.wait(0.2)
        self.check("slowly", seen(found), self.wanted[::-1] if reverse else self.wanted)

    def count(self, client, topic):
        self.check("count", topic.countTopicData(), len(self.wanted))
        self.check("info", sum(each.count for each in client.info(["/t"])), len(self.wanted))
        self.check("names", [each.name for each in client.getAllTopics()], ["/t"])

    def look_up(self, client, topic):
        key, wire = random.choice(self.keys)
        self.check("key", serialize(topic.getData(key)), wire)
        first = next(row for row in self.wanted if row[0] == key.ns)
        self.check("time", serialize(topic.getData(key.ns)), first[-1])
        latest = max(row[0] for row in self.wanted if row[0] <= key.ns + 1)
        first = next(row for row in self.wanted if row[0] == latest)
        near = serialize(topic.getData(key.ns + 1, nearest="before"))
        self.check("nearest", near, first[-1])

    def ask(self, client, topic):
        found = client.executeCQL("SELECT KEY FROM /t WHERE header.seq < 100")
        self.check("condition", len(found), 200)
        self.check("count", list(client.executeCQL("SELECT count(*) FROM /t")), [(600,)])


@pytest.mark.fault
def test_who_reads_sees_each_message_all_the_time_and_once(rosCas, connect, keyspace):
    fill(rosCas, "ros", 300)
    topic = rosCas.getTopic("/t")
    wanted, keys = seen(topic.rows()), [(row.key, row.wire) for row in topic.rows()]
    with Reading(connect, keyspace, wanted, keys) as reading:
        for target in TARGETS[SUITE]:
            assert rosCas.convertTopic("/t", target).messages == 600
            assert not reading.failures
        deadline = time.monotonic() + 180
        while len(reading.rounds) < 5 and not reading.failures and time.monotonic() < deadline:
            time.sleep(0.1)
    assert not reading.failures
    assert len(reading.rounds) == 5
    assert formats(rosCas) == [TARGETS[SUITE][-1]]


KILLED = """
import sys, os, signal
from cassandra_ros import RosCassandra
from cassandra_ros.store.tables import replacement
from cassandra_ros.store.tables.side_tables import SchemaLock
from cassandra_ros.topics.upkeep import conversion as convert
host, port, keyspace, where, target = sys.argv[1:]
replacement.SETTLE_SEC = 0.3
def kill(*args): os.kill(os.getpid(), signal.SIGKILL)
if where == 'drop':
    finish = replacement.finish
    def finish_then(*args):
        finish(*args)
        kill()
    replacement.finish = finish_then
elif where == 'finish':
    replacement.finish = kill
elif where.startswith('DROP'):
    left, change = int(where[4:]), SchemaLock.change
    def change_then(self, cql, **others):
        global left
        left -= cql.startswith('DROP')
        if not left:
            kill()
        change(self, cql, **others)
        left -= cql.startswith('DROP')
        if not left:
            kill()
    SchemaLock.change = change_then
def progress(done, total):
    if where == 'fill' and done >= 150 or where == 'compare' and done >= 450:
        kill()
with RosCassandra(host, int(port), keyspace=keyspace) as rosCas:
    rosCas.convertTopic('/t', target, progress)
"""


def convert_until(cassandra, keyspace, where, target):
    """Convert in a process that is killed at some step."""
    arguments = [cassandra.host, str(cassandra.port), keyspace, where, target]
    done = subprocess.run(
        [sys.executable, "-c", KILLED, *arguments], env=os.environ, timeout=300, check=False
    )
    assert done.returncode == -signal.SIGKILL, where


@pytest.mark.fault
@pytest.mark.parametrize("target", sparing(["binary", "packed"], ["packed"], "campaign"))
def test_one_that_is_killed_is_done_again(rosCas, cassandra, keyspace, monkeypatch, target):
    monkeypatch.setattr(convert, "QUIET_SEC", 0.0)
    fill(rosCas, "ros", 150)
    topic = rosCas.getTopic("/t")
    before, told = seen(topic.rows()), facts(rosCas)
    for where in ("fill", "compare", "finish", "drop"):
        convert_until(cassandra, keyspace, where, target)
        rosCas.catalog.keyspace.schema.tables(fresh=True)
        assert len(rosCas.catalog.keyspace.schema.listing().every) == 2
        assert formats(rosCas) == [target if where == "drop" else "ros"]
        assert seen(topic.rows()) == before
        assert topic.countTopicData() == 300
        if where == "compare":  # into the format that it has: only what was left is removed
            assert rosCas.convertTopic("/t", "ros").messages == 0
            assert len(rosCas.catalog.keyspace.schema.listing(fresh=True).every) == 1
    assert rosCas.convertTopic("/t", target).messages == 0
    assert len(rosCas.catalog.keyspace.schema.listing(fresh=True).every) == 1
    assert seen(topic.rows()) == before
    assert facts(rosCas) == told


@pytest.mark.fault
def test_what_a_killed_one_left_is_deleted_whole(rosCas, cassandra, keyspace, monkeypatch, cql):
    """Each conversion dies at the next step of deleting what the one before left."""
    monkeypatch.setattr(convert, "QUIET_SEC", 0.0)
    fill(rosCas, "ros", 100)
    # The first message needs a table of chunks: each table has one, and two DROPs.
    large = JointState(name=["x" * 4_000_000])
    rosCas.getTopic("/t").addData(large, key=T0 - SEC)
    rosCas.catalog.adder.close()  # a bucket whose heartbeats go on would refuse a conversion
    before = seen(rosCas.getTopic("/t").rows())
    for step in ("DROP1", "DROP2", "DROP3", "DROP4"):
        convert_until(cassandra, keyspace, "fill", "packed")
        convert_until(cassandra, keyspace, step, "packed")
        cql.execute(f"DELETE FROM {keyspace}.cr_lock WHERE name = 'schema' IF EXISTS")
        assert rosCas.convertTopic("/t", "ros").messages == 0
        assert rosCas.upkeep.check().damages == [], step
    assert len(rosCas.catalog.keyspace.schema.listing(fresh=True).every) == 1
    assert seen(rosCas.getTopic("/t").rows()) == before


def during(monkeypatch, what):
    """Do something when the copy is compared, before the switch."""
    compare = copying.TableCopy.compare

    def compare_then(self):
        count = compare(self)
        what()
        return count

    monkeypatch.setattr(copying.TableCopy, "compare", compare_then)


@pytest.mark.parametrize("how", ["addData", "messageWriter"])
def test_what_is_added_meanwhile_is_seen_at_once_and_stays(
    rosCas, connect, keyspace, monkeypatch, how
):
    fill(rosCas, "ros", 50)
    topic = rosCas.getTopic("/t")
    before = seen(topic.rows())
    with connect(keyspace=keyspace) as other:
        writer = other.messageWriter()
        handle = writer.connect(topic.tables[0].connections.get(*_place(topic)))
        added = []

        def add():
            if added:
                return
            msg = joint_state(1000)
            if how == "addData":
                added.append(other.getTopic("/t").addData(msg, key=T0 + 7))
            else:
                writer.write(handle, T0 + 7, 1, serialize(msg))
                writer.flush()
                added.append(None)
            assert len(list(topic.rows())) == 101

        during(monkeypatch, add)
        rosCas.convertTopic("/t", "json")
        writer.close()
    assert len(added) == 1
    after = seen(topic.rows())
    assert len(after) == 101
    assert [row for row in after if row in before] == before
    assert set(formats(rosCas)) == {"json"} if how == "addData" else {"json", "ros"}
    monkeypatch.undo()
    if added[0] is not None:
        assert topic.getData(added[0]).header.seq == 1000


def _place(topic):
    row = next(topic.rows())
    return row.table.name, row.conn


def test_deleting_and_indexing_is_refused_meanwhile(rosCas, connect, keyspace, monkeypatch):
    fill(rosCas, "ros", 30)
    with connect(keyspace=keyspace) as other:
        topic = other.getTopic("/t")
        told = []

        def change():
            for work in (
                lambda: topic.removeData(T0, T0 + 10**9),
                lambda: topic.removeData(where="header.seq < 5"),
                lambda: topic.createIndex("header.seq"),
            ):
                with pytest.raises(SchemaConflict, match="is being converted to format packed"):
                    work()
            other.getTopic("/t").setMeta(site="lab")
            told.append(1)

        during(monkeypatch, change)
        rosCas.convertTopic("/t", "packed")
        assert told == [1]
        time.sleep(0.6)
        assert topic.countTopicData() == 60
        assert topic.getMeta["site"] == "lab"
        assert topic.removeData(where="header.seq < 5") == 10
        assert topic.countTopicData() == 50


@pytest.mark.parametrize("how", ["removeTopic", "truncateTopic", "renameTopic"])
def test_a_topic_that_is_removed_or_renamed_meanwhile(rosCas, connect, keyspace, monkeypatch, how):
    fill(rosCas, "ros", 30)
    rosCas.addTopic("/other", msg_type="std_msgs/String").addData(String("x"))
    with connect(keyspace=keyspace) as other:
        during(monkeypatch, lambda: getattr(other, how)("/t", *["/u"] * (how == "renameTopic")))
        if how == "renameTopic":
            assert rosCas.convertTopic("/t", "binary").messages == 60
            assert formats(rosCas, "/u") == ["binary"]
            assert rosCas.getTopic("/u").countTopicData() == 60
        else:
            with pytest.raises(CassandraRosError, match="remove"):
                rosCas.convertTopic("/t", "binary")
            rosCas.catalog.keyspace.schema.tables(fresh=True)
            assert rosCas.existTopic("/t") == (how == "truncateTopic")
    every = rosCas.catalog.keyspace.schema.listing(fresh=True)
    assert every.every == every.visible


@pytest.mark.parametrize("fmt", ["json", "packed"])
def test_a_bag_is_imported_again_after_messages_came_while_it_was_converted(
    rosCas, connect, keyspace, monkeypatch, tmp_path, fmt
):
    path = tmp_path / "a.bag"
    with BagWriter(path) as bag:
        number = bag.connection(api_connection("/t", definition_of(JointState), "/n"))
        for n in range(50):
            bag.write(number, T0 + n, serialize(joint_state(n)))
    import_bag(rosCas, path)
    for turn in range(3):  # which table is the first one by name is a matter of chance
        with connect(keyspace=keyspace) as other:
            added = []

            def add(n=turn, store=other, done=added):
                if not done:
                    done.append(store.getTopic("/t").addData(joint_state(1000 + n), key=T0 + n))

            with monkeypatch.context() as patch:
                during(patch, add)
                rosCas.convertTopic("/t", [fmt, "ros"][turn % 2])
        import_bag(rosCas, path)
        assert len(list(rosCas.getTopic("/t").rows())) == 51 + turn
        assert rosCas.getTopic("/t").countTopicData() == 51 + turn
