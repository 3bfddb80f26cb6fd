# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Directives that show what is in the code: command lines, services, messages, parameters, paths.

Texts become nodes as they are: no star or bar in a help text is taken for markup.
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Iterator, NamedTuple, Sequence

from docutils import nodes
from docutils.parsers.rst import Directive

from cassandra_ros.cli.parameters import actions_by_parameter

ROOT = Path(__file__).resolve().parent.parent
_COMMENT = re.compile(r"\s+#\s*")


class Line(NamedTuple):
    """A field or a constant of a service or a message, or '---'."""

    text: str
    comment: str


def spans(text: str) -> list[nodes.Node]:
    """Return a text as nodes, what stands in `backticks` or ``two`` as code."""
    found: list[nodes.Node] = []
    for n, part in enumerate(re.split(r"``?([^`]+)``?", text)):
        if part:
            found.append(nodes.literal(text=part) if n % 2 else nodes.Text(part))
    return found


def paragraphs(text: str) -> list[nodes.Node]:
    """Return the paragraphs of a docstring; indented ones and tables stand as they are."""
    found: list[nodes.Node] = []
    for part in re.split(r"\n\s*\n", inspect.cleandoc(text)):
        lines = part.splitlines()
        if any(line.startswith(("  ", "    ")) or "   " in line.strip() for line in lines):
            found.append(nodes.literal_block(part, part))
        else:
            found.append(nodes.paragraph("", "", *spans(" ".join(part.split()))))
    return found


def table(head: Sequence[str], rows: Sequence[Sequence[str]], code: int = 1) -> nodes.table:
    """Return a table, the first ``code`` columns of which are code."""
    group = nodes.tgroup("", *(nodes.colspec(colwidth=1) for _ in head), cols=len(head))

    def row(cells: Sequence[str], literal: int) -> nodes.row:
        shown = nodes.row()
        for n, cell in enumerate(cells):
            inside = [nodes.literal(text=cell)] if n < literal and cell else spans(cell)
            shown += nodes.entry("", nodes.paragraph("", "", *inside))
        return shown

    group += nodes.thead("", row(head, 0))
    group += nodes.tbody("", *(row(cells, code) for cells in rows))
    return nodes.table("", group)


def subparsers(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """Return the parsers of a program's verbs, none where it has no verbs."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}


def option_rows(parser: argparse.ArgumentParser) -> Iterator[tuple[str, list[tuple[str, str]]]]:
    """Yield the groups of a parser that hold something: title, and (option, help text)."""
    formatter = parser.formatter_class(prog=parser.prog)
    for group in parser._action_groups:
        rows = []
        for action in group._group_actions:
            if action.help is argparse.SUPPRESS or isinstance(action, argparse._SubParsersAction):
                continue
            shown = formatter._format_action_invocation(action)
            text = formatter._expand_help(action) if action.help else ""
            rows.append((shown, " ".join(text.split())))
        if rows:
            yield group.title or "", rows


def interface(path: Path) -> tuple[str, list[Line]]:
    """Read a .srv or .msg file: the comment at its head, and its lines with theirs.

    A comment of several lines before a field belongs to it; one after it is its own.
    """
    text = path.read_text(encoding="utf-8")
    blocks = text.split("\n\n", 2)
    head = " ".join(line.lstrip("# ") for line in blocks[1].splitlines())
    lines, before = [], []
    for line in (blocks[2] if len(blocks) > 2 else "").splitlines():
        if line.startswith("#"):
            before.append(line.lstrip("# "))
        elif line.strip():
            field, _, comment = _COMMENT.sub("\n", line, count=1).partition("\n")
            lines.append(Line(" ".join(field.split()), " ".join([*before, comment]).strip()))
            before = []
        else:
            before = []
    return head, lines


class _Shown(Directive):
    """A directive with one argument that makes sections."""

    required_arguments = 1
    final_argument_whitespace = True

    def section(self, title: str, *content: nodes.Node) -> nodes.section:
        made = nodes.section("", nodes.title("", "", nodes.literal(text=title)), *content)
        made["names"].append(nodes.fully_normalize_name(title))
        self.state.document.note_implicit_target(made, made)
        env = self.state.document.settings.env
        # So that pages link to it: #srv-getdata.
        label = f"{self.arguments[0]}-{made['ids'][0]}"
        env.domains["std"].note_hyperlink_target(label, env.docname, made["ids"][0], title)
        return made

    def depends_on(self, path: Path) -> None:
        self.state.document.settings.env.note_dependency(str(path))


class CommandLine(_Shown):
    """The options of a program of the package, and of each of its verbs, some groups left out."""

    option_spec = {"without": str}

    def run(self) -> list[nodes.Node]:
        """Return the program's own part, then a section for each verb."""
        module = importlib.import_module(f"cassandra_ros.cli.{self.arguments[0]}")
        parser = module.make_parser()
        verbs = subparsers(parser)
        found = self._describe(parser)
        for name, verb in verbs.items():
            found.append(self.section(f"{parser.prog} {name}", *self._describe(verb)))
        # Also where only a module of a verb has changed.
        for path in (ROOT / "src/cassandra_ros/cli").rglob("*.py"):
            self.depends_on(path)
        return found

    def _describe(self, parser: argparse.ArgumentParser) -> list[nodes.Node]:
        usage = " ".join(parser.format_usage().split()[1:])
        found = [*paragraphs(parser.description or ""), nodes.literal_block(usage, usage)]
        for title, rows in option_rows(parser):
            if title == self.options.get("without"):
                continue
            found.append(nodes.rubric("", title))
            terms = nodes.definition_list()
            for shown, text in rows:
                term = nodes.term("", "", nodes.literal(text=shown))
                said = nodes.definition("", nodes.paragraph("", "", *spans(text)))
                terms += nodes.definition_list_item("", term, said)
            found.append(terms)
        return [*found, *paragraphs(parser.epilog or "")]


class Interfaces(_Shown):
    """All services, or all messages: the files of a folder."""

    def run(self) -> list[nodes.Node]:
        """Return a section for each file."""
        found = []
        for path in sorted((ROOT / self.arguments[0]).glob(f"*.{self.arguments[0]}")):
            self.depends_on(path)
            head, lines = interface(path)
            content: list[nodes.Node] = [nodes.paragraph("", "", *spans(head))]
            for title, part in self._parts(lines):
                if part:
                    content.append(table((title, ""), part))
            found.append(self.section(path.stem, *content))
        return found

    def _parts(self, lines: list[Line]) -> list[tuple[str, list[Line]]]:
        rules = [n for n, line in enumerate(lines) if line.text == "---"]
        if not rules:
            return [("field", lines)]
        return [("request", lines[: rules[0]]), ("reply", lines[rules[0] + 1 :])]


class LaunchArguments(_Shown):
    """The arguments of a launch file."""

    def run(self) -> list[nodes.Node]:
        """Return a table of names, defaults and texts."""
        path = ROOT / "launch" / self.arguments[0]
        self.depends_on(path)
        rows: dict[str, tuple[str, str, str]] = {}
        for arg in ElementTree.parse(path).getroot().findall("arg"):  # noqa: S314 (our own file)
            name, text = arg.get("name", ""), arg.get("doc")
            # One without a text is computed, another one for a second condition.
            if text and name not in rows:
                rows[name] = (name, arg.get("default") or "", text)
        return [table(("argument", "default", ""), list(rows.values()), code=2)]


class NodeParameters(_Shown):
    """The private parameters of a node, which are the options of its program."""

    def run(self) -> list[nodes.Node]:
        """Return a table of parameters and options."""
        module = importlib.import_module(f"cassandra_ros.cli.{self.arguments[0]}")
        self.depends_on(Path(str(module.__file__)))
        actions = actions_by_parameter(module.make_parser())
        last = {action: name for name, action in actions.items()}
        rows = [
            (f"~{name}", ", ".join(action.option_strings) or "TOPIC")
            for action, name in last.items()
        ]
        return [table(("parameter", "as the option"), rows, code=2)]


class ApiRoutes(_Shown):
    """The paths of the viewer's API, with their parameters."""

    required_arguments = 0

    def run(self) -> list[nodes.Node]:
        """Return a definition for each route."""
        module = importlib.import_module("cassandra_ros.viewing.routes")
        for path in (ROOT / "src/cassandra_ros/viewing").glob("*.py"):
            self.depends_on(path)
        found = nodes.definition_list()
        for route in module.ROUTES:
            term = nodes.term("", "", nodes.literal(text=f"GET {route.path}"))
            parts = [nodes.paragraph("", "", *spans(route.summary))]
            if route.parameters:
                rows = [
                    (each.name, each.kind, each.summary + " Required." * each.required)
                    for each in route.parameters
                ]
                parts.append(table(("parameter", "kind", ""), rows))
            found += nodes.definition_list_item("", term, nodes.definition("", *parts))
        return [found]


def setup(app: object) -> dict[str, bool]:
    """Tell Sphinx of the directives."""
    app.add_directive("api-routes", ApiRoutes)  # type: ignore[attr-defined]
    app.add_directive("command-line", CommandLine)  # type: ignore[attr-defined]
    app.add_directive("interfaces", Interfaces)  # type: ignore[attr-defined]
    app.add_directive("launch-arguments", LaunchArguments)  # type: ignore[attr-defined]
    app.add_directive("node-parameters", NodeParameters)  # type: ignore[attr-defined]
    return {"parallel_read_safe": True}
