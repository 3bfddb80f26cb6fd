# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the programs say of themselves: help texts with defaults and units, statuses, version."""

from __future__ import annotations

import argparse
import math
import re
import shlex
import subprocess
import sys

import pytest
from conftest import ROOT

from cassandra_ros.cli import (
    cassandra_bag,
    local_cassandra,
    player,
    query_server,
    recorder,
    replicator,
    viewer,
)
from cassandra_ros.cli.parsers import Rare
from cassandra_ros.cli.verbs import GROUPS, VERBS
from cassandra_ros.metadata import SCHEMA_VERSION

PROGRAMS = (cassandra_bag, local_cassandra, player, query_server, recorder, replicator, viewer)
UNITS = re.compile(
    r"\b(seconds?|SECONDS|ns|SEC|MB|KB|Hz|bytes|percent|T|hours?|days?|metres|radians)\b|[0-9][smhdGM]\b"
)
COLUMNS, MOST_ROWS = 80, 100
"""Two screens."""


def parsers(program):
    parser = program.make_parser()
    found = [parser]
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            found += action.choices.values()
    return found


def valued(parser):
    """The actions of a parser that take a value."""
    for action in parser._actions:
        if action.nargs != 0 and not isinstance(action, argparse._SubParsersAction):
            yield action


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda module: module.__name__.split(".")[-1])
def test_every_option_states_its_default(program):
    silent = []
    for parser in parsers(program):
        for action in valued(parser):
            optional = action.option_strings or action.nargs in ("?", "*")
            told = "default" in action.help or "may be repeated" in action.help
            if optional and not action.required and not told:
                silent.append((parser.prog, action.dest, action.help))
    assert silent == []


def test_every_verb_that_answers_does_so_in_json_too():
    options = {
        parser.prog.split()[-1]: {
            text for action in parser._actions for text in action.option_strings
        }
        for parser in parsers(cassandra_bag)[1:]
    }
    silent = ["plot", "rename"]  # what is drawn or done
    assert [verb for verb, known in options.items() if "--json" not in known] == silent


def test_topics_may_be_named_by_regular_expressions():
    verbs = parsers(cassandra_bag)[1:]
    many = [verb for verb in verbs if any(action.dest == "topics" for action in verb._actions)]
    assert len(many) > 8
    assert all("--regex" in verb._option_string_actions for verb in many)


def test_numbers_have_units():
    silent = []
    for parser in parsers(cassandra_bag):
        for action in valued(parser):
            measured = isinstance(action.default, float) or "sec" in str(action.metavar).lower()
            if measured and not UNITS.search(f"{action.metavar} {action.help}"):
                silent.append((parser.prog, action.dest, action.help))
    assert silent == []


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda module: module.__name__.split(".")[-1])
def test_exit_statuses_are_documented(program):
    name = program.__name__.split(".")[-1]
    for parser in parsers(program):
        text = parser.format_help()
        assert "exit status:\n  0    success\n  1    failure" in text, parser.prog
        assert f"each line '{name}: …' on standard error" in text


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda module: module.__name__.split(".")[-1])
def test_a_help_text_fits_two_screens(program, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(COLUMNS))
    for parser in parsers(program):
        lines = parser.format_help().splitlines()
        assert sum(max(1, math.ceil(len(line) / COLUMNS)) for line in lines) <= MOST_ROWS, (
            parser.prog
        )


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda module: module.__name__.split(".")[-1])
def test_options_that_are_needed_rarely_are_shown_by_help_all(program, capsys):
    for parser in parsers(program):
        options = [action for action in parser._actions if action.option_strings]
        rare = {action.option_strings[-1] for action in options if isinstance(action.help, Rare)}
        short = parser.format_help()
        with pytest.raises(SystemExit) as ended:
            parser.parse_args(["--help-all"])
        full = capsys.readouterr().out
        assert ended.value.code == 0
        for action in options:
            option = action.option_strings[-1]
            line = re.compile(rf"^  (-.*, )?{re.escape(option)}(?![\w-])", re.MULTILINE)
            assert line.search(full), (parser.prog, option)
            assert bool(line.search(short)) == (option not in rare), (parser.prog, option)
        note = re.search(rf"^([0-9]+) more .* by {parser.prog} --help-all$", short, re.MULTILINE)
        assert (int(note[1]) if note else 0) == len(rare)
        assert "more option" not in full


def test_verbs_are_shown_in_groups_with_an_example_that_can_be_typed(monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    parser = cassandra_bag.make_parser()
    assert len(VERBS) == len(parser.verbs) <= 24
    text = parser.format_help()
    for group in GROUPS:
        block = next(b for b in text.split("\n\n") if b.startswith(f"{group.title}:\n"))
        lines = [
            f"  {name:<11}{verb.__doc__.splitlines()[0]}" for name, verb in group.verbs.items()
        ]
        assert block.splitlines()[1:] == [*lines, f"  as in: {group.example}"]
        program, *words = shlex.split(group.example)
        assert (program, parser.parse_args(words).verb in group.verbs) == ("cassandra_bag", True)


def test_a_description_fills_the_terminal(monkeypatch):
    for columns in (60, 90):
        monkeypatch.setenv("COLUMNS", str(columns))
        text = cassandra_bag.make_parser().verbs["import"].format_help()
        prose = [line for line in text.split("positional")[0].splitlines() if line[:1] != " "]
        assert columns - 20 < max(map(len, prose)) <= columns - 2
        assert "\n  cassandra_bag import *.bag\n" in text


def test_version_and_wrong_usage_have_one_form():
    def typed(program, *words):
        return subprocess.run(
            [sys.executable, ROOT / "scripts" / program, *words],
            env={"PYTHONPATH": f"{ROOT / 'src'}:/usr/lib/python3/dist-packages"},
            capture_output=True,
            text=True,
            timeout=300,
        )

    version = re.search("<version>(.*)</version>", (ROOT / "package.xml").read_text())[1]
    for program in sorted(path.name for path in (ROOT / "scripts").iterdir()):
        shown = f"{program} {version} (reads and writes keyspaces of schema {SCHEMA_VERSION})\n"
        assert typed(program, "--version").stdout == shown
    done = typed("cassandra_bag", "info", "--no-such")
    assert done.returncode == 2
    last = done.stderr.splitlines()[-1]
    assert last.startswith("cassandra_bag: unrecognized arguments: --no-such")
    assert last.endswith("(see cassandra_bag info --help)")
