# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Names from outside: nothing that a terminal acts on is printed, and tables stay narrow."""

from __future__ import annotations

import logging

import genpy
import pytest
from std_msgs.msg import String

from cassandra_ros.arguments import MAX_NAME_BYTES
from cassandra_ros.cli.recorder_report import closing_table
from cassandra_ros.cli.terminal_text import format_table
from cassandra_ros.errors import InvalidName, InvalidOption
from cassandra_ros.printable import MOST_CHARACTERS, shown, shown_lines
from cassandra_ros.recording.losses import LossTotal
from cassandra_ros.recording.option_values import read_label
from cassandra_ros.recording.recorder_options import RecorderOptions
from cassandra_ros.recording.run_series import RunSeries
from cassandra_ros.recording.topic_counts import TopicReport
from cassandra_ros.store.tables.registry import LossKind, Run

EVIL = "\x1b]0;owned\x07\nfake line\r\x9b31m\u202e"
"""A terminal's title, a line of its own, a colour by C1, text from right to left."""
TOPIC = f"/a{EVIL}"
NODE = f"r{EVIL}"
LONG = "x" * 100_000
T0 = 1_700_000_000 * 10**9


@pytest.fixture
def stored(rosCas):
    """A topic, a robot, a run and labels with such names; the run has a loss."""
    run = Run(NODE, 5, "recording", name=f"run{EVIL}", source=EVIL, labels={f"k{EVIL}": EVIL})
    with rosCas.messageWriter(writer_id=5, nodeID=NODE, run=run):
        pass
    topic = rosCas.addTopic(TOPIC, msg_type="std_msgs/String", nodeID=NODE)
    topic.addData(String(EVIL), key=genpy.Time(0, T0 % 10**9) + genpy.Duration(T0 // 10**9))
    return rosCas


WORDS = [
    ["list"],
    ["info"],
    ["info", "-y"],
    ["info", "--json"],
    ["runs", "--json"],
    ["info", "--freq", TOPIC],
    ["runs"],
    ["cat", TOPIC],
    ["meta", TOPIC],
    ["query", f'select KEY, NODE, data from "{TOPIC}"'],
    ["query", f'select data from "{TOPIC}"', "--explain"],
    ["query", f'select nothing from "{TOPIC}"'],
    ["query", f"select data from '{EVIL}'"],
    ["index", TOPIC, "data"],
    ["index", "--list"],
    ["index", "--places", "--list"],
    ["check"],
    ["delete", TOPIC, "--dry-run"],
    ["delete", "--run", f"run{EVIL}", "--yes"],
    ["delete", TOPIC, "--messages", "--dry-run"],
    ["convert", TOPIC, "--format", "json"],
    ["plot", TOPIC, "data", "-o", "/dev/null"],
    ["thumbs", TOPIC],
    ["cat", f"/absent{EVIL}"],
    ["info", "--run", EVIL],
    ["info", "--node-id", EVIL],
    ["rename", TOPIC, f"/b{EVIL}"],
]


def unsafe(text):
    """Return what of a text is not a line break and not printable."""
    return {c for c in text if not (c.isprintable() or c in "\n\t")}


@pytest.mark.suite("all", "it types each verb with many names")
def test_no_verb_prints_what_a_terminal_acts_on(stored, call, keyspace):
    for words in WORDS:
        status, out, err = call(*words, keyspace=stored.keyspace)
        assert status in (0, 1, 2), (words, status)
        # YAML leaves as it is what other scripts than ours write.
        told = out.replace("\u202e", "") if words[0] == "meta" or "-y" in words else out
        assert not unsafe(told + err), (words, out, err)
        # A message and a statement have lines of their own, a table has none of its names'.
        if words[0] not in ("cat", "query", "meta") and "-y" not in words:
            lines = [line.strip() for line in out.splitlines()]
            assert not [line for line in lines if line.startswith("fake")], (words, out)


def test_a_warning_is_printed_safely(call, stored, monkeypatch):
    from cassandra_ros.cli.verbs import list_

    def warn(options):
        logging.getLogger("cassandra_ros.topics").warning("topic %s is odd", TOPIC)
        return 0

    monkeypatch.setattr(list_, "run", warn)
    status, out, err = call("list")
    assert (status, out) == (0, "")
    assert err.startswith(r"cassandra_bag: topic /a\x1b]0;owned\x07")
    assert not unsafe(err)


def test_tables_are_bounded_and_safe():
    text = format_table(("topic", EVIL), [(LONG, EVIL), ("b", LONG + EVIL)], right=(EVIL,))
    assert len(text.splitlines()) == 3
    assert max(map(len, text.splitlines())) <= 2 * MOST_CHARACTERS + 2
    assert not unsafe(text)
    kind = LossKind.BUFFER_FULL
    losses = {kind: LossTotal(3, 0, 0, EVIL)}
    report = TopicReport(TOPIC + LONG, (EVIL,), 3, 0, 3, losses, None, 0, 0.0)
    assert not unsafe(closing_table([report]))
    assert max(map(len, closing_table([report]).splitlines())) < 1000


def test_shown_keeps_what_is_printable_and_cuts_what_is_long():
    assert shown("/käse 日本") == "/käse 日本"
    assert shown("a\nb\x1b\ud800") == r"a\nb\x1b\ud800"
    assert shown("y" * 256) == "y" * 256
    assert shown("y" * 257) == "y" * 255 + "…"
    assert len(shown("\x1b" * 10**6)) == 256
    assert shown(LONG, None) == LONG
    assert shown_lines("a\tb\nc\x1b[1m\r") == "a\tb\nc\\x1b[1m\\r"


def test_new_names_have_a_length_that_people_can_read(rosCas):
    fits, longer = "n" * MAX_NAME_BYTES, "n" * (MAX_NAME_BYTES + 1)
    for values in ({"name": longer}, {"labels": {longer: "a"}}, {"labels": {"a": longer}}):
        run = Run("", 7, "api", **values)
        with pytest.raises(InvalidName, match=f"more than {MAX_NAME_BYTES} bytes"):
            rosCas.messageWriter(writer_id=7, run=run)
    with pytest.raises(InvalidName, match="nodeID"):
        rosCas.messageWriter(nodeID=longer)
    with pytest.raises(InvalidName, match="topic"):
        rosCas.addTopic(longer, msg_type="std_msgs/String")
    for label in (f"{longer}=a", f"a={longer}"):
        with pytest.raises((InvalidName, InvalidOption), match="label"):
            read_label(label)
    run = Run("", 8, "api", name=fits, labels={fits: fits})
    with rosCas.messageWriter(writer_id=8, run=run):
        pass
    assert [each.name for each in rosCas.runs()] == [fits]
    # What another client stored under a longer name is still found.
    assert rosCas.info(nodeID=longer) == []


def test_a_split_recording_refuses_a_name_that_its_later_runs_could_not_have(rosCas):
    options = RecorderOptions(all=True, split=True, duration=1, output_name="n" * MAX_NAME_BYTES)
    series = RunSeries(rosCas.catalog, options, lambda: T0, lambda recording: None)
    with pytest.raises(InvalidName, match=r"run\.name"):
        series.begin()
    assert rosCas.runs() == []
