# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Format ``yaml``: the text that ``rostopic pub -f`` reads, written and parsed by libyaml.

It is meant for low rates: PyYAML takes microseconds for every number.
"""

from __future__ import annotations

from typing import Any, Sequence

import yaml

from cassandra_ros.messages.formats.text_column import ParsedFormat
from cassandra_ros.messages.tree.tree_reader import MessageTree

MAX_DEPTH = 300
"""Maximum nesting depth of a text. From some ten thousand levels on libyaml overflows the stack."""
ONE_LINE = 1 << 30
"""Width at which strings and arrays are never wrapped, characters."""


class CassandraTopic_yaml(ParsedFormat):
    """Block style, arrays of numbers in one line; exact except for NaNs with other bits."""

    NAME = "yaml"

    def print_tree(self, tree: MessageTree) -> str | None:
        """Return the YAML text of a message."""
        layout = {"sort_keys": False, "allow_unicode": True, "width": ONE_LINE}
        try:
            return str(yaml.dump(tree, Dumper=_Dumper, **layout))
        except yaml.YAMLError:
            return None

    def is_faithful(self, text: str) -> bool:
        """Return whether the text has no NaN, whose bits are lost, and no quoted text.

        A text without quotes parses as it was written, because the writer applies the parser's
        rules.
        """
        quoted = '"' in text or "'" in text.replace("''\n", "\n")
        return text.isascii() and not quoted and ".nan" not in text

    def parse_own(self, text: str) -> object:
        """Return the parsed YAML."""
        loader = _Loader(text)
        try:
            return loader.get_single_data()
        finally:
            loader.dispose()

    def parse(self, text: str) -> object:
        """Return the parsed YAML; refuses aliases and deep nesting."""
        _check(text)
        return self.parse_own(text)


def _check(text: str) -> None:
    """Refuse aliases, which expand without limit, and deep nesting. Works without recursion."""
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
    """Reads ``.nan`` as fixed bits: the sign of PyYAML's NaN depends on the processor."""

    nan_value = float("nan")


class _Dumper(yaml.CSafeDumper):
    """Writes trees without aliases, and arrays of numbers in one line."""

    def ignore_aliases(self, data: object) -> bool:
        return True


def _list(dumper: _Dumper, values: Sequence[object]) -> Any:
    """Write numbers (also bytes) in one line, messages and strings on lines of their own."""
    flow = not values or not isinstance(values[0], (dict, str))
    return dumper.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=flow)


_Dumper.add_representer(list, _list)
_Dumper.add_representer(bytes, _list)
