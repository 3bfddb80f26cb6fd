# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""cassandra_bag size: of bags, of stored topics, and beside what the benchmark measured on disk."""

from __future__ import annotations

import json
import math
import statistics
from pathlib import Path

import pytest
from sensor_msgs.msg import Image
from std_msgs.msg import Float64

from cassandra_ros.cli import cassandra_bag
from cassandra_ros.cli.verbs import size as verb
from cassandra_ros.files.bag import size_estimate
from cassandra_ros.files.bag.file_formats import open_file
from cassandra_ros.files.bag.size_estimate import TopicSample, estimate, sample_file
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.metadata import FORMAT_NAMES

ROOT = Path(__file__).resolve().parents[2]
HUSKY = ROOT / "examples/data/husky_gps_data.bag"
DAY = 24 * 60 * 60
T = 1_400_000_000 * 10**9


def of_bag(capsys, *words):
    assert cassandra_bag.main(["size", str(HUSKY), "--json", *words]) == 0
    return json.loads(capsys.readouterr()[0])


@pytest.mark.suite("all", "it imports a whole bag in each format")
def test_the_estimate_agrees_with_what_the_benchmark_measured():
    """Bytes of the tables' data in the last make bench, whose imports fill the blocks."""
    measured = json.loads((ROOT / "benchmark/results/full.json").read_text(encoding="utf-8"))
    with open_file(str(HUSKY)) as reader:
        samples = sample_file(reader, None, 1000)
    whole = sum(sample.message_bytes * sample.count for sample in samples)
    sizes = [(sample.count, estimate(sample, math.inf)) for sample in samples]
    for name in ("binary", "ros", "packed"):
        disk = sum(count * each[name].disk for count, each in sizes)
        (found,) = measured_share(measured, name)
        assert disk / whole == pytest.approx(found, rel=0.1), name


def measured_share(results, name):
    """Bytes of data on disk, by bytes of messages, of the bag that is shipped with us."""
    wanted = {"what": "size of data alone", "contender": name, "kind": HUSKY.name}
    for each in results["series"]:
        if each["experiment"] == "bags" and wanted.items() <= each.items():
            yield statistics.median(each["values"])


@pytest.mark.suite("all", "make test asks others of its kind")
def test_rates_and_topics_are_those_given(capsys):
    found = of_bag(capsys, "--topics", "/tf", "/fix", "--rates", "/t.*:100", "7")
    tf, fix = sorted(found["topics"], key=lambda each: each["topic"] != "/tf")
    assert (tf["topic"], tf["rate_hz"], fix["topic"], fix["rate_hz"]) == ("/tf", 100, "/fix", 7)
    for each in (tf, fix):
        assert set(each["bytes_a_day"]) == set(FORMAT_NAMES)
        for name, size in each["bytes_a_message"].items():
            assert each["bytes_a_day"][name] == pytest.approx(size * each["rate_hz"] * DAY)
    # A block of /tf at 100 Hz holds 50 messages.
    assert tf["bytes_a_message"]["packed"] < tf["bytes_a_message"]["ros"] / 2
    assert tf["stored_format"] == "" and tf["measured"] is None


@pytest.mark.suite("all", "make test asks others of its kind")
def test_what_three_nodes_need(capsys):
    found = of_bag(capsys, "--days", "10", "--format", "packed")
    need, day = found["cluster"], [each["bytes_a_day"]["packed"] for each in found["topics"]]
    assert (need["nodes"], need["replication_factor"], need["left_out"]) == (3, 3, 0)
    assert need["node_bytes_a_day"] == pytest.approx(sum(day))
    assert need["node_bytes"] == pytest.approx(10 * sum(day))
    assert need["node_free_bytes"] == pytest.approx(10 * max(day))
    sent = sum(each["rate_hz"] * each["message_bytes"] for each in found["topics"])
    assert need["network_bytes_a_second"] == pytest.approx(3 * sent)


def test_large_messages_count_their_chunks_in_every_format():
    image = Image(height=1000, width=1000, encoding="mono8", step=1000, data=bytes(10**6))
    noise = (ROOT / "examples/data/husky_gps_data.bag").read_bytes()[:600_000]
    for data, low, high in ((bytes(10**6), 0, 60_000), (noise, 100_000, 700_000)):
        image.data = data
        wire = serialize(image)
        sample = TopicSample("/i", image._type, image._md5sum, definition_of(Image), 10.0, count=1)
        assert sample.add_message(T, wire, 5)
        for name, size in estimate(sample, 0.5).items():
            assert low < size.disk < high, name
            assert size.plain > len(wire), name


def test_an_unusable_definition_leaves_the_formats_that_need_none():
    sample = TopicSample("/x", "pkg/Unknown", "0" * 32, None, None, count=1)
    sample.add_message(T, b"abc", 5)
    known = {name for name, size in estimate(sample, 0.5).items() if size is not None}
    assert known == {"binary"}


def test_of_stored_topics(rosCas, call, monkeypatch):
    topic = rosCas.addTopic("/value", format="ros")
    for n in range(40):
        topic.addData(Float64(n / 7), key=T + n * 10**8)
    rosCas.addTopic("/empty", msg_type=Float64._type)
    status, out, err = call("size", "--json", "--sample", "20")
    assert (status, err) == (0, "")
    (found,) = json.loads(out)["topics"]
    assert (found["topic"], found["stored_format"], found["message_bytes"]) == ("/value", "ros", 8)
    assert found["rate_hz"] == pytest.approx(10)
    assert 0 < found["sampled"] <= 20
    assert found["measured"] is None  # the table is too small to tell
    assert call("size", "--rates", "0")[0] == 2
    # What the nodes say is divided by messages and copies.
    monkeypatch.setattr(
        "cassandra_ros.store.tables.disk_usage.disk_usage",
        lambda cassandra, keyspace: {topic.tables[0].name: verb._MEASURED_BYTES},
    )
    status, out, _ = call("size")
    assert status == 0
    assert "stored as" in out.splitlines()[0]
    assert " ros " in out.splitlines()[1]
    (found,) = json.loads(call("size", "--json")[1])["topics"]
    assert found["measured"] == verb._MEASURED_BYTES / 40


def test_an_empty_store_says_so(call, rosCas):
    rosCas.addTopic("/empty", msg_type=Float64._type)
    status, out, _ = call("size")
    assert (status, out) == (
        1,
        "there are no messages to measure: name a bag, or another keyspace\n",
    )


def test_the_sample_is_bounded(monkeypatch):
    monkeypatch.setattr(size_estimate, "SAMPLE_BYTES", 1000)
    with open_file(str(HUSKY)) as reader:
        samples = sample_file(reader, ["/tf", "/fix"], 5)
    assert all(len(sample.wires) <= 5 and sample.nbytes <= 1000 for sample in samples)
    assert {sample.topic for sample in samples} == {"/tf", "/fix"}
