# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The text that ``rostopic echo`` prints for a message, made from its tree without an object.

It is the same as genpy's strify_message to the letter, quirks included: char[] prints as bytes.
"""

from __future__ import annotations

import re
from functools import lru_cache
from typing import Any, Callable, List, Sequence

import yaml

from cassandra_ros.messages.definition import Definition, attribute_name
from cassandra_ros.messages.spec import Field
from cassandra_ros.messages.tree.tree_reader import NUMBER_CODES, TIME_CODES, MessageTree

_Print = Callable[[Any, str], str]
"""(value of a field, indentation of its further lines) -> text after 'name: '."""
_Lines = Callable[[MessageTree, str], List[str]]
"""(tree of a message, indentation) -> its lines."""

_CACHED = 128
"""Maximum length of a cached string, characters. Longer strings rarely repeat."""
_PLAIN = re.compile(r"[ !#-\[\]-~]{1,70}")
"""Text that yaml only quotes: printable characters that need no escape, short enough for a line."""


@lru_cache(maxsize=512)
def echo_printer(definition: Definition) -> Callable[[MessageTree], str]:
    """Return the function that prints trees of a definition, compiled once."""
    lines = _EchoCompiler(definition).message(definition.type)
    return lambda tree: "\n".join(lines(tree, ""))


class _EchoCompiler:
    """Makes the functions that print messages of one definition."""

    def __init__(self, definition: Definition) -> None:
        self._specs = definition.specs
        self._memo: dict[str, _Lines] = {}

    def message(self, name: str) -> _Lines:
        """Return the function for a message type, made once."""
        if name not in self._memo:
            spec = self._specs[name]
            fields = [(f"{attribute_name(f.name)}: ", f.name, self._field(f)) for f in spec.fields]

            def lines(tree: MessageTree, indent: str) -> list[str]:
                deeper = indent + "  "
                return [indent + head + show(tree[key], deeper) for head, key, show in fields]

            self._memo[name] = lines
        return self._memo[name]

    def _field(self, field: Field) -> _Print:
        if not field.is_array:
            return self._one(field.type)
        show = self._array(field)
        # The tree has a text in place of an array that was too long.
        return lambda value, indent: _quote(value) if type(value) is str else show(value, indent)

    def _one(self, type_: str) -> _Print:
        """Return the function for a single value, or an element of an array."""
        if type_ == "string":
            return lambda value, indent: _quote(value)
        if type_ in TIME_CODES:
            return lambda v, indent: f"\n{indent}secs: {v['secs']}\n{indent}nsecs: {v['nsecs']:9d}"
        if type_ in NUMBER_CODES:
            return lambda value, indent: str(value)
        lines = self.message(type_)
        return lambda tree, indent: "\n" + "\n".join(lines(tree, indent))

    def _array(self, field: Field) -> _Print:
        if field.type == "char":
            return lambda value, indent: repr(value)
        if field.base in NUMBER_CODES:
            return lambda value, indent: str(list(value))
        if field.type == "string":
            return _strings
        element = self._one(field.type)

        def show(values: Sequence[Any], indent: str) -> str:
            if not values:
                return "[]"
            head, deeper = f"\n{indent}- ", indent + "  "
            return "".join([head + element(value, deeper) for value in values])

        return show


def _strings(values: Sequence[str], indent: str) -> str:
    """Print string[] as yaml writes a list, which quotes only texts that need it."""
    if not values:
        return "[]"
    items = (_item(v) if len(v) <= _CACHED else _item.__wrapped__(v) for v in values)
    return "".join([f"\n{indent}{line}" for item in items for line in item])


def _quote(text: str) -> str:
    """Print a string as yaml quotes it, without yaml where its answer is known."""
    if _PLAIN.fullmatch(text):
        return f'"{text}"'
    if not text:
        return "''"
    return _dump(text) if len(text) <= _CACHED else _dump.__wrapped__(text)


@lru_cache(maxsize=4096)
def _dump(text: str) -> str:
    return str(yaml.dump(text, default_style='"')).rstrip("\n")


@lru_cache(maxsize=4096)
def _item(text: str) -> list[str]:
    return str(yaml.dump([text], default_flow_style=False)).rstrip("\n").splitlines()
