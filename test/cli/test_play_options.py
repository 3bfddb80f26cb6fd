# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Each option of the player's command line is what Player gets."""

from __future__ import annotations

import dataclasses
from decimal import Decimal

import pytest

from cassandra_ros.cli.options import without_empty
from cassandra_ros.cli.player import make_parser, read_options, read_selection
from cassandra_ros.playing.play_options import PlayerOptions
from cassandra_ros.playing.play_selection import PlaySelection

HIT = "/cmd_vel: linear.x > 0.5"
PAIR = ("/cmd_vel", "linear.x > 0.5")


EXACT = Decimal("10000000.123456789")
"""Seconds that a float does not hold to the ns."""


def changed(line):
    """Return what a command line changes of the defaults."""
    options = make_parser().parse_args(line)
    found = {}
    for value, plain in (
        (read_selection(options), PlaySelection()),
        (read_options(options), PlayerOptions()),
    ):
        for field in dataclasses.fields(plain):
            new, old = getattr(value, field.name), getattr(plain, field.name)
            if new != old and (new or old):
                found[field.name] = new
    return found


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ([], {}),
        (["/a", "/b"], {"topics": ["/a", "/b"]}),
        (["--topics", "/a", "/b"], {"topics": ["/a", "/b"]}),
        (["-e", "/a.*"], {"topics": ["/a.*"], "regex": True}),
        (["-x", "/b.*"], {"exclude": ["/b.*"]}),
        (["--exclude", "/b.*"], {"exclude": ["/b.*"]}),
        (["-x", "/b.*", "-x", "/c"], {"exclude": ["/b.*", "/c"]}),
        (["-s", "12.5"], {"start": "12.5"}),
        (["--start", "2013-05-08T14:06:20Z"], {"start": "2013-05-08T14:06:20Z"}),
        (["-u", "90"], {"duration": 90.0}),
        (["--duration", "1.5m"], {"duration": 90.0}),
        (["--end", "20"], {"end": "20"}),
        (["--run", "monday"], {"run": "monday"}),
        (["--node-id", "r1"], {"nodeID": "r1"}),
        (["--where", HIT], {"where": dict([PAIR])}),
        (["--around", HIT], {"around": PAIR}),
        (["--before", "2", "--after", "0.5"], {"before": 2.0, "after": 0.5}),
        (["--before", "10000000.123456789"], {"before": EXACT}),
        (["-u", "10000000.123456789"], {"duration": EXACT}),
        (["--align-start"], {"align_start": True}),
        (["--align-nodes"], {"align_start": "node"}),
        (["--node-prefix"], {"node_prefix": True}),
        (["-p", "/old"], {"prefix": "/old"}),
        (["--prefix", "/old"], {"prefix": "/old"}),
        (["-r", "0.5"], {"rate": 0.5}),
        (["--rate", "4"], {"rate": 4.0}),
        (["-i"], {"immediate": True}),
        (["--immediate"], {"immediate": True}),
        (["--pause"], {"paused": True}),
        (["--pause-topics", "/a", "/b"], {"pause_topics": ["/a", "/b"]}),
        (["--skip-empty", "3"], {"skip_empty": 3.0}),
        (["-l"], {"loop": True}),
        (["--loop"], {"loop": True}),
        (["-k"], {"keep_alive": True}),
        (["--keep-alive"], {"keep_alive": True}),
        (["-d", "0"], {"delay": 0.0}),
        (["--delay", "2"], {"delay": 2.0}),
        (["--wait-for-subscribers"], {"wait_for_subscribers": True}),
        (["--rate-control-topic", "/out"], {"rate_control_topic": "/out"}),
        (["--rate-control-max-delay", "0.25"], {"rate_control_max_delay": 0.25}),
        (["--read-ahead", "8"], {"read_ahead": 8 << 20}),
        (["--queue", "7"], {"queue": 7}),
        (["--clock"], {"clock_hz": 100.0}),
        (["--clock", "--hz", "25"], {"clock_hz": 25.0}),
    ],
    ids=str,
)
def test_an_option_is_what_the_player_gets(line, expected):
    assert changed(line) == expected


def test_options_that_a_launch_file_gives_empty_are_not_given():
    words = ["/a", "--start=", "--run=x", "--node-id=", "--where", "--end=="]
    assert without_empty(words) == ["/a", "--run=x", "--where", "--end=="]


@pytest.mark.parametrize("line", [["-r", "0"], ["-r", "fast"], ["-u", "x"], ["--queue", "-1"]])
def test_wrong_values_end_with_usage(line, capsys):
    with pytest.raises(SystemExit) as ended:
        changed(line)
    assert ended.value.code == 2
    assert line[1] in capsys.readouterr().err
