# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Nesting depth, size and md5 of message definitions."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

from cassandra_ros.errors import DefinitionError
from cassandra_ros.messages.spec import PRIMITIVE_SIZES, Field, Specs

MAX_DEPTH = 64
"""Maximum nesting depth of messages."""
MAX_FIXED_BYTES = 1 << 26
"""Maximum of what a message takes at least, bytes: on the wire, and by OBJECT_BYTES in memory."""
OBJECT_BYTES = 16
"""Bytes counted for each message in a fixed array: an empty message takes memory too."""
MAX_LEAVES = 1 << 12
"""Maximum number of fields of a message, nested fields included. It can grow exponentially with
the nesting depth."""


@dataclass(frozen=True)
class _Shape:
    """Depth and size of a type."""

    height: int
    """Nesting depth of the messages in it; -1 for a primitive type."""
    leaves: int
    """Number of fields, nested ones included; a nested message without fields counts as one."""
    least_bytes: int
    """Minimum size on the wire, bytes."""
    objects: int
    """Number of messages in one such message, itself included; variable arrays count as empty."""


def check_shape(msg_type: str, specs: Specs) -> None:
    """Check that a type is not recursive and within depth and size limits; else DefinitionError."""
    _shape(msg_type, specs, {}, ())


def object_counts(msg_type: str, specs: Specs) -> dict[str, int] | None:
    """Return the number of objects in a message of each type, if a few bytes can mean many objects.

    That is possible only if a message without bytes is nested in the type; else return None.
    """
    shapes: dict[str, _Shape] = {}
    _shape(msg_type, specs, shapes, ())
    if all(shape.least_bytes for name, shape in shapes.items() if name != msg_type):
        return None
    return {name: shape.objects for name, shape in shapes.items()}


def _shape(name: str, specs: Specs, shapes: dict[str, _Shape], path: tuple[str, ...]) -> _Shape:
    """Return the shape of a type and keep it in ``shapes``; DefinitionError: it is refused.

    ``path``: the types that contain it.
    """
    if name in shapes:
        return shapes[name]
    if name in path:
        raise DefinitionError(f"message type {name} contains itself")
    if len(path) > MAX_DEPTH:
        raise DefinitionError(f"message type {path[0]} is nested deeper than {MAX_DEPTH}")
    height, leaves, least, objects = 0, 0, 0, 1
    for field in specs[name].fields:
        element = _Shape(-1, 1, PRIMITIVE_SIZES.get(field.type, 0), 0)
        if not field.is_primitive:
            element = _shape(field.type, specs, shapes, (*path, name))
        height = max(height, element.height + 1)
        leaves += max(1, element.leaves)
        count = _count(name, field, element)
        least += 4 if count is None else count * element.least_bytes
        objects += (count or 0) * element.objects
    if height > MAX_DEPTH:
        raise DefinitionError(f"message type {name} is nested deeper than {MAX_DEPTH}")
    if leaves > MAX_LEAVES:
        raise DefinitionError(f"message type {name} has over {MAX_LEAVES} fields in all")
    if max(least, objects * OBJECT_BYTES) > MAX_FIXED_BYTES:
        raise DefinitionError(f"the fixed arrays of message type {name} exceed 2**26 bytes")
    shapes[name] = _Shape(height, leaves, least, objects)
    return shapes[name]


def _count(name: str, field: Field, element: _Shape) -> int | None:
    """Return the number of elements of a field; None if the message carries it."""
    if not field.is_array or field.length is None:
        return None if field.is_array else 1
    if field.length * max(1, element.least_bytes) > MAX_FIXED_BYTES:
        raise DefinitionError(f"{field.full_type} {field.name} of {name} exceeds 2**26 bytes")
    return field.length


def compute_md5(msg_type: str, specs: Specs) -> dict[str, str]:
    """Return the md5 of a checked type and of each type that it uses, as genmsg computes it.

    The md5 covers the constants, then the fields; message types are replaced by their md5.
    """
    sums: dict[str, str] = {}

    def md5(name: str) -> str:
        if name not in sums:
            lines = [f"{c.type} {c.name}={c.text}\n" for c in specs[name].constants]
            for field in specs[name].fields:
                kind = field.declared or field.full_type
                lines.append(f"{kind if field.is_primitive else md5(field.type)} {field.name}\n")
            text = "".join(lines).strip().encode("utf-8", "surrogateescape")
            sums[name] = hashlib.md5(text).hexdigest()
        return sums[name]

    md5(msg_type)
    return sums
