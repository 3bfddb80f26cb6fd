# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The timeline of a viewer beside what was stored, message by message."""

from __future__ import annotations

import pytest
from std_msgs.msg import Int64, String
from viewers import running_viewer

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.read import EVERYBODY
from cassandra_ros.store.tables.directory import SLOT_BUCKETS, BucketTotals
from cassandra_ros.store.tables.registry import Loss, LossKind, Run
from cassandra_ros.topics.overview.timeline import bucket_detail as detail
from cassandra_ros.topics.overview.timeline import directory_reader as reader

T0 = 1_500_000_000 * SECOND_NS
BUCKET = 100 * SECOND_NS
HOUR = 3600 * SECOND_NS
EVEN = [T0 + n * SECOND_NS for n in range(500)]
PAUSED = [T0 + n * SECOND_NS // 5 for n in range(1500) if not 400 <= n < 900]
"""For 100 s nothing came."""
LATE = [T0 + HOUR + n * SECOND_NS for n in range(50)]


def add(store, topic, times, writer=7, node="husky", format="binary", name="drive"):
    """Store a message at each time, in buckets of 100 s."""
    run = Run(node, writer, "recording", name=name)
    header = {"type": Int64._type, "md5sum": Int64._md5sum}
    header["message_definition"] = Int64._full_text
    with store.messageWriter(writer_id=writer, nodeID=node, format=format, run=run) as out:
        handle = out.connect(live_connection(topic, header), bucket_ns=BUCKET)
        for n, time in enumerate(times):
            out.write(handle, time, n, serialize(Int64(n)))


@pytest.fixture(scope="module")
def store(fresh):
    with fresh() as store:
        add(store, "/even", EVEN)
        add(store, "/paused", PAUSED, writer=8, format="packed", name="other")
        add(store, "/even", LATE, writer=9, node="jackal", name="late")
        store.addTopic("/map", msg_type="std_msgs/String", key_format="manual")
        for floor in ("ground", "first"):
            store.getTopic("/map").addData(String(floor), key=floor)
        loss = Loss("/gone", "husky", 7, LossKind.BUFFER_FULL, EVEN[10], EVEN[20], 11)
        store.catalog.keyspace.registry.put_loss(loss)
        yield store


@pytest.fixture(scope="module")
def viewer(store):
    with running_viewer(store) as viewer:
        yield viewer


def lanes(answer):
    return {(lane["topic"], lane["node"]): lane for lane in answer["lanes"]}


def counts(answer, topic, node="husky"):
    """Return the counts of all cells of a lane."""
    found = [0] * answer["cells"]
    for first, *run in lanes(answer)[topic, node]["counts"]:
        found[first : first + len(run)] = run
    return found


def by_hand(answer, times):
    start, step = int(answer["start"]), int(answer["cell_ns"])
    found = [0] * answer["cells"]
    for time in times:
        if start <= time <= int(answer["end"]):
            found[(time - start) // step] += 1
    return found


def test_all_time_is_shown_when_no_window_is_asked_for(viewer, store):
    answer = viewer.get("/api/timeline", topics=["/even", "/paused"], pixels=400)
    assert (int(answer["first"]), int(answer["last"])) == (EVEN[0], LATE[-1])
    assert (answer["start"], answer["end"]) == (answer["first"], answer["last"])
    assert answer["cells"] <= 400
    even, late = lanes(answer)["/even", "husky"], lanes(answer)["/even", "jackal"]
    assert (even["messages"], even["bytes"], even["exact"]) == (500, 4000, True)
    assert (even["first"], even["last"]) == (str(EVEN[0]), str(EVEN[-1]))
    assert even["rate_hz"] == pytest.approx(1.0)
    assert (even["types"], even["formats"], even["key"]) == (["std_msgs/Int64"], ["binary"], "time")
    assert late["messages"] == 50
    assert lanes(answer)["/paused", "husky"]["messages"] == len(PAUSED)
    runs = {run["run"]: run for run in answer["runs"]}
    assert {name: run["messages"] for name, run in runs.items()} == {
        "drive": 500,
        "other": len(PAUSED),
        "late": 50,
    }
    assert (runs["late"]["first"], runs["late"]["node"]) == (str(LATE[0]), "jackal")
    infos = {(info.topic, info.node): info for info in store.info(["/even", "/paused"])}
    assert {key: info.count for key, info in infos.items()} == {
        key: lane["messages"] for key, lane in lanes(answer).items()
    }


@pytest.mark.parametrize("looked_into", [False, True])
def test_cells_hold_what_lies_in_them(viewer, looked_into):
    # Cells of 50 s, of 0.4 s, of a part of a bucket, and of a time range without messages.
    for start, end, pixels in (
        (T0, T0 + 499 * SECOND_NS, 10),
        (T0, T0 + 499 * SECOND_NS, 1250),
        (T0 + 30 * SECOND_NS + 1, T0 + 41 * SECOND_NS, 800),
        (T0 - HOUR, T0 - 1, 100),
    ):
        window = {"start": start, "end": end, "pixels": pixels, "detail": looked_into}
        answer = viewer.get("/api/timeline", topics=["/even", "/paused"], **window)
        assert (int(answer["start"]), int(answer["end"])) == (start, end)
        for topic, known in (("/even", EVEN), ("/paused", PAUSED)):
            lane, inside = lanes(answer)[topic, "husky"], [t for t in known if start <= t <= end]
            assert lane["messages"] == pytest.approx(len(inside), abs=3)
            if looked_into:
                assert counts(answer, topic) == by_hand(answer, known)
                assert lane["messages"] == len(inside)
                assert lane["exact"]
                assert lane["even"] == []
            elif pixels == 1250:
                assert lane["even"], "a bucket covers many cells"
                assert sum(counts(answer, topic)) == pytest.approx(len(inside), rel=0.2)


def test_a_pause_of_a_run_is_a_gap_and_time_between_runs_is_none(viewer):
    answer = viewer.get("/api/timeline", start=T0, end=LATE[-1], pixels=1000, detail=True)
    gaps = lanes(answer)["/paused", "husky"]["gaps"]
    assert [(int(low), int(high)) for low, high in gaps] == [(PAUSED[399], PAUSED[400])]
    assert lanes(answer)["/even", "husky"]["gaps"] == []


def test_robots_runs_and_topics_are_chosen(viewer):
    answer = viewer.get("/api/timeline", nodes="jackal")
    assert list(lanes(answer)) == [("/even", "jackal")]
    assert (int(answer["first"]), int(answer["last"])) == (LATE[0], LATE[-1])
    answer = viewer.get("/api/timeline", runs="other,late", pixels=100)
    assert sorted(lanes(answer)) == [("/even", "jackal"), ("/paused", "husky")]
    assert (int(answer["first"]), int(answer["last"])) == (T0, LATE[-1])
    status, failure = viewer.fail("/api/timeline", topics="/evn")
    assert (status, failure["error"]) == (404, "TopicNotFound")
    assert "/even" in failure["text"]


def test_messages_under_names_stand_where_they_were_stored(viewer, store):
    lane = lanes(viewer.get("/api/timeline", topics="/map"))["/map", ""]
    known = [row.t for row in store.readMessages(["/map"])]
    # They are of today, and would leave little to be seen of what was recorded.
    answer = viewer.get("/api/timeline")
    assert (answer["last"], lanes(answer)["/map", ""]["messages"]) == (str(LATE[-1]), 0)
    assert (lane["messages"], lane["exact"], lane["key"]) == (2, True, "manual")
    assert (int(lane["first"]), int(lane["last"])) == (min(known), max(known))


def test_what_is_no_window_is_refused(viewer):
    for given in (
        {"pixels": 0},
        {"pixels": 10**6},
        {"start": T0, "end": T0 - 1},
        {"start": "noon"},
    ):
        status, failure = viewer.fail("/api/timeline", **given)
        assert (status, failure["error"]) == (400, "InvalidOption"), given


def test_long_pauses_divide_periods(viewer, fresh):
    (period,) = viewer.get("/api/timeline", topics="/even")["periods"]
    assert period == [str(EVEN[0]), str(LATE[-1]), 550]
    day = 86_400 * SECOND_NS
    year = 365 * day
    with fresh() as store, running_viewer(store) as other:
        assert other.get("/api/timeline")["periods"] == []
        add(store, "/clock", [n * SECOND_NS for n in range(5, 9)])
        add(store, "/clock", [year + n * SECOND_NS for n in range(7)], writer=8, name="b")
        # Two days later there is more: so far apart both can be seen in one picture.
        add(store, "/clock", [year + 2 * day], writer=10, name="b2")
        add(store, "/other", [20 * year, 20 * year + SECOND_NS], writer=9, name="c")
        assert other.get("/api/timeline")["periods"] == [
            [str(5 * SECOND_NS), str(8 * SECOND_NS), 4],
            [str(year), str(year + 2 * day), 8],
            [str(20 * year), str(20 * year + SECOND_NS), 2],
        ]
        (period,) = other.get("/api/timeline", topics="/other")["periods"]
        assert period[0] == str(20 * year)
        # A message each week of a year, and ten years without one.
        weeks = [21 * year + n * 7 * day for n in range(52)]
        add(store, "/weekly", [*weeks, weeks[-1] + 10 * year], writer=11, name="d")
        periods = other.get("/api/timeline", topics="/weekly")["periods"]
        assert [messages for *_, messages in periods] == [52, 1]


def test_an_end_alone_is_enough(viewer):
    late = viewer.get("/api/timeline", start=LATE[-1] + HOUR, topics="/even")
    assert late["start"] == late["end"] == str(LATE[-1] + HOUR)
    assert all(lane["counts"] == [] for lane in late["lanes"])


def test_more_keys_than_the_bound_are_spread_evenly(viewer, monkeypatch):
    window = {"start": T0, "end": T0 + 499 * SECOND_NS, "pixels": 1250, "detail": True}
    monkeypatch.setattr(detail, "MAX_KEYS", 1200)  # for one of them
    found = lanes(viewer.get("/api/timeline", topics=["/even", "/paused"], **window))
    assert found["/even", "husky"]["even"] == []
    # There are few blocks: enough is known of those that are not read to show the pause.
    assert found["/paused", "husky"]["even"]
    assert found["/paused", "husky"]["messages"] == len(PAUSED)
    monkeypatch.setattr(detail, "MAX_KEYS", 0)
    monkeypatch.setattr(detail, "MAX_PICTURE_BLOCKS", 0)
    found = lanes(viewer.get("/api/timeline", topics=["/even", "/paused"], **window))
    assert all(lane["even"] for lane in found.values() if lane["node"] == "husky")


def test_an_empty_keyspace_shows_nothing_and_then_what_is_stored(fresh, monkeypatch):
    monkeypatch.setattr(reader, "KEEP_SEC", 0.0)
    with fresh() as store, running_viewer(store) as viewer:
        answer = viewer.get("/api/timeline")
        assert (answer["first"], answer["start"], answer["lanes"]) == (None, None, [])
        for count in (3, 5):
            add(store, "/even", EVEN[:count], writer=count)
        assert lanes(viewer.get("/api/timeline"))["/even", "husky"]["messages"] == 8
        add(store, "/even", LATE, writer=9)
        assert lanes(viewer.get("/api/timeline"))["/even", "husky"]["messages"] == 8 + len(LATE)
        store.getTopic("/even").removeData(to_key=EVEN[-1])
        answer = viewer.get("/api/timeline", detail=True)
        assert lanes(answer)["/even", "husky"]["messages"] == len(LATE)


def test_what_is_being_recorded_is_shown(fresh, monkeypatch):
    # It stays open, however long the answers take: a writer closes idle buckets by itself.
    monkeypatch.setattr("cassandra_ros.store.rows.writer.HEARTBEAT_SEC", 1e9)
    header = {"type": Int64._type, "md5sum": Int64._md5sum}
    header["message_definition"] = Int64._full_text
    with fresh() as store, running_viewer(store) as viewer:
        with store.messageWriter(writer_id=5) as out:
            handle = out.connect(live_connection("/n", header), bucket_ns=BUCKET)
            for n, time in enumerate(EVEN[:150]):
                out.write(handle, time, n, serialize(Int64(n)))
            out.flush()
            lane = lanes(viewer.get("/api/timeline", pixels=50))["/n", ""]
            assert lane["writing"]
            assert not lane["exact"]
            looked_into = viewer.get("/api/timeline", pixels=50, detail=True)
            assert lanes(looked_into)["/n", ""]["messages"] == 150


class Counting:
    """Counts the rows of the directory that are read."""

    def __init__(self, directory, monkeypatch):
        self.rows = self.asked = 0
        read = directory.columns

        def columns(wanted, *, single=False):
            for found in read(wanted, single=single):
                self.rows += len(found.bucket)
                self.asked += 1
                yield found

        monkeypatch.setattr(directory, "columns", columns)


def test_the_directory_is_read_again_after_some_seconds(store, monkeypatch):
    """Rows that are read again take the place of those in the cache, which is nearly full."""
    counted, now = Counting(store.catalog.keyspace.directory, monkeypatch), [0.0]
    monkeypatch.setattr(reader, "KEPT_BUCKETS", 8)  # of /even there are six
    cached = reader.DirectoryReader(store.catalog.keyspace.directory, lambda: now[0])
    tables = store.getTopic("/even").tables
    for times in range(1, 5):
        for _ in range(2):
            found = cached.pieces(tables, (T0, LATE[-1]), EVERYBODY)
            assert sum(piece.time_ranges.messages.sum() for piece in found) == 550
        assert counted.rows == 6 * times
        now[0] += reader.KEEP_SEC + 1


@pytest.mark.suite("all", "it stores a year")
def test_a_year_of_many_buckets_costs_what_a_day_costs(fresh, monkeypatch):
    """The directory says that 10**9 messages are there; of it no more is read than a bound."""
    monkeypatch.setattr(reader, "MAX_BUCKETS", 600)
    with fresh() as store:
        add(store, "/even", EVEN[:1])
        (table,) = store.getTopic("/even").tables
        directory = store.catalog.keyspace.directory
        counted = Counting(directory, monkeypatch)
        first = (T0 // BUCKET // SLOT_BUCKETS + 1) * SLOT_BUCKETS - 500
        buckets = range(first, first + 1200)  # of two partitions
        for slot in {bucket // SLOT_BUCKETS for bucket in buckets}:
            directory.add_node(table.name, slot, "husky")
        for bucket in buckets:
            begin = bucket * BUCKET
            totals = BucketTotals(833_333, 10**6, 9, begin, begin + BUCKET - 1)
            directory.mark((table.name, "husky", bucket, 7), 0, totals=totals, closed=True)
        with running_viewer(store) as viewer:
            answer = viewer.get("/api/timeline", pixels=500)
            assert 600 < counted.rows <= 2 * 600 + 2
            lane = lanes(answer)["/even", "husky"]
            assert not lane["exact"]
            assert lane["messages"] == pytest.approx(10**9, rel=0.05)
            begin = (first * BUCKET - T0) // int(answer["cell_ns"])
            found = counts(answer, "/even")
            assert all(found[begin + 2 : -2])
            assert not any(found[2 : begin - 2])
            # A part of it is told exactly, of the directory.
            part = {"start": (first + 450) * BUCKET, "end": (first + 650) * BUCKET - 1}
            answer = viewer.get("/api/timeline", pixels=200, **part)
            lane = lanes(answer)["/even", "husky"]
            assert (lane["messages"], lane["exact"]) == (200 * 833_333, True)
            assert counts(answer, "/even") == [833_333] * 200
            # If there are more partitions than may be read, some are read as a sample.
            monkeypatch.setattr(reader, "MAX_PARTITIONS", 1)
            lane = lanes(viewer.get("/api/timeline", pixels=500))["/even", "husky"]
            assert lane["messages"] == pytest.approx(10**9, rel=0.5)
            assert not lane["exact"]


def test_the_ends_are_those_of_all_runs_of_the_outmost_bucket(fresh):
    """The directory orders the runs of a bucket by writer ids, which say nothing of their times."""
    with fresh() as store:
        for n in range(12):
            times = [T0 + (n * 7 % 12 + 1) * SECOND_NS]
            add(store, "/many", times, writer=50 + n, name=f"run {n}")
        with running_viewer(store) as viewer:
            answer = viewer.get("/api/timeline")
        assert (answer["first"], answer["last"]) == (
            str(T0 + SECOND_NS),
            str(T0 + 12 * SECOND_NS),
        )
