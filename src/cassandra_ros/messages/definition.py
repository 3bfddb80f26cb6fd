# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Message definitions as connection headers and bags carry them, checked before any use.

A definition is text from outside, and genpy executes the text that it is given. Therefore genpy
gets only text that render_spec writes from a parsed definition.
"""

from __future__ import annotations

import importlib
import importlib.util
import keyword
import logging
import os
import sys
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, Iterator, Mapping

from cassandra_ros.errors import DefinitionError
from cassandra_ros.messages.shape import check_shape, compute_md5
from cassandra_ros.messages.spec import (
    MessageSpec,
    Specs,
    check_type_name,
    parse_spec,
    resolve_type,
)
from cassandra_ros.metadata import Kind, message_kind

MAX_DEFINITION_CHARACTERS = 1 << 20
"""Maximum length of the text of a definition, characters."""
MAX_TYPES = 256
"""Maximum number of types in a definition."""

_SEPARATOR = "=" * 80
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Definition:
    """A message type and all types that it uses. Equal when type, md5 and arrays are equal.

    The md5 alone does not distinguish definitions: ROS omits the brackets of arrays of messages.
    """

    type: str
    md5sum: str
    text: str = field(compare=False, repr=False)
    """Definition text as given."""
    specs: Specs = field(compare=False, repr=False)
    """Specs of the type itself and of every type that it uses, directly or not, by type name."""
    md5sums: Mapping[str, str] = field(compare=False, repr=False)
    """md5 of each of these types, by type name."""
    arrays: tuple[str, ...] = field(repr=False)
    """Path of each array of messages with its brackets, as 'transforms[]' or 'arms[2].joints[]'."""

    @property
    def root(self) -> MessageSpec:
        """Spec of the type itself."""
        return self.specs[self.type]

    @property
    def kind(self) -> Kind:
        """Kind of the messages of this type."""
        return message_kind(self.md5sum, self.type, self.arrays)

    def nested(self, msg_type: str) -> Definition:
        """Return the definition of a type that this one uses, constants included."""
        return parse_definition(msg_type, _render_whole(self, msg_type), self.md5sums[msg_type])


def parse_definition(msg_type: str, text: str, md5sum: str | None = None) -> Definition:
    """Parse and check a full definition (the text that ``gendeps --cat`` prints).

    A type that the text uses but does not define is taken from the installed packages, but only if
    the md5 of the whole is then md5sum.

    Args:
        msg_type: 'pkg/Name'.
        text: Definition of the type, then that of each type that it uses, each after a line of 80
            '=' and a line 'MSG: pkg/Name'.
        md5sum: Expected md5; None accepts any md5, but requires a complete text.

    Raises:
        DefinitionError: The text is not a definition, is hostile, or has another md5.
    """
    if not isinstance(text, str) or len(text) > MAX_DEFINITION_CHARACTERS:
        raise DefinitionError(f"the definition of {msg_type!r} is not a text of at most 1 MiB")
    return _parse(check_type_name(msg_type), text, md5sum)


def read_definition(msg_type: str, text: str, md5sum: str) -> Definition:
    """Parse the definition of a connection, whose md5sum may be that of another definition.

    As for rosbag, the text counts if it is complete. Its md5 is that of the returned definition.

    Raises:
        DefinitionError: As in parse_definition; a text without fields counts as missing.
    """
    try:
        return parse_definition(msg_type, text, md5sum)
    except DefinitionError:
        with suppress(DefinitionError):
            definition = parse_definition(msg_type, text)
            if definition.root.fields:
                return definition
        raise


@lru_cache(maxsize=256)
def _parse(msg_type: str, text: str, md5sum: str | None) -> Definition:
    """Parse and check a definition, as parse_definition."""
    sections = _split(msg_type, text)
    specs: dict[str, MessageSpec] = {}
    missing: set[str] = set()
    waiting = [msg_type]
    while waiting:
        name = waiting.pop()
        if name in specs:
            continue
        if name not in sections:
            missing.add(name)
            sections = {**_installed_sections(name, msg_type, md5sum), **sections}
        specs[name], *others = [parse_spec(name, body) for body in sections[name]]
        if any(other != specs[name] for other in others):
            raise DefinitionError(f"the definition of {msg_type} defines {name} twice, differently")
        waiting.extend(f.type for f in specs[name].fields if not f.is_primitive)
        if len(specs) > MAX_TYPES:
            raise DefinitionError(f"the definition of {msg_type} uses over {MAX_TYPES} types")
    check_shape(msg_type, specs)
    md5sums = compute_md5(msg_type, specs)
    if md5sum is not None and md5sums[msg_type] != md5sum:
        where = f" ({', '.join(sorted(missing))} taken from installed packages)" if missing else ""
        what = f"has md5 {md5sums[msg_type]}, not {md5sum[:80]!r} as its connection says"
        raise DefinitionError(f"the definition of {msg_type}{where} {what}")
    arrays = tuple(_message_arrays(msg_type, specs, ""))
    definition = Definition(msg_type, md5sums[msg_type], text, specs, md5sums, arrays)
    if missing:
        # Text from installed packages is kept too: other machines may lack it or have a newer one.
        definition = replace(definition, text=_render_whole(definition, msg_type))
    return definition


def _message_arrays(msg_type: str, specs: Specs, prefix: str) -> Iterator[str]:
    """Yield the path of each array of messages in a checked type."""
    for child in specs[msg_type].fields:
        if child.is_primitive:
            continue
        length = "" if child.length is None else child.length
        path = f"{prefix}{child.name}[{length}]" if child.is_array else f"{prefix}{child.name}"
        if child.is_array:
            yield path
        yield from _message_arrays(child.type, specs, f"{path}.")


def _split(msg_type: str, text: str) -> dict[str, list[str]]:
    """Return the texts of each type in a full definition, by type name. Equal texts count once.

    A line of eight or more '=' separates them.
    """
    sections: dict[str, list[str]] = {}
    name, expect_name = msg_type, False
    lines: list[str] = []
    for line in [*text.split("\n"), _SEPARATOR]:
        stripped = line.strip()
        if expect_name:
            if not stripped.startswith("MSG:"):
                what = f"names no type after a separator: {stripped[:80]!r}"
                raise DefinitionError(f"the definition of {msg_type} {what}")
            name = check_type_name(resolve_type(stripped[4:].strip(), ""))
            lines, expect_name = [], False
        elif len(stripped) >= 8 and stripped == "=" * len(stripped):
            body = "\n".join(lines).rstrip()
            bodies = sections.setdefault(name, [])
            if body not in bodies:
                bodies.append(body)
            expect_name = True
        else:
            lines.append(line)
    return sections


def _installed_sections(name: str, msg_type: str, md5sum: str | None) -> dict[str, list[str]]:
    """Return the texts of a missing type and of the types that it uses, from installed packages."""
    msg_class = installed_class(name) if md5sum is not None else None
    if msg_class is None:
        lacking = " and which is not installed" if md5sum is not None else ""
        what = f"the definition of {msg_type} uses {name}, which it does not define"
        raise DefinitionError(what + lacking)
    return _split(name, str(msg_class._full_text))


def render_spec(spec: MessageSpec) -> str:
    """Return the text of one message type, without constants, comments and the types that it uses.

    Only this text may be given to genpy. Its md5 differs from the original's if the type has
    constants. Field names are the attribute names, because genpy does not rename keywords inside a
    path.
    """
    return "\n".join(f"{f.full_type} {attribute_name(f.name)}" for f in spec.fields)


def attribute_name(name: str) -> str:
    """Return the Python name of a field or constant: genpy renames ``from`` to ``from_``."""
    return name + "_" if keyword.iskeyword(name) or name == "self" else name


def _render_whole(definition: Definition, msg_type: str) -> str:
    """Return the full text of a type, constants included, as ``gendeps --cat`` prints it."""
    names = [msg_type]
    for name in names:
        types = (f.type for f in definition.specs[name].fields if not f.is_primitive)
        names.extend(dict.fromkeys(n for n in types if n not in names))
    parts = []
    for name in names:
        spec = definition.specs[name]
        lines = [f"{c.type} {c.name}={c.text}" for c in spec.constants]
        lines += [f"{f.declared or f.full_type} {f.name}" for f in spec.fields]
        body = "\n".join(lines)
        parts.append(body if name == msg_type else f"{name}\n{body}")
    return f"\n{_SEPARATOR}\nMSG: ".join(parts)


def definition_of(msg_class: Any) -> Definition:
    """Return the definition of a message class or instance. DefinitionError: not a message."""
    definition = getattr(msg_class, "_definition", None)
    if isinstance(definition, Definition):  # message_class generated this class
        return definition
    try:
        msg_type, text, md5sum = msg_class._type, msg_class._full_text, msg_class._md5sum
    except AttributeError as exc:
        raise DefinitionError(f"{msg_class!r} is not a ROS message class") from exc
    return parse_definition(msg_type, text, md5sum)


@lru_cache(maxsize=1024)
def installed_class(msg_type: str) -> Any | None:
    """Return the class of an installed message type, or None; DefinitionError: not a 'pkg/Name'.

    None also if its module cannot be imported. The answer is kept: a type that is installed later
    is not found. A type name comes from outside: a package is only imported if its folder has
    ``msg/_Name.py``.
    """
    package, name = check_type_name(msg_type).split("/")
    if not _has_message(package, name):
        return None
    try:
        # The whole package first: threads that begin with two of its modules wait for each other.
        importlib.import_module(f"{package}.msg")
        cls = getattr(importlib.import_module(f"{package}.msg._{name}"), name)
        if cls._type == msg_type:
            return cls
        _log.warning("installed class %s calls itself %s: not used", msg_type, cls._type)
    except (ImportError, AttributeError, SyntaxError) as exc:
        _log.warning("installed message type %s cannot be imported: %s", msg_type, exc)
    return None


def _has_message(package: str, name: str) -> bool:
    """Return whether a package has the module of a message; the package is not imported."""
    loaded = sys.modules.get(package)
    if loaded is not None:  # an imported package may have extended its path
        folders = getattr(loaded, "__path__", [])
    else:
        try:
            spec = importlib.util.find_spec(package)
        except (ImportError, ValueError):
            return False
        folders = (spec.submodule_search_locations if spec is not None else None) or []
    return any(os.path.isfile(os.path.join(f, "msg", f"_{name}.py")) for f in folders)
