# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A topic is converted into another format: the same messages, seen all the time, each once."""

from __future__ import annotations

import random
import threading

import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from suites import sparing

from cassandra_ros.errors import (
    InvalidOption,
    SchemaConflict,
    StoreUnavailable,
    TopicNotFound,
    UnknownFormat,
)
from cassandra_ros.keys import decode_cursor, encode_cursor
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.metadata import FORMAT_NAMES
from cassandra_ros.query.arrays import arrow_batches, batch
from cassandra_ros.query.arrays.table_values import TableValues
from cassandra_ros.store.tables import replacement, schema
from cassandra_ros.topics.row_reader import RowReader
from cassandra_ros.topics.upkeep import conversion as convert
from cassandra_ros.topics.upkeep import table_copy as copying

SEC = 10**9
T0 = 1_500_000_000 * SEC


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Clients of these tests read the comments anew at once."""
    monkeypatch.setattr(replacement, "SETTLE_SEC", 0.05)
    monkeypatch.setattr("cassandra_ros.store.tables.schema.CACHE_SEC", 0.03)


def joint_state(number):
    rand = random.Random(number)
    msg = JointState()
    msg.header.seq, msg.header.frame_id = number, "a" * (number % 7)
    msg.name = [f"joint{n}" for n in range(number % 4)]
    msg.position = [rand.random() for _ in msg.name]
    return msg


def fill(rosCas, format, count=300, topic="/t", writers=((7, ""), (3, "r1"))):
    """Store messages of two writers of two nodes, with equal stamps, over several buckets."""
    rand = random.Random(1)
    for writer_id, node in writers:
        with rosCas.messageWriter(writer_id=writer_id, nodeID=node, format=format) as writer:
            names = [f"/{node}{n}" for n in range(2)]
            handles = [
                writer.connect(
                    api_connection(topic, definition_of(JointState), name), bucket_ns=SEC
                )
                for name in names
            ]
            for number in range(count):
                # Some at the last nanosecond of a bucket, others at its first.
                t = T0 + rand.randrange(8) * SEC // 2 - (number % 5 == 4)
                writer.write(rand.choice(handles), t, number, serialize(joint_state(number)))


def seen(rows):
    return [
        (r.t, r.node, r.seq, r.name, r.received, r.conn, r.connection, r.run, r.wire) for r in rows
    ]


def formats(rosCas, topic="/t"):
    return [table.metadata.format for table in rosCas.getTopic(topic).tables]


def facts(rosCas):
    """What is told of what is stored, but the table in which."""
    wanted = ("topic", "type", "md5sum", "node", "count", "bytes", "first_ns", "last_ns", "buckets")
    return [tuple(getattr(each, name) for name in wanted) for each in rosCas.info()]


def check_conversion(rosCas, source, target):
    topic = rosCas.getTopic("/t")
    assert formats(rosCas) == [source]
    before, told = seen(topic.rows()), facts(rosCas)
    report = rosCas.convertTopic("t", target)
    assert formats(rosCas) == [target]
    assert report.messages == (0 if source == target else len(before))
    assert seen(topic.rows()) == before
    assert seen(topic.rows(reverse=True)) == before[::-1]
    assert topic.countTopicData() == len(before) > 0
    assert facts(rosCas) == told
    assert len(rosCas.catalog.keyspace.schema.listing(fresh=True).every) == 1


@pytest.mark.suite("test", "each format")
def test_a_topic_goes_through_all_formats(rosCas):
    every = [*FORMAT_NAMES, *list(FORMAT_NAMES)[:1]]
    fill(rosCas, every[0], 60)
    before = seen(rosCas.getTopic("/t").rows())
    for source, target in zip(every, every[1:]):
        check_conversion(rosCas, source, target)
    assert seen(rosCas.getTopic("/t").rows()) == before
    check_conversion(rosCas, every[0], every[0])


def test_messages_that_one_client_added_for_two_robots_keep_their_robots(rosCas):
    topic = rosCas.addTopic("/t", "ros", msg_type="std_msgs/String")
    for number in range(20):
        topic.addData(String(data=str(number)), key=T0 + number, nodeID="ab"[number % 2])
    check_conversion(rosCas, "ros", "binary")


def test_progress_counts_what_is_written_and_what_is_compared(rosCas):
    fill(rosCas, "binary", 150, writers=((7, ""),))
    told = []
    rosCas.convertTopic("/t", "packed", lambda done, total: told.append((done, total)))
    assert told == [(100, 300), (200, 300), (300, 300), (300, 300)]


@pytest.mark.suite("all", "make test converts between fewer formats")
@pytest.mark.parametrize("target", FORMAT_NAMES)
@pytest.mark.parametrize("source", FORMAT_NAMES)
def test_each_format_becomes_each_other(rosCas, source, target):
    fill(rosCas, source, 60)
    check_conversion(rosCas, source, target)


@pytest.mark.suite("all", "make test asks others of its kind")
def test_keys_and_cursors_of_the_old_table_stay_good(rosCas):
    fill(rosCas, "ros", 120)
    topic = rosCas.getTopic("/t")
    rows = list(topic.rows())
    keys = [(row.key, row.wire) for row in rows]
    cursors = [(encode_cursor(row.position), n) for n, row in enumerate(rows)]
    statement = "SELECT KEY, header.seq, name FROM /t"
    result = rosCas.iterCQL(statement, limit=100)
    first, cursor = list(result), result.cursor
    rows[0]._wire = None
    for target in ("binary", "json", "ros"):  # a chain of replacements
        rosCas.convertTopic("/t", target)
        places = [row.position[:3] for row in rows]
        for key, wire in keys[::7]:
            assert serialize(topic.getData(key)) == wire
        for text, n in cursors[::9]:
            after = decode_cursor(text)
            assert [r.position[:3] for r in topic.rows(after=after)] == places[n + 1 :]
            back = [r.position[:3] for r in topic.rows(after=after, reverse=True)]
            assert back == places[:n][::-1]
        rest = list(rosCas.statements.select(statement, after=cursor))
        assert first + rest == list(rosCas.iterCQL(statement))
    # A row that was read before, whose bytes lie in a table that is gone.
    assert rows[0].wire == keys[0][1]


@pytest.mark.suite("all", "make test converts between fewer formats")
def test_an_iterator_goes_on_where_its_table_was_dropped(rosCas):
    fill(rosCas, "ros", 1200)
    topic = rosCas.getTopic("/t")
    wanted = seen(topic.rows())
    ways = {
        "up": topic.rows(),
        "down": topic.rows(reverse=True),
        "where": (row for row in topic._finder(where="header.seq >= 0").many(None, None)),
        "received": rosCas.readMessages(["/t"], received=True),
        "all": rosCas.readMessages(),
    }
    got = {name: [next(rows) for _ in range(700)] for name, rows in ways.items()}
    lazy, untouched = topic.rows(), list(topic.rows())
    for target in ("json", "packed", "binary"):
        rosCas.convertTopic("/t", target)
    for name, rows in ways.items():
        found = seen(got[name]) + seen(rows)
        assert found == (wanted[::-1] if name == "down" else wanted), name
    assert seen(lazy) == wanted
    for row in untouched[::100]:
        row.table.connections.get.cache_clear()
        assert row.connection.topic == "/t"
        assert row.message().header.seq >= 0


@pytest.mark.parametrize("source", ["ros", "binary", "packed"])
def test_arrays_are_read_again_where_a_table_was_dropped(rosCas, monkeypatch, source):
    fill(rosCas, source, 150)
    topic = rosCas.getTopic("/t")
    wanted = sorted((row.t, row.message().header.seq) for row in topic.rows())
    add, targets = TableValues.add, ["json", "binary" if source == "packed" else "packed"]

    def add_and_convert(self, batch):
        add(self, batch)
        if targets:
            rosCas.convertTopic("/t", targets.pop())

    monkeypatch.setattr(TableValues, "add", add_and_convert)
    for where in (None, "header.seq >= 0"):
        found = topic.getArrays(["KEY", "header.seq"], where=where)
        assert sorted(zip(found["KEY"].tolist(), found["header.seq"].tolist())) == wanted
    assert not targets


@pytest.mark.parametrize("source", ["ros", "packed"])
@pytest.mark.parametrize("begun", [False, True])
def test_no_array_ends_early_where_a_table_of_many_years_is_dropped(
    rosCas, monkeypatch, source, begun
):
    """It is dropped after the first batch, or before the first request."""
    monkeypatch.setattr(batch, "ROW_BATCH_MESSAGES", 1)
    years = [T0 + n * 365 * 86400 * SEC for n in range(9)]
    with rosCas.messageWriter(format=source) as writer:
        handle = writer.connect(api_connection("/t", definition_of(String), "/x"), bucket_ns=SEC)
        for n, t in enumerate(years):
            writer.write(handle, t, n, serialize(String(str(n))))
    topic, targets = rosCas.getTopic("/t"), ["binary"]
    in_order = RowReader.in_order

    def convert():
        if targets:
            rosCas.convertTopic("/t", targets.pop())

    def read(*args):
        if not begun:
            convert()
        for each in in_order(*args):
            yield each
            convert()

    monkeypatch.setattr(RowReader, "in_order", read)
    assert topic.getArrays("data")["data"].tolist() == [str(n) for n in range(9)]
    assert not targets


@pytest.mark.parametrize("source", ["ros", "packed"])
def test_record_batches_go_on_where_a_table_was_dropped(rosCas, monkeypatch, source):
    monkeypatch.setattr(arrow_batches, "ARROW_BATCH_MESSAGES", 1)
    monkeypatch.setattr(batch, "ROW_BATCH_MESSAGES", 50)
    fill(rosCas, source, 150)
    topic = rosCas.getTopic("/t")
    begun, new = topic.toArrow(), topic.toArrow()
    first = begun.read_next_batch()
    assert 0 < first.num_rows < 300
    rosCas.convertTopic("/t", "binary")
    assert first.num_rows + begun.read_all().num_rows == 300
    assert new.read_all().num_rows == 300  # of which no batch had been read
    begun = topic.toArrow()
    begun.read_next_batch()
    rosCas.removeTopic("/t")
    with pytest.raises(StoreUnavailable, match="was removed while it was read"):
        begun.read_all()


def test_a_table_that_is_made_meanwhile_does_not_end_record_batches(rosCas, monkeypatch):
    monkeypatch.setattr(arrow_batches, "ARROW_BATCH_MESSAGES", 1)
    monkeypatch.setattr(batch, "ROW_BATCH_MESSAGES", 50)
    fill(rosCas, "ros", 150)
    reader = rosCas.getTopic("/t").toArrow()
    first = reader.read_next_batch()
    with rosCas.messageWriter(writer_id=9, format="ros") as writer:
        handle = writer.connect(api_connection("/t", definition_of(String), "/x"), bucket_ns=SEC)
        writer.write(handle, T0, 0, serialize(String("another type")))
    assert first.num_rows + reader.read_all().num_rows == 300


@pytest.mark.parametrize("key_format", ["hash", "manual"])
def test_messages_under_names(rosCas, key_format):
    topic = rosCas.addTopic("/t", "ros", key_format=key_format)
    keys = []
    for n in range(40):
        name = f"k{n % 9}" if key_format == "manual" else None
        keys.append(topic.addData(String(data=f"m{n % 30}"), key=name))
    before = seen(topic.rows())
    rosCas.convertTopic("/t", "yaml")
    assert formats(rosCas) == ["yaml"]
    assert seen(topic.rows()) == before
    if key_format == "manual":
        assert [topic.getData(key).data for key in keys] == [f"m{n % 30}" for n in range(40)]
    with pytest.raises(InvalidOption, match="cannot be kept in format packed"):
        rosCas.convertTopic("/t", "packed")
    assert len(rosCas.catalog.keyspace.schema.listing(fresh=True).every) == 1


@pytest.mark.parametrize("part", sparing(["header.stamp", "header.seq"], kept=["header.stamp"]))
def test_keys_in_the_message_and_indexes(rosCas, part):
    topic = rosCas.addTopic(
        "/t", "ros", msg_type="sensor_msgs/JointState", key_format="msg_part", key_part=part
    )
    topic.createIndex("header.frame_id")
    for n in range(30):
        msg = joint_state(n)
        msg.header.stamp.secs = 100 + n // 2
        topic.addData(msg)
    before = seen(topic.rows())
    rosCas.convertTopic("/t", "json")
    assert seen(topic.rows()) == before
    assert topic.hasIndex("header.frame_id")
    found = rosCas.explainCQL("SELECT KEY FROM /t WHERE header.frame_id = 'aa'")
    assert "index" in str(found)
    assert len(list(topic.items(where="header.frame_id = 'aa'"))) == len(range(2, 30, 7))
    if part == "header.seq":
        assert topic.getData(7).header.seq == 7


def test_an_index_keeps_its_name(rosCas):
    fill(rosCas, "ros", count=5)
    rosCas.executeCQL("CREATE INDEX by_frame ON /t (header.frame_id)")
    rosCas.convertTopic("/t", "json")
    assert rosCas.getTopic("/t").hasIndex("header.frame_id")
    rosCas.executeCQL("DROP INDEX by_frame")
    assert not rosCas.getTopic("/t").hasIndex("header.frame_id")


@pytest.mark.suite("all", "make test asks others of its kind")
@pytest.mark.parametrize("target", ["binary", "packed"])
def test_what_expires_keeps_about_the_time_that_it_has_left(rosCas, cql, target):
    topic = rosCas.addTopic("/t", "ros", msg_type="std_msgs/String", ttl=2000)
    old = topic.tables[0]
    for n in range(20):
        topic.addData(String(data=str(n)), key=T0 + n * SEC)
    rosCas.catalog.keyspace.schema.tables(fresh=True)
    set_ttl = f'UPDATE {old.qualified} USING TTL %s SET "_conn" = %s WHERE "_node" = %s AND '
    for row in list(topic.rows()):
        place = ("", old.bucket_of(row.t), row.t, row.seq)
        cql.execute(
            set_ttl + '"_bucket" = %s AND "_t" = %s AND "_seq" = %s', (700, row.conn, *place)
        )
    before = seen(topic.rows())
    for format in (target, "ros"):
        rosCas.convertTopic("/t", format)
        assert seen(topic.rows()) == before
        new = topic.tables[0]
        left = [ttl for (ttl,) in cql.execute(f'SELECT TTL("_conn") FROM {new.qualified}')]
        assert len(left) == 20 or format == "packed"
        assert all(600 < each <= 700 for each in left)
        assert new.metadata.ttl == 2000
    topic.addData(String(data="new"), key=T0 - SEC)
    assert topic.countTopicData() == 21


def test_several_definitions_and_formats_become_one_table_each(rosCas):
    for format, writer in (("ros", 5), ("yaml", 6), ("json", 8)):
        fill(rosCas, format, 40, writers=((writer, "a"),))
    with rosCas.messageWriter(format="binary") as writer:
        handle = writer.connect(api_connection("/t", definition_of(String), "/x"))
        writer.write(handle, T0 + 5, 0, serialize(String("other")))
    before = seen(rosCas.getTopic("/t").rows())
    report = rosCas.convertTopic("/t", "ros")
    assert report.tables == 4
    assert report.messages == len(before) == 121
    assert formats(rosCas) == ["ros", "ros"]
    assert seen(rosCas.getTopic("/t").rows()) == before
    assert rosCas.convertTopic("/t", "ros").messages == 0


def test_what_goes_wrong_is_said_before_anything_is_made(rosCas):
    with pytest.raises(TopicNotFound):
        rosCas.convertTopic("/none", "ros")
    fill(rosCas, "ros", 10)
    with pytest.raises(UnknownFormat):
        rosCas.convertTopic("/t", "xml")
    assert len(rosCas.catalog.keyspace.schema.listing(fresh=True).every) == 1


def test_a_topic_that_is_being_recorded_is_refused(rosCas, connect, monkeypatch):
    monkeypatch.setattr("cassandra_ros.store.rows.writer.HEARTBEAT_SEC", 0.3)
    monkeypatch.setattr(convert, "LOOK_SEC", 0.1)
    fill(rosCas, "ros", 10)
    with rosCas.messageWriter() as writer:
        handle = writer.connect(api_connection("/t", definition_of(JointState), "/x"))
        stop = threading.Event()

        # So that it is being written to when the conversion begins, however late the thread comes.
        writer.write(handle, T0, 0, serialize(joint_state(0)))

        def write():
            number = 1
            while not stop.wait(0.01):
                writer.write(handle, T0 + number, number, serialize(joint_state(number)))
                number += 1

        thread = threading.Thread(target=write)
        thread.start()
        try:
            with pytest.raises(SchemaConflict, match="is being recorded .* end the recording"):
                rosCas.convertTopic("/t", "binary")
        finally:
            stop.set()
            thread.join()
    assert formats(rosCas) == ["ros"]
    assert rosCas.convertTopic("/t", "binary").messages == rosCas.getTopic("/t").countTopicData()


@pytest.mark.suite("all", "make test asks others of its kind")
def test_who_deletes_is_no_writer_that_is_waited_for(rosCas, monkeypatch):
    monkeypatch.setattr(convert, "QUIET_SEC", 1e9)
    monkeypatch.setattr(convert, "DELETING_SEC", 0.5)
    fill(rosCas, "packed", 20)
    topic = rosCas.getTopic("/t")
    topic.removeData(topic.first())
    left = seen(topic.rows())
    assert rosCas.convertTopic("/t", "binary").messages == len(left) == topic.countTopicData()
    assert seen(rosCas.getTopic("/t").rows()) == left


@pytest.mark.parametrize("format", ["binary", "packed"])
def test_a_table_whose_conversion_was_given_up_takes_messages_again(rosCas, format):
    with rosCas.messageWriter(format=format) as writer:
        handle = writer.connect(api_connection("/t", definition_of(String), "/x"))
        writer.write(handle, T0, 1, serialize(String("before")))
        # As it was told while the conversion went on, which ends before the next message.
        writer._rows.gone.add(handle.table.name)
        writer.write(handle, T0 + 1, 2, serialize(String("after")))
        writer.flush()
    topic = rosCas.getTopic("/t")
    assert [table.name for table in topic.tables] == [handle.table.name]
    assert [msg.data for _, msg in topic.items()] == ["before", "after"]


@pytest.mark.suite("all", "large messages, to see how much memory they take")
def test_large_messages_and_bytes_that_are_no_message(rosCas):
    with rosCas.messageWriter(writer_id=9, format="ros") as writer:
        handle = writer.connect(api_connection("/t", definition_of(String), "/x"), bucket_ns=SEC)
        wires = [serialize(String("x" * n)) for n in (3, 100_000, 700_000, 1_300_000, 0)]
        for number, wire in enumerate([*wires, b"", b"\xff" * 9, wires[0] + b"surplus"]):
            writer.write(handle, T0 + number * SEC // 3, number, wire)
    before = seen(rosCas.getTopic("/t").rows())
    lazy = rosCas.getTopic("/t").rows()
    late = [next(lazy) for _ in range(4)]
    for target in ("packed", "json", "ros", "binary"):
        rosCas.convertTopic("/t", target)
        assert seen(rosCas.getTopic("/t").rows()) == before
    assert seen(late) == before[:4]


def test_blocks_cover_what_the_rate_asks_for(rosCas):
    with rosCas.messageWriter(writer_id=9, format="ros") as writer:
        handle = writer.connect(
            api_connection("/t", definition_of(String), "/x"), bucket_ns=60 * SEC
        )
        for number in range(3000):
            writer.write(handle, T0 + number * SEC // 1000, number, serialize(String("x")))
    rosCas.convertTopic("/t", "packed")
    (table,) = rosCas.getTopic("/t").tables
    assert table.metadata.span_ns == pytest.approx(4.096 * SEC, rel=0.01)
    assert rosCas.getTopic("/t").countTopicData() == 3000


def test_what_comes_into_the_old_table_after_all_is_taken_along(rosCas, connect, monkeypatch):
    """As a client does that cannot read the comments."""
    fill(rosCas, "ros", 20)
    topic, finish = rosCas.getTopic("/t"), replacement.finish
    with connect(keyspace=rosCas.keyspace) as other, other.messageWriter() as writer:
        row = next(topic.rows())
        handle = writer.connect(row.connection)
        monkeypatch.setattr(other.catalog.keyspace.schema, "takes_rows", lambda table: True)

        def finish_then(*arguments):
            finish(*arguments)
            writer.write(handle, T0 + 5, 1, serialize(joint_state(99)))
            writer.flush()

        monkeypatch.setattr(replacement, "finish", finish_then)
        rosCas.convertTopic("/t", "json")
    assert formats(rosCas) == ["json"]
    assert topic.countTopicData() == 41
    assert topic.getData(T0 + 5).header.seq == 99


def test_what_comes_in_the_seconds_after_the_switch_is_taken_along(rosCas, connect, monkeypatch):
    """The other client writes during the pause after the switch, at the latest before the drop."""
    fill(rosCas, "ros", 20)
    topic, drop = rosCas.getTopic("/t"), replacement.drop
    await_clients = convert.Conversion._await_clients
    written_into = []
    with connect(keyspace=rosCas.keyspace) as other, other.messageWriter() as writer:
        handle = writer.connect(next(topic.rows()).connection)
        # As where it cannot read the comments.
        monkeypatch.setattr(other.catalog.keyspace.schema, "takes_rows", lambda table: True)

        def write_once():
            rosCas.catalog.keyspace.schema.tables(fresh=True)
            if formats(rosCas) == ["json"] and not written_into:
                written_into.append(handle.table.name)
                writer.write(handle, T0 + 5, 1, serialize(joint_state(99)))
                writer.flush()

        def write_then_wait(conversion):
            write_once()
            await_clients(conversion)

        def write_then_drop(*arguments):
            write_once()
            drop(*arguments)

        monkeypatch.setattr(convert.Conversion, "_await_clients", write_then_wait)
        monkeypatch.setattr(replacement, "drop", write_then_drop)
        rosCas.convertTopic("/t", "json")
    tables = [table.name for table in topic.tables]
    assert len(written_into) == len(tables) == 1
    assert written_into != tables
    assert topic.countTopicData() == len(list(topic.rows())) == 41
    assert topic.getData(T0 + 5).header.seq == 99


@pytest.mark.suite("all", "make test asks others of its kind")
def test_what_comes_late_into_a_bucket_that_stayed_open_is_taken_along(
    rosCas, connect, monkeypatch
):
    """A client was away, and its requests reach the old table when the new one is complete."""
    monkeypatch.setattr(convert, "QUIET_SEC", 0.1)
    fill(rosCas, "ros", 20)
    topic, finish = rosCas.getTopic("/t"), replacement.finish
    with connect(keyspace=rosCas.keyspace) as other, other.messageWriter() as writer:
        handle = writer.connect(next(topic.rows()).connection)
        writer.write(handle, T0 + 5, 1, serialize(joint_state(98)))
        writer.flush()
        space = other.catalog.keyspace
        monkeypatch.setattr(space.schema, "takes_rows", lambda table: True)
        monkeypatch.setattr(space.directory, "mark", lambda *args, **more: None)

        def finish_then(*arguments):
            finish(*arguments)
            writer.write(handle, T0 + 6, 2, serialize(joint_state(99)))
            writer.flush()

        monkeypatch.setattr(replacement, "finish", finish_then)
        rosCas.convertTopic("/t", "json")
    assert formats(rosCas) == ["json"]
    assert topic.getData(T0 + 6).header.seq == 99
    assert len(list(topic.rows())) == 42


@pytest.mark.parametrize("form", sparing(["ros", "packed", "names"], kept=["packed", "names"]))
def test_what_comes_after_a_conversion_was_broken_off_is_taken_along(
    rosCas, connect, monkeypatch, form
):
    """A conversion dies after the switch; a client that does not know of it goes on; then again."""
    monkeypatch.setattr(convert, "DELETING_SEC", 0.1)
    if form == "names":
        rosCas.addTopic("/t", "ros", msg_type="sensor_msgs/JointState", key_format="manual")
        for number in range(3):
            rosCas.getTopic("/t").addData(joint_state(number), key=f"n{number}")
    else:
        fill(rosCas, form, 20)
    topic, finish = rosCas.getTopic("/t"), replacement.finish
    before = topic.countTopicData()

    def finish_then_die(*arguments):
        finish(*arguments)
        raise KeyboardInterrupt

    with connect(keyspace=rosCas.keyspace) as other, other.messageWriter() as writer:
        handle = writer.connect(api_connection("/t", definition_of(JointState), "/late"))
        monkeypatch.setattr(other.catalog.keyspace.schema, "takes_rows", lambda table: True)
        with monkeypatch.context() as killed, pytest.raises(KeyboardInterrupt):
            killed.setattr(replacement, "finish", finish_then_die)
            rosCas.convertTopic("/t", "json")
        deleted = topic.removeData("n1") if form == "names" else topic.removeData(T0, T0)
        assert deleted > 0
        writer.write(handle, T0 + 5, 1, serialize(joint_state(99)), "late")
        writer.flush()
    assert topic.countTopicData() == before - deleted
    for _ in range(2):
        rosCas.convertTopic("/t", "json")
        assert topic.countTopicData() == len(list(topic.rows())) == before - deleted + 1
        (late,) = (row for row in topic.rows() if row.connection.callerid == "/late")
        assert (late.received, late.message().header.seq) == (T0 + 5, 99)
        assert len(rosCas.catalog.keyspace.schema.listing(fresh=True).every) == 1


def test_what_came_late_is_not_taken_along_while_its_writer_goes_on(rosCas, connect, monkeypatch):
    """Its next heartbeat would count without the late rows: both write the entry of its bucket."""
    monkeypatch.setattr("cassandra_ros.store.rows.writer.HEARTBEAT_SEC", 0.3)
    monkeypatch.setattr(convert, "LOOK_SEC", 0.1)
    fill(rosCas, "ros", 20)
    topic, finish = rosCas.getTopic("/t"), replacement.finish

    def finish_then_die(*arguments):
        finish(*arguments)
        raise KeyboardInterrupt

    def write():
        number = 3
        while not stop.wait(0.01):
            writer.write(handle, T0 + number, number, serialize(joint_state(number)))
            number += 1

    with connect(keyspace=rosCas.keyspace) as other, other.messageWriter() as writer:
        handle = writer.connect(api_connection("/t", definition_of(JointState), "/late"))
        with monkeypatch.context() as away:
            away.setattr(other.catalog.keyspace.schema, "takes_rows", lambda table: True)
            with monkeypatch.context() as killed, pytest.raises(KeyboardInterrupt):
                killed.setattr(replacement, "finish", finish_then_die)
                rosCas.convertTopic("/t", "json")
            writer.write(handle, T0 + 1, 1, serialize(joint_state(1)))
            writer.flush()
        writer._rows.gone.add(handle.table.name)  # as it is told some seconds later
        writer.write(handle, T0 + 2, 2, serialize(joint_state(2)))
        writer.flush()
        assert topic.countTopicData() == 41  # in the new table; the late one is not read yet
        stop = threading.Event()
        thread = threading.Thread(target=write)
        thread.start()
        try:
            with pytest.raises(SchemaConflict, match="is being recorded .* end the recording"):
                rosCas.convertTopic("/t", "json")
        finally:
            stop.set()
            thread.join()
    rosCas.convertTopic("/t", "json")
    assert topic.countTopicData() == len(list(topic.rows()))
    assert topic.getData(T0 + 1).header.seq == 1


CHANGES = ["convert", "rename", "delete", "index"]


@pytest.mark.suite("all", "two changes of all messages")
@pytest.mark.parametrize("between", CHANGES)
def test_equal_stamps_of_a_client_keep_their_order(rosCas, between):
    topic = rosCas.addTopic("/t", "ros", msg_type="std_msgs/String")
    for round_ in range(4):
        rosCas.getTopic("/t").addData(String(str(round_)), key=T0)
        if between == "convert":
            rosCas.convertTopic("/t", ["packed", "binary", "yaml", "ros"][round_])
        elif between == "rename":
            rosCas.renameTopic("/t", "/u")
            rosCas.renameTopic("/u", "/t")
        elif between == "delete":
            rosCas.upkeep.delete(["/t"], T0 + SEC)
        else:
            (topic.removeIndex if topic.hasIndex("data") else topic.createIndex)("data")
    topic = rosCas.getTopic("/t")
    assert [msg.data for _, msg in topic.items()] == ["0", "1", "2", "3"]
    assert topic.getData(T0).data == "0"
    assert len({key.seq >> 32 for key, _ in topic.items()}) == 1
    assert topic.countTopicData() == sum(info.count for info in rosCas.info(["/t"])) == 4


def test_what_is_deleted_between_copy_and_switch_does_not_come_back(rosCas, monkeypatch):
    """As a client deletes that does not know of the conversion yet."""
    fill(rosCas, "ros", 20)
    topic, compare, deleted = rosCas.getTopic("/t"), copying.TableCopy.compare, []

    def compare_then_delete(self):
        count = compare(self)
        if not deleted:
            with monkeypatch.context() as earlier:
                earlier.setattr(schema.TableListing, "check_staying", lambda self, table: None)
                deleted.append(topic.removeData(T0, T0))
        return count

    monkeypatch.setattr(copying.TableCopy, "compare", compare_then_delete)
    monkeypatch.setattr(convert, "DELETING_SEC", 0.0)
    before = topic.countTopicData()
    rosCas.convertTopic("/t", "json")
    assert deleted[0] > 0
    assert topic.countTopicData() == len(list(topic.rows())) == before - deleted[0]


def test_what_is_added_after_a_conversion_lives_as_long_as_the_topic_says(rosCas, cql):
    topic = rosCas.addTopic("/t", "ros", msg_type="std_msgs/String", ttl=2000)
    old = topic.tables[0]
    key = topic.addData(String("old"), key=T0)
    cql.execute(
        f'UPDATE {old.qualified} USING TTL 700 SET "_conn" = %s WHERE "_node" = %s AND '
        '"_bucket" = %s AND "_t" = %s AND "_seq" = %s',
        (next(topic.rows()).conn, "", old.bucket_of(T0), T0, key.seq),
    )
    rosCas.convertTopic("/t", "binary")
    rosCas.getTopic("/t").addData(String("new"), key=T0 + 1)
    (table,) = topic.tables
    left = dict(cql.execute(f'SELECT "_t", TTL("_conn") FROM {table.qualified}').all())
    assert left[T0] <= 700 and 1900 < left[T0 + 1] <= 2000
