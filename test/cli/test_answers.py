# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Verbs answer other programs in JSON, and take topics by name or by regular expression."""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from pathlib import Path

import pytest
from bag.truth import string_connection, string_wire
from std_msgs.msg import Int64

from cassandra_ros.cli.json_answer import plain
from cassandra_ros.cli.terminal_text import sparkline
from cassandra_ros.cli.topic_options import add_topics_option, topics_among
from cassandra_ros.errors import InvalidOption, TopicNotFound
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.store.tables.registry import LossKind

HUSKY = Path(__file__).resolve().parents[2] / "examples/data/husky_gps_data.bag"


@pytest.fixture
def three_topics(call, tmp_path):
    """Import a bag of /cam/left, /cam/right and /tf, 6 messages in all; return its path."""
    path = tmp_path / "three.bag"
    with BagWriter(path) as writer:
        names = ("/cam/left", "/cam/right", "/tf")
        numbers = [writer.connection(string_connection(name)) for name in names]
        for n in range(6):
            writer.write(numbers[n % 3], 10**18 + n * 10**9, string_wire(str(n)))
    assert call("import", path, "-q") == (0, "", "")
    return path


def test_list_and_info(call, three_topics):
    status, out, err = call("list", "--json")
    assert (status, err) == (0, "")
    found = json.loads(out)
    assert [row["topic"] for row in found] == ["/cam/left", "/cam/right", "/tf"]
    assert found[0] == {"topic": "/cam/left", "type": "std_msgs/String", "format": "ros"}
    for words in (["/cam/.*"], ["-e", "/cam/.*"]):
        assert len(json.loads(call("list", "--json", *words)[1])) == 2
    assert len(json.loads(call("list", "--json", "/cam/.*", "-e", "/tf")[1])) == 3
    assert call("list", "--json", "/none")[:2] == (0, "[]\n")

    found = json.loads(call("info", "--json")[1])
    assert [(t["topic"], t["messages"], t["first_ns"]) for t in found["topics"]] == [
        ("/cam/left", 2, 10**18),
        ("/cam/right", 2, 10**18 + 10**9),
        ("/tf", 2, 10**18 + 2 * 10**9),
    ]
    run = found["runs"][0]
    assert (run["name"], run["stored"]["/tf"]) == ("three.bag", 2)
    assert datetime.fromisoformat(run["started"].replace("Z", "+00:00")).tzinfo is not None

    for words in (["-e", "/cam/.*"], ["/cam/(left|right)", "--regex"], ["cam/left", "/cam/right"]):
        found = json.loads(call("info", "--json", *words)[1])
        assert [t["topic"] for t in found["topics"]] == ["/cam/left", "/cam/right"]


def test_info_draws_how_many_messages_came_when(call, three_topics):
    activity = json.loads(call("info", "--json", "-k", "activity")[1])
    lanes = {each["topic"]: each["messages"] for each in activity["topics"]}
    assert (activity["start_ns"], len(lanes["/tf"])) == (10**18, 60)
    assert {topic: sum(counts) for topic, counts in lanes.items()} == dict.fromkeys(lanes, 2)
    behind = 3 * 10**9 // activity["step_ns"]
    assert [n for n, count in enumerate(lanes["/cam/left"]) if count] == [0, behind]
    lines = call("info", "-v", "-e", "/cam/.*")[1].splitlines()
    head = next(n for n, line in enumerate(lines) if line.startswith("activity of"))
    assert lines[head].endswith("2001-09-09T01:46:40Z to 2001-09-09T01:46:44Z")
    assert lines[head + 1].split() == ["/cam/left", "-", "█", "█"]
    assert len(lines) == head + 3
    assert "activity" not in call("info", "-y")[1]


def test_info_folds_decades_in_which_nothing_lies(call, tmp_path):
    """The robot's clock was not set at first: five messages of 1970, five of 2026."""
    path, later = tmp_path / "clock.bag", 1_767_225_600
    with BagWriter(path) as writer:
        number = writer.connection(string_connection("/cam"))
        other = writer.connection(string_connection("/late"))
        for second in (*range(5, 10), *range(later, later + 5)):
            writer.write(number, second * 10**9, string_wire("x"))
        writer.write(other, (later + 2) * 10**9, string_wire("x"))
    assert call("import", path, "-q") == (0, "", "")
    lines = call("info", "-v")[1].splitlines()
    told = "duration:  56.0 years (1767225599s); without pauses of ten years or more 8.0s"
    assert told in lines
    head = next(n for n, line in enumerate(lines) if line.startswith("activity of"))
    first = "1970-01-01T00:00:05Z to 1970-01-01T00:00:09Z"
    assert lines[head].endswith(f"{first} // 2026-01-01T00:00:00Z to 2026-01-01T00:00:04Z")
    column = lines[head].index(first)
    early, late = lines[head + 1][column:].split(" // ")
    assert (early.count("█"), late.count("█")) == (5, 5)
    assert len(early) == 30
    early, late = lines[head + 2][column:].split(" // ")
    assert (early.strip(), late.strip()) == ("", "█")


def test_a_line_of_bars():
    assert sparkline([0, 1, 4, 8], "utf-8") == " ▁▄█"
    assert sparkline([0, 1, 4, 8], "ascii") == sparkline([0, 1, 4, 8], None) == " .=@"
    assert sparkline([0, 0], "utf-8") == "  " and sparkline([], "utf-8") == ""
    assert sparkline([1e-9, 1e9], "latin-1") == ".@"


def test_indexes_and_which_is_not_finished(call, rosCas, three_topics):
    assert json.loads(call("index", "--list", "--json")[1]) == []
    assert call("index", "--list")[1] == "there is no index\n"
    # A table whose writer was killed before it was filled.
    rosCas.catalog.keyspace.indexes.add_index("/tf", "data", lambda metadata: "text")
    status, out, _ = call("index", "--list", "/tf")
    lines = out.splitlines()
    assert (status, lines[1].split()) == (0, ["/tf", "data", "2", "2", "not", "finished"])
    assert "cassandra_bag index TOPIC FIELD" in lines[2]
    (answer,) = json.loads(call("index", "tf", "data", "--json")[1])
    assert answer == {"topic": "/tf", "field": "data", "removed": False, "messages": 2}
    (state,) = json.loads(call("index", "--list", "--json")[1])
    assert (state["missing"], state["finished"]) == (0, True)
    assert "not finished" not in call("index", "--list")[1]
    text = "index on data of topic {}: 2 stored messages were taken in\n"
    expected = text.format("/cam/left") + text.format("/cam/right")
    assert call("index", "-e", "/cam/.*", "data") == (0, expected, "")
    assert call("index", "/cam/left", "data", "--remove")[1].endswith("/cam/left removed\n")
    assert call("index", "--list")[1].count("\n") == 3
    status, out, _ = call("query", "SELECT data FROM /tf WHERE data = '2'", "--json")
    assert json.loads(out) == [{"data": "2"}]
    asked = "SELECT data FROM /tf WHERE data = '2'"
    found = json.loads(call("query", asked, "--json", "--explain")[1])
    assert (found["topic"], found["rows_returned"]) == ("/tf", 1)


@pytest.mark.suite("all", "it waits for seconds")
def test_convert_and_roles(call, three_topics):
    status, out, _ = call("convert", "-e", "/cam/.*", "--format", "packed", "--json")
    assert status == 0
    assert [(r["topic"], r["messages"]) for r in json.loads(out)] == [
        ("/cam/left", 2),
        ("/cam/right", 2),
    ]
    found = json.loads(call("roles", "--json")[1])
    assert all(text.startswith(("CREATE", "GRANT")) for text in found["statements"])


def test_what_no_topic_matches(call, three_topics):
    status, out, err = call("info", "--json", "-e", "/cam")
    assert (status, out, err.count("\n")) == (1, "", 1)
    assert "matches '/cam': an expression must match the whole name" in err
    assert "with -e (--regex) they are regular expressions" in call("info", "/cam/.*")[2]
    assert "not a regular expression" in call("info", "-e", "/cam/(")[2]


def test_topics_of_a_file():
    parser = argparse.ArgumentParser()
    add_topics_option(parser, "FILE")

    def chosen(*words):
        return topics_among(parser.parse_args(words), {"/a", "/b", "/bb"}, "x.bag")

    assert chosen() is None
    assert chosen("-e", "/b+") == ["/b", "/bb"]
    assert chosen("-e", "/a", "--topics", "b", "c", "-e", "/b") == ["/a", "/b", "b", "c"]
    for words, error in ((["-e", "b"], TopicNotFound), (["-e", "*"], InvalidOption)):
        with pytest.raises(error):
            chosen(*words)


def test_values_of_an_answer():
    @dataclass
    class Part:
        kind: LossKind
        when: datetime

    zone = timezone(timedelta(hours=2))
    kind = next(iter(LossKind))
    naive = plain(Part(kind, datetime(2026, 1, 2, 3, 4, 5)))
    assert naive == {"kind": kind.value, "when": "2026-01-02T03:04:05Z"}
    assert plain(datetime(2026, 1, 2, 3, tzinfo=zone)) == "2026-01-02T01:00:00Z"
    found = plain({1: (math.nan, math.inf, 2.5), "b": b"\0\xff", "c": {"x"}})
    assert found == {"1": [None, None, 2.5], "b": "AP8=", "c": ["x"]}
    with pytest.raises(TypeError):
        plain(object())


def test_the_index_of_places(call):
    assert call("import", HUSKY, "-q", "--topics", "/encoder", "/fix") == (0, "", "")
    assert "not indexed" in call("index", "--places", "--list")[1]
    (made,) = json.loads(call("index", "--places", "--run", HUSKY.name, "--json")[1])
    assert (made["state"], made["node"]) == ("indexed", "")
    assert made["visits"] > 3
    status, out, _ = call("index", "--places", "--list")
    assert (status, out.splitlines()[1].split()[-1]) == (0, "indexed")
    query = "select count(*) from /fix where NEAR(-4.5, 3, 1, 'odom_combined')"
    assert call("query", query, "--output", "csv")[1].split() == ["count(*)", "10"]
    assert call("index", "--places", "/fix")[0] == 2
    assert call("index", "/fix", "altitude", "--run", "x")[0] == 2


def test_nothing_is_drawn_of_what_was_deleted(rosCas, call):
    topic = rosCas.addTopic("/t", msg_type="std_msgs/Int64")
    for n in range(20):
        topic.addData(Int64(n), key=10**18 + n * 10**9)
    topic.removeData(10**18 + 10 * 10**9, 10**18 + 100 * 10**9)
    found = json.loads(call("info", "--json")[1])
    (lane,) = found["activity"]["topics"]
    assert sum(lane["messages"]) == pytest.approx(found["messages"]) == 10
    assert found["activity"]["start_ns"] == found["start_ns"]
    topic.removeData(0, 2 * 10**18)
    status, out, err = call("info")
    assert (status, err) == (0, "")
    assert "messages:  0 of 1 topic" in out and "activity" not in out
