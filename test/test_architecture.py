# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The map in doc/architecture.md shows what is there, and stays short; so does doc/internals.md."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "src" / "cassandra_ros"
MAP = (ROOT / "doc" / "architecture.md").read_text(encoding="utf-8")
INTERNALS = (ROOT / "doc" / "internals.md").read_text(encoding="utf-8")
WALKS = dict(re.findall(r"^### (.*)\n\n((?:\d+\. .*\n(?:   .*\n)*)+)", MAP, re.M))
STEPS = [pair for pair in re.findall(r"`([\w/]+\.py)` `([\w.]+)`", MAP) if pair[1][-3:] != ".py"]


def names_in(path):
    """Functions, classes, constants and methods of a file, these as Class.method."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            yield node.name
        if isinstance(node, ast.Assign):
            yield from (target.id for target in node.targets if isinstance(target, ast.Name))
        if isinstance(node, ast.ClassDef):
            yield from (f"{node.name}.{f.name}" for f in node.body if hasattr(f, "name"))


@pytest.mark.parametrize(("path", "name"), STEPS, ids=lambda value: value)
def test_a_step_names_a_file_and_what_is_in_it(path, name):
    assert name in set(names_in(PACKAGE / path)), f"{path} has no {name}"


def test_the_map_is_short():
    """A new maintainer reads it in one sitting."""
    assert len(MAP.encode()) <= 15_000
    walks = MAP.split("## Five walks")[1].split("\n## ")[0]
    assert re.findall(r"^### (.*)$", walks, re.M) == list(WALKS)
    assert len(WALKS) == 5
    for title, steps in WALKS.items():
        assert len(re.findall(r"^\d+\. ", steps, re.M)) <= 10, title


def test_every_room_is_on_the_map():
    table = MAP.split("## The rooms")[1].split("## ")[0]
    first_column = "".join(line.split("|")[1] for line in table.splitlines() if "|" in line)
    rooms = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert set(re.findall(r"`(\w+)/`", first_column)) == rooms
    files = {p.name for p in PACKAGE.glob("*.py")} - {"__init__.py"}
    assert set(re.findall(r"`(\w+\.py)`", first_column)) == files
    picture = MAP.split("```text")[1].split("```")[0]
    assert {word for word in re.findall(r"[a-z_]+", picture) if word in rooms} == rooms


@pytest.mark.parametrize("page", [MAP, INTERNALS], ids=["architecture", "internals"])
def test_every_file_on_the_page_exists(page):
    names = re.findall(r"`((?:\w+/)*\w+\.(?:py|lark))`", page)
    assert len(names) > 20
    for name in names:
        assert (PACKAGE / name).is_file() or (ROOT / name).is_file(), name


@pytest.mark.parametrize("folder", ["src", "benchmark", "examples", "test"])
def test_docstrings_begin_with_a_noun_or_a_verb(folder):
    """None begins with "Of" or "So many", or says that there "is none"."""
    riddle = re.compile(r'(?:"""(?:Of|So (?:many|much|long|often)) )|there (?:is|are) none\b')
    files = [p for p in (ROOT / folder).rglob("*.py") if p.name != Path(__file__).name]
    assert len(files) > 10
    found = [p.name for p in files if riddle.search(p.read_text(encoding="utf-8"))]
    assert found == []
