# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Lookup of the fields that a statement names in a message definition.

What was found is cached: most statements name the same fields again.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Iterator, Sequence, Tuple

from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.spec import Field
from cassandra_ros.query.tree.syntax import (
    OWN_WORDS,
    FieldPath,
    PathPart,
    StatementError,
    path_text,
)

_TIME_PARTS = {"time": "uint32", "duration": "int32"}
"""Type of secs and nsecs, by type of the field."""
MAX_FOUND = 512
"""Maximum number of paths whose fields are cached."""


@dataclass(frozen=True)
class FieldStep:
    """One field on the path to a value."""

    name: str
    many: bool = False
    """Whether the field is an array of messages."""
    index: int | None = None
    """Index of the selected element of the array; None = no index."""


Array = Tuple[FieldStep, ...]
"""The path to an array of messages."""


@dataclass(frozen=True)
class FieldRef:
    """A field of primitive type, or an array of a primitive type."""

    steps: tuple[FieldStep, ...]
    """Path from the message to the field."""
    type: str
    """Primitive type, aliases resolved."""
    is_array: bool = False
    """Whether it is a whole primitive array."""
    index: int | None = None
    """Index of the selected element of a primitive array; None = no index."""
    part: str = ""
    """'secs' or 'nsecs' of a time or duration; '' = the whole field."""

    @cached_property
    def column(self) -> str:
        """Dotted name without indexes: the column of format ``ros``."""
        return ".".join(step.name for step in self.steps)

    @cached_property
    def name(self) -> str:
        """Dotted name with indexes, as a column of a result."""
        names = [(step.name, step.index) for step in self.steps]
        names[-1] = (names[-1][0], self.index)
        return path_text(names) + (f".{self.part}" if self.part else "")

    @cached_property
    def arrays(self) -> tuple[Array, ...]:
        """Paths of the arrays of messages without an index on the path, outermost first."""
        steps = self.steps
        whole = (n for n, step in enumerate(steps, 1) if step.many and step.index is None)
        return tuple(steps[:n] for n in whole)


@lru_cache(maxsize=256)
def all_fields(definition: Definition) -> tuple[FieldRef, ...]:
    """Return every field of primitive type in wire order."""
    return tuple(_primitive_fields(definition, definition.type, ()))


@lru_cache(maxsize=MAX_FOUND)
def fields_of(path: FieldPath, definition: Definition) -> tuple[FieldRef, ...]:
    """Return the fields that a path names: one, or all of a message.

    StatementError: no such field.
    """
    steps: tuple[FieldStep, ...] = ()
    msg_type = definition.type
    for number, path_part in enumerate(path.parts):
        field = _field(definition, msg_type, path_part, steps)
        _check_index(path_part, field, path)
        if field.is_primitive:
            return (_primitive(path, number, steps, field),)
        steps = (*steps, FieldStep(field.name, field.is_array, path_part.index))
        msg_type = field.type
    return tuple(_primitive_fields(definition, msg_type, steps))


@lru_cache(maxsize=MAX_FOUND)
def field_of(path: FieldPath, definition: Definition, array: bool | None = False) -> FieldRef:
    """Return the field that a path names; StatementError: no field, several, or of another shape.

    ``array``: whether it must be a whole array; None = either.
    """
    refs = fields_of(path, definition)
    if len(refs) != 1 or len(refs[0].steps) > len(path.parts):
        inside = " or ".join(ref.name for ref in refs[:3])
        hint = f", like {inside}" if inside else " (it has none)"
        reason = f"is a message; name one of its fields{hint}"
    elif array is True and not refs[0].is_array:
        reason = f"is a {refs[0].type}, not an array; compare it with ="
    elif array is False and refs[0].is_array:
        reason = f"is an array; name an element, like {path.text}[0]"
    else:
        return refs[0]
    raise StatementError(path.position, f"{path.text} {reason}")


@lru_cache(maxsize=MAX_FOUND)
def counted_field(path: FieldPath, definition: Definition) -> FieldRef:
    """Return a field with one value for each element of the array that a path names.

    For an array of messages it is their first field. A path to any other field gives that field:
    the caller checks that it is an array or a text. StatementError: the path names one message, or
    no field.
    """
    refs = fields_of(path, definition)
    if refs and len(refs[0].steps) > len(path.parts):
        step = refs[0].steps[len(path.parts) - 1]
        if not step.many or step.index is not None:
            refs = ()
    if not refs:
        reason = f"{path.text} is a message; len is for arrays and text"
        raise StatementError(path.position, reason)
    return refs[0]


def nearest(name: str, names: Sequence[str]) -> str:
    """Return ' (did you mean …?)' with the most similar names, or '' without similar names."""
    lowered = {other.lower(): other for other in names}
    close = difflib.get_close_matches(name.lower(), lowered, n=3, cutoff=0.6)
    longer = [other for other in lowered if len(name) > 1 and other.startswith(name.lower())]
    return _did_you_mean([lowered[other] for other in dict.fromkeys(close + longer)])


def _did_you_mean(names: Sequence[str]) -> str:
    return f" (did you mean {' or '.join(names[:3])}?)" if names else ""


def _field(
    definition: Definition, msg_type: str, path_part: PathPart, steps: Sequence[FieldStep]
) -> Field:
    """Return the field of a message that a path names; StatementError, with similar names: none."""
    fields = {field.name: field for field in definition.specs[msg_type].fields}
    if path_part.name in fields:
        return fields[path_part.name]
    prefix, names = "".join(f"{step.name}." for step in steps), list(fields)
    own_words = [word for word in OWN_WORDS if not steps and word == path_part.name.upper()]
    deeper = [ref.name for ref in all_fields(definition) if ref.steps[-1].name == path_part.name]
    hint = ("" if own_words else nearest(path_part.name, names)) or _did_you_mean(
        own_words + deeper
    )
    reason = f"{definition.type} has no field {prefix}{path_part.name}{hint}; "
    reason += f"{prefix[:-1] or 'its'} fields are {', '.join(names[:20]) or 'none'}"
    raise StatementError(path_part.position, reason)


def _check_index(path_part: PathPart, field: Field, path: FieldPath) -> None:
    if path_part.index is not None and not field.is_array:
        raise StatementError(path_part.position, f"{path_part.name} in {path.text} is not an array")
    if path_part.index is not None and field.length is not None and path_part.index >= field.length:
        reason = f"has {field.length} elements, counted from 0; {path.text} asks for more"
        raise StatementError(path_part.position, f"{path_part.name} {reason}")


def _primitive(
    path: FieldPath, number: int, steps: tuple[FieldStep, ...], field: Field
) -> FieldRef:
    """Return the reference to a primitive field, which the part ``number`` of a path names.

    After it may only stand secs or nsecs of a time or duration; else StatementError.
    """
    path_part, rest = path.parts[number], path.parts[number + 1 :]
    whole = field.is_array and path_part.index is None
    ref = FieldRef((*steps, FieldStep(field.name)), field.base, whole, path_part.index)
    if not rest:
        return ref
    if field.base in _TIME_PARTS and not whole and len(rest) == 1 and rest[0].index is None:
        if rest[0].name in ("secs", "nsecs"):
            return replace(ref, type=_TIME_PARTS[field.base], part=rest[0].name)
    reason = f"{ref.name} is a {field.full_type}; it has no field {rest[0].name}"
    raise StatementError(rest[0].position, reason)


def _primitive_fields(
    definition: Definition, msg_type: str, steps: tuple[FieldStep, ...]
) -> Iterator[FieldRef]:
    """Yield the fields of primitive type in the message to which ``steps`` lead, in wire order."""
    for field in definition.specs[msg_type].fields:
        here = (*steps, FieldStep(field.name, field.is_array and not field.is_primitive))
        if field.is_primitive:
            yield FieldRef(here, field.base, field.is_array)
        else:
            yield from _primitive_fields(definition, field.type, here)
