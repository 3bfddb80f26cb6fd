# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Settings of recorded topics: patterns in a file, conditions, rates; valid and invalid ones."""

from __future__ import annotations

from pathlib import Path

import pytest
from geometry_msgs.msg import Twist
from nodes.raw_publisher import header_of, message
from sensor_msgs.msg import Imu
from std_msgs.msg import Int32, String

from cassandra_ros.cli.recorder import make_parser
from cassandra_ros.errors import InvalidOption
from cassandra_ros.recording.dry_run import plan_topics
from cassandra_ros.recording.filters import Filters
from cassandra_ros.recording.option_values import SnapshotBound, read_bound
from cassandra_ros.recording.recorder_options import RecorderOptions
from cassandra_ros.recording.recording import Recording
from cassandra_ros.recording.topic_settings import (
    RecordingSettings,
    TopicSettings,
    read_settings,
    recording_settings,
)

ROOT = Path(__file__).resolve().parents[2]
SEC = 10**9


def settings_of(text, **options):
    return recording_settings(RecorderOptions(config=read_settings(text), **options))


def test_the_example():
    rules, _ = read_settings((ROOT / "config/recorder.yaml").read_text(encoding="utf-8"))
    of = RecordingSettings(TopicSettings("json", 60), [rules]).of
    camera = TopicSettings("binary", 86400, 5.0)
    assert of("/front/image_raw") == of("/lidar/points/filtered") == camera
    assert of("/imu/data") == TopicSettings("packed", 60)
    assert of("/cmd_vel_stamped").key_part == "header.stamp"
    assert of("/main_battery/state").index == ("percentage", "voltage")
    assert of("/else") == TopicSettings("json", 60)


def test_the_first_that_matches_holds_and_options_go_before_the_file():
    text = "topics:\n- {pattern: /a.*, ttl: 5}\n- {pattern: /ab, ttl: 6, format: yaml}\n"
    found = settings_of(text, rate_limit=[("/ab", 2.0), (".*", 9.0)], where=[("/x", "data > 1")])
    assert found.of("/ab") == TopicSettings(None, 5, 2.0)
    assert found.of("/b") == TopicSettings(None, 0, 9.0)
    assert found.of("/x").where == "data > 1"
    assert read_settings("") == read_settings("topics:\n") == ([], [])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("topics: [", "while parsing"),
        ("- a", "mapping with the keys topics and events"),
        ("topics: {a: b}", "must be a list"),
        ("topics: [{format: ros}]", "not a mapping with a pattern"),
        ("topics: [{pattern: '('}]", "not a regular expression"),
        ("topics: [{pattern: /a, fromat: ros}]", "did you mean format?"),
        ("topics: [{pattern: /a, format: xml}]", "no format 'xml'"),
        ("topics: [{pattern: /a, ttl: -1}]", "whole number of 0"),
        ("topics: [{pattern: /a, ttl: soon}]", "not a duration"),
        ("topics: [{pattern: /a, rate_limit: 0}]", "not a rate"),
        ("topics: [{pattern: /a, where: 'a >'}]", "pattern '/a'"),
        ("topics: [{pattern: /a, where: 'header.stamp > now() - 1s'}]", "KEY - 1s"),
        ("topics: [{pattern: /a, index: 5}]", "not a list of names"),
        ("!!python/object/apply:os.system ['true']", "could not determine a constructor"),
    ],
)
def test_what_is_wrong_is_named(text, said):
    with pytest.raises(InvalidOption, match="my.yaml cannot be used") as caught:
        read_settings(text, "my.yaml")
    assert said in str(caught.value)


def test_bounds():
    assert read_bound("30s") == SnapshotBound(seconds=30.0)
    assert read_bound("5m") == SnapshotBound(seconds=300.0)
    assert read_bound("200MB") == SnapshotBound(nbytes=200 << 20)
    for wrong in ("", "0MB", "MB", "-3s", "soon"):
        with pytest.raises(InvalidOption, match="30s or 200MB"):
            read_bound(wrong)


def passed(filters, times, topic="/t", header=None, wire=b""):
    return [t for t in times if filters.passes(topic, header or {}, t, wire)]


def test_a_rate_is_kept_also_where_messages_jitter():
    filters = Filters(recording_settings(RecorderOptions(rate_limit=[("/t", 5.0)])))
    jitter = [n * SEC // 10 + (n * 7919 % 40 - 20) * 10**6 for n in range(10, 1010)]
    kept = passed(filters, jitter)
    assert 498 <= len(kept) <= 502
    assert passed(filters, jitter, topic="/other") == jitter
    again = [t - 90 * SEC for t in jitter[-100:]]  # time goes back
    assert 48 <= len(passed(filters, again)) <= 52


@pytest.mark.parametrize("pause_sec", [1, 10, 1000])
def test_after_a_pause_no_burst_is_recorded(pause_sec):
    """What was not sent in the pause is not made up for: one message more, and the rate holds."""
    filters = Filters(recording_settings(RecorderOptions(rate_limit=[("/t", 1.0)])))
    early = [SEC * n // 10 for n in range(50)]
    late = [early[-1] + pause_sec * SEC + SEC * n // 10 for n in range(1, 51)]
    assert len(passed(filters, early)) == 5
    kept = passed(filters, late)
    assert kept[0] == late[0] and 5 <= len(kept) <= 6
    assert all(b - a >= SEC * 9 // 10 for a, b in zip(kept[1:], kept[2:]))


def test_a_condition_is_that_of_the_query_language():
    filters = Filters(recording_settings(RecorderOptions(where=[("/n", "data > 5 and data != 7")])))
    header = header_of(Int32)
    wires = {n: message(Int32(n)) for n in range(10)}
    assert [n for n in wires if filters.passes("/n", header, 0, wires[n])] == [6, 8, 9]
    # Another type on the same topic that the condition does not fit: recorded whole, and logged.
    assert filters.passes("/n", header_of(Twist), 0, message(Twist()))


def test_a_condition_that_asks_for_positions_keeps_the_topic_whole(caplog):
    filters = Filters(recording_settings(RecorderOptions(where=[("/n", "NEAR(0, 0, 1)")])))
    assert filters.passes("/n", header_of(Int32), 0, message(Int32(1)))
    assert "topic /n is recorded whole, because its condition 'NEAR(0, 0, 1)' cannot" in caplog.text


def test_what_the_condition_leaves_out_does_not_count_for_the_rate():
    options = RecorderOptions(where=[("/n", "data > 5")], rate_limit=[("/n", 1.0)])
    filters, header = Filters(recording_settings(options)), header_of(Int32)
    came = [(0, 1), (100, 8), (200, 9), (1150, 2), (1200, 7), (1300, 6)]  # ms, data
    kept = [
        n for ms, n in came if filters.passes("/n", header, SEC + ms * 10**6, message(Int32(n)))
    ]
    assert kept == [8, 7]


def test_left_out_is_counted_and_not_lost(rosCas):
    options = RecorderOptions(where=[("/n", "data >= 3")])
    recorder = Recording(rosCas.catalog, settings=recording_settings(options), limit=2)
    for n in range(10):
        recorder.received("/n", header_of(Int32), message(Int32(n)))
    (report,) = recorder.close()
    assert (report.received, report.left_out, report.stored, report.lost) == (5, 3, 2, 0)
    assert [m.data for _, m in rosCas.getTopic("/n").items()] == [3, 4]


def test_a_condition_on_a_field_that_is_not_there(rosCas, caplog):
    recorder = Recording(
        rosCas.catalog, settings=recording_settings(RecorderOptions(where=[("/n", "date > 3")]))
    )
    recorder.received("/n", header_of(Int32), message(Int32(1)))
    (report,) = recorder.close()
    assert (report.stored, report.left_out) == (1, 0)
    assert "recorded whole" in caplog.text
    assert "did you mean data?" in caplog.text


TABLES = """
topics:
- {pattern: /imu, format: ros, ttl: 3600, key_part: header.stamp, index: [orientation.w]}
- {pattern: /text, key_part: header.stamp}
"""


def test_tables_are_made_as_the_settings_say(rosCas, caplog):
    settings = settings_of(TABLES, format="binary")
    recorder = Recording(rosCas.catalog, settings=settings)
    imu = Imu()
    imu.header.stamp.secs = 77
    recorder.received("/imu", header_of(Imu), message(imu))
    recorder.received("/text", header_of(String), message(String("x")))
    assert [report.lost for report in recorder.close()] == [0, 0]
    meta = rosCas.getTopic("/imu").getMeta
    found = [meta[name] for name in ("format", "ttl", "key_part", "indexes")]
    assert found == ["ros", 3600, "header.stamp", ["orientation.w"]]
    assert rosCas.getTopic("/imu").getData(77 * SEC) == imu
    # A key field that the type does not have: stored by time, and logged.
    assert "kept by time of reception" in caplog.text
    assert rosCas.getTopic("/text").getMeta["format"] == "binary"
    # Stored messages stay as they are.
    other = settings_of("topics: [{pattern: /imu, ttl: 60, index: [header.seq]}]")
    recorder = Recording(rosCas.catalog, settings=other)
    recorder.received("/imu", header_of(Imu), message(imu))
    recorder.close()
    assert "was made with a ttl of 3600 s, not 60 s" in caplog.text
    assert "has no index on header.seq" in caplog.text


def test_a_plan_writes_nothing(rosCas):
    types = {"/imu": "sensor_msgs/Imu", "/new": ""}
    plan = plan_topics(rosCas.catalog, settings_of(TABLES), types)
    assert [(p.topic, p.format, p.ttl, p.stored) for p in plan] == [
        ("/imu", "ros", 3600, False),
        ("/new", "ros", 0, False),
    ]
    assert plan[0].settings == ["key header.stamp", "index on orientation.w"]
    assert rosCas.getAllTopics() == []


@pytest.mark.parametrize(
    ("msg_type", "said"),
    [
        ("geometry_msgs/Twist", "did you mean linear?"),
        ("no_such_pkg/Type", ""),  # its messages bring their definition
        ("*", ""),
        ("", ""),
    ],
)
def test_a_plan_checks_conditions_against_the_fields_of_known_types(rosCas, msg_type, said):
    settings = settings_of("topics: [{pattern: /a, where: liner.x > 1}]")
    (planned,) = plan_topics(rosCas.catalog, settings, {"/a": msg_type})
    assert bool(planned.problem) == bool(said)
    assert said in planned.problem
    fitting = settings_of("topics: [{pattern: /a, where: 'linear.x > 1 and KEY > 0'}]")
    assert plan_topics(rosCas.catalog, fitting, {"/a": msg_type})[0].problem == ""


def test_a_plan_checks_conditions_on_a_topic_that_is_stored_and_not_published(rosCas):
    rosCas.addTopic("/n").addData(Int32(1))
    settings = recording_settings(RecorderOptions(where=[("/n", "date > 3")]))
    (planned,) = plan_topics(rosCas.catalog, settings, {"/n": ""})
    assert "/n" in planned.problem
    assert "did you mean data?" in planned.problem


def test_ttl_of_a_command_line():
    parser = make_parser()
    ttls = [parser.parse_args(["/a", f"--ttl={text}"]).ttl for text in ("0", "60", "90m", "7d")]
    assert ttls == [0, 60, 5400, 604800]
