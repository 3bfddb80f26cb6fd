# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Format ``yaml``: the message as ``rostopic pub -f`` reads it."""

from __future__ import annotations

import re
from typing import Any

import yaml

from cassandra_ros.formats.text import ParsedFormat
from cassandra_ros.formats.yaml_block import MAX_NAME, ONE_LINE, printBlock, readBlock
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.tree.read import Tree

MAX_DEPTH = 300
"""Of a text; libyaml's composer overflows the stack of the process at some ten thousand."""

_FLAT = re.compile(r"\[[-+.\w, ]*\]", re.ASCII)
_INDENTS = re.compile(r"[ \t?:-]+")


class CassandraTopic_yaml(ParsedFormat):
    """Block style, arrays of numbers in one line; exact but for NaNs other than Python's."""

    NAME = "yaml"

    def __init__(self, msg_type: str, md5sum: str, definition: Definition | None) -> None:
        super().__init__(msg_type, md5sum, definition)
        specs = self.definition.specs.values()
        longest = max((len(field.name) for spec in specs for field in spec.fields), default=0)
        self._print = printBlock if longest <= MAX_NAME else _dump

    def printTree(self, tree: Tree) -> str | None:
        """Return the YAML of a message."""
        try:
            return self._print(tree)
        except yaml.YAMLError:
            return None

    def isFaithful(self, text: str) -> bool:
        """Return whether there is no NaN, whose bits are lost, and no text in quotes.

        What needs none reads as it was written, for writing asks the rules of reading.
        """
        quoted = '"' in text or "'" in text.replace("''\n", "\n")
        return text.isascii() and not quoted and ".nan" not in text

    def parseOwn(self, text: str) -> object:
        """Return what the YAML says."""
        try:
            return readBlock(text)
        except ValueError:
            return _load(text)

    def parse(self, text: str) -> object:
        """Return what the YAML says, unless it is a bomb."""
        try:
            return readBlock(text)
        except ValueError:
            _check(text)
            return _load(text)


def _check(text: str) -> None:
    """Refuse what composing cannot bear, event by event where a glance does not tell.

    Raises:
        ValueError: The text has aliases, which expand without end, or is nested too deep.
    """
    if "&" not in text and "*" not in text and _most_depth(text) <= MAX_DEPTH:
        return
    depth = 0
    for event in yaml.parse(text, Loader=yaml.CSafeLoader):
        if isinstance(event, yaml.AliasEvent):
            raise ValueError("aliases are not read")
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
            if depth > MAX_DEPTH:
                raise ValueError(f"it is nested deeper than {MAX_DEPTH}")
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1


def _most_depth(text: str) -> int:
    """Return what the depth of a text is at most.

    Every bracket opens a list and, in it, a mapping without braces; flat lists are open one at a
    time. In a column begin at most a mapping and the sequence in it, behind blanks and dashes.
    """
    brackets = text.count("[") + text.count("{") - len(_FLAT.findall(text)) + 1
    columns = max(map(len, _INDENTS.findall(text)), default=0) + 1
    return 2 * (brackets + columns)


def _load(text: str) -> object:
    loader = _Loader(text)
    try:
        return loader.get_single_data()
    finally:
        loader.dispose()


def _dump(tree: Tree) -> str:
    text: str = yaml.dump(tree, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=ONE_LINE)
    return text


class _Loader(yaml.CSafeLoader):
    """Reads ``.nan`` as the same bits everywhere: PyYAML's has the sign of the processor."""

    nan_value = float("nan")


class _Dumper(yaml.CSafeDumper):
    """Writes trees: no aliases, numbers in one line."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _list(dumper: Any, values: Any) -> Any:
    flow = not values or not isinstance(values[0], (dict, str))
    return dumper.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=flow)


_Dumper.add_representer(list, _list)
_Dumper.add_representer(bytes, _list)
