# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The YAML of messages without PyYAML, which takes microseconds for every number.

What is written here PyYAML would write the same; what is read here it would read the same. It
does itself whatever is none of: block mappings and sequences, numbers and strings of one line.
"""

from __future__ import annotations

import json
import re
from functools import lru_cache
from typing import Any, List, NamedTuple, Tuple

import yaml

MAX_NAME = 128
"""Of a field: a longer one is no simple key of YAML."""
ONE_LINE = 1 << 30
"""Width at which neither strings nor arrays are broken."""

_PRINTABLE = re.compile("[ -~]*")
_PLAIN = re.compile(
    r"(?!---|\.\.\.|[-?:](?: |$))[^ #,[\]{}&*!|>'\"%@`](?:[^ :]|:(?! |$)| +(?![ #]|$))*"
)
"""Of printable ASCII: what needs no quotes, unless it reads as something else than a string."""
_QUOTED = re.compile("'(?:[ -&(-~]|'')*'")

_NUMBER = r"(?:-?(?:0|[1-9][0-9]{0,19})(?:\.[0-9]+(?:e[-+][0-9]+)?)?|-?\.inf|\.nan|true|false)"
_NUMBERS = re.compile(rf"{_NUMBER}|\[(?:{_NUMBER}(?:, {_NUMBER})*)?\]")
"""What YAML and, but for the names of infinity and NaN, JSON read alike."""
_EXPONENT = re.compile(r"(?<![.0-9])([0-9]+)e")
_NAME = rf"[A-Za-z][A-Za-z0-9_]{{0,{MAX_NAME - 1}}}"
_LINE = re.compile(rf"((?:  ){{0,100}})(- )?(?:({_NAME}):(?: (?=.)|$))?(.*)")


def _is_plain(text: str) -> bool:
    """Return whether printable ASCII without quotes is this very string."""
    if _PLAIN.fullmatch(text) is None:
        return False
    rules = yaml.CSafeLoader.yaml_implicit_resolvers.get(text[0], ())
    return not any(rule.match(text) for _, rule in rules)


_is_plain_name = lru_cache(maxsize=1024)(_is_plain)


def printBlock(tree: dict[str, Any]) -> str:
    """Return the YAML of a tree whose names have at most MAX_NAME characters.

    Raises:
        yaml.YAMLError: A string cannot be written.
    """
    parts: list[str] = []
    _print_mapping(tree, "", "", parts)
    return "".join(parts) or "{}\n"


def _print_mapping(tree: dict[str, Any], lead: str, indent: str, parts: list[str]) -> None:
    """Append the lines of a mapping, the first of them behind ``lead``."""
    for name, value in tree.items():
        parts.append(f"{lead}{name}:" if _is_plain_name(name) else f"{lead}'{name}':")
        lead = indent
        if isinstance(value, dict) and value:
            parts.append("\n")
            _print_mapping(value, indent + "  ", indent + "  ", parts)
        elif isinstance(value, list) and value and isinstance(value[0], (dict, str)):
            parts.append("\n")
            for element in value:
                if isinstance(element, dict) and element:
                    _print_mapping(element, indent + "- ", indent + "  ", parts)
                else:
                    parts.append(f"{indent}- {_scalar(element, indent)}\n")
        else:
            parts.append(f" {_scalar(value, indent)}\n")


def _scalar(value: Any, indent: str) -> str:
    if isinstance(value, str):
        return _string(value, indent)
    text = str(list(value) if isinstance(value, bytes) else value)
    if "e" in text:
        text = _EXPONENT.sub(r"\1.0e", text.lower())
    return text.replace("nan", ".nan").replace("inf", ".inf") if "n" in text else text


def _string(text: str, indent: str) -> str:
    if _PRINTABLE.fullmatch(text):
        return text if _is_plain(text) else "'" + text.replace("'", "''") + "'"
    tree: Any = text
    depth = len(indent) // 2 + 1  # the lines behind the first are indented as deep
    for _ in range(depth):
        tree = {"x": tree}
    dumped: str = yaml.dump(tree, Dumper=yaml.CSafeDumper, allow_unicode=True, width=ONE_LINE)
    return dumped.split("x:", depth)[depth][1:-1]


class _Line(NamedTuple):
    """A line, or what is behind the dash of one."""

    indent: int
    dash: bool
    name: str
    value: str


def readBlock(text: str) -> dict[str, Any]:
    """Return what a text of the kind of printBlock says, all others are refused.

    It has at most 100 levels of indentation and no alias.

    Raises:
        ValueError: PyYAML must have a look at it.
    """
    lines: list[_Line] = []
    for line in text.split("\n"):
        _read_line(line, lines)
    if lines.pop() != (0, False, "", ""):
        raise ValueError("the last line does not end")
    tree, end = _read_mapping(lines, 0, 0)
    if end < len(lines):
        raise ValueError(f"line {end} of the block is another's")
    return tree


def _read_line(text: str, lines: List[_Line]) -> None:
    match = _LINE.fullmatch(text)
    if match is None:
        raise ValueError("a line is indented too deep")
    blanks, dash, name, value = match.groups("")
    indent = len(blanks)
    if name and not _is_plain_name(name):
        raise ValueError("a name is not plain")
    if dash and name:
        lines += (_Line(indent, True, "", ""), _Line(indent + 2, False, name, value))
    else:
        if dash and not value:
            raise ValueError("an element is empty")
        lines.append(_Line(indent, bool(dash), name, value))


def _read_mapping(lines: List[_Line], at: int, indent: int) -> Tuple[dict[str, Any], int]:
    tree: dict[str, Any] = {}
    while at < len(lines) and lines[at].name and lines[at].indent == indent:
        _, _, name, value = lines[at]
        at += 1
        if value:
            tree[name] = _read_scalar(value)
        elif at < len(lines) and lines[at].dash:
            tree[name], at = _read_sequence(lines, at, indent)
        else:
            tree[name], at = _read_mapping(lines, at, indent + 2)
    if not tree:
        raise ValueError("a name or a dash is alone")
    return tree, at


def _read_sequence(lines: List[_Line], at: int, indent: int) -> Tuple[List[Any], int]:
    values: list[Any] = []
    while at < len(lines) and lines[at].dash and lines[at].indent == indent:
        value: Any = lines[at].value
        at += 1
        if value:
            value = _read_scalar(value)
        else:
            value, at = _read_mapping(lines, at, indent + 2)
        values.append(value)
    if not values:
        raise ValueError("a sequence is indented otherwise")
    return values, at


def _read_scalar(text: str) -> Any:
    if _NUMBERS.fullmatch(text):
        return json.loads(text.replace(".nan", "NaN").replace(".inf", "Infinity"))
    if _QUOTED.fullmatch(text):
        return text[1:-1].replace("''", "'")
    if text == "{}":
        return {}
    if _PRINTABLE.fullmatch(text) and _is_plain(text):
        return text
    raise ValueError("a value is neither a number nor a string of one line")
