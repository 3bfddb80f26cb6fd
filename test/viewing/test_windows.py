# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Windows of time as files, as rosbag, curl, MCAP's reader and Foxglove ask for them."""

from __future__ import annotations

import shutil
import subprocess
import threading
from pathlib import Path

import pytest
import rosbag
from bag.truth import string_connection, string_wire
from conftest import ROOT
from mcap.reader import make_reader
from std_msgs.msg import String
from viewers import running_viewer

from cassandra_ros.files.bag.exporter import export_bag
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.viewing import window_routes

HUSKY = ROOT / "examples/data/husky_gps_data.bag"
TURTLE = ROOT / "examples/data/turtlesim_tf.bag"
START, END = 1368021990 * 10**9, 1368021992 * 10**9
WINDOW = {"topics": "/fix,imu/data", "start": "1368021990", "end": "2013-05-08T14:06:32Z"}


@pytest.fixture(scope="module")
def store(fresh):
    with fresh() as store:
        topics = ["/fix", "/imu/data"]
        import_bag(store, HUSKY, topics=topics, format="packed", nodeID="husky")
        topics = ["/tf_static", "/turtle1/pose"]
        import_bag(store, TURTLE, topics=topics, format="packed", nodeID="turtle")
        import_bag(store, TURTLE, topics=["/tf_static"], format="packed", nodeID="third")
        yield store


@pytest.fixture(scope="module")
def viewer(store, tmp_path_factory):
    with running_viewer(store, cache=tmp_path_factory.mktemp("cache")) as viewer:
        yield viewer


def messages_in(path):
    with rosbag.Bag(str(path)) as bag:
        return [(topic, t.to_nsec(), raw[1]) for topic, raw, t in bag.read_messages(raw=True)]


def tag(reply):
    return reply.headers["ETag"]


def test_a_window_is_the_bag_that_export_writes(store, viewer, tmp_path):
    reply = viewer.ask("/window.bag", WINDOW)
    (tmp_path / "a.bag").write_bytes(reply.data)
    export_bag(store, tmp_path / "b.bag", ["/fix", "/imu/data"], float(START // 10**9), END)
    assert reply.status == 200
    assert reply.data == (tmp_path / "b.bag").read_bytes()
    with rosbag.Bag(str(HUSKY)) as bag:
        every = bag.read_messages(["/fix", "/imu/data"], raw=True)
        wanted = [
            (topic, t.to_nsec(), raw[1]) for topic, raw, t in every if START <= t.to_nsec() <= END
        ]
    assert messages_in(tmp_path / "a.bag") == wanted and len(wanted) > 20
    assert reply.headers["Content-Disposition"].endswith(
        f'filename="{store.keyspace}_2013-05-08T14-06-30.bag"'
    )


def test_who_looks_at_parts_gets_them_as_foxglove_asks(viewer):
    """It asks for all, looks at the headers, and takes the parts that it shows."""
    whole = viewer.ask("/window.mcap", WINDOW)
    assert whole.headers["Accept-Ranges"] == "bytes"
    size = int(whole.headers["Content-Length"])
    assert size == len(whole.data)
    part = viewer.ask("/window.mcap", WINDOW, Range=f"bytes={size - 100}-{size - 1}")
    assert (part.status, part.data) == (206, whole.data[-100:])
    assert part.headers["Content-Range"] == f"bytes {size - 100}-{size - 1}/{size}"
    head = viewer.ask("/window.mcap", WINDOW, method="HEAD")
    assert (head.status, head.data, tag(head)) == (200, b"", tag(whole))
    assert head.headers["Content-Length"] == str(size)
    same = viewer.ask("/window.mcap", WINDOW, If_None_Match=tag(whole))
    assert (same.status, same.data) == (304, b"")
    assert viewer.ask("/window.mcap", WINDOW, If_Match='"other"').status == 412
    behind = viewer.ask("/window.mcap", WINDOW, Range=f"bytes={size}-")
    assert (behind.status, behind.headers["Content-Range"]) == (416, f"bytes */{size}")


def test_an_mcap_while_it_is_written(viewer, tmp_path):
    asked = {**WINDOW, "compression": "lz4"}
    streamed = viewer.ask("/window.mcap", {**asked, "stream": "true"})
    assert "Content-Length" not in streamed.headers
    whole = viewer.ask("/window.mcap", asked)
    assert (streamed.data, tag(streamed)) == (whole.data, tag(whole))
    (tmp_path / "a.mcap").write_bytes(streamed.data)
    with (tmp_path / "a.mcap").open("rb") as stream:
        found = list(make_reader(stream).iter_messages())
    assert {schema.name for schema, *_ in found} == {"sensor_msgs/NavSatFix", "sensor_msgs/Imu"}
    assert len(found) == len(messages_in(bag_of(viewer, tmp_path, **WINDOW)))


def bag_of(viewer, folder, **parameters):
    reply = viewer.ask("/window.bag", parameters)
    assert reply.status == 200, reply.text
    path = Path(folder) / "found.bag"
    path.write_bytes(reply.data)
    return path


def test_curl_goes_on_with_a_download(viewer, tmp_path):
    if shutil.which("curl") is None:
        pytest.skip("curl is not installed")
    whole = viewer.ask("/window.bag", WINDOW).data
    path = tmp_path / "a.bag"
    path.write_bytes(whole[:1000])
    query = "&".join(f"{name}={text}" for name, text in WINDOW.items())
    command = ["curl", "-sf", "-C", "-", "-o", str(path), f"{viewer.url}/window.bag?{query}"]
    subprocess.run(command, check=True, timeout=300)
    assert path.read_bytes() == whole


def test_robots_runs_conditions_and_what_was_latched(store, viewer, tmp_path):
    def counts(**parameters):
        found = [topic for topic, *_ in messages_in(bag_of(viewer, tmp_path, **parameters))]
        return {topic: found.count(topic) for topic in sorted(set(found))}

    assert counts(nodes="husky") == {"/fix": 95, "/imu/data": 316}
    assert counts(runs="turtlesim_tf.bag") == {"/tf_static": 2, "/turtle1/pose": 1344}
    both = counts(nodes="husky,turtle", runs="turtlesim_tf.bag,husky_gps_data.bag")
    assert both == {**counts(nodes="husky"), **counts(nodes="turtle")}
    assert counts() == {**both, "/tf_static": 2}
    condition = "latitude > 43.40990 AND altitude IN (272.4, 273.2)"
    few = store.getTopic("/fix").countTopicData(where=condition)
    where = f"/fix: {condition}"
    assert counts(topics="/fix", where=where) == {"/fix": few} and 0 < few < 95
    assert counts(nodes="husky,turtle", where=where) == {**both, "/fix": few}
    # The last message of a latched topic comes at the start, unless latched=0.
    late = {"nodes": "turtle", "start": "2014-03-31T19:25:00Z"}
    assert "/tf_static" in counts(**late)
    assert "/tf_static" not in counts(**late, latched="false")


def test_a_condition_with_or_does_not_let_other_robots_in(viewer, tmp_path):
    """Robots turtle and third sent /tf_static, husky did not. Two of the three are selected."""

    def count(condition, nodes):
        asked = {"topics": "/tf_static", "where": f"/tf_static: {condition}"}
        return len(messages_in(bag_of(viewer, tmp_path, **asked, nodes=nodes)))

    of_each = [count("KEY > 0", node) for node in ("turtle", "third")]
    for condition in ("KEY > 0 OR KEY < 0", "KEY < 0 OR KEY > 0"):
        assert [count(condition, nodes) for nodes in ("husky,turtle", "third,husky")] == of_each
        assert count(condition, "turtle,third") == sum(of_each)


def test_a_window_of_several_robots_has_their_events(store, viewer, tmp_path):
    key, nodes = next(store.getTopic("/tf_static").rows()).key, ("husky", "turtle", "third", "")
    added = [store.addEvent(f"of {node}", key, key + 1, nodeID=node) for node in nodes]
    for asked, names in (
        ("turtle,third", {"of turtle", "of third", "of "}),
        ("turtle", {"of turtle", "of "}),
        ("husky,turtle,third", {"of husky", "of turtle", "of third", "of "}),
    ):
        reply = viewer.ask("/window.mcap", {"topics": "/tf_static", "nodes": asked})
        (tmp_path / "w.mcap").write_bytes(reply.data)
        with open(tmp_path / "w.mcap", "rb") as stream:
            records = [record.metadata for record in make_reader(stream).iter_metadata()]
        assert {record["name"] for record in records if "name" in record} == names, records
    for event in added:
        store.removeEvent(event)


def test_what_is_stored_since_makes_another_file(store, viewer, tmp_path):
    topic = store.addTopic("/notes", msg_type="std_msgs/String")
    topic.addData(String("one"), key=10**18)
    window = {"topics": "/notes", "start": "900000000", "end": "1100000000"}
    first = viewer.ask("/window.bag", window)
    assert tag(viewer.ask("/window.bag", window, method="HEAD")) == tag(first)
    store.getTopic("/fix").setMeta(site="lab")
    topic.addData(String("two"), key=10**18 + 10**9)
    # Who looks at the file goes on looking at it, who goes on with a download begins anew.
    part = viewer.ask("/window.bag", window, Range="bytes=0-99")
    assert (part.status, tag(part), part.data) == (206, tag(first), first.data[:100])
    again = viewer.ask("/window.bag", window, Range="bytes=100-", If_Range=tag(first))
    assert again.status == 200 and tag(again) != tag(first)
    assert viewer.ask("/window.bag", window).data == again.data
    assert [raw for *_, raw in messages_in(bag_of(viewer, tmp_path, **window))] == [
        b"\x03\0\0\0one",
        b"\x03\0\0\0two",
    ]
    part = viewer.ask("/window.bag", window, Range="bytes=0-99", If_Range=tag(again))
    assert (part.status, part.data) == (206, again.data[:100])
    before = tag(viewer.ask("/window.mcap", window))
    store.addEvent("bump", 10**18, 10**18 + 1)  # which the MCAP holds, too
    assert tag(viewer.ask("/window.mcap", window)) != before
    topic.removeData(10**18)
    assert tag(viewer.ask("/window.bag", window)) not in (tag(first), tag(again))
    store.removeTopic("/notes")
    assert viewer.fail("/window.bag", **window)[0] == 404


def test_what_was_latched_before_is_a_part_of_the_window(store, viewer, tmp_path):
    with store.messageWriter() as writer:
        handle = writer.connect(string_connection("/latched", latching="1"), 10**9)
        for n in range(2):
            writer.write(handle, 10**18 + n * 10**11, n, string_wire(str(n)))
    window = {"topics": "/latched", "start": "1000000050"}
    first = viewer.ask("/window.bag", window)
    assert len(messages_in(bag_of(viewer, tmp_path, **window))) == 2
    store.getTopic("/latched").removeData(10**18)
    assert tag(viewer.ask("/window.bag", window)) != tag(first)
    assert len(messages_in(bag_of(viewer, tmp_path, **window))) == 1


def test_what_fails_says_why(viewer):
    status, answer = viewer.fail("/window.bag", topics="/fix", start="1", end="2")
    assert (status, answer["error"]) == (404, "MessageNotFound")
    assert answer["text"].startswith("there is no such message: these topics reach from 2013-")
    for parameters, text in (
        ({"topics": "/fixx"}, "did you mean /fix"),
        ({"runs": "nobody"}, "there is no run 'nobody'"),
        ({"start": "5", "end": "4"}, "lies after end"),
        ({"where": "altitude > 3"}, "is not of the form"),
        ({"where": ["/fix: altitude > 3", "fix: altitude > 4"]}, "two conditions for /fix"),
        ({"where": "/fix: altitud > 3"}, "no field altitud"),
        (
            {"topics": "/fix", "where": "/imu/data: orientation.x > 1"},
            "not among those that are read",
        ),
        ({"compression": "zstd"}, "give one of none, lz4, bz2"),
        ({"stream": "true"}, "no parameter 'stream'"),
    ):
        status, answer = viewer.fail("/window.bag", **parameters)
        assert status in (400, 404) and text in answer["text"], (parameters, answer)
    status, answer = viewer.fail("/window.mcap", topics="/fix", start="1", end="2", stream="1")
    assert (status, answer["error"]) == (404, "MessageNotFound")


def test_who_leaves_ends_the_writing_and_nothing_is_left(store, tmp_path, monkeypatch):
    begun, ended = threading.Event(), threading.Event()

    def endless(store, path, progress, **options):
        begun.set()
        try:
            while not ended.wait(0.002):
                progress(1, 1)
        finally:
            ended.set()

    monkeypatch.setattr(window_routes, "export_bag", endless)
    with running_viewer(store, cache=tmp_path) as viewer:
        connection = viewer.connect()
        connection.request("GET", "/window.bag")
        assert begun.wait(180)
        assert not ended.is_set()
        connection.close()
        assert ended.wait(180)
    assert list(tmp_path.iterdir()) == []
