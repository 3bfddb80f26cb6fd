# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The format that an import chooses for a new topic: by number, rate, size, and what it saves."""

from __future__ import annotations

import json
import random
from pathlib import Path

import pytest
from bag.truth import string_connection, string_wire
from nav_msgs.msg import OccupancyGrid
from sensor_msgs.msg import CompressedImage, Imu
from std_msgs.msg import String
from suites import sparing

from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.bag.comparison import verify_bag
from cassandra_ros.files.bag.file_formats import open_file
from cassandra_ros.files.bag.format_choice import CHOICE_MESSAGES, FormatChoice, choose_format
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.files.bag.mcap_writer import McapWriter
from cassandra_ros.files.bag.size_estimate import TopicSample, sample_file
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of

SECOND = 10**9
START = 1_700_000_000 * SECOND
HUSKY = Path(__file__).resolve().parents[2] / "examples/data/husky_gps_data.bag"


def imu(n):
    """Return a message of an IMU that shakes a little."""
    msg = Imu()
    msg.header.seq = n
    msg.header.stamp.secs, msg.header.stamp.nsecs = divmod(n * 5_000_000, SECOND)
    msg.header.frame_id = "imu_link"
    msg.linear_acceleration.z = 9.81 + 0.001 * random.Random(n).randrange(-50, 50)
    return msg


def jpeg(n, size=20_000):
    """Return a picture that is compressed already."""
    data = random.Random(n).getrandbits(8 * size).to_bytes(size, "big")
    return CompressedImage(format="jpeg", data=data)


def sample(messages, rate_hz, count=None):
    """Return what a first pass keeps of a topic."""
    kind = type(messages[0])
    count = len(messages) if count is None else count
    found = TopicSample("/t", kind._type, kind._md5sum, definition_of(kind), rate_hz, count=count)
    step = SECOND / (rate_hz or 1)
    for n, msg in enumerate(messages):
        found.add_message(START + round(n * step), serialize(msg), 2000)
    return found


@pytest.fixture(scope="module")
def imus():
    return [imu(n) for n in range(300)]


def test_many_small_messages_that_compress_are_packed(imus):
    chosen, why = choose_format(sample(imus, 200.0, 4000))
    assert chosen == "packed"
    assert why.startswith("200/s of 320 B: saves ")
    assert 25 <= int(why.split()[-1].rstrip("%")) < 100


@pytest.mark.parametrize(
    ("rate_hz", "count", "why"),
    [
        (200.0, 99, "few messages"),
        (8.99, 4000, "low rate: 8.99/s"),
        (1.0, 4000, "low rate: 1/s"),
        (0.25, 4000, "low rate: 0.25/s"),
        (None, 4000, "low rate: 0/s"),  # all of one time
    ],
)
def test_few_and_rare_messages_are_ros(imus, rate_hz, count, why):
    assert choose_format(sample(imus, rate_hz, count)) == ("ros", why)


def test_messages_that_do_not_compress_are_ros():
    chosen, why = choose_format(sample([jpeg(n) for n in range(100)], 30.0))
    assert chosen == "ros"
    assert why.startswith("30/s of 200") and why.endswith(" B: packed saves 0%")


def test_the_limits_are_included(imus):
    assert choose_format(sample(imus, 9.0, 100)).format == "packed"


@pytest.mark.parametrize(("size", "expected"), [(60_000, "packed"), (70_000, "ros")])
def test_large_messages_are_ros(size, expected):
    """A large one is a block of its own: these repeat what ROS's rows do not see far enough."""
    pictures = [jpeg(n, 10_000) for n in range(100)]
    for picture in pictures:
        picture.data *= size // 10_000
    chosen, why = choose_format(sample(pictures, 20.0))
    assert chosen == expected, why
    assert (why == "messages over 64 KiB") == (expected == "ros")


def test_an_unusable_definition_is_binary(imus):
    broken = sample(imus, 200.0)
    broken.definition = None
    assert choose_format(broken) == ("binary", "unusable definition")


def test_only_the_first_messages_count():
    """So 'size', which reads more of them, says what an import does."""
    few, noise = [imu(n) for n in range(CHOICE_MESSAGES)], []
    for n in range(500):
        noise.append(imu(n))
        noise[-1].orientation_covariance = [random.Random(n + m).random() for m in range(9)]
    assert choose_format(sample(few, 200.0, 4000)) == choose_format(
        sample(few + noise, 200.0, 4000)
    )
    assert choose_format(sample(noise, 200.0, 4000)) != choose_format(sample(few, 200.0, 4000))


def test_it_follows_from_the_bag_and_also_from_its_mcap(tmp_path):
    path, chosen = write_robot(tmp_path / "a.bag"), []
    for name in (path, write_robot(tmp_path / "a.mcap", McapWriter)):
        with open_file(str(name)) as reader:
            chosen.append({s.topic: choose_format(s) for s in sample_file(reader, None, 1000)})
    assert chosen[0] == chosen[1]
    assert {topic: choice.format for topic, choice in chosen[0].items()} == ROBOT


ROBOT = {"/broken": "binary", "/camera": "ros", "/imu": "packed", "/map": "ros", "/status": "ros"}
"""Topics of the bag of a robot, and the formats that an import chooses."""


def write_robot(path, writer_class=BagWriter, seconds=12, imu_hz=50):
    """Write seconds of a robot: IMU, pictures at 10 Hz, a status each second, a latched map."""
    types = {"/imu": Imu, "/camera": CompressedImage, "/status": String, "/map": OccupancyGrid}
    messages = [(START, "/map", serialize(OccupancyGrid(data=[-1] * 100_000)))]
    for n in range(seconds * imu_hz):
        messages.append((START + n * SECOND // imu_hz, "/imu", serialize(imu(n))))
    for n in range(seconds * 10):
        messages.append((START + n * SECOND // 10 + 1, "/camera", serialize(jpeg(n, 5000))))
        messages.append((START + n * SECOND // 10 + 2, "/broken", b"??"))
    for n in range(seconds):
        messages.append((START + n * SECOND + 3, "/status", string_wire(f"on {n}")))
    with writer_class(path) as writer:
        numbers = {
            topic: writer.connection(api_connection(topic, definition_of(kind), "/n"))
            for topic, kind in types.items()
        }
        broken = {"type": "x/Odd", "md5sum": "0" * 32, "message_definition": "??"}
        numbers["/broken"] = writer.connection(string_connection("/broken", **broken))
        for t_ns, topic, wire in sorted(messages, key=lambda message: message[0]):
            writer.write(numbers[topic], t_ns, wire)
    return path


def formats(report):
    return {topic: imported.format for topic, imported in report.topics.items()}


def tables(rosCas):
    return {
        topic.name: [t.metadata.format for t in topic.tables] for topic in rosCas.getAllTopics()
    }


def test_an_import_stores_each_topic_in_the_format_chosen(rosCas, tmp_path):
    path = write_robot(tmp_path / "a.bag")
    report = import_bag(rosCas, path)
    assert formats(report) == ROBOT
    assert {
        topic: imported.why for topic, imported in report.topics.items() if topic != "/imu"
    } == {
        "/broken": "unusable definition",
        "/camera": report.topics["/camera"].why,
        "/map": "few messages",
        "/status": "few messages",
    }
    assert "packed saves 0%" in report.topics["/camera"].why
    assert ": saves " in report.topics["/imu"].why
    assert tables(rosCas) == {topic: [form] for topic, form in ROBOT.items()}
    assert verify_bag(rosCas, path).equal
    # Once more, and a part of it: into the same tables.
    for topics in (None, ["/imu", "/map"]):
        again = import_bag(rosCas, path, topics=topics)
        assert formats(again).items() <= ROBOT.items()
        assert {imported.why for topic, imported in again.topics.items() if topic != "/broken"} == {
            "stored before"
        }
    assert tables(rosCas) == {topic: [form] for topic, form in ROBOT.items()}
    assert verify_bag(rosCas, path).equal


def test_a_part_of_a_bag_is_stored_as_all_of_it(rosCas, tmp_path):
    path = write_robot(tmp_path / "a.bag")
    for topic, form in ROBOT.items():
        assert formats(import_bag(rosCas, path, topics=[topic])) == {topic: form}


def test_the_second_bag_goes_where_the_first_one_went(rosCas, tmp_path):
    import_bag(rosCas, write_robot(tmp_path / "a.bag"), topics=["/imu", "/status"])
    slow = import_bag(rosCas, write_robot(tmp_path / "b.bag", imu_hz=2), topics=["/imu", "/map"])
    assert formats(slow) == {"/imu": "packed", "/map": "ros"}
    assert tables(rosCas) == {"/imu": ["packed"], "/status": ["ros"], "/map": ["ros"]}


def test_a_stored_topic_keeps_its_format_and_its_keys(rosCas, tmp_path):
    rosCas.addTopic("/imu", "json", msg_type="sensor_msgs/Imu")
    assert formats(import_bag(rosCas, write_robot(tmp_path / "a.bag"), topics=["/imu"])) == {
        "/imu": "json"
    }
    rosCas.removeTopic("/imu")
    # Packed messages could not have such keys, or an index.
    rosCas.addTopic("/imu", msg_type="sensor_msgs/Imu", key_format="hash")
    report = import_bag(rosCas, tmp_path / "a.bag", topics=["/imu"])
    assert report.topics["/imu"].format == "ros" and report.topics["/imu"].why == "stored before"
    assert tables(rosCas) == {"/imu": ["ros"]}


@pytest.mark.parametrize("form", sparing(["ros", "packed", "binary"], kept=["binary"]))
def test_a_format_that_the_user_names_wins(rosCas, tmp_path, form):
    path = write_robot(tmp_path / "a.bag")
    report = import_bag(rosCas, path, format=form)
    assert formats(report) == {topic: "binary" if topic == "/broken" else form for topic in ROBOT}
    assert {imported.why for imported in report.topics.values()} == {""}
    again = import_bag(rosCas, path)
    assert formats(again) == formats(report)
    assert verify_bag(rosCas, path).equal


def test_the_table_says_the_format_and_why(call, tmp_path):
    path = write_robot(tmp_path / "a.bag")
    status, out, _ = call("import", path)
    rows = [line.split(None, 5) for line in out.splitlines()[:6]]
    assert rows[0] == ["topic", "messages", "size", "format", "why"]
    assert [(row[0], row[4]) for row in rows[1:]] == [*ROBOT.items()]  # the size is two words
    assert rows[1][5] == "unusable definition" and rows[5][5] == "few messages"
    assert rows[3][5].startswith("50/s of 320 B: saves ")
    (found,) = json.loads(call("import", path, "--json")[1])["files"]
    assert found["topics"]["/imu"]["format"] == "packed"
    assert found["topics"]["/imu"]["why"] == "stored before"
    assert (status, call("import", path, "-q")[1]) == (0, "")


def test_the_table_of_a_named_format_needs_no_reason(call, tmp_path):
    path = write_robot(tmp_path / "a.bag")
    out = call("import", path, "--format", "packed", "--topics", "/imu", "/status")[1]
    assert [line.split()[-1] for line in out.splitlines()[:3]] == ["format", "packed", "packed"]
    assert "for new topics packed or ros" in " ".join(call("import", "--help")[1].split())


@pytest.mark.suite("all", "it compresses a robot's bag three times; make test asks both alone")
def test_size_says_what_an_import_does(call, tmp_path):
    path = write_robot(tmp_path / "a.bag")
    for words in (("--rates", "1"), ()):  # rates are those of a recording
        status, out, _ = call("size", path, "--json", *words)
        told = {each["topic"]: each for each in json.loads(out)["topics"]}
        assert (status, {topic: each["import_format"] for topic, each in told.items()}) == (
            0,
            ROBOT,
        )
    imported = json.loads(call("import", path, "--json")[1])["files"][0]["topics"]
    for topic, each in told.items():
        whys = (each["import_why"], imported[topic]["why"])
        assert (each["messages"], whys[0]) == (imported[topic]["messages"], whys[1])
    # The import's blocks are full, those of a recorder hold half a second.
    assert told["/imu"]["import_bytes"] < 600 * told["/imu"]["bytes_a_message"]["packed"]
    lines = call("size", path)[1].splitlines()
    begin = lines.index("imported without --format:")
    assert lines[begin + 1].split() == ["topic", "messages", "on", "disk", "format", "why"]
    assert [line.split()[0] for line in lines[begin + 2 :]] == [*ROBOT, "total"]


def test_of_a_stored_topic_size_says_nothing_of_an_import(call, rosCas):
    rosCas.addTopic("/a", "ros").addData(String("x"))
    (found,) = json.loads(call("size", "--json")[1])["topics"]
    assert (found["import_format"], found["import_bytes"]) == ("", None)
    assert "imported" not in call("size")[1]


def test_the_bag_of_the_pages():
    with open_file(str(HUSKY)) as reader:
        chosen = {s.topic: choose_format(s) for s in sample_file(reader, None, 1000)}
    assert chosen["/tf"] == FormatChoice("packed", "80/s of 423 B: saves 80%")
    assert chosen["/imu/data"] == FormatChoice("ros", "low rate: 8.32/s")
    assert chosen["/fix"] == FormatChoice("ros", "few messages")
    assert sum(choice.format == "packed" for choice in chosen.values()) == 15
