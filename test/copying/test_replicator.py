# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Topics are copied into another store: the same rows, whoever copies them how often."""

from __future__ import annotations

import random
import threading

import pytest
from nav_msgs.msg import OccupancyGrid
from nodes.children import await_true
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import Int64, String
from suites import FEW_FORMATS, sparing
from upkeep.test_convert import fill, joint_state, seen

from cassandra_ros.errors import InvalidOption, StoreUnavailable, UnsupportedSchema
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection, live_connection
from cassandra_ros.messages.definition import definition_of, parse_definition
from cassandra_ros.metadata import FORMAT_NAMES, SCHEMA_VERSION, SIDE_COMMENT
from cassandra_ros.store.tables.context_blob import NodeGraph, RunContext
from cassandra_ros.store.tables.directory import Directory
from cassandra_ros.store.tables.registry import Loss, LossKind, Run
from cassandra_ros.stores.copying.copy_status import copy_status
from cassandra_ros.stores.copying.replicator import Replicator

SEC = 10**9
T0 = 1_500_000_000 * SEC


@pytest.fixture
def home(keyspaces, connect):
    """The store to which is copied."""
    with keyspaces.lend() as name, connect(keyspace=name) as store:
        yield store


def rows_of(cql, store, chunks=False):
    """All columns of all rows of all topic tables, by topic."""
    found = {}
    listing = store.catalog.keyspace.schema.listing(fresh=True)
    for name, metadata in listing.visible.items():
        table = f'"{store.keyspace}"."{name}{"_c" * chunks}"'
        where = "keyspace_name = %s AND table_name = %s"
        columns = cql.execute(
            f"SELECT column_name FROM system_schema.columns WHERE {where}",
            (store.keyspace, f"{name}{'_c' * chunks}"),
        )
        names = sorted(column for (column,) in columns)
        if names:
            quoted = ", ".join(f'"{column}"' for column in names)
            rows = cql.execute(f"SELECT {quoted} FROM {table}")
            found.setdefault((metadata.topic, metadata.format), []).extend(
                sorted(map(repr, (dict(zip(names, row)) for row in rows)))
            )
    return found


def messages(store, topic="/t"):
    return seen(store.getTopic(topic).rows())


def facts(store):
    """What is told of what is stored, but the tables in which."""
    names = "topic type md5sum format node count bytes first_ns last_ns odd buckets".split()
    return [tuple(getattr(each, name) for name in names) for each in store.info()]


def directory(store):
    """What the directory says, but the tables and heartbeats."""
    space = store.catalog.keyspace
    found = []
    for table in store.catalog.tables(None):
        for row in space.directory.buckets_by_robot(table.name, -(2**40), 2**40):
            key = (table.metadata.topic, table.metadata.format, *row[:4])
            found.append((*key, row.rows, row.bytes, row.t_min, row.t_max, row.odd))
    return sorted(found)


@pytest.mark.parametrize("fmt", sparing(FORMAT_NAMES, kept=FEW_FORMATS))
def test_rows_are_copied_as_they_are_stored(rosCas, home, cql, fmt):
    fill(rosCas, fmt)
    report = Replicator(rosCas, home).copy()
    assert report.complete, report
    assert report.messages == 600
    assert rows_of(cql, home) == rows_of(cql, rosCas)
    assert messages(home) == messages(rosCas)
    assert facts(home) == facts(rosCas)
    assert directory(home) == directory(rosCas)
    assert all(row[5] for row in directory(home))


PARTS = "Part[] parts\n" + "=" * 80 + "\nMSG: lost_msgs/Part\nint32 value\n"


def write_parts(store, text, counters, writer_id=7):
    """Write messages of a type that is not installed, whose connection has this definition."""
    kind = {"type": "lost_msgs/Parts", "md5sum": parse_definition("lost_msgs/Parts", PARTS).md5sum}
    with store.messageWriter(writer_id=writer_id, format="ros") as writer:
        fields = {**kind, "callerid": "/x", "message_definition": text}
        handle = writer.connect(live_connection("/t", fields))
        for n in counters:
            writer.write(handle, T0 + n, n, bytes([1, 0, 0, 0, n, 0, 0, 0]))


@pytest.mark.parametrize("texts", [(PARTS, ""), ("", PARTS)])
def test_a_side_without_a_usable_definition_is_no_other_type(rosCas, home, texts):
    """Both stores recorded such a publisher; one of them does not know its definition."""
    write_parts(rosCas, texts[0], range(6))
    write_parts(home, texts[1], range(10, 13), writer_id=8)
    report = Replicator(rosCas, home).copy()
    assert report.complete, report
    assert [row.t - T0 for row in home.getTopic("/t").rows()] == [*range(6), *range(10, 13)]
    assert len(home.getTopic("/t").tables) == 1
    assert Replicator(rosCas, home).compare().equal


def test_a_table_without_a_usable_definition_takes_no_rows_of_the_other(rosCas, home):
    for text, counters in (("", range(3)), (PARTS, range(3, 6))):
        write_parts(rosCas, text, counters)
    for _ in range(2):
        assert Replicator(rosCas, home).copy().complete
        assert sorted(each.format for each in home.info()) == ["binary", "ros"]
        assert sorted(facts(home)) == sorted(facts(rosCas))


def test_nothing_is_decoded(rosCas, home, monkeypatch, cql):
    for fmt in ("ros", "packed"):
        fill(rosCas, fmt, topic=f"/{fmt}")

    def refuse(*args):
        raise AssertionError("a message was decoded or encoded")

    for table in rosCas.catalog.tables(None):
        for name in ("encode_wire", "encode_together", "decode_together", "decode_wire", "decode"):
            monkeypatch.setattr(type(table.format), name, refuse)
    monkeypatch.setattr("cassandra_ros.store.blocks.block_row.unpack_block", refuse)
    monkeypatch.setattr("cassandra_ros.store.blocks.block_builder.pack_block", refuse)
    assert Replicator(rosCas, home).copy().messages == 1200
    monkeypatch.undo()
    assert rows_of(cql, home) == rows_of(cql, rosCas)


def test_a_block_that_grew_under_its_key_is_copied_again(rosCas, home):
    """An import that was broken off is copied, repeated whole, and copied again."""
    for count in (5, 40):
        with rosCas.messageWriter(writer_id=7, format="packed") as writer:
            handle = writer.connect(api_connection("/t", definition_of(Int64), "/n"))
            for n in range(count):
                writer.write(handle, T0 + n, n, serialize(Int64(n)))
        assert Replicator(rosCas, home).copy().complete
        assert messages(home) == messages(rosCas)
        assert len(messages(home)) == count
    assert Replicator(rosCas, home).compare().equal


def test_a_repeated_copy_sends_nothing_and_a_lost_book_changes_nothing(rosCas, home, cql):
    fill(rosCas, "ros")
    fill(rosCas, "packed", topic="/p")
    Replicator(rosCas, home).copy()
    rows = rows_of(cql, home)
    assert Replicator(rosCas, home).copy().messages == 0
    assert Replicator(rosCas, home).copy(again=True).messages == 1200
    assert rows_of(cql, home) == rows
    assert facts(home) == facts(rosCas)


def test_only_what_is_new_is_copied(rosCas, home, cql):
    fill(rosCas, "ros", 40)
    Replicator(rosCas, home).copy()
    fill(rosCas, "ros", 30, writers=((9, "r2"),))
    report = Replicator(rosCas, home).copy()
    assert report.messages == 30
    assert rows_of(cql, home) == rows_of(cql, rosCas)


@pytest.mark.suite("all", "make test asks others of its kind")
def test_the_copy_of_a_copy_is_the_original(rosCas, home, fresh, cql):
    fill(rosCas, "ros", 50)
    fill(rosCas, "packed", 50, topic="/p")
    with fresh() as third:
        Replicator(rosCas, home).copy()
        Replicator(home, third).copy()
        assert rows_of(cql, third) == rows_of(cql, rosCas)
        assert facts(third) == facts(rosCas)
        assert Replicator(third, rosCas).copy().complete
    assert facts(home) == facts(rosCas)


@pytest.mark.suite("all", "make test asks others of its kind")
def test_large_messages_come_with_their_chunks(rosCas, home, cql):
    image = Image(
        height=1,
        width=1,
        encoding="x",
        data=random.Random(1).getrandbits(10_400_000).to_bytes(1_300_000, "little"),
    )
    for fmt in ("ros", "binary", "packed"):
        topic = rosCas.addTopic(f"/{fmt}", fmt)
        for n in range(3):
            image.header.seq = n
            topic.addData(image, key=T0 + n * SEC)
    rosCas.catalog.adder.close()
    assert Replicator(rosCas, home).copy().messages == 9
    assert rows_of(cql, home) == rows_of(cql, rosCas)
    assert rows_of(cql, home, chunks=True) == rows_of(cql, rosCas, chunks=True)
    for fmt in ("ros", "binary", "packed"):
        assert messages(home, fmt) == messages(rosCas, fmt)


def test_a_message_without_its_chunks_is_told_and_the_others_are_copied(rosCas, home, cql):
    topic = rosCas.addTopic("/i", "binary")
    for n in range(3):
        topic.addData(Image(data=bytes(1_300_000)), key=T0 + n)
    rosCas.catalog.adder.close()
    (name,) = rosCas.catalog.keyspace.schema.listing().visible
    table = f'"{rosCas.keyspace}"."{name}_c"'
    (node, bucket, t, seq), *_ = cql.execute(
        f'SELECT "_node", "_bucket", "_t", "_seq" FROM {table}'
    )
    cql.execute(
        f'DELETE FROM {table} WHERE "_node" = %s AND "_bucket" = %s AND "_t" = %s AND "_seq" = %s '
        'AND "_chunk" = 1',
        (node, bucket, t, seq),
    )
    report = Replicator(rosCas, home).copy()
    assert "2 of 3 chunks" in report.topics["/i"].refused
    assert home.getTopic("/i").countTopicData() == 2
    assert Replicator(rosCas, home).copy().topics["/i"].refused


@pytest.mark.parametrize("key_format", ["manual", "hash"])
def test_named_messages_come_with_all_versions(rosCas, home, cql, key_format):
    topic = rosCas.addTopic("/maps", "ros", key_format=key_format)
    names = ["kitchen", "hall", "a/b", "Küche ' \""] if key_format == "manual" else [None] * 4
    for n, name in enumerate(names * 3):
        topic.addData(OccupancyGrid(data=[n] * 5), **({"key": name} if name else {}))
    rosCas.catalog.adder.close()
    assert Replicator(rosCas, home).copy().complete
    assert rows_of(cql, home) == rows_of(cql, rosCas)
    topic.addData(OccupancyGrid(data=[99]), **({"key": "hall"} if names[0] else {}))
    rosCas.catalog.adder.close()
    assert Replicator(rosCas, home).copy().messages >= 1
    assert rows_of(cql, home) == rows_of(cql, rosCas)
    assert messages(home, "/maps") == messages(rosCas, "/maps")


@pytest.mark.suite("all", "make test asks others of its kind")
def test_two_copies_at_once_end_in_the_same_rows(rosCas, home, cql):
    fill(rosCas, "ros")
    fill(rosCas, "packed", topic="/p")
    failures = []

    def copy():
        try:
            Replicator(rosCas, home).copy()
        except Exception as exc:  # noqa: BLE001 - raised below
            failures.append(exc)

    threads = [threading.Thread(target=copy) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failures
    assert rows_of(cql, home) == rows_of(cql, rosCas)
    assert facts(home) == facts(rosCas)


def test_a_bucket_that_is_written_is_followed(rosCas, home, monkeypatch):
    monkeypatch.setattr(
        "cassandra_ros.store.rows.writer.IDLE_SEC", 1e9
    )  # a copy may take that long
    handle_of = live_connection(
        "/t", {"type": Int64._type, "md5sum": Int64._md5sum, "message_definition": Int64._full_text}
    )
    with rosCas.messageWriter(writer_id=5, format="ros") as writer:
        handle = writer.connect(handle_of)
        for n in range(50):
            writer.write(handle, T0 + n, n, serialize(Int64(n)))
            if n in (20, 40):
                writer.flush()
                Replicator(rosCas, home).copy()
                assert home.getTopic("/t").countTopicData() == n + 1
                assert not any(row[5] for row in directory(home))
    Replicator(rosCas, home).copy()
    assert messages(home) == messages(rosCas)
    assert directory(home) == directory(rosCas)


@pytest.mark.parametrize("fmt", ["ros", "packed"])
def test_the_status_does_not_take_new_messages_for_those_that_were_deleted(
    rosCas, home, monkeypatch, fmt
):
    """A topic is truncated while it is written, and gets as many messages again."""
    monkeypatch.setattr("cassandra_ros.store.rows.writer.HEARTBEAT_SEC", 0.1)

    def status():
        (found,) = copy_status(rosCas.catalog)
        return found.copied, found.waiting

    with rosCas.messageWriter(writer_id=5, format=fmt) as writer:
        handle = writer.connect(api_connection("/t", definition_of(Int64), "/x"))
        for first in (0, 50):
            for n in range(first, first + 50):
                writer.write(handle, T0 + n, n, serialize(Int64(n)))
            writer.flush()
            if not first:
                await_true(lambda: directory(rosCas)[0][6] == 50)  # the books get these numbers
                Replicator(rosCas, home).copy()
                assert status() == (50, 0)
                assert rosCas.truncateTopic("/t") == 50
                assert status() == (0, 0)
        assert status() == (0, 50)
        Replicator(rosCas, home).copy()
        assert status() == (50, 0)


def test_a_selection_is_copied(rosCas, home):
    fill(rosCas, "ros")
    fill(rosCas, "ros", topic="/u")
    end = T0 + 2 * SEC - 1
    report = Replicator(rosCas, home, "/t", to_key=end, nodeID="r1").copy()
    assert list(report.topics) == ["/t"]
    every = seen(rosCas.getTopic("/t").rows())
    assert messages(home) == [row for row in every if row[0] <= end and row[1] == "r1"]
    assert not home.existTopic("/u")
    assert Replicator(rosCas, home).copy().complete
    assert messages(home) == every


@pytest.mark.suite("test", "a copy in another format")
def test_formats_are_converted_on_the_way(rosCas, home):
    fill(rosCas, "ros")
    report = Replicator(rosCas, home, format="packed").copy()
    assert report.complete
    assert report.topics["/t"].format == "packed"
    assert messages(home) == messages(rosCas)
    assert Replicator(rosCas, home, format="packed").copy().messages == 0
    fill(rosCas, "ros", 20, writers=((9, "r2"),))
    assert Replicator(rosCas, home).copy().messages == 20
    assert Replicator(rosCas, home).copy(again=True).messages == 0
    assert messages(home) == messages(rosCas)
    assert rosCas.info()[0].format == "ros"
    assert {each.format for each in home.info()} == {"packed"}


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_topic_converted_on_either_side_stays_one(rosCas, home, monkeypatch):
    monkeypatch.setattr("cassandra_ros.store.tables.replacement.SETTLE_SEC", 0.05)
    monkeypatch.setattr("cassandra_ros.store.tables.schema.CACHE_SEC", 0.03)
    fill(rosCas, "ros", 60)
    Replicator(rosCas, home).copy()
    home.convertTopic("/t", "packed")
    assert Replicator(rosCas, home).copy().messages == 0
    rosCas.convertTopic("/t", "binary")
    assert Replicator(rosCas, home).copy().complete
    fill(rosCas, "binary", 20, writers=((9, "r2"),))
    assert Replicator(rosCas, home).copy().messages == 20
    assert messages(home) == messages(rosCas)
    assert {each.format for each in home.info()} == {"packed"}


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_topic_removed_there_is_copied_again(rosCas, home):
    fill(rosCas, "ros", 30)
    Replicator(rosCas, home).copy()
    home.removeTopic("/t")
    assert Replicator(rosCas, home).copy().messages == 60
    home.truncateTopic("/t")
    assert Replicator(rosCas, home).copy().messages == 60
    assert messages(home) == messages(rosCas)


def test_a_topic_of_two_formats_there_gets_its_messages_once(rosCas, home):
    fill(rosCas, "ros", 30)
    Replicator(rosCas, home, format="packed").copy()
    with home.messageWriter(format="ros", writer_id=77) as writer:
        connection = api_connection("/t", definition_of(JointState), "/n")
        writer.write(writer.connect(connection), T0, 0, serialize(joint_state(0)))
    fill(rosCas, "ros", 10, writers=((9, "r2"),))
    assert Replicator(rosCas, home).copy().messages == 10
    assert len(messages(home)) == len(messages(rosCas)) + 1


@pytest.mark.suite("all", "it waits for seconds")
def test_what_expires_here_stays_there(rosCas, home):
    """Its end is not a deletion to repeat."""
    for ttl in (3, 30, 180):  # both messages must live until they are copied
        for store in (home, rosCas):
            if store.existTopic("/t"):
                store.removeTopic("/t")
        home.addTopic("/t", "ros", msg_type="std_msgs/Int64")
        rosCas.addTopic("/t", "ros", msg_type="std_msgs/Int64", ttl=ttl)
        rosCas.getTopic("/t").addData(Int64(1), key=T0)
        rosCas.catalog.adder.close()
        first = Replicator(rosCas, home).copy().messages
        await_true(lambda: not list(rosCas.getTopic("/t").rows()), 2 * ttl + 180)
        rosCas.getTopic("/t").addData(Int64(2), key=T0 + 1)
        rosCas.catalog.adder.close()
        second = Replicator(rosCas, home, with_deletions=True).copy().messages
        if (first, second) == (1, 1):
            break
    assert (first, second) == (1, 1)
    assert len(messages(home)) == 2


class TestRefusals:
    def refused(self, source, target, **options):
        report = Replicator(source, target, **options).copy()
        assert not report.complete
        assert report.topics["/ok"].refused == ""
        return report.topics["/t"].refused

    @pytest.fixture
    def both(self, rosCas, home):
        rosCas.addTopic("/ok").addData(String("ok"))
        rosCas.addTopic("/t", ttl=1000).addData(String("a"), key=T0)
        rosCas.catalog.adder.close()
        return rosCas, home

    def test_another_type(self, both):
        both[1].addTopic("/t", msg_type="std_msgs/Int64")
        text = self.refused(*both)
        assert "std_msgs/String" in text and "std_msgs/Int64" in text

    def test_another_key_format(self, both):
        both[1].addTopic("/t", msg_type="std_msgs/String", key_format="manual")
        text = self.refused(*both)
        assert "key format time here" in text and "manual there" in text

    def test_another_lifetime(self, both):
        both[1].addTopic("/t", msg_type="std_msgs/String", ttl=500)
        text = self.refused(*both)
        assert "1000 s" in text and "500 s" in text

    def test_another_spelling(self, both):
        both[1].addTopic("t", msg_type="std_msgs/String")
        assert "name /t here" in self.refused(*both)

    def test_another_format_than_asked(self, both):
        both[1].addTopic("/t", "binary", msg_type="std_msgs/String", ttl=1000)
        text = self.refused(*both, format="json")
        assert "json" in text and "binary" in text

    def test_a_renamed_topic(self, both):
        Replicator(*both).copy()
        both[1].renameTopic("/t", "/other")
        assert "/other" in self.refused(*both)

    def test_another_format_of_messages_that_expire(self, both):
        assert "ttl" in self.refused(*both, format="packed")


def test_messages_that_expire_keep_their_time(rosCas, home, cql):
    fill_options = {"ttl": 5000}
    rosCas.addTopic("/t", "ros", msg_type="std_msgs/Int64", **fill_options)
    (table,) = rosCas.getTopic("/t").tables
    rosCas.getTopic("/t").addData(Int64(1), key=T0)
    rosCas.catalog.adder.close()
    name = f'"{rosCas.keyspace}"."{table.name}"'
    (row,) = cql.execute(
        f'SELECT "_node", "_bucket", "_t", "_seq", "_conn", "_size", data FROM {name}'
    )
    marks = '("_node", "_bucket", "_t", "_seq", "_conn", "_size", data)'
    cql.execute(
        f"INSERT INTO {name} {marks} VALUES (%s, %s, %s, %s, %s, %s, %s) USING TTL 700", row
    )
    Replicator(rosCas, home).copy()
    (there,) = home.getTopic("/t").tables
    assert there.metadata.ttl == 5000
    (left,) = cql.execute(f'SELECT TTL("_conn") FROM "{home.keyspace}"."{there.name}"').one()
    assert 500 < left <= 700


def test_the_index_of_a_field_is_there_too(rosCas, home):
    topic = rosCas.addTopic("/t", "ros", msg_type="std_msgs/Int64", index=["data"])
    for n in range(20):
        topic.addData(Int64(n), key=T0 + n)
    rosCas.catalog.adder.close()
    Replicator(rosCas, home).copy()
    (table,) = home.getTopic("/t").tables
    (row,) = home.catalog.keyspace.directory.buckets_by_robot(table.name, -(2**40), 2**40)
    assert row.filled == frozenset(table.metadata.indexes.values()) != frozenset()
    assert [key.to_nsec() for (key,) in home.executeCQL("select KEY from t where data = 7")] == [
        T0 + 7
    ]


def test_events_come_with_the_messages(rosCas, home):
    fill(rosCas, "binary", 20)
    bump = rosCas.addEvent("bump", T0, T0 + SEC, nodeID="r1", values={"force": 2.5})
    door = rosCas.addEvent("door", T0 + 5 * SEC, nodeID="r2")
    rosCas.addEvent("all", T0 + SEC, T0 + 2 * SEC)
    home.addEvent("theirs", T0, T0 + SEC)
    Replicator(rosCas, home, nodeID="r1").copy()
    assert sorted(event.name for event in home.events()) == ["all", "bump", "theirs"]
    Replicator(rosCas, home).copy()
    Replicator(rosCas, home).copy()
    assert list(home.events("bump")) == [bump]
    assert len(list(home.events())) == 4
    rosCas.endEvent(door, T0 + 7 * SEC)
    Replicator(rosCas, home).copy()
    assert [event.end_ns for event in home.events("door")] == [T0 + 7 * SEC]


def test_runs_losses_metadata_and_contexts_come_with_their_messages(rosCas, home):
    run = Run("r1", 77, "recording", name="patrol", labels={"site": "lab"})
    with rosCas.messageWriter(writer_id=77, nodeID="r1", run=run) as writer:
        handle = writer.connect(api_connection("/t", definition_of(String), "/talker"))
        writer.write(handle, T0, 0, serialize(String("x")))
        writer.connect(api_connection("/t", definition_of(String), "/silent"))
    rosCas.getTopic("/t").setMeta(place="roof", comment="mine")
    registry = rosCas.catalog.keyspace.registry
    registry.put_context(77, "r1", RunContext({"a": 1}, NodeGraph({}, {}, {}, {})))
    registry.put_loss(Loss("/t", "r1", 77, LossKind.BUFFER_FULL, T0, T0 + 5, 3))
    registry.put_loss(Loss("/never", "r1", 77, LossKind.NO_TABLE, T0, T0, 1))
    Replicator(rosCas, home).copy()
    assert list(home.runs()) == list(rosCas.runs())
    assert home.losses() == rosCas.losses() != []
    assert home.runContext("patrol") == rosCas.runContext("patrol")
    assert home.getTopic("/t").getMeta["place"] == "roof"
    assert home.getTopic("/t").getMeta["comment"] == "mine"
    home.getTopic("/t").setMeta(place="cellar")
    rosCas.getTopic("/t").setMeta(site="lab")
    Replicator(rosCas, home).copy()
    assert home.getTopic("/t").getMeta["place"] == "cellar"
    assert home.getTopic("/t").getMeta["site"] == "lab"
    headers = {
        store.keyspace: sorted(
            (conn, header)
            for _, conn, header in store.catalog.keyspace.registry.headers(
                [t.name for t in store.catalog.tables(None)]
            )
        )
        for store in (rosCas, home)
    }
    assert headers[home.keyspace] == headers[rosCas.keyspace]
    assert len(headers[home.keyspace]) == 2


class TestDeletions:
    @pytest.mark.parametrize("fmt", ["ros", "packed"])
    def test_are_made_there_where_that_is_asked_for(self, rosCas, home, fmt):
        fill(rosCas, fmt)
        fill(home, fmt, 20, writers=((9, "r2"),))
        theirs = messages(home)
        Replicator(rosCas, home).copy()
        every = messages(home)
        rosCas.getTopic("/t").removeData(T0 + SEC, T0 + 2 * SEC)
        left = messages(rosCas)
        assert Replicator(rosCas, home).copy().complete
        assert messages(home) == every
        assert len(left) < 600
        report = Replicator(rosCas, home, with_deletions=True).copy()
        assert messages(home) == sorted(left + theirs, key=lambda row: row[:3]), report
        assert home.getTopic("/t").countTopicData() == len(left) + 20

    def test_that_came_before_the_first_copy_stay_deleted(self, rosCas, home):
        fill(rosCas, "packed")
        rosCas.upkeep.delete("/t", where={"/t": "header.seq > 100"})
        assert Replicator(rosCas, home).copy().complete
        assert messages(home) == messages(rosCas)
        assert facts(home) == facts(rosCas)

    def test_of_a_whole_topic(self, rosCas, home):
        fill(rosCas, "ros", 30)
        fill(home, "ros", 20, writers=((9, "r2"),))
        theirs = messages(home)
        Replicator(rosCas, home).copy()
        rosCas.removeTopic("/t")
        Replicator(rosCas, home).copy()
        assert len(messages(home)) == 80
        Replicator(rosCas, home, with_deletions=True).copy()
        assert messages(home) == theirs


def test_a_store_is_not_copied_into_itself(rosCas, connect):
    fill(rosCas, "ros", 5)
    with connect(keyspace=rosCas.keyspace) as same:
        with pytest.raises(InvalidOption, match="the store itself"):
            Replicator(rosCas, same)


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_target_of_another_schema_is_refused(rosCas, connect, new_keyspace, cql):
    fill(rosCas, "ros", 5)
    with connect(keyspace=new_keyspace) as home:
        home.catalog.keyspace.side_tables.make()
        comment = SIDE_COMMENT.replace(f'"version": {SCHEMA_VERSION}', '"version": 99')
        cql.execute(f"ALTER TABLE {new_keyspace}.cr_run WITH comment = '{comment}'")
        with pytest.raises(UnsupportedSchema, match=f"{new_keyspace}.cr_run has schema version 99"):
            Replicator(rosCas, home)


@pytest.mark.suite("test", "a copy, and two imports")
@pytest.mark.parametrize("target_ns", sparing([10 * SEC, 60 * SEC], kept=[10 * SEC]))
def test_a_bag_that_is_imported_at_home_after_its_copy_is_there_once(
    rosCas, home, tmp_path, target_ns
):
    """Home cuts blocks as its own table says, unlike the robot that has imported the bag."""
    for store, writer_id, length in ((rosCas, 1, 10 * SEC), (home, 2, target_ns)):
        with store.messageWriter(writer_id=writer_id, format="packed") as writer:
            handle = writer.connect(
                api_connection("/t", definition_of(Int64), "/n"), bucket_ns=length
            )
            writer.write(handle, T0, 0, serialize(Int64(-writer_id)))
    path = tmp_path / "a.bag"
    with BagWriter(path) as bag:
        number = bag.connection(api_connection("/t", definition_of(Int64), "/n"))
        for n in range(5000):
            bag.write(number, T0 + (n + 1) * SEC // 100, serialize(Int64(n)))
    import_bag(rosCas, path, nodeID="husky")
    Replicator(rosCas, home).copy()
    assert home.getTopic("/t").countTopicData() == 5002
    import_bag(home, path, nodeID="husky")
    every = [row.message().data for row in home.getTopic("/t").rows()]
    assert sorted(every) == [-2, -1, *range(5000)]
    assert home.getTopic("/t").countTopicData() == 5002


def test_a_bucket_that_cannot_be_closed_in_time_does_not_end_the_copy(rosCas, home, monkeypatch):
    """Its rows are there; the other topics are copied, and a reader counts it."""
    fill(rosCas, "ros", 100, "/a")
    fill(rosCas, "ros", 100, "/b")
    put, late = Directory.put_recount, ["once"]

    def too_late(self, *args):
        if late:
            raise StoreUnavailable(f"closing a bucket took too long {late.pop()}")
        return put(self, *args)

    monkeypatch.setattr(Directory, "put_recount", too_late)
    report = Replicator(rosCas, home).copy()
    assert not late
    assert report.complete
    for topic in ("/a", "/b"):
        assert messages(home, topic) == messages(rosCas, topic)
        assert home.getTopic(topic).countTopicData() == 200
