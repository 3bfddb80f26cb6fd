# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Counts stay true while other clients write, are suspended, delete or count."""

from __future__ import annotations

import pytest
from nodes.children import await_true
from std_msgs.msg import String

from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.store.rows import row_counts as counting
from cassandra_ros.store.rows import writer
from cassandra_ros.store.rows.layouts import RowLayout, layout_of
from cassandra_ros.store.tables import directory

SEC = 10**9
T0 = 1_500_000_000 * SEC


def wire_of(number):
    return serialize(String(data=f"text {number}"))


def write(target, numbers):
    handle = target.connect(api_connection("/a", definition_of(String), "/x"), bucket_ns=600 * SEC)
    for number in numbers:
        target.write(handle, T0 + number, number, wire_of(number))


def listed(rosCas):
    """What the directory says of the one bucket: writer → its row."""
    (table,) = rosCas.getTopic("/a").tables
    rows = rosCas.catalog.keyspace.directory.find(table.name, "", table.bucket_of(T0))
    return {row.writer: row for row in rows}


def counts(rosCas):
    """How many messages there are: by the rows themselves, and as the two counts tell."""
    topic = rosCas.getTopic("/a")
    return len(list(topic.rows())), topic.countTopicData(), rosCas.info(["/a"])[0].count


def test_a_closed_bucket_of_one_writer_does_not_speak_for_the_other(rosCas, still):
    """One has closed the bucket that both have written to; of the other's rows nothing is known."""
    with rosCas.messageWriter(writer_id=1) as first:
        write(first, range(10))
    second = rosCas.messageWriter(writer_id=2)
    write(second, range(100, 105))
    second.flush()
    assert [listed(rosCas)[number].closed for number in (1, 2)] == [True, False]
    assert counts(rosCas) == (15, 15, 15)
    second.close()
    assert [(listed(rosCas)[n].closed, listed(rosCas)[n].rows) for n in (1, 2)] == [
        (True, 10),
        (True, 5),
    ]
    assert counts(rosCas) == (15, 15, 15)


def test_who_is_taken_for_dead_comes_back_before_that():
    assert directory.HEARTBEAT_SEC < writer.REOPEN_SEC < directory.STALE_SEC
    assert writer.IDLE_SEC < directory.STALE_SEC


@pytest.fixture
def still(monkeypatch):
    """No heartbeat, and nothing is late until a test says so."""
    monkeypatch.setattr(writer, "HEARTBEAT_SEC", 1e9)
    monkeypatch.setattr(writer, "REOPEN_SEC", 1e9)


def taken_for_dead(rosCas, monkeypatch):
    """Delete five rows of the living writer, and close its bucket as that of a dead one."""
    with monkeypatch.context() as patched:
        patched.setattr(counting, "STALE_SEC", -1.0)
        assert rosCas.getTopic("/a").removeData(T0, T0 + 4) == 5
        rosCas.info(["/a"])
    assert listed(rosCas)[9].closed
    assert listed(rosCas)[9].rows == 5


def test_a_writer_that_stood_still_opens_its_bucket_again(rosCas, still, monkeypatch):
    target = rosCas.messageWriter(writer_id=9)
    write(target, range(10))
    target.flush()
    taken_for_dead(rosCas, monkeypatch)
    monkeypatch.setattr(writer, "REOPEN_SEC", -1.0)
    write(target, range(10, 13))
    # Before the row is sent, the bucket is open, so that no client takes the old count.
    assert not listed(rosCas)[9].closed
    target.flush()
    assert counts(rosCas) == (8, 8, 8)
    target.close()
    assert (listed(rosCas)[9].closed, listed(rosCas)[9].rows) == (True, 8)
    assert counts(rosCas) == (8, 8, 8)


def test_rows_that_waited_while_the_writer_stood_still_open_it_again(rosCas, still, monkeypatch):
    target = rosCas.messageWriter(writer_id=9)
    write(target, range(10))
    target.flush()
    monkeypatch.setattr(target._rows, "_linger_sec", 1e9)
    write(target, range(10, 13))
    taken_for_dead(rosCas, monkeypatch)
    monkeypatch.setattr(writer, "REOPEN_SEC", -1.0)
    monkeypatch.setattr(target._rows, "_linger_sec", -1.0)
    await_true(lambda: target.stats()["/a"].stored == 13)
    assert not listed(rosCas)[9].closed
    assert counts(rosCas) == (8, 8, 8)
    target.close()
    assert (listed(rosCas)[9].closed, listed(rosCas)[9].rows) == (True, 8)
    assert counts(rosCas) == (8, 8, 8)


def test_a_writer_that_was_not_late_is_not_counted_again(rosCas, still, monkeypatch):
    """Only then the directory is cheap: a recount reads all keys of the bucket."""
    counted = []
    monkeypatch.setattr(RowLayout, "recount", lambda *args: counted.append(args))
    with rosCas.messageWriter() as target:
        write(target, range(10))
    assert counted == []
    assert counts(rosCas) == (10, 10, 10)


@pytest.fixture
def beating(monkeypatch):
    """Heartbeats as fast as the ticker goes."""
    monkeypatch.setattr(writer, "HEARTBEAT_SEC", -1.0)
    monkeypatch.setattr(writer, "IDLE_SEC", 1e9)
    monkeypatch.setattr(writer, "REOPEN_SEC", 1e9)


def test_a_busy_bucket_is_marked(rosCas, beating):
    target = rosCas.messageWriter(writer_id=9)
    write(target, range(10))
    target.flush()
    await_true(lambda: listed(rosCas)[9].rows == 10)
    first = listed(rosCas)[9]
    assert not first.closed
    assert (first.t_min, first.t_max, first.largest) == (T0, T0 + 9, len(wire_of(0)))
    assert first.bytes == 10 * len(wire_of(0))
    write(target, range(10, 15))
    target.flush()
    await_true(lambda: listed(rosCas)[9].rows == 15)
    assert listed(rosCas)[9].heartbeat > first.heartbeat
    assert not listed(rosCas)[9].closed
    target.close()
    assert (listed(rosCas)[9].closed, listed(rosCas)[9].rows) == (True, 15)


def test_an_idle_bucket_is_closed_and_opened_again(rosCas, beating, monkeypatch):
    target = rosCas.messageWriter(writer_id=9)
    write(target, range(10))
    target.flush()
    with monkeypatch.context() as patched:
        patched.setattr(writer, "IDLE_SEC", -1.0)
        await_true(lambda: listed(rosCas)[9].closed)
    assert listed(rosCas)[9].rows == 10
    write(target, range(10, 15))
    assert not listed(rosCas)[9].closed
    target.flush()
    assert counts(rosCas) == (15, 15, 15)
    target.close()
    # The second state of the bucket has seen five of its rows.
    assert (listed(rosCas)[9].closed, listed(rosCas)[9].rows) == (True, 15)


def test_a_bucket_with_rows_on_their_way_is_not_closed(rosCas, beating, monkeypatch):
    target = rosCas.messageWriter(writer_id=9)
    monkeypatch.setattr(target._rows, "_linger_sec", 1e9)
    write(target, range(10))
    before = listed(rosCas)[9].heartbeat
    monkeypatch.setattr(writer, "IDLE_SEC", -1.0)
    await_true(lambda: listed(rosCas)[9].heartbeat > before)
    assert not listed(rosCas)[9].closed
    target.close()
    assert target.stats()["/a"].stored == 10
    assert counts(rosCas) == (10, 10, 10)


def test_a_recount_gives_what_the_writer_has_counted(rosCas):
    """Plain rows, one that its columns do not hold exactly, and one in chunks."""
    odd = b"\4\0\0\0\xff\xfe\xfd\xfc"  # no UTF-8
    large = serialize(String(data="x" * 600_000))
    with rosCas.messageWriter(writer_id=9) as target:
        write(target, range(10))
        handle = target.connect(api_connection("/a", definition_of(String), "/x"))
        for number, wire in ((20, odd), (30, large), (31, odd)):
            target.write(handle, T0 + number, number, wire)
    told = listed(rosCas)[9]
    (table,) = rosCas.getTopic("/a").tables
    counted = layout_of(table).recount("", told.bucket)[9]
    assert vars(counted) == {name: getattr(told, name) for name in vars(counted)}
    assert (told.rows, told.odd, told.t_min, told.t_max) == (13, 3, T0, T0 + 31)
    assert told.largest == len(wire_of(0))
    assert told.bytes == 10 * len(wire_of(0)) + 2 * len(odd) + len(large)


def test_a_reader_closes_no_bucket_of_a_living_writer(rosCas, still):
    target = rosCas.messageWriter(writer_id=9)
    write(target, range(10))
    target.flush()
    assert counts(rosCas) == (10, 10, 10)
    assert not listed(rosCas)[9].closed
    write(target, range(10, 15))
    target.flush()
    assert counts(rosCas) == (15, 15, 15)
    target.close()
    assert counts(rosCas) == (15, 15, 15)


def test_a_count_ends_where_its_times_end(rosCas):
    """At both sides of the borders of buckets, to the nanosecond."""
    borders = [T0 + number * SEC for number in range(4)]
    times = [border + more for border in borders for more in (-1, 0, 1)]
    with rosCas.messageWriter() as target:
        connection = api_connection("/a", definition_of(String), "/x")
        handle = target.connect(connection, bucket_ns=SEC)
        for number, t in enumerate(times):
            target.write(handle, t, number, wire_of(number))
    topic = rosCas.getTopic("/a")
    assert topic.tables[0].metadata.bucket_ns == SEC
    ends = sorted({t + more for t in times for more in (-1, 0, 1)})
    for low in ends[:8]:
        for high in ends[-8:]:
            assert topic.countTopicData(low, high) == sum(low <= t <= high for t in times)


@pytest.fixture
def around_delete(rosCas, monkeypatch):
    """Lets a test do something right before and after rows are deleted."""
    execute, todo = rosCas.cassandra.execute, {}

    def executing(cql, *args, **options):
        deletes = cql.startswith("DELETE") and "cr_" not in cql
        if deletes and "before" in todo:
            todo.pop("before")()
        found = execute(cql, *args, **options)
        if deletes and "after" in todo:
            todo.pop("after")()
        return found

    monkeypatch.setattr(rosCas.cassandra, "execute", executing)
    return todo


def test_a_removal_that_dies_behind_its_delete_leaves_true_counts(rosCas, around_delete):
    with rosCas.messageWriter() as target:
        write(target, range(10))

    def die():
        raise KeyboardInterrupt

    around_delete["after"] = die
    with pytest.raises(KeyboardInterrupt):
        rosCas.getTopic("/a").removeData(T0, T0 + 4)
    assert counts(rosCas) == (5, 5, 5)


def test_rows_that_are_written_while_others_are_deleted_stay(rosCas, around_delete, monkeypatch):
    with rosCas.messageWriter(writer_id=1) as target:
        write(target, (0, 1, 2, 8, 9))

    def write_between():
        with rosCas.messageWriter(writer_id=2) as other:
            write(other, range(4, 7))
            write(other, range(100, 102))

    around_delete["before"] = write_between
    # What came after the deletion had begun stays, also where it lies in its range of time.
    assert rosCas.getTopic("/a").removeData(T0, T0 + 8) == 4
    monkeypatch.setattr(counting, "STALE_SEC", -1.0)
    assert counts(rosCas) == (6, 6, 6)
    # Each writer's own, as it was counted again and kept.
    assert [(listed(rosCas)[n].closed, listed(rosCas)[n].rows) for n in (1, 2)] == [
        (True, 1),
        (True, 5),
    ]
    assert counts(rosCas) == (6, 6, 6)


def test_the_note_of_a_node_outlives_the_rows_that_rely_on_it(rosCas, still, monkeypatch):
    noted, ttl = [], 1000
    add_node = directory.Directory.add_node

    def adding(self, table, slot, node, ttl=0):
        noted.append(ttl)
        add_node(self, table, slot, node, ttl)

    monkeypatch.setattr(directory.Directory, "add_node", adding)
    with rosCas.messageWriter(ttl=ttl) as target:
        write(target, range(3))
        # A row that is written right before the note is renewed lives for its ttl from then on.
        assert noted and min(noted) >= ttl + directory.NOTE_SEC
        del noted[:]
        monkeypatch.setattr(writer, "REOPEN_SEC", -1.0)
        write(target, range(3, 6))
        assert noted == []
        monkeypatch.setattr(directory, "NOTE_SEC", -1.0)
        write(target, range(6, 9))
        assert len(noted) >= 3  # the writer's own thread marks the bucket, too


def test_rows_of_an_open_bucket_may_come_late():
    """They may have been tried for minutes: an open bucket is listed longer than a closed one."""
    place = ("", 0, 1, True, None, 1, 1, 1, 0, 0, 0)
    closed = directory.BucketRow(*place, 105.0)
    assert closed.expired(100)
    assert not closed.expired(104)
    assert not closed._replace(closed=False).expired(100)
    assert closed._replace(closed=False, age_sec=105.0 + directory.TTL_MARGIN_SEC).expired(100)
    assert directory.CLOCKS_SEC < directory.TTL_MARGIN_SEC


@pytest.mark.parametrize("how", ["closes", "is idle"])
def test_a_writer_that_stood_still_and_writes_no_more_counts_again(rosCas, still, monkeypatch, how):
    target = rosCas.messageWriter(writer_id=9)
    write(target, range(10))
    target.flush()
    taken_for_dead(rosCas, monkeypatch)
    monkeypatch.setattr(writer, "REOPEN_SEC", -1.0)
    if how == "is idle":
        monkeypatch.setattr(writer, "IDLE_SEC", -1.0)
        monkeypatch.setattr(writer, "HEARTBEAT_SEC", 0.01)
        await_true(lambda: not target._rows._buckets)
    target.close()
    assert (listed(rosCas)[9].closed, listed(rosCas)[9].rows) == (True, 5)
    assert counts(rosCas) == (5, 5, 5)
