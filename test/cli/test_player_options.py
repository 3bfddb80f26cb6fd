# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The command line of the player: what it reads, and what it says of what makes no sense."""

from __future__ import annotations

import sys

import pytest
from std_msgs.msg import Int32

from cassandra_ros.cli import player
from cassandra_ros.cli.options import strip_remappings
from cassandra_ros.errors import CassandraRosError

SEC = 10**9
T0 = 1_405_015_391 * SEC


@pytest.fixture(scope="module")
def store(fresh):
    with fresh() as rosCas:
        for name in ("/scan", "/scan_2"):
            topic = rosCas.addTopic(name)
            for n in range(3):
                topic.addData(Int32(n), key=T0 + n * SEC)
        yield rosCas


def read(*words):
    options = player.make_parser().parse_args(strip_remappings(words))
    return player.read_selection(options), player.read_options(options)


def test_the_options_of_rosbag_play_mean_the_same():
    selection, options = read(
        *("--topics", "/a", "/b", "-p", "/old", "-s", "1.5", "-u", "2m", "/c:=/d"),
        *("-q", "-i", "--pause", "--queue", "7", "--clock", "--hz", "50", "-d", "0", "-r", "2"),
        *("--skip-empty", "3", "-l", "-k", "--pause-topics", "/e", "--wait-for-subscribers"),
        *("--rate-control-topic", "/f", "--rate-control-max-delay", "0.5"),
    )
    assert (selection.topics, selection.prefix) == (["/a", "/b"], "/old")
    assert (selection.start, selection.duration) == ("1.5", 120.0)
    assert (options.immediate, options.paused, options.loop, options.keep_alive) == (True,) * 4
    assert (options.queue, options.clock_hz, options.delay, options.rate) == (7, 50.0, 0.0, 2.0)
    assert (options.skip_empty, options.pause_topics) == (3.0, ["/e"])
    assert options.wait_for_subscribers
    assert (options.rate_control_topic, options.rate_control_max_delay) == ("/f", 0.5)


def test_the_defaults_are_those_of_rosbag_play():
    selection, options = read()
    assert selection.topics is None
    assert (options.queue, options.clock_hz, options.delay, options.rate) == (100, 0.0, 0.2, 1.0)
    assert options.rate_control_max_delay == 1.0


def test_conditions_and_windows_are_read():
    around = "/fix: status.status = 1 AND data != 'a:=b'"
    selection, _ = read("/x", "--where", "/x: data > 1", "--around", around, "--before", "1m")
    assert selection.where == {"/x": "data > 1"}
    assert selection.around == ("/fix", "status.status = 1 AND data != 'a:=b'")
    assert (selection.before, selection.after) == (60.0, 10.0)


WRONG = {
    ("/scann",): "/scan",
    ("-e", "/scan.*("): "not a regular expression",
    ("-e", "/nothing.*"): "no topic in keyspace",
    ("-x", ".*"): "leaves none",
    ("-s", "yesterday"): "not a time to play",
    ("-s", "2000-01-01T00:00:00Z"): "lies before all selected messages",
    ("-s", "100"): "lies after all selected messages",
    ("--end", "2014-07-10T18:03:11Z", "-s", "1"): "lies before the start",
    ("--end", "1", "-u", "1"): "an end and a duration",
    ("--where", "/scan: data >"): "data >",
    ("--where", "/scan: date > 1"): "data",
    ("--around", "/nope: data > 1"): "/nope",
    ("--node-id", "r2"): "no message of node 'r2'",
    ("--run", "monday"): "monday",
    ("-p", "/has space"): "not a name",
}


@pytest.mark.parametrize("words", WRONG, ids=" ".join)
def test_what_makes_no_sense_says_why(store, cassandra, monkeypatch, words):
    where = ("--host", cassandra.host, "--port", str(cassandra.port), "--keyspace", store.keyspace)
    monkeypatch.setattr(sys, "argv", ["player", *where, *words])
    with pytest.raises((CassandraRosError, SystemExit)) as caught:
        player.main()
    assert not isinstance(caught.value, SystemExit)
    assert WRONG[words] in str(caught.value)


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("-r", "0"), "'0' is not a number above 0"),
        (("-u", "0"), "'0' is not a duration"),
        (("-u", "-3"), "'-3' is not a duration"),
        (("--queue", "x"), "'x' is not a whole number"),
        (("-d", "never"), "is not a number of seconds"),
        (("-x", "("), "not a regular expression"),
        (("--where", "data > 1"), "is not of the form"),
        (("--around", "data > 1"), "is not of the form"),
        (("--hz", "-5"), "'-5' is not a number above 0"),
        (("--hz", "1e9", "--clock"), "clock_hz"),
        (("--rate-control-topic", "/a b"), "rate_control_topic '/a b' is not a name"),
    ],
)
def test_what_cannot_be_read_ends_the_program(words, text, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["player", *words])
    with pytest.raises(SystemExit) as caught:
        player.main()
    assert caught.value.code == 2
    assert text in capsys.readouterr().err
