# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Format ``yaml``: the message as ``rostopic pub -f`` reads it, written and read by libyaml.

It is for low rates: PyYAML takes microseconds for every number.
"""

from __future__ import annotations

from typing import Any, Sequence

import yaml

from cassandra_ros.formats.text_column import ParsedFormat
from cassandra_ros.messages.tree.tree_reader import MessageTree

MAX_DEPTH = 300
"""Of a text; libyaml's composer overflows the stack of the process at some ten thousand."""
ONE_LINE = 1 << 30
"""Width at which neither strings nor arrays are broken."""


class CassandraTopic_yaml(ParsedFormat):
    """Block style, arrays of numbers in one line; exact but for NaNs other than Python's."""

    NAME = "yaml"

    def print_tree(self, tree: MessageTree) -> str | None:
        """Return the YAML of a message."""
        layout = {"sort_keys": False, "allow_unicode": True, "width": ONE_LINE}
        try:
            return str(yaml.dump(tree, Dumper=_Dumper, **layout))
        except yaml.YAMLError:
            return None

    def is_faithful(self, text: str) -> bool:
        """Return whether there is no NaN, whose bits are lost, and no text in quotes.

        What needs none reads as it was written, for writing asks the rules of reading.
        """
        quoted = '"' in text or "'" in text.replace("''\n", "\n")
        return text.isascii() and not quoted and ".nan" not in text

    def parse_own(self, text: str) -> object:
        """Return what the YAML says."""
        loader = _Loader(text)
        try:
            return loader.get_single_data()
        finally:
            loader.dispose()

    def parse(self, text: str) -> object:
        """Return what the YAML says, unless it is a bomb."""
        _check(text)
        return self.parse_own(text)


def _check(text: str) -> None:
    """Refuse aliases, which expand without end, and depth: event by event, which takes no stack."""
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


class _Loader(yaml.CSafeLoader):
    """Reads ``.nan`` as the same bits everywhere: PyYAML's has the sign of the processor."""

    nan_value = float("nan")


class _Dumper(yaml.CSafeDumper):
    """Writes trees: no aliases, numbers in one line."""

    def ignore_aliases(self, data: object) -> bool:
        return True


def _list(dumper: _Dumper, values: Sequence[object]) -> Any:
    flow = not values or not isinstance(values[0], (dict, str))
    return dumper.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=flow)


_Dumper.add_representer(list, _list)
_Dumper.add_representer(bytes, _list)
