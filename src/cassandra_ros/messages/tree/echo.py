# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What ``rostopic echo`` prints of a message, made from its tree: no message object is needed.

It follows genpy's strify_message to the letter, its quirks included: char[] is printed as bytes.
"""

from __future__ import annotations

import re
from functools import lru_cache
from typing import Any, Callable, Dict, List, Mapping, Sequence, Tuple

import yaml

from cassandra_ros.messages.definition import Definition, attributeName
from cassandra_ros.messages.spec import Field, MessageSpec
from cassandra_ros.messages.tree.fields import NUMBER_CODES, TIME_CODES
from cassandra_ros.messages.tree.read import Tree

_Print = Callable[[Any, str], str]
"""(value, indentation of the lines below) -> text behind 'name: '."""
_Lines = Callable[[Tree, str], List[str]]
_Memo = Dict[str, _Lines]

_CACHED = 128
"""Longer strings are seldom the same twice."""
_PLAIN = re.compile(r"[ !#-\[\]-~]{1,70}")
"""Text that yaml only puts quotes around: printable, and short enough for one line."""


@lru_cache(maxsize=512)
def echoPrinter(definition: Definition) -> Callable[[Tree], str]:
    """Return the function that prints the trees of a definition, compiled once."""
    lines = _message(definition.type, definition.specs, {})
    return lambda tree: "\n".join(lines(tree, ""))


def _message(name: str, specs: Mapping[str, MessageSpec], memo: _Memo) -> _Lines:
    if name not in memo:
        fields: Sequence[Tuple[str, str, _Print]] = [
            (f"{attributeName(field.name)}: ", field.name, _field(field, specs, memo))
            for field in specs[name].fields
        ]

        def lines(tree: Tree, indent: str) -> list[str]:
            deeper = indent + "  "
            return [indent + head + show(tree[key], deeper) for head, key, show in fields]

        memo[name] = lines
    return memo[name]


def _field(field: Field, specs: Mapping[str, MessageSpec], memo: _Memo) -> _Print:
    if not field.is_array:
        return _one(field, specs, memo)
    show = _array(field, specs, memo)
    # Words in place of an array that was too long.
    return lambda value, indent: _quoted(value) if type(value) is str else show(value, indent)


def _one(field: Field, specs: Mapping[str, MessageSpec], memo: _Memo) -> _Print:
    if field.type == "string":
        return lambda value, indent: _quoted(value)
    if field.type in TIME_CODES:
        return lambda v, indent: f"\n{indent}secs: {v['secs']}\n{indent}nsecs: {v['nsecs']:9d}"
    if field.is_primitive:
        return lambda value, indent: str(value)
    lines = _message(field.type, specs, memo)
    return lambda tree, indent: "\n" + "\n".join(lines(tree, indent))


def _array(field: Field, specs: Mapping[str, MessageSpec], memo: _Memo) -> _Print:
    if field.type == "char":
        return lambda value, indent: repr(value)
    if field.base in NUMBER_CODES:
        return lambda value, indent: str(list(value))
    if field.type == "string":
        return _strings
    element = _one(Field(field.name, field.type), specs, memo)

    def show(values: Any, indent: str) -> str:
        if not values:
            return "[]"
        head, deeper = f"\n{indent}- ", indent + "  "
        return "".join([head + element(value, deeper) for value in values])

    return show


def _strings(values: Any, indent: str) -> str:
    if not values:
        return "[]"
    items = (_item(v) if len(v) <= _CACHED else _dump_item(v) for v in values)
    return "".join([f"\n{indent}{line}" for item in items for line in item])


def _quoted(text: str) -> str:
    if _PLAIN.fullmatch(text):
        return f'"{text}"'
    if not text:
        return "''"
    return _dump(text) if len(text) <= _CACHED else _dump_text(text)


def _dump_text(text: str) -> str:
    return str(yaml.dump(text, default_style='"')).rstrip("\n")


def _dump_item(text: str) -> list[str]:
    return str(yaml.dump([text], default_flow_style=False)).rstrip("\n").splitlines()


_dump = lru_cache(maxsize=4096)(_dump_text)
_item = lru_cache(maxsize=4096)(_dump_item)
