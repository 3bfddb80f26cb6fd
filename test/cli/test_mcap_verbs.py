# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""cassandra_bag import, verify and export of MCAP files, and what it says of rosbag2's."""

from __future__ import annotations

import shutil
import sqlite3

import pytest
from bag.truth import read_with_rosbag, string_wire
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_ros1.decoder import DecoderFactory

from cassandra_ros.files.bag.file_formats import open_file
from cassandra_ros.files.bag.identity import read_content
from cassandra_ros.store.tables.sent_times import SendTimeStore

TOPICS = ("/rosout", "/tf_static", "/turtle1/cmd_vel")


def words(text, first):
    """Return the words of the line of a table that begins with a word."""
    return next(line.split() for line in text.splitlines() if line.split()[:1] == [first])


@pytest.mark.suite("test", "promise 1, by the verbs of a person")
def test_bag_to_mcap_to_bag_loses_nothing(call, keyspaces, bags, tmp_path):
    bag, mcap, again = bags / "turtlesim_tf.bag", tmp_path / "a.mcap", tmp_path / "again.bag"
    assert call("import", bag, "--topics", *TOPICS)[0] == 0
    status, text, err = call("export", mcap, "--topics", *TOPICS)
    assert (status, err) == (0, "")
    assert words(text, "/turtle1/cmd_vel")[1] == "357"
    expected = [m for m in read_with_rosbag(bag)[1] if m.topic in TOPICS]
    with open(mcap, "rb") as file:  # as Foxglove does
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros1"
        turns = [m.linear.x for *_, m in reader.iter_decoded_messages(topics=["/turtle1/cmd_vel"])]
    assert len(turns) == 357
    assert any(turns)
    with keyspaces.lend() as other:
        assert call("import", mcap, "-q", keyspace=other) == (0, "", "")
        status, text, _ = call("verify", mcap, keyspace=other)
        assert (status, text.split(":")[0]) == (0, "equal")
        assert call("import", mcap, "-q", keyspace=other)[0] == 0
        assert f"messages:  {len(expected)} of 3 topics" in call("info", keyspace=other)[1]
        assert call("export", again, keyspace=other)[0] == 0
        assert read_with_rosbag(again)[1] == expected
        assert call("export", mcap, "--compression", "none", keyspace=other)[0] == 1  # it exists
        assert call("export", mcap, "-f", "--compression", "none", keyspace=other)[0] == 0
        raw = bytearray(mcap.read_bytes())
        raw[raw.index(expected[0].data) + 3] ^= 1
        mcap.write_bytes(raw)
        status, _, err = call("verify", mcap, keyspace=other)
        assert (status, err.count("\n")) == (1, 1)
        assert "its crc is wrong" in err
        mcap.write_bytes(raw[:30_000])
        status, _, err = call("import", mcap, "-q", keyspace=other)
        assert (status, err.count("\n")) == (1, 1)
        assert "with --salvage (salvage=True) what it holds is read" in err
        status, _, err = call("import", mcap, "-q", "--salvage", keyspace=other)
        assert status == 1
        assert "messages up to there are read, " in err


def write(path, channels, profile="ros1", messages=6, extras=False):
    """Write an MCAP of any encodings: topic -> message encoding, schema encoding."""
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start(profile)
        ids = []
        for topic, (encoding, schema_encoding) in channels.items():
            schema = writer.register_schema("std_msgs/String", schema_encoding, b"string data\n")
            ids.append(writer.register_channel(topic, encoding, schema))
        for n in range(messages):
            writer.add_message(ids[n % len(ids)], 5 + n, string_wire(str(n)), 5 + n)
        if extras:
            writer.add_metadata("where", {"site": "lab"})
        writer.finish()
    return path


ROS1, CDR, JSON = ("ros1", "ros1msg"), ("cdr", "ros2msg"), ("json", "jsonschema")


def test_messages_that_are_not_of_ros_1_are_reported(call, tmp_path):
    mixed = write(tmp_path / "a.mcap", {"/a": ROS1, "/j": JSON}, extras=True)
    status, text, err = call("import", mixed)
    assert status == 1
    assert words(text, "/a")[1] == "3"
    assert "3 messages of topic /j are not stored: its messages are encoded as 'json'" in err
    assert "its 1 records of metadata are not stored" in err
    status, text, _ = call("verify", mixed)  # or somebody deletes the file, for it is equal
    assert status == 1
    assert "3 messages of /j are not stored: its messages are encoded as 'json'" in text
    status, text, _ = call("verify", mixed, "--topics", "/a")
    assert status == 0
    assert "not stored: records of metadata of the file, 1; the store holds messages only" in text
    assert call("import", mixed, "--topics", "/a", "-q") == (0, "", "")
    status, _, err = call("import", write(tmp_path / "j.mcap", {"/j": JSON}))
    assert (status, err.count("\n")) == (1, 1)
    assert "holds no messages of ROS 1: of topic /j" in err


def read(path):
    """Return all that the mcap package says of the messages of a file."""
    with open(path, "rb") as file:
        return [
            (m.log_time, m.publish_time, m.sequence, c.topic, m.data)
            for _, c, m in make_reader(file).iter_messages()
        ]


@pytest.mark.suite("test", "publish_time through the store")
def test_when_messages_were_sent_comes_back(call, rosCas, tmp_path):
    """publish_time and sequence, of more messages than lie in one row."""
    path, out = tmp_path / "a.mcap", tmp_path / "b.mcap"
    with open(path, "wb") as file:
        writer = Writer(file, chunk_size=40_000)
        writer.start("ros1")
        schema = writer.register_schema("std_msgs/String", "ros1msg", b"string data\n")
        ids = [writer.register_channel(topic, "ros1", schema) for topic in ("/a", "/b")]
        for n in range(4200):
            sent = 10**9 * n if n < 100 else 10**9 * n - n % 7 * 1000 + 3 * (n == 4199)
            data = string_wire(str(n))
            writer.add_message(ids[n % 2], 10**9 * n, data, sent, n // 2 if n > 50 else 0)
        writer.finish()
    expected = read(path)
    for _ in range(2):  # once more changes nothing
        assert call("import", path, "-q", "--format", "packed") == (0, "", "")
    assert call("verify", path)[0] == 0
    assert call("export", out)[0] == 0
    assert read(out) == expected
    late = ("--topics", "/b", "--start", "4150", "--no-latched")
    assert call("export", out, "-f", *late)[0] == 0
    assert read(out) == [m for m in expected if m[0] >= 4150 * 10**9 and m[3] == "/b"]
    # A bag of the same messages does not say when they were sent, and so is another one.
    assert call("export", tmp_path / "a.bag")[0] == 0
    assert [m.data for m in read_with_rosbag(tmp_path / "a.bag")[1]] == [m[-1] for m in expected]
    with open_file(path) as mcap, open_file(tmp_path / "a.bag") as bag:
        assert read_content(mcap).digest != read_content(bag).digest
    (run,) = rosCas.runs()
    sent = SendTimeStore(rosCas.catalog.keyspace.side_tables)
    kept = sent.read_stripe(run.writer, "", 1)
    kept.delays[3] += 1
    kept.sequences[5] += 1
    sent.write_stripe(run.writer, "", 1, kept)
    status, text, _ = call("verify", path)
    assert (status, "publish_time or sequence of 2 messages" in text) == (1, True)
    assert call("import", path, "-q")[0] == call("verify", path)[0] == 0
    assert call("delete", "--run", run.name, "--yes", "-q")[0] == 0
    assert sent.read_stripe(run.writer, "", 1) is None


@pytest.mark.parametrize("kind", ["folder", "db3", "mcap"])
def test_bags_of_ros_2_are_named_with_what_to_do(call, tmp_path, kind):
    folder = tmp_path / "drive"
    folder.mkdir()
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 5}\n")
    path = folder if kind == "folder" else folder / f"drive_0.{kind}"
    if kind == "db3":
        with sqlite3.connect(path) as file:
            file.execute("CREATE TABLE topics (id INTEGER)")
    elif kind == "mcap":
        write(path, {"/a": CDR}, profile="ros2")
    for verb in ("import", "verify"):
        status, _, err = call(verb, path)
        assert (status, err.count("\n")) == (1, 1)
        assert f"{path} is a bag of ROS 2 (rosbag2)" in err
        assert f"rosbags-convert --src {folder} --dst OUT.bag" in err
    shutil.copy(path, tmp_path / "x") if path.is_file() else None
    if path.is_file():  # alone, and whatever its name
        assert f"--src {tmp_path / 'x'} " in call("import", tmp_path / "x")[2]
