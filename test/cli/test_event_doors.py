# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Everything that takes a time takes an event, by the same name, and means the same messages.

Two robots send a message a second. Robot husky bumps twice, jackal once in between.
"""

from __future__ import annotations

import json

import numpy as np
import pytest
import rosbag
import rospy
from mapping.room import PERIOD_NS, Drive
from mapping.room import T0 as DRIVE
from PIL import Image as Pillow
from sensor_msgs.msg import Image
from std_msgs.msg import Int64

from cassandra_ros import makeMap
from cassandra_ros.cli import player
from cassandra_ros.errors import (
    EventNotFound,
    InvalidOption,
    InvalidQuery,
    MessageNotFound,
)
from cassandra_ros.files.bag.comparison import verify_bag
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.playing.play_selection import PlaySelection
from cassandra_ros.playing.play_stream import PlayStream
from cassandra_ros.playing.played_store import PlayedKeyspace
from cassandra_ros.read import TimeRange

SEC = 10**9
T0 = 1_500_000_000 * SEC
BUMPS = {("husky", n) for n in (10, 11, 12, 30, 31)} | {("jackal", n) for n in (11, 12, 13, 14)}
"""Messages during the bumps, both ends included."""
WIDER = {("husky", n) for n in (*range(8, 14), *range(28, 33))} | {
    ("jackal", n) for n in range(9, 16)
}
"""Those of 2 s before to 1 s after the bumps."""
NUMBER = {"husky": 0, "jackal": 100}


def write(store, node, topics):
    """Store (time, number) by topic; /map is latched."""
    kind = Int64
    header = {"type": kind._type, "md5sum": kind._md5sum, "message_definition": kind._full_text}
    with store.messageWriter(nodeID=node, format="ros") as writer:
        for topic, numbers in topics.items():
            latching = {"latching": "1"} if topic == "/map" else {}
            handle = writer.connect(live_connection(topic, {**header, **latching}))
            for t, number in numbers:
                writer.write(handle, t, number, serialize(Int64(number)))


@pytest.fixture
def store(rosCas):
    """Numbers a second of both robots on /n, a camera of husky, a latched map that changes once."""
    maps = [(T0 - 5 * SEC, 1000), (T0 + 20 * SEC, 1001)]
    for node, first in NUMBER.items():
        ticks = [(T0 + n * SEC, first + n) for n in range(50)]
        write(rosCas, node, {"/n": ticks, **({"/map": maps} if node == "husky" else {})})
    rosCas.addEvent("bump", T0 + 10 * SEC, T0 + 12 * SEC, nodeID="husky")
    rosCas.addEvent("bump", T0 + 11 * SEC, T0 + 14 * SEC, nodeID="jackal")
    rosCas.addEvent("bump", T0 + 30 * SEC, T0 + 31 * SEC, nodeID="husky")
    rosCas.addEvent("bumper off", T0 + 40 * SEC, nodeID="jackal")
    rosCas.addEvent("door", T0 + 45 * SEC, T0 + 46 * SEC)
    return rosCas


def told(numbers):
    """(robot, second) of the numbers on /n."""
    return [("jackal" if n >= 100 else "husky", n % 100) for n in numbers]


@pytest.mark.suite("test", "all doors for one event")
def test_every_door_means_the_same_messages(store, call, tmp_path):
    rows = list(store.readMessages("/n", event="bump"))
    assert set(told(row.message().data for row in rows)) == BUMPS
    assert [row.t for row in rows] == sorted(row.t for row in rows)

    for statement in ("EVENT 'bump'", "EVENT LIKE 'bump' AND NOT EVENT LIKE 'bumper%'"):
        found = store.executeCQL(f"SELECT data FROM /n WHERE {statement}")
        assert set(told(n for (n,) in found)) == BUMPS
    counted = store.executeCQL("SELECT count(*) FROM /n WHERE EVENT ?", ["bump"])
    assert counted == [(len(BUMPS),)]

    topic, where = store.getTopic("/n"), "EVENT 'bump'"
    assert topic.countTopicData(where=where) == len(BUMPS)
    assert set(told(topic.getArrays(["data"], where=where)["data"].tolist())) == BUMPS
    assert set(told(message.data for _, message in topic.items(where=where))) == BUMPS
    assert "read in 2 time ranges" in str(store.explainCQL(f"SELECT * FROM /n WHERE {where}"))

    _, out, _ = call("query", "SELECT data FROM /n WHERE EVENT 'bump'", "--json")
    assert set(told(row["data"] for row in json.loads(out))) == BUMPS

    _, out, _ = call("cat", "/n", "--event", "bump", "--json")
    assert set(told(row["message"]["data"] for row in json.loads(out))) == BUMPS

    bag = tmp_path / "bump.bag"
    assert call("export", bag, "--topics", "/n", "--event", "bump", "-q")[0] == 0
    with rosbag.Bag(str(bag)) as written:
        assert set(told(m.data for _, m, _ in written.read_messages())) == BUMPS
    for verify in (("verify", bag), ("verify", bag, "--content")):
        assert call(*verify, "--topics", "/n", "--event", "bump")[0] == 0
        assert call(*verify, "--topics", "/n", "--event", "door")[0] == 1
    status, out, _ = call("verify", bag)
    assert (status, "of an exported part compare that part: --start T" in out) == (1, True)
    near, around = tmp_path / "near.bag", ("--around", "/n: data = 20", "--before", "2s")
    assert call("export", near, *around, "--after", "1", "-q")[0] == 0
    for verify in (("verify", near), ("verify", near, "--content")):
        assert call(*verify, *around, "--after", "1")[0] == 0
        assert call(*verify, *around, "--after", "3")[0] == 1
    assert call("verify", near, *around, "--event", "bump")[0] == 2

    played = PlayStream(PlayedKeyspace(store.catalog), PlaySelection(["/n"], event="bump"))
    assert set(told(each.row.message().data for each in played.messages())) == BUMPS

    assert call("delete", "/n", "--event", "bump", "--dry-run", "--json")[0] == 0
    assert store.upkeep.delete("/n", event="bump", dry_run=True) == {"/n": len(BUMPS)}
    kept = store.upkeep.retain(
        "/n", max_age=1.0, event="bump", before=0, after=0, now=T0 + 100 * SEC, dry_run=True
    )
    # Retention keeps the messages of all robots around an event.
    assert kept[0].left == 2 * len({second for _, second in BUMPS})

    status, out, _ = call("delete", "/n", "--event", "bump", "-y")
    assert (status, out.splitlines()[-1]) == (0, f"{len(BUMPS)} messages of 1 topic are deleted")
    assert store.getTopic("/n").countTopicData() == 100 - len(BUMPS)
    assert len(list(store.events())) == 5


def test_every_door_takes_the_time_before_and_after(store, call, tmp_path):
    rule, words = ("bump", 2, 1.0), ("--event", "bump", "--before", "2s", "--after", "1")
    rows = store.readMessages("/n", event=rule)
    assert set(told(row.message().data for row in rows)) == WIDER
    _, out, _ = call("cat", "/n", *words, "--json")
    assert set(told(row["message"]["data"] for row in json.loads(out))) == WIDER
    bag = tmp_path / "bump.bag"
    assert call("export", bag, "--topics", "/n", "-q", *words)[0] == 0
    with rosbag.Bag(str(bag)) as written:
        assert set(told(m.data for _, m, _ in written.read_messages())) == WIDER
    assert call("verify", bag, "--content", "--topics", "/n", *words)[0] == 0
    options = player.make_parser().parse_args(["/n", *words])
    played = PlayStream(PlayedKeyspace(store.catalog), player.read_selection(options))
    assert set(told(each.row.message().data for each in played.messages())) == WIDER
    assert store.upkeep.delete("/n", event=rule) == {"/n": len(WIDER)}


def test_times_robots_runs_and_conditions_narrow_the_events(store, call):
    def told_by(*words):
        _, out, _ = call("cat", "/n", "--event", "bump", *words, "--json")
        return set(told(row["message"]["data"] for row in json.loads(out)))

    assert told_by("--node-id", "jackal") == {each for each in BUMPS if each[0] == "jackal"}
    assert told_by("--end", "1500000011") == {("husky", 10), ("husky", 11), ("jackal", 11)}
    assert told_by("--where", "/n: data > 100") == {e for e in BUMPS if e[0] == "jackal"}
    asked = "SELECT data FROM /n WHERE EVENT 'bump' AND NODE = 'husky' AND KEY > 1500000012.5"
    assert store.executeCQL(asked) == [(30,), (31,)]
    asked = "SELECT data FROM /n WHERE data < 45 AND NOT EVENT 'door' AND NOT EVENT LIKE 'bump%'"
    found = set(told(n for (n,) in store.executeCQL(asked)))
    assert found == {("husky", n) for n in range(45)} - BUMPS
    descending = store.executeCQL(
        "SELECT data FROM /n WHERE EVENT 'bump' ORDER BY KEY DESC LIMIT 2"
    )
    assert descending == [(31,), (30,)]
    either = store.executeCQL("SELECT data FROM /n WHERE EVENT 'door' OR EVENT 'bump'")
    assert set(told(n for (n,) in either)) == BUMPS | {
        (node, n) for node in NUMBER for n in (45, 46)
    }


def test_a_statement_deletes_the_messages_of_an_event(store):
    assert store.executeCQL("DELETE FROM /n WHERE EVENT 'door'") == [(4,)]
    assert store.getTopic("/n").countTopicData() == 96


def test_an_event_that_lasts_has_no_end(store):
    rows = store.readMessages("/n", event="bumper off")
    assert told(row.message().data for row in rows) == [("jackal", n) for n in range(40, 50)]


def test_a_name_without_events_says_so(store, call, tmp_path):
    with pytest.raises(EventNotFound, match="did you mean bump"):
        store.readMessages("/n", event="bumb")
    with pytest.raises(EventNotFound, match="of this time, robot and run"):
        store.readMessages("/n", T0 + 40 * SEC, event="bump")
    with pytest.raises(EventNotFound):
        PlayStream(PlayedKeyspace(store.catalog), PlaySelection(event="bumb"))
    with pytest.raises(MessageNotFound, match="between"):
        PlayStream(
            PlayedKeyspace(store.catalog), PlaySelection(["/n"], event="bump", start=8.0, end=9.0)
        )
    with pytest.raises(InvalidOption, match="give one of them"):
        PlayStream(
            PlayedKeyspace(store.catalog), PlaySelection(event="bump", around="/n: data > 1")
        )
    for verb in ("cat", "export", "delete", "thumbs", "map"):
        words = [tmp_path / "x.bag"] if verb == "export" else ["/n"]
        status, out, err = call(verb, *words, "--event", "bumb")
        assert (status, out) == (1, ""), verb
        assert "no event 'bumb'" in err or verb == "map", err
    status, _, err = call("cat", "/n", "--before", "2")
    assert status == 2 and "--before and --after go with --event" in err
    # RUN and EVENT that match nothing only match nothing.
    assert store.executeCQL("SELECT data FROM /n WHERE EVENT 'bumb'") == []


@pytest.mark.parametrize(
    ("statement", "values", "reason"),
    [
        ("EVENT ?", [5], "a text in quotes"),
        ("EVENT ''", [], "name of an event"),
        ("EVENT LIKE 5", [], "a text in quotes"),
        ("EVENT", [], "expected"),
    ],
)
def test_what_is_no_event_is_refused(store, statement, values, reason):
    with pytest.raises(InvalidQuery, match=reason):
        store.executeCQL(f"SELECT data FROM /n WHERE {statement}", values)
    with pytest.raises(InvalidQuery, match="stored messages only"):
        from cassandra_ros.recording.topic_settings import check_condition

        check_condition("EVENT 'bump'")


def test_an_export_begins_each_time_range_with_what_was_latched(store, tmp_path):
    from cassandra_ros.files.bag.exporter import export_bag

    report = export_bag(store, tmp_path / "a.bag", event=("bump", 2, 1))
    assert report.latched == {"/map": 2}
    with rosbag.Bag(str(tmp_path / "a.bag")) as written:
        maps = [(m.data, t.to_nsec()) for _, m, t in written.read_messages(["/map"])]
    assert maps == [(1000, T0 + 8 * SEC), (1001, T0 + 28 * SEC)]
    report = export_bag(store, tmp_path / "b.bag", event="bump", latched=False)
    assert report.latched == {}


def test_the_player_skips_the_time_between_events(store):
    stream = PlayStream(
        PlayedKeyspace(store.catalog), PlaySelection(["/n"], event="bump", nodeID="husky")
    )
    assert stream.windows == [
        TimeRange(T0 + 10 * SEC, T0 + 12 * SEC),
        TimeRange(T0 + 30 * SEC, T0 + 31 * SEC),
    ]
    assert stream.start_ns == T0 + 10 * SEC
    assert {each.window.low for each in stream.messages()} == {T0 + 10 * SEC, T0 + 30 * SEC}


def test_retention_keeps_events_as_it_keeps_conditions(store, call, capsys):
    words = ("retention", "/n", "--max-age", "1s", "--now", "1500000100", "--before", "0", "--json")
    _, out, err = call(*words, "--after", "0", "--keep", "event: door", "--dry-run")
    assert json.loads(out)["topics"][0]["left"] == 4
    assert err == ""
    _, out, err = call(
        *words, "--after", "1", "--keep", "event: door", "--keep", "event: bump", "-y"
    )
    assert json.loads(out)["topics"][0]["left"] == 2 * (6 + 3 + 3)
    _, out, err = call(*words, "--keep", "event: nothing", "--dry-run")
    assert "no event 'nothing'" in err
    assert json.loads(out)["topics"][0]["left"] == 0


def test_thumbs_are_spread_over_the_events(store, call, tmp_path):
    topic = store.addTopic("/camera", "binary", msg_type="sensor_msgs/Image")
    for n in range(50):
        msg = Image(height=6, width=8, encoding="rgb8", step=24, data=bytes((n, 0, 0)) * 48)
        topic.addData(msg, key=T0 + n * SEC, nodeID="husky")
    for words, seconds in (
        (("--columns", "9", "--rows", "1"), [10, 11, 12, 30, 31]),
        (("--columns", "3", "--rows", "1"), [10, 12, 31]),
        (("--columns", "9", "--every", "2"), [10, 12, 30]),
        (("--columns", "2", "--rows", "1", "--where", "/camera: height = 6"), [10, 30]),
    ):
        status, out, err = call(
            *("thumbs", "/camera", "-o", tmp_path / "a.png", "-f", "--width", "8"),
            *("--event", "bump", "--json", *words),
        )
        assert status == 0, err
        found = [(each["time_ns"] - T0) // SEC for each in json.loads(out)["pictures"]]
        assert found == seconds
    assert np.asarray(Pillow.open(tmp_path / "a.png")).size


def test_a_map_is_made_of_the_events(rosCas, call, tmp_path):
    Drive().store(rosCas, {"/tf", "/tf_static", "/scan"}, node="husky")
    rosCas.addEvent("turn", DRIVE + 10 * PERIOD_NS, DRIVE + 19 * PERIOD_NS, nodeID="husky")
    rosCas.addEvent("turn", DRIVE + 30 * PERIOD_NS, DRIVE + 34 * PERIOD_NS)
    rosCas.addEvent("turn", DRIVE, DRIVE + 5 * PERIOD_NS, nodeID="jackal")
    made = makeMap(rosCas, "/scan", event="turn")
    assert made.used == 9 + 4
    assert makeMap(rosCas, "/scan", event=("turn", 0, 0.1), nodeID="husky").used == 10 + 5
    status, out, _ = call("map", "/scan", "-o", tmp_path / "m.png", "--event", "turn", "--json")
    assert (status, json.loads(out)["used"]) == (0, 13)


def test_verify_compares_an_imported_bag_at_the_times_of_an_event(store, call, tmp_path):
    imported = tmp_path / "imported.bag"
    with rosbag.Bag(str(imported), "w") as bag:
        for n in range(50):
            bag.write("/n", Int64(1000 + n), rospy.Time(T0 // SEC + n))
    assert call("import", imported, "--node-id", "husky", "-q")[0] == 0
    store.addEvent("early", T0 - 20 * SEC, T0 - 10 * SEC, nodeID="husky")
    times = {n for robot, n in BUMPS if robot == "husky"}
    report = verify_bag(store, imported, event="bump")
    assert report.equal
    assert report.equal_messages == len(times)
    assert call("verify", imported, "--event", "bump")[0] == 0
    status, _, error = call("verify", imported, "--event", "early")
    assert (status, "nothing was compared" in error) == (1, True), error
    assert store.upkeep.delete("/n", event="bump")
    assert call("verify", imported, "--event", "bump")[0] == 1
