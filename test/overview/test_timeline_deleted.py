# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Messages were deleted just now: the table of info and the picture of the timeline agree."""

from __future__ import annotations

import pytest
from std_msgs.msg import Int64
from suites import sparing

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.read import LAST_NS, Whose
from cassandra_ros.topics.overview.timeline.lanes import Timeline, View

T0 = 1_500_000_000 * SECOND_NS
COUNT = 60
STEP = SECOND_NS // 2
BUCKET = SECOND_NS


def fill(store, topic, fmt, writer_id, node="r"):
    """Store two messages a second, in buckets of a second."""
    header = {"type": Int64._type, "md5sum": Int64._md5sum}
    header["message_definition"] = Int64._full_text
    with store.messageWriter(writer_id=writer_id, nodeID=node, format=fmt) as writer:
        handle = writer.connect(live_connection(topic, header), bucket_ns=BUCKET)
        for n in range(COUNT):
            writer.write(handle, T0 + n * STEP, n, serialize(Int64(n)))


@pytest.fixture
def store(rosCas):
    fill(rosCas, "/rows", "binary", 7)
    fill(rosCas, "/blocks", "packed", 8)
    return rosCas


def in_table(store):
    return {info.topic: info.count for info in store.info()}


def ends_of(store):
    infos = [info for info in store.info() if info.count]
    if not infos:
        return None
    return min(info.first_ns for info in infos), max(info.last_ns for info in infos)


def in_picture(picture):
    """Return topic -> messages, as the lanes say and as their cells hold."""
    if picture.scale is None:
        assert not any(lane.messages for lane in picture.lanes)
        return {lane.topic: 0 for lane in picture.lanes}
    drawn = {lane.topic: lane.cells(picture.scale).counts.sum() for lane in picture.lanes}
    said = {lane.topic: lane.messages for lane in picture.lanes}
    assert drawn == pytest.approx(said)
    return said


SECONDS = COUNT // 2
DELETIONS = {
    "all": [(0, SECONDS)],
    "the first": [(0, SECONDS - 4)],  # more buckets than are looked at for the ends
    "the last": [(4, SECONDS)],
    "the middle": [(5, 25)],
    "both ends": [(0, 12), (18, SECONDS)],
    "half of a bucket": [(0, 3.5)],
}


@pytest.mark.parametrize("what", sparing(DELETIONS, kept=list(DELETIONS)[::5]))
def test_picture_and_table_agree_at_once(store, what):
    timeline = Timeline(store.catalog)
    for begin, end in DELETIONS[what]:
        low, high = T0 + round(begin * SECOND_NS), T0 + round(end * SECOND_NS) - 1
        store.upkeep.delete(None, low, high)
    picture = timeline.picture(View(cells=30))
    assert in_picture(picture) == in_table(store)
    assert picture.extent == ends_of(store)
    assert all(lane.exact for lane in picture.lanes)


def test_they_agree_for_a_window_for_a_run_and_for_what_was_deleted_of_one(store):
    fill(store, "/rows", "binary", 9)
    assert store.upkeep.delete(None, T0 + 6 * SECOND_NS, run=9) == {
        "/rows": COUNT - 12,
        "/blocks": 0,
    }
    picture = Timeline(store.catalog).picture(View(cells=30))
    assert in_picture(picture) == in_table(store)
    (run,) = [span for span in picture.runs if span.writer == 9]
    assert (run.messages, run.first, run.last) == (12, T0, T0 + 11 * STEP)
    window = View(start=T0 + 4 * SECOND_NS, end=T0 + 8 * SECOND_NS - 1, cells=4)
    assert in_picture(Timeline(store.catalog).picture(window)) == {"/rows": 8 + 4, "/blocks": 8}


def test_what_a_sample_stands_for_was_deleted(store, monkeypatch):
    monkeypatch.setattr("cassandra_ros.topics.overview.timeline.directory_reader.MAX_BUCKETS", 10)
    monkeypatch.setattr("cassandra_ros.topics.overview.timeline.directory_reader.LEAST_BUCKETS", 10)
    store.upkeep.delete(None, T0, T0 + 100 * SECOND_NS)
    assert in_picture(Timeline(store.catalog).picture(View(T0, T0 + 30 * SECOND_NS))) == in_table(
        store
    )


def test_a_robot_whose_messages_were_deleted_has_no_lane(store):
    fill(store, "/rows", "binary", 9, node="s")
    store.upkeep.delete(None, nodeID="s")
    whole = Timeline(store.catalog).picture(View(cells=30))
    assert {lane.key for lane in whole.lanes} == {("r", "/blocks"), ("r", "/rows")}
    assert not Timeline(store.catalog).picture(View(whose=Whose.of("s"))).lanes
    store.upkeep.delete(["/rows"], nodeID="r")
    whole = Timeline(store.catalog).picture(View(start=0, end=LAST_NS, cells=1))
    assert {lane.key for lane in whole.lanes} == {("r", "/blocks"), ("", "/rows")}
    store.upkeep.delete(None, nodeID="r")
    empty = Timeline(store.catalog).picture(View(cells=30))
    assert {lane.key for lane in empty.lanes} == {("", "/blocks"), ("", "/rows")}
