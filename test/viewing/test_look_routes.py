# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Messages for the Studio: byte for byte, in pages, with what was sent last before a moment."""

from __future__ import annotations

import json
import struct
from typing import NamedTuple

import genpy
import pytest
import rosbag
from bag.truth import read_with_rosbag, string_wire
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import OccupancyGrid
from sensor_msgs.msg import Image
from std_msgs.msg import Float64, String
from test_imports import ROOT
from tf2_msgs.msg import TFMessage
from viewers import running_viewer

from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import Connection, live_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.viewing.message_frames import STREAM_CHUNK_BYTES

HUSKY = ROOT / "examples/data/husky_gps_data.bag"
T0 = 1_500_000_000 * SECOND_NS
HEAD = struct.Struct("<IIq")


class Message(NamedTuple):
    topic: str
    t: int
    data: bytes


class Page(NamedTuple):
    messages: list
    channels: dict
    problems: list
    next: str | None


def read_page(data):
    """Take a stream of frames apart, as a program in another language would."""
    at, channels, messages, problems = 0, {}, [], []
    while True:
        channel, size, t = HEAD.unpack_from(data, at)
        at += HEAD.size
        body = data[at : at + size]
        assert len(body) == size
        at += size
        if channel:
            messages.append(Message(channels[channel]["topic"], t, body))
            continue
        told = json.loads(body)
        if "channel" in told:
            assert told["channel"]["id"] not in channels
            channels[told["channel"]["id"]] = told["channel"]
        elif "problem" in told:
            problems.append(told["problem"])
        else:
            assert at == len(data)
            return Page(messages, channels, problems, told["end"]["next"])


def at(seconds):
    return T0 + round(seconds * SECOND_NS)


def connect(writer, topic, message, number, **fields):
    definition = definition_of(type(message))
    header = {
        "type": definition.type,
        "md5sum": definition.md5sum,
        "message_definition": definition.text,
        "callerid": f"/n{number}",
        **fields,
    }
    return writer.connection(Connection(topic, live_connection(topic, header).header), number)


def transform(frame):
    stamped = TransformStamped(child_frame_id=frame)
    stamped.transform.rotation.w = 1
    return TFMessage([stamped])


IMAGE = Image(height=600, width=1000, encoding="rgb8", step=3000, data=bytes(range(256)) * 7031)


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Ten seconds: two latch on /static, tf of two frames in turn, a large image, two types."""
    path = tmp_path_factory.mktemp("look") / "look.bag"
    with BagWriter(path) as writer:
        statics = [
            connect(writer, "/static", TFMessage(), number, latching="1") for number in (0, 1)
        ]
        tf = connect(writer, "/tf", TFMessage(), 2)
        tick = connect(writer, "/tick", String(), 3)
        other = connect(writer, "/tick", Float64(), 4)
        image = connect(writer, "/image", Image(), 5)
        for number, frame in enumerate(("arm", "camera")):
            writer.write(statics[number], at(number / 10), serialize(transform(frame)))
        for step in range(100):
            t = at(step / 10 + 0.5)
            writer.write(tick, t, string_wire(f"t{step}"))
            writer.write(tf, t, serialize(transform(f"wheel{step % 2}")))
            if step == 50:
                writer.write(image, t, serialize(IMAGE))
        writer.write(other, at(20), serialize(Float64(0.25)))
    return path


@pytest.fixture(scope="module")
def store(fresh, bag):
    with fresh() as store:
        import_bag(store, bag, nodeID="r1", format="packed")
        import_bag(store, HUSKY, nodeID="husky")
        with store.messageWriter():
            pass
        store.addTopic("/map", key_format="manual", nodeID="").addData(
            OccupancyGrid(), key="kitchen"
        )
        store.addTopic("/seen", key_format="hash").addData(String("once"))
        yield store


@pytest.fixture(scope="module")
def viewer(store):
    with running_viewer(store) as viewer:
        yield viewer


def page(viewer, path="/api/messages", **parameters):
    found = viewer.ask(path, parameters)
    assert found.status == 200, found.text
    assert found.headers["Content-Type"] == "application/x-cassandra-ros-frames"
    return read_page(found.data)


def all_pages(viewer, **parameters):
    messages, after, pages = [], {}, 0
    while True:
        found = page(viewer, **parameters, **after)
        messages += found.messages
        pages += 1
        if found.next is None:
            return messages, pages
        after = {"after": found.next}


@pytest.mark.suite("all", "it reads a whole bag in small pages")
def test_pages_give_the_messages_of_a_real_bag_byte_for_byte(viewer):
    _, expected = read_with_rosbag(HUSKY)
    # In the store equal times come by the counter of their writer, as rosbag reads them.
    wanted = [Message(each.topic, each.t_ns, each.data) for each in expected]
    messages, pages = all_pages(viewer, nodes="husky", bytes=200_000)
    assert messages == wanted
    assert pages > 5
    assert len(all_pages(viewer, nodes="husky")[0]) == len(wanted)
    first, last = wanted[100].t, wanted[900].t
    chosen = {"/tf", "/fix"}
    window, _ = all_pages(viewer, topics=",".join(chosen), start=first, end=last, runs=HUSKY.name)
    assert window == [m for m in wanted if m.topic in chosen and first <= m.t <= last]


def test_a_page_is_bounded_but_has_a_message(viewer):
    small = page(viewer, nodes="husky", bytes=1)
    assert len(small.messages) == 1
    assert small.next
    empty = page(viewer, topics="/tick", start=at(30), end=at(40))
    assert (empty.messages, empty.next) == ([], None)


def test_a_large_image_comes_in_pieces_and_whole(viewer, store):
    found = page(viewer, topics="/image")
    assert [m.data for m in found.messages] == [serialize(IMAGE)]
    assert len(serialize(IMAGE)) > 5 * STREAM_CHUNK_BYTES
    assert next(iter(store.readMessages(["/image"]))).chunked


def test_two_definitions_of_a_topic_are_two_channels(viewer):
    found = page(viewer, topics="/tick", start=at(10))
    assert {channel["type"] for channel in found.channels.values()} == {
        "std_msgs/String",
        "std_msgs/Float64",
    }
    assert found.messages[-1].data == serialize(Float64(0.25))
    listed = viewer.get("/api/connections", topics="/tick", start=at(0), end=at(30))
    (topic,) = listed["topics"]
    assert topic["messages"] == 101
    assert topic["type"] in ("std_msgs/String", "std_msgs/Float64")  # made in the same second


def test_a_schema_has_names_that_were_checked_and_says_how_to_read(viewer):
    (topic,) = viewer.get("/api/connections", topics="/image")["topics"]
    assert topic["schema"]["root"] == "sensor_msgs/Image"
    fields = topic["schema"]["types"]["sensor_msgs/Image"]
    assert fields[0] == {"name": "header", "type": "std_msgs/Header", "isComplex": True}
    assert fields[-1] == {"name": "data", "type": "uint8", "isArray": True}
    assert set(topic["schema"]["types"]) == {"sensor_msgs/Image", "std_msgs/Header"}


def test_connections_tell_the_window_and_how_much_lies_in_it(viewer):
    found = viewer.get("/api/connections", nodes="r1", time=at(5))
    assert (int(found["start"]), int(found["end"])) == (at(0), at(20))
    by_name = {topic["topic"]: topic for topic in found["topics"]}
    assert by_name["/tf"]["messages"] == 100
    assert int(by_name["/tf"]["first"]) == at(0.5)
    assert by_name["/image"]["bytes"] == len(serialize(IMAGE))
    assert by_name["/map"]["messages"] == 0  # it has no place in time, and is shown at every one
    assert found["problems"] == []  # the topic that cannot be shown has nothing in the window
    (problem,) = viewer.get("/api/connections", topics="/seen,/tf", time=at(5))["problems"]
    assert problem["topic"] == "/seen" and "no time" in problem["text"]
    given = viewer.get("/api/connections", start=at(1), end=at(2))
    assert (given["start"], given["end"]) == (str(at(1)), str(at(2)))
    # Without a time range it is the last day.
    with rosbag.Bag(str(HUSKY)) as husky:
        newest = viewer.get("/api/connections", nodes="husky")
        assert abs(int(newest["end"]) / SECOND_NS - husky.get_end_time()) < 1e-6
    assert viewer.fail("/api/connections", topics="/none")[0] == 404
    assert viewer.fail("/api/messages", start=2.0, end=1.0)[0] == 400
    assert viewer.fail("/api/messages", after="nonsense")[0] == 400
    assert viewer.fail("/api/messages", bytes=10**12)[0] == 400
    assert viewer.fail("/api/messages", runs="none")[0] == 404


def test_only_what_a_window_has_to_show_is_named(viewer):
    def named(**window):
        return [topic["topic"] for topic in viewer.get("/api/connections", **window)["topics"]]

    # /static was latched before by the same run; /map has no place in time. There is no /image yet.
    window = {"start": at(1), "end": at(2)}
    assert named(**window) == ["/map", "/static", "/tf", "/tick"]
    assert named(**window, topics="/static,/image") == ["/static"]
    assert "/image" in named(start=at(5), end=at(6))
    with rosbag.Bag(str(HUSKY)) as husky:
        start = husky.get_start_time()
    others = named(start=start + 5, end=start + 6)
    assert {"/fix", "/map"} < set(others)
    assert not {"/static", "/tick", "/image"} & set(others)


def test_a_window_without_messages_is_told(viewer):
    (problem,) = viewer.get("/api/connections", topics="/tf", start=1.5, end=2.5)["problems"]
    assert "no message" in problem["text"] and "1970-01-01T00:00:01.5" in problem["text"]
    assert viewer.get("/api/connections", start=1.5, end=2.5)["problems"] == []  # /map is shown


def test_the_latest_has_all_that_a_panel_needs_at_once(viewer):
    found = page(viewer, "/api/latest", time=at(5.04), start=at(0), nodes="r1")
    by_topic = {}
    for message in found.messages:
        by_topic.setdefault(message.topic, []).append(message)
    # Each publisher's latched message, from before; of transforms all of the last second.
    assert [m.data for m in by_topic["/static"]] == [
        serialize(transform(frame)) for frame in ("arm", "camera")
    ]
    frames = {m.data for m in by_topic["/tf"]}
    assert frames == {serialize(transform(f"wheel{number}")) for number in (0, 1)}
    assert [m.t for m in by_topic["/tick"]] == [at(5)]
    assert "/image" not in by_topic  # it came later
    assert [m.data for m in by_topic["/map"]] == [serialize(OccupancyGrid())]
    assert found.messages == sorted(found.messages, key=lambda m: m.t)
    # At the very moment of a message that one counts; what came before the window does not.
    for start in (at(5.2), at(5.5)):
        exact = page(viewer, "/api/latest", topics="/tick,/image", time=at(5.5), start=start)
        assert {(m.topic, m.t) for m in exact.messages} == {("/tick", at(5.5)), ("/image", at(5.5))}
    assert page(viewer, "/api/latest", topics="/tick", time=at(5.45), start=at(5.42)).messages == []
    late = page(viewer, "/api/latest", topics="/static,/tick", time=at(15), runs="look.bag")
    assert [m.topic for m in late.messages] == ["/static", "/static", "/tick"]


def test_a_message_that_cannot_be_read_does_not_hide_the_others(fresh, cql):
    with fresh() as store:
        topic = store.addTopic("/broken", format="string", msg_type="std_msgs/String")
        for number in range(3):
            topic.addData(String(f"m{number}"), key=genpy.Time(100 + number))
        (table,) = topic.tables
        row = list(topic.rows())[1]
        cql.execute(
            f'UPDATE {store.keyspace}.{table.name} SET "_size" = 999 WHERE "_node" = %s AND '
            '"_bucket" = %s AND "_t" = %s AND "_seq" = %s',
            (row.node, table.bucket_of(row.t), row.t, row.seq),
        )
        with running_viewer(store) as viewer:
            found = page(viewer, topics="/broken")
    assert [m.t // SECOND_NS for m in found.messages] == [100, 102]
    assert "bytes instead of" in found.problems[0]["text"]


def test_whether_the_studio_is_here_is_told(store, tmp_path):
    with running_viewer(store, studio=tmp_path) as viewer:
        assert viewer.get("/api/studio") == {"installed": False, "version": "1.48.0"}
        assert viewer.ask("/studio/react/umd/react.production.min.js").status == 404
        policy = viewer.ask("/studio.html").headers["Content-Security-Policy"]
        assert "script-src 'self' 'unsafe-eval';" in policy
        assert "frame-ancestors 'self'" in policy
        worker = viewer.ask("/studio/any.worker.js").headers["Content-Security-Policy"]
        assert worker == policy
        policy = viewer.ask("/look.html").headers["Content-Security-Policy"]
        assert "frame-src 'self'" in policy
        assert "eval" not in policy
