# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Parser of one message definition: fields and constants, every line checked.

The grammar is genmsg's, but stricter where genmsg accepts text that later becomes code: names
must be ASCII identifiers, and constants must be literals of their type.
"""

from __future__ import annotations

import re
import struct
from contextlib import suppress
from dataclasses import dataclass
from typing import Mapping

from cassandra_ros.errors import DefinitionError

CODES = {
    "bool": "?",
    "int8": "b",
    "byte": "b",
    "uint8": "B",
    "char": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
    "time": "Q",
    "duration": "q",
}
"""struct codes of the primitive types on the wire. A time or duration is read as one integer."""
PRIMITIVE_SIZES = {name: struct.calcsize("<" + code) for name, code in CODES.items()}
PRIMITIVE_SIZES["string"] = 4
"""Size of a primitive value on the wire, bytes; for a string the size of its length prefix."""

MAX_NAME = 255
"""Maximum length of the name of a type, field or constant, characters."""

_ALIASES = {"byte": "int8", "char": "uint8"}
_NAME = "[A-Za-z][A-Za-z0-9_]*"
_IS_NAME = re.compile(_NAME)
_IS_TYPE = re.compile(f"{_NAME}/{_NAME}")
_FIELD_TYPE = re.compile(
    rf"(?P<base>{_NAME}(?:/{_NAME})?)(?P<array>\[(?P<length>[0-9]{{0,10}})\])?"
)
_INTEGER = re.compile(r"[+-]?[0-9]{1,40}")
_FLOAT = re.compile(
    r"[+-]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:e[+-]?[0-9]+)?|inf|infinity|nan)", re.IGNORECASE
)
_BOOLS = {"true": True, "false": False}


@dataclass(frozen=True)
class Field:
    """One field of a message."""

    name: str
    type: str
    """Primitive type or 'pkg/Name', without the array's brackets."""
    is_array: bool = False
    length: int | None = None
    """Number of elements of a fixed array; None if the message carries it."""
    declared: str = ""
    """Type as written, brackets included; the md5 is computed from it."""

    @property
    def base(self) -> str:
        """Type with the old names resolved: byte is int8, char is uint8."""
        return _ALIASES.get(self.type, self.type)

    @property
    def is_primitive(self) -> bool:
        """Whether the elements are primitive values, not messages."""
        return self.type in PRIMITIVE_SIZES

    @property
    def full_type(self) -> str:
        """Resolved type with brackets, as 'float64[9]'."""
        if not self.is_array:
            return self.type
        return f"{self.type}[{'' if self.length is None else self.length}]"


@dataclass(frozen=True)
class Constant:
    """One constant of a message."""

    name: str
    type: str
    value: int | float | bool | str
    text: str
    """Value as written; the md5 is computed from it."""


@dataclass(frozen=True)
class MessageSpec:
    """One message type: its fields in wire order, and its constants."""

    type: str
    fields: tuple[Field, ...]
    constants: tuple[Constant, ...]


Specs = Mapping[str, MessageSpec]
"""Specs of a type and of all types that it uses, by type name."""


def check_type_name(name: str) -> str:
    """Return the name if it is a message type, 'pkg/Name', else raise DefinitionError."""
    if not isinstance(name, str) or len(name) > MAX_NAME or not _IS_TYPE.fullmatch(name):
        raise DefinitionError(f"{str(name)[:80]!r} is not a message type: expected pkg/Name")
    return name


def parse_spec(msg_type: str, text: str) -> MessageSpec:
    """Parse the .msg text of one type, whose name is already checked; raises DefinitionError."""
    package = msg_type.split("/")[0]
    fields: list[Field] = []
    constants: list[Constant] = []
    for number, line in enumerate(text.split("\n"), 1):
        code = line.split("#")[0].strip()
        if not code:
            continue
        try:
            if "=" in code:
                constants.append(_parse_constant(code, line))
            else:
                fields.append(_parse_field(code, package))
        except (DefinitionError, ValueError, OverflowError) as exc:
            raise DefinitionError(f"definition of {msg_type}, line {number}: {exc}") from exc
    _check_unique(msg_type, fields, constants)
    return MessageSpec(msg_type, tuple(fields), tuple(constants))


def resolve_type(name: str, package: str) -> str:
    """Return the full name of a message type as a definition of a package mentions it."""
    if name in ("Header", "roslib/Header"):  # in roslib until 2010
        return "std_msgs/Header"
    return name if "/" in name else f"{package}/{name}"


def _check_name(name: str, what: str) -> str:
    if len(name) > MAX_NAME or not _IS_NAME.fullmatch(name):
        raise DefinitionError(f"{name[:80]!r} is not a {what} name")
    return name


def _check_unique(msg_type: str, fields: list[Field], constants: list[Constant]) -> None:
    names: set[str] = set()
    for field in fields:
        if field.name in names:
            raise DefinitionError(f"definition of {msg_type}: field {field.name} occurs twice")
        names.add(field.name)
    both = [constant.name for constant in constants if constant.name in names]
    if both:
        raise DefinitionError(f"definition of {msg_type}: {both[0]} is both field and constant")


def _parse_field(code: str, package: str) -> Field:
    parts = code.split()
    if len(parts) != 2:
        raise DefinitionError(f"{code[:80]!r} is neither 'type name' nor a constant")
    declared, name = parts
    match = _FIELD_TYPE.fullmatch(declared)
    if match is None or len(match["base"]) > MAX_NAME:
        raise DefinitionError(f"{declared[:80]!r} is not a field type")
    _check_name(name, "field")
    base, is_array = match["base"], match["array"] is not None
    if base not in PRIMITIVE_SIZES:
        # genmsg knows the short name Header only without brackets.
        base = f"{package}/{base}" if base == "Header" and is_array else resolve_type(base, package)
        check_type_name(base)
    length = int(match["length"]) if is_array and match["length"] else None
    return Field(name, base, is_array, length, declared)


def _parse_constant(code: str, line: str) -> Constant:
    """Parse ``type NAME=value``; ``code`` is the line without its comment."""
    type_ = code.split()[0].split("=")[0]
    if type_ not in PRIMITIVE_SIZES or type_ in ("time", "duration"):
        raise DefinitionError(f"{type_[:80]!r} is not the type of a constant")
    # A string is the whole text right of the '=', including '#'.
    source = line if type_ == "string" else code
    left, _, right = source.partition("=")
    name = _check_name(left.strip()[len(type_) :].strip(), "constant")
    text = right.strip()
    return Constant(name, type_, _literal(type_, text), text)


def _literal(type_: str, text: str) -> int | float | bool | str:
    """Return the value of a constant; DefinitionError: the text is not a literal of its type."""
    if type_ == "string":
        return text
    if type_ in ("float32", "float64"):
        if _FLOAT.fullmatch(text):
            return float(text)
    elif type_ == "bool" and text.lower() in _BOOLS:
        return _BOOLS[text.lower()]
    elif _INTEGER.fullmatch(text):
        value = int(text)
        if type_ == "bool":
            return bool(value)
        with suppress(struct.error):  # out of range
            struct.pack("<" + CODES[type_], value)
            return value
    raise DefinitionError(f"{text[:80]!r} is not a literal of type {type_}")
