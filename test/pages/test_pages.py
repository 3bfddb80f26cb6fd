# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The pages of doc/ and the README: what they must name, and that they read the code aright.

make doc, a part of make lint, builds them and takes a warning, as of a broken link, for an error.
"""

from __future__ import annotations

import argparse
import importlib
import re
import sys
import xml.etree.ElementTree as ElementTree

import pytest
from conftest import ROOT

import cassandra_ros
from cassandra_ros.cli import (
    cassandra_bag,
    local_cassandra,
    player,
    query_server,
    recorder,
    viewer,
)
from cassandra_ros.nodes import query_node, recorder_services
from cassandra_ros.viewing.routes import ROUTES

sys.path.insert(0, str(ROOT / "doc"))

import directives  # noqa: E402

PROGRAMS = (cassandra_bag, local_cassandra, player, query_server, recorder, viewer)


def page(name):
    return (ROOT / "doc" / f"{name}.md").read_text(encoding="utf-8")


def test_the_readme_is_what_a_newcomer_needs():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 200
    assert ".venv/bin/python" in text.split("**Which Python?**")[1].split("\n\n")[0]
    linked = re.findall(r"\]\(([\w./-]+)", text)
    assert {"doc/tutorial.md", "doc/track.png", ".github/CONTRIBUTING.md"} <= set(linked)
    for name in linked:
        assert (ROOT / name).is_file(), name


def test_every_page_is_in_the_table_of_contents():
    listed = re.findall(r"^(\w+)$", page("index"), re.M)
    pages = {path.stem for path in (ROOT / "doc").glob("*.md")} - {"index"}
    assert sorted(listed) == sorted(pages)


@pytest.mark.parametrize("path", sorted((ROOT / "doc").glob("*.md")), ids=lambda path: path.stem)
def test_every_page_says_first_for_whom_it_is(path):
    text = path.read_text(encoding="utf-8")
    included = re.search(r"^```{include} (.*)$", text, re.M)
    if included:
        text = (path.parent / included[1]).read_text(encoding="utf-8")
    first = text.split("\n# ")[1].split("\n\n")[1].splitlines()[:3]
    assert re.search(r"(^|[.:] )For [a-z]", " ".join(first)), first


def test_lint_builds_the_pages_and_takes_warnings_for_errors():
    text = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert re.search(r"^lint:.* doc\b", text, re.M)
    assert re.search(r"^doc: .*\n(?:\t.*\n)*\t.*-m sphinx .*-W .* doc build/doc$", text, re.M)


def test_the_makefile_has_the_targets_that_are_named():
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M)
    places = [ROOT / "README.md", *ROOT.glob(".github/*.md"), *ROOT.glob("doc/*.md")]
    texts = [path.read_text(encoding="utf-8") for path in places]
    named = {name for text in texts for name in re.findall(r"(?:^|`)make ([a-z-]+)", text, re.M)}
    assert {"setup", "test-all", "bench"} <= named <= set(targets)


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda module: module.__name__.split(".")[-1])
def test_the_command_line_shows_each_option_of_each_verb(program):
    name = program.__name__.split(".")[-1]
    assert f"```{{command-line}} {name}\n" in page("command_line")
    parser = program.make_parser()
    verbs = directives.subparsers(parser)
    assert set(verbs) == set(getattr(program, "VERBS", ()))
    for each in (parser, *verbs.values()):
        shown = {text for _, rows in directives.option_rows(each) for text, _ in rows}
        for action in each._actions:
            if action.help is not argparse.SUPPRESS:
                for option in action.option_strings:
                    assert any(option in re.split(r"[ ,]+", text) for text in shown), option


def test_cassandra_bag_is_typed_the_same_way_everywhere():
    texts = [*ROOT.glob("*.md"), *ROOT.glob("doc/*.md"), *ROOT.glob("src/**/*.py")]
    texts += [*ROOT.glob("examples/*.py"), *ROOT.glob("web/**/*.js")]
    assert len(texts) > 300
    for path in texts:
        typed = re.search(
            r"rosrun\s+cassandra_ros\s+cassandra_bag", path.read_text(encoding="utf-8")
        )
        assert typed is None, f"{path}: cassandra_bag is on PATH: type it without rosrun"


def test_texts_are_shown_as_they_are():
    nodes = directives.paragraphs("Take *.bag | what `-e` says.\n\n    $ import *.bag\n\nEnd.")
    assert [node.tagname for node in nodes] == ["paragraph", "literal_block", "paragraph"]
    assert nodes[0].astext() == "Take *.bag | what -e says."
    assert [child.tagname for child in nodes[0].children] == ["#text", "literal", "#text"]


@pytest.mark.parametrize("path", [*ROOT.glob("srv/*.srv"), *ROOT.glob("msg/*.msg")], ids=str)
def test_every_field_of_services_and_messages_is_shown_with_its_comment(path):
    head, lines = directives.interface(path)
    assert head.endswith("."), head
    module = importlib.import_module(f"cassandra_ros.{path.suffix[1:]}")
    made = getattr(module, path.stem)
    classes = [made] if path.suffix == ".msg" else [made._request_class, made._response_class]
    shown = [line.text.split()[1] for line in lines if line.text != "---" and "=" not in line.text]
    assert shown == [name for each in classes for name in each.__slots__]
    for line in lines:
        assert line.comment or "=" in line.text or line.text == "---" or "bool loop", line


def test_every_service_is_in_the_tables_of_the_page():
    text = page("services")
    for path in ROOT.glob("srv/*.srv"):
        assert f"[{path.stem}](#srv-{path.stem.lower()})" in text, path.stem
    nodes = "".join(path.read_text(encoding="utf-8") for path in ROOT.glob("src/*/nodes/*.py"))
    offered = set(re.findall(r'"(~\w+)", [A-Z]', nodes))
    assert {"~seek", "~setRate"} <= offered
    tables = (query_node.SERVICES, recorder_services.TOPIC_SERVICES)
    for table in (*tables, recorder_services.OTHER_SERVICES):
        offered |= {f"~{name}" for name in table}
    for name in offered:
        assert f"`{name}`" in text, name


@pytest.mark.parametrize("path", list(ROOT.glob("launch/*.launch")), ids=lambda path: path.name)
def test_every_argument_of_a_launch_file_says_what_it_is(path):
    assert f"```{{launch-arguments}} {path.name}\n" in page("parameters")
    arguments = ElementTree.parse(path).getroot().findall("arg")  # noqa: S314 (our own file)
    said = {arg.get("name") for arg in arguments if arg.get("doc")}
    assert {arg.get("name") for arg in arguments if "default" in arg.attrib} <= said


def test_every_variable_of_the_environment_is_listed():
    text = "".join(path.read_text(encoding="utf-8") for path in ROOT.glob("src/**/*.py"))
    for name in set(re.findall(r'"((?:CASSANDRA_ROS|SSL)_[A-Z]+)"', text)):
        assert f"`{name}`" in page("parameters"), name


def test_every_public_name_is_on_the_page_of_the_python_api():
    for name in cassandra_ros.__all__:
        assert re.search(rf"cassandra_ros\.{name}\b", page("python")), name


def test_every_path_of_the_viewer_is_on_its_page():
    assert "```{api-routes}\n" in page("viewer")
    (found,) = directives.ApiRoutes.run(Unplaced())
    shown = found.astext()
    for route in ROUTES:
        assert f"GET {route.path}\n" in shown
        for parameter in route.parameters:
            assert parameter.summary in shown


class Unplaced:
    """Stands for a directive on no page."""

    def depends_on(self, path):
        assert path.is_file()
