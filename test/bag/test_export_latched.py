# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""An exported window begins with what was latched before it, judged by the rosbag module."""

from __future__ import annotations

import pytest
import rosbag
from bag.truth import read_with_rosbag, string_connection, string_wire
from mcap.reader import make_reader

from cassandra_ros.cli import cassandra_bag
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.bag.comparison import verify_bag, verify_content
from cassandra_ros.files.bag.exporter import export_bag
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.files.bag.mcap_writer import McapWriter

SEC = 10**9
T0 = 1_500_000_000 * SEC


def at(seconds):
    return T0 + round(seconds * SEC)


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    """A bag: two publishers latch /tf_static at the beginning, one /map, one /tick each second."""
    path = tmp_path_factory.mktemp("latched") / "original.bag"
    with BagWriter(path) as writer:
        latched = {"latching": "1"}
        tick = writer.connection(string_connection("/tick", number=0, callerid="/t"), 0)
        tf = [
            writer.connection(
                string_connection("/tf_static", number=n, callerid=f"/tf{n}", **latched), n
            )
            for n in (1, 2)
        ]
        maps = writer.connection(string_connection("/map", callerid="/m", **latched), 3)
        writer.write(tf[0], at(0), string_wire("arm"))
        writer.write(tf[1], at(0.1), string_wire("base"))
        writer.write(maps, at(1.5), string_wire("m1"))
        for n in range(10):
            writer.write(tick, at(n), string_wire(f"t{n}"))
            if n in (2, 7):
                writer.write(maps, at(n + 0.5), string_wire(f"m{n}"))
    return path


@pytest.fixture
def stored(rosCas, original):
    import_bag(rosCas, original, nodeID="r1")
    return rosCas


def lines(path):
    """What rosbag gives: (topic, seconds, text, callerid, mark)."""
    with rosbag.Bag(str(path)) as bag:
        return [
            (
                topic,
                (t.to_nsec() - T0) / SEC,
                message.data,
                header["callerid"].decode(),
                int(header.get("latched_from", b"0")),
            )
            for topic, message, t, header in bag.read_messages(return_connection_header=True)
        ]


def test_a_window_begins_with_what_was_latched(stored, tmp_path):
    out = tmp_path / "out.bag"
    report = export_bag(stored, out, start=at(5), end=at(8))
    assert lines(out) == [
        ("/tf_static", 5, "arm", "/tf1", at(0)),
        ("/tf_static", 5, "base", "/tf2", at(0.1)),
        ("/map", 5, "m2", "/m", at(2.5)),
        ("/tick", 5, "t5", "/t", 0),
        ("/tick", 6, "t6", "/t", 0),
        ("/tick", 7, "t7", "/t", 0),
        ("/map", 7.5, "m7", "/m", 0),
        ("/tick", 8, "t8", "/t", 0),
    ]
    assert report.latched == {"/tf_static": 2, "/map": 1}
    assert report.messages == {"/tf_static": 2, "/map": 2, "/tick": 4}
    with rosbag.Bag(str(out)) as bag:
        assert (bag.get_start_time(), bag.get_end_time()) == (at(5) / SEC, at(8) / SEC)
    # But for the mark their connections are the publishers' own.
    _, read = read_with_rosbag(out)
    header = dict(read[0].header)
    assert header.pop("latched_from") == str(at(0)).encode()
    assert header == string_connection("/tf_static", callerid="/tf1", latching="1").fields


def test_what_was_latched_has_no_publish_time_of_its_own_in_a_window(rosCas, tmp_path):
    """It is written at the start of the window: the time from its sending does not count there."""
    source, out = tmp_path / "source.mcap", tmp_path / "out.mcap"
    with McapWriter(source) as writer:
        latched = string_connection("/map", number=0, callerid="/m", latching="1")
        maps = writer.connection(latched, 0)
        tick = writer.connection(string_connection("/tick", number=1, callerid="/t"), 1)
        writer.write(maps, at(0), string_wire("map"), -SEC // 4, 7)
        for n in range(10):
            writer.write(tick, at(n), string_wire(f"t{n}"), -SEC // 8, n)
    import_bag(rosCas, source)
    export_bag(rosCas, out, start=at(5), end=at(6))
    with out.open("rb") as file:
        found = [
            (channel.topic, message.log_time, message.publish_time, message.sequence)
            for _, channel, message in make_reader(file).iter_messages()
        ]
    assert found == [
        ("/map", at(5), at(5), 0),
        ("/tick", at(5), at(5 - 1 / 8), 5),
        ("/tick", at(6), at(6 - 1 / 8), 6),
    ]


def test_it_takes_only_what_is_asked_for(stored, tmp_path):
    out = tmp_path / "out.bag"
    export_bag(stored, out, start=at(5), end=at(5), latched=False)
    assert [line[2] for line in lines(out)] == ["t5"]
    export_bag(stored, out, ["/map", "/tick"], start=at(5), end=at(5), force=True)
    assert [line[2] for line in lines(out)] == ["m2", "t5"]
    export_bag(stored, out, start=at(5), end=at(5), where={"/map": "data <> 'm2'"}, force=True)
    assert [line[2] for line in lines(out)] == ["arm", "base", "m1", "t5"]
    # Alone a topic that was sent once is what the window shows of it.
    export_bag(stored, out, ["/tf_static"], start=at(5), end=at(6), force=True)
    assert [line[2] for line in lines(out)] == ["arm", "base"]
    # What came exactly at the start is in the window.
    export_bag(stored, out, ["/map"], start=at(2.5), force=True)
    assert [line[1:3] for line in lines(out)] == [(2.5, "m1"), (2.5, "m2"), (7.5, "m7")]


def test_without_a_start_nothing_is_added(stored, original, tmp_path):
    report = export_bag(stored, tmp_path / "out.bag")
    assert report.latched == {}
    assert read_with_rosbag(tmp_path / "out.bag") == read_with_rosbag(original)
    export_bag(stored, tmp_path / "from.bag", start=at(-1))
    assert read_with_rosbag(tmp_path / "from.bag") == read_with_rosbag(original)


def test_other_runs_give_nothing(stored, tmp_path):
    with BagWriter(tmp_path / "later.bag") as writer:
        number = writer.connection(string_connection("/tick", callerid="/l"))
        writer.write(number, at(100), string_wire("l"))
    import_bag(stored, tmp_path / "later.bag", nodeID="r1")
    export_bag(stored, tmp_path / "out.bag", start=at(50))
    assert [line[2] for line in lines(tmp_path / "out.bag")] == ["l"]


def test_what_is_marked_is_not_compared_with_the_original(stored, tmp_path):
    out = tmp_path / "out.bag"
    export_bag(stored, out, start=at(5))
    report = verify_content(stored, out, start=at(5))
    assert (report.equal, report.equal_messages, report.left_out) == (True, 6, 3)
    report = verify_bag(stored, out)
    assert report.left_out == 3
    assert (report.missing, report.differences) == (0, 9)  # the store holds what was before


def test_a_window_is_imported_as_it_stands(stored, fresh, tmp_path):
    out, again = tmp_path / "out.bag", tmp_path / "again.bag"
    export_bag(stored, out, start=at(5))
    with fresh() as other:
        import_bag(other, out)
        report = verify_bag(other, out)
        assert (report.equal, report.equal_messages, report.left_out) == (True, 9, 0)
        export_bag(other, again)
        assert read_with_rosbag(again)[1] == read_with_rosbag(out)[1]
        # A second export of a shorter time range keeps the messages latched, with their first mark.
        export_bag(other, again, start=at(6), end=at(6), force=True)
        assert lines(again) == [
            ("/tf_static", 6, "arm", "/tf1", at(0)),
            ("/tf_static", 6, "base", "/tf2", at(0.1)),
            ("/map", 6, "m2", "/m", at(2.5)),
            ("/tick", 6, "t6", "/t", 0),
        ]


@pytest.mark.suite("all", "make test asks others of its kind")
def test_windows_of_a_real_bag(rosCas, bags, tmp_path):
    """rosbag decides what a late subscriber of /tf_static and /rosout would have been sent."""
    path, out = bags / "turtlesim_tf.bag", tmp_path / "out.bag"
    import_bag(rosCas, path)
    _, every = read_with_rosbag(path)
    for place in (500, 3000, 7000):
        start = every[place].t_ns
        export_bag(rosCas, out, start=start, force=True)
        last = {}
        for each in every:
            if each.t_ns < start and each.header.get("latching") == b"1":
                last[each.topic, each.header["callerid"]] = each
        assert "/tf_static" in {topic for topic, _ in last}
        _, read = read_with_rosbag(out)
        early, rest = read[: len(last)], read[len(last) :]
        assert {(e.topic, e.data, int(e.header["latched_from"])) for e in early} == {
            (e.topic, e.data, e.t_ns) for e in last.values()
        }
        assert {e.t_ns for e in early} == {start}
        assert rest == [e for e in every if e.t_ns >= start]


def test_the_command_line_says_so(stored, tmp_path, capsys, cassandra):
    out = str(tmp_path / "out.bag")
    store = ["--host", cassandra.host, "--port", str(cassandra.port)]
    store += ["--keyspace", stored.keyspace]

    def run(*words):
        assert cassandra_bag.main([*words, *store]) == 0
        return capsys.readouterr().out

    said = run("export", out, "--start", "1500000005.0")
    assert (
        "3 of these were latched before 1500000005.0; their time in the file is 1500000005.0"
        in said
    )
    assert "9 messages of 3 topics" in said
    said = run("verify", "--content", "--start", "1500000005.0", out)
    assert "not compared: 3 messages that the export took from before its window" in said
    said = run("export", out, "--start", "1500000005.0", "--no-latched", "-f")
    assert "latched" not in said and "6 messages of 2 topics" in said


def test_windows_around_a_condition(stored, tmp_path, call):
    """Around t3 and t4, which are one window, and t8: ticks, and what was latched before each."""
    path = tmp_path / "around.bag"
    where = "/tick: data = 't3' or data = 't4' or data = 't8'"
    status, out, _ = call("export", str(path), "--around", where, "--before", "1", "--after", "0.5")
    assert status == 0
    ticks = [text for topic, _, text, *_ in lines(path) if topic == "/tick"]
    assert ticks == ["t2", "t3", "t4", "t7", "t8"]
    latched = [(topic, text) for topic, _, text, _, mark in lines(path) if mark]
    assert ("/map", "m1") in latched and latched.count(("/tf_static", "arm")) == 1
    assert "were latched before the time ranges" in out
    around = (("/tick", ("data = ?", ["t8"])), 0, 0)
    report = export_bag(stored, tmp_path / "b.bag", around=around, latched=False)
    assert report.messages == {"/tick": 1}
    for words, told in (
        (("--around", "/tick: data = 'x'"), "nothing lies around one"),
        (("--around", "/tock: data = 'x'"), "/tock"),
        (("--around", "/tick"), "names no hits"),
    ):
        status, _, err = call("export", str(tmp_path / "c.bag"), *words)
        assert (status, told in err) == (1, True), err
    for words in (
        ("--around", where, "--event", "e"),
        ("--around", where, "--parquet"),
        ("--before", "1"),
    ):
        assert call("export", str(tmp_path / "c.bag"), *words)[0] == 2
    assert not (tmp_path / "c.bag").exists()
