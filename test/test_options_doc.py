# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""doc/play.md and doc/record.md have a row for every option, rosbag's and ours; each has a test."""

from __future__ import annotations

import ast
import importlib.util
import os
import re
import subprocess
from pathlib import Path

import pytest

from cassandra_ros.cli import player, recorder

ROOT = Path(__file__).resolve().parents[1]
PARSERS = {"play": player.make_parser, "record": recorder.make_parser}
# Options of programs of rosbag other than its front end in this version: see doc/record.md.
LATER = {"-L", "--min-space", "-s", "--snapshot"}
TESTS = ROOT / "test/options.md"
KINDS = {"keep", "adapt", "drop", "ours"}
OPTION = re.compile(r"(?<![\w-])(--?[A-Za-z][\w-]*)")


def rows(name):
    """The rows of the tables: (options, kind, what it does)."""
    for line in (ROOT / "doc" / f"{name}.md").read_text(encoding="utf-8").splitlines():
        if line.startswith("| ") and not line.startswith(("| option", "| ---")):
            cells = [cell.strip() for cell in line.strip("|").split(" | ")]
            assert len(cells) == 3, line
            yield (set(re.findall(r"`(-[^`]*)`", cells[0])), *cells[1:])


def options_of_rosbag(verb, env):
    done = subprocess.run(
        ["rosbag", verb, "-h"], env=env, capture_output=True, text=True, check=True, timeout=300
    )
    lines = [line for line in done.stdout.splitlines() if re.match(r" {2}-", line)]
    return {option for line in lines for option in OPTION.findall(re.split(r"\s{2,}", line[2:])[0])}


@pytest.mark.parametrize("name", PARSERS)
def test_every_option_has_a_row(name, ros_env):
    theirs = options_of_rosbag(name, ros_env)
    assert {"-h", "--help", "-q"} <= theirs
    theirs |= LATER if name == "record" else set()
    ours = {text for action in PARSERS[name]()._actions for text in action.option_strings}
    kinds = {option: kind for options, kind, _ in rows(name) for option in options}
    assert set(kinds) == theirs | ours
    assert set(kinds.values()) <= KINDS
    # What is dropped or only like theirs may have another name; the rest is what it says.
    assert {option for option, kind in kinds.items() if kind == "keep"} <= theirs
    assert {option for option, kind in kinds.items() if kind == "ours"} <= ours - theirs
    assert {option for option, kind in kinds.items() if kind in ("keep", "ours")} <= ours


@pytest.mark.parametrize(("name", "program"), [("play", "player"), ("record", "recorder")])
def test_every_option_has_a_test_that_exists(name, program):
    known, tested = {}, set()
    for line in TESTS.read_text(encoding="utf-8").splitlines():
        if line.startswith(f"| {program} | "):
            _, options, test = line.strip("| ").split(" | ")
            tested.update(re.findall(r"`(-[^`]*)`", options))
            named = re.findall(r"`([\w/]+\.py)::(\w+)`", test)
            assert named, options
            for path, function in named:
                if path not in known:
                    tree = ast.parse((ROOT / "test" / path).read_text(encoding="utf-8"))
                    known[path] = {n.name for n in tree.body if isinstance(n, ast.FunctionDef)}
                assert function in known[path], (options, path, function)
    assert tested == {option for options, _, what in rows(name) for option in options if what}


def test_pages_and_launch_files_have_the_options_of_the_parsers(monkeypatch):
    for name in [name for name in os.environ if name.startswith("CASSANDRA_ROS_")]:
        monkeypatch.delenv(name)
    spec = importlib.util.spec_from_file_location("option_tables", ROOT / "doc/option_tables.py")
    option_tables = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(option_tables)
    for path, text in option_tables.texts().items():
        assert path.read_text(encoding="utf-8") == text, f"{path.name}: run make doc"
