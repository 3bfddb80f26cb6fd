# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is read of many robots at once equals what a plain list of their messages says."""

from __future__ import annotations

import itertools
import time

import pytest
from bag.truth import string_connection, string_wire
from hypothesis import HealthCheck, given
from hypothesis import strategies as st
from suites import search

from cassandra_ros.store.tables.directory import (
    CLOCKS_SEC,
    ActiveEntry,
    BucketTotals,
    Directory,
    slot_of,
)

SEC = 10**9
T0 = 1_600_000_000 * SEC
ROBOTS = [f"r{n:02}" for n in range(12)]
FORMATS = ("binary", "packed")
number = itertools.count()

robots = st.sampled_from(ROBOTS)
# Buckets of a second in two slots of the directory, with gaps; some times are equal.
offsets = st.builds(
    lambda second, part: second * SEC + part * SEC // 8,
    st.sampled_from([0, 1, 2, 9, 10, 5000, 5001, 5060]),
    st.integers(0, 7),
)
writes = st.tuples(st.just("write"), st.lists(st.tuples(robots, offsets), max_size=20))
deletions = st.tuples(st.just("delete"), offsets, offsets, st.one_of(st.none(), robots))
closings = st.tuples(st.just("close"))
lives = st.lists(st.one_of(writes, writes, deletions, closings), min_size=1, max_size=6)


class Fleet:
    """A topic that many robots write to, and the plain list of its messages.

    Each message is (time, robot, writer id << 32 | counter), which is the order of all reads.
    """

    def __init__(self, rosCas, form):
        self.rosCas, self.form = rosCas, form
        self.topic = f"/fleet/{next(number)}"
        self.messages = []
        self.writers = itertools.count(1)
        self.writer = None
        self.write([(ROBOTS[0], 0)])

    def write(self, some):
        if self.writer is None:
            self.id, self.counter = next(self.writers), itertools.count()
            self.writer = self.rosCas.messageWriter(writer_id=self.id, format=self.form)
        for robot, offset in some:
            connection = string_connection(self.topic)
            handle = self.writer.connect(connection, SEC, node=robot)
            count = next(self.counter)
            self.writer.write(handle, T0 + offset, count, string_wire(str(count)))
            self.messages.append((T0 + offset, robot, self.id << 32 | count))
        self.writer.flush()

    def close(self):
        if self.writer is not None:
            self.writer.close()
            self.writer = None

    def delete(self, low, high, robot):
        topic = self.rosCas.getTopic(self.topic)
        gone = [m for m in self.messages if low <= m[0] - T0 <= high and robot in (None, m[1])]
        assert topic.removeData(T0 + low, T0 + high, nodeID=robot) == len(gone)
        self.messages = [m for m in self.messages if m not in gone]

    def live(self, steps):
        for kind, *arguments in steps:
            {"write": self.write, "delete": self.delete, "close": self.close}[kind](*arguments)

    def check(self, store):
        """Compare all kinds of reads with the list."""
        topic, every = store.getTopic(self.topic), sorted(self.messages)
        times = sorted({t for t, *_ in every})

        def read(*args, **options):
            return [(key.ns, key.node, key.seq) for key, _ in topic.items(*args, **options)]

        assert read() == every
        assert read(reverse=True) == every[::-1]
        assert read(limit=5) == every[:5]
        assert read(limit=5, reverse=True) == every[::-1][:5]
        ends = [topic.first(), topic.last()]
        assert [key and (key.ns, key.node) for key in ends] == (
            [every[0][:2], every[-1][:2]] if every else [None, None]
        )
        assert topic.countTopicData() == len(every)
        for second in (0, 1, 5, 10, 4999, 5060):
            low, high = T0 + second * SEC - SEC // 3, T0 + second * SEC + 2 * SEC
            inside = [m for m in every if low <= m[0] <= high]
            assert read(low, high) == inside
            assert topic.countTopicData(low, high) == len(inside)
        for robot in ROBOTS[:2]:
            assert read(nodeID=robot) == [m for m in every if m[1] == robot]
        for offset in (-1, 0, SEC // 8, SEC // 4 + 1, 3 * SEC, 10 * SEC, 5000 * SEC, 6000 * SEC):
            t = T0 + offset
            row = topic.getRow(t)
            assert (row is not None) == (t in times)
            if row is not None:
                assert (row.t, row.node, row.seq) in every
            for robot in (None, ROBOTS[0]):
                own = [m[0] for m in every if robot in (None, m[1])]
                before = max((each for each in own if each <= t), default=None)
                after = min((each for each in own if each >= t), default=None)
                near = [each for each in (before, after) if each is not None]
                wanted = {
                    "before": {before},
                    "after": {after},
                    "either": {e for e in near if abs(e - t) == min(abs(n - t) for n in near)}
                    or {None},
                }
                for way, right in wanted.items():
                    row = topic.getRow(t, nearest=way, nodeID=robot)
                    assert (None if row is None else row.t) in right
        counts = {info.node: info.count for info in store.info([self.topic]) if info.count}
        assert counts == {r: n for r in ROBOTS if (n := sum(m[1] == r for m in every))}


@pytest.mark.suite("all", "a search; make test asks two robots")
@pytest.mark.parametrize("form", FORMATS)
@search(20, suppress_health_check=list(HealthCheck))
@given(steps=lives)
def test_reads_of_many_robots_equal_a_plain_list(rosCas, connect, form, steps):
    fleet = Fleet(rosCas, form)
    try:
        fleet.live(steps)
        fleet.check(rosCas)
        with connect(keyspace=rosCas.keyspace) as other:
            fleet.check(other)
            fleet.check(other)  # with what it has cached
    finally:
        fleet.close()


def filled(rosCas):
    """Return a fleet with closed and open buckets and deletions."""
    fleet = Fleet(rosCas, "binary")
    fleet.write([(robot, n * SEC // 2) for n, robot in enumerate(ROBOTS)])
    fleet.delete(0, SEC // 8, None)
    fleet.close()
    fleet.write([(robot, 5000 * SEC + n) for n, robot in enumerate(ROBOTS)])
    fleet.delete(5000 * SEC, 5000 * SEC + 2, ROBOTS[1])
    return fleet


def place_of(store, fleet):
    (table,) = store.getTopic(fleet.topic).tables
    return table, store.catalog.keyspace.directory


def test_a_writer_that_was_killed_before_its_first_message_hides_nothing(rosCas, connect):
    fleet = filled(rosCas)
    table, directory = place_of(rosCas, fleet)
    for offset in (-SEC, 0, 5 * SEC, 9000 * SEC):
        bucket = table.bucket_of(T0 + offset)
        directory.note(table, "killed", bucket)
        directory.mark((table.name, "killed", bucket, 99), 0)
    with connect(keyspace=rosCas.keyspace) as other:
        fleet.check(other)
    fleet.close()


@pytest.mark.suite("all", "it waits for seconds")
def test_an_entry_that_is_missing_by_time_is_found_and_listed_again(rosCas, connect, cql):
    fleet = filled(rosCas)
    fleet.close()
    table, directory = place_of(rosCas, fleet)
    lost, wrong = sorted(fleet.messages)[3:5]

    def entry(message):
        bucket = table.bucket_of(message[0])
        return table.name, slot_of(bucket), bucket, message[1], message[2] >> 32

    where = "WHERE tbl = %s AND slot = %s AND bucket = %s AND node = %s AND writer = %s"
    active = f"{rosCas.keyspace}.cr_active"
    cql.execute(f"DELETE FROM {active} {where}", entry(lost))
    bad = ActiveEntry(True, (77, 9, 9, wrong[0], wrong[0], 0)).encoded()
    cql.execute(f"UPDATE {active} SET entry = %s {where}", (bad, *entry(wrong)))
    with connect(keyspace=rosCas.keyspace) as other:
        count = len(fleet.messages) - 1 + 76
        assert other.getTopic(fleet.topic).countTopicData() == count
        kinds = {damage.kind.value for damage in other.upkeep.check([fleet.topic]).damages}
        assert kinds == {"not listed", "count"}
        time.sleep(CLOCKS_SEC + 0.1)  # what was changed above is older than what is written now
        report = other.upkeep.check([fleet.topic], repair=True)
        assert (report.found, report.mended) == (2, 2)
        assert not other.upkeep.check([fleet.topic]).damages
        fleet.check(other)


def test_a_recount_does_not_hide_a_later_deletion(rosCas):
    fleet = filled(rosCas)
    fleet.close()
    table, directory = place_of(rosCas, fleet)
    message = min(fleet.messages)
    bucket = table.bucket_of(message[0])
    place = (table.name, message[1], bucket)
    (row,) = directory.find(*place)
    counts = row.rows, row.bytes, row.largest, row.t_min, row.t_max, row.odd

    def totals():
        return BucketTotals(*counts)

    assert directory.put_recount(table.name, row, totals(), 0)
    (closed,) = directory.find(*place)
    directory.mark((*place, row.writer), 0, deleted=True)
    # As if a recount of another client had closed cr_bucket before, and cr_active comes now.
    directory._cassandra.execute(
        f"UPDATE {directory._active_table} USING TIMESTAMP ? SET "
        "deleted = false WHERE tbl = ? AND slot = ? AND bucket = ? AND node = ? AND writer = ?",
        (closed.marked_us + 1, table.name, slot_of(bucket), bucket, message[1], row.writer),
    )
    assert not directory.put_recount(table.name, closed, totals(), 0)
    (active,) = directory.find_active(*place)
    assert active.cut and not active.closed
    fleet.check(rosCas)


def test_a_question_about_an_hour_reads_no_other_entries(rosCas, monkeypatch):
    fleet = filled(rosCas)
    fleet.close()
    topic = rosCas.getTopic(fleet.topic)
    asked = []

    def note(name):
        method = getattr(Directory, name)

        def noted(self, table, *args, **options):
            asked.append((name, *args))
            return method(self, table, *args, **options)

        monkeypatch.setattr(Directory, name, noted)

    for name in ("begin_active", "count_closed", "begin_buckets", "begin_nodes"):
        note(name)
    t = T0 + 2 * SEC
    bucket = topic.tables[0].bucket_of(t)
    assert topic.countTopicData(t, t + 2 * SEC - 1) == 4
    assert topic.getRow(t) is not None
    assert asked == [
        ("count_closed", bucket, bucket + 1),
        ("begin_active", slot_of(bucket), bucket, bucket),
    ]
