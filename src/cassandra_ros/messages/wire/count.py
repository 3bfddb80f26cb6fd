# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""How many objects a message would become, asked of the few types where bytes do not bound it.

An array of empty messages takes four bytes, whatever it counts; genpy makes an object of each.
"""

from __future__ import annotations

import struct
from typing import Callable, Mapping

from cassandra_ros.messages.shape import objectCounts
from cassandra_ros.messages.spec import Field, MessageSpec
from cassandra_ros.messages.wire.skip import compileFieldSkip, fixedSize

MAX_SURPLUS = 1 << 20
"""Objects that a message may have beyond one for each byte."""

_length = struct.Struct("<I").unpack_from


def compileObjectCheck(
    msg_type: str, specs: Mapping[str, MessageSpec]
) -> Callable[[bytes], None] | None:
    """Return the check of a type, None where the size of a message bounds its objects.

    The check raises struct.error.
    """
    objects = objectCounts(msg_type, specs)
    if objects is None:
        return None
    counts = objects

    def check(wire: bytes) -> None:
        _Counter(wire, specs, counts).message(msg_type, 0)

    return check


class _Counter:
    def __init__(
        self, wire: bytes, specs: Mapping[str, MessageSpec], objects: Mapping[str, int]
    ) -> None:
        self._wire = wire
        self._specs = specs
        self._objects = objects
        self._left = len(wire) + MAX_SURPLUS

    def message(self, name: str, at: int) -> int:
        """Count what a message holds in arrays; return where it ends."""
        for field in self._specs[name].fields:
            if field.is_primitive:
                at = compileFieldSkip(field, self._specs)(self._wire, at)
            elif field.is_array:
                at = self._array(field, at)
            else:
                at = self.message(field.type, at)
        return at

    def _array(self, field: Field, at: int) -> int:
        count = field.length
        if count is None:
            (count,) = _length(self._wire, at)
            at += 4
        self._left -= count * self._objects[field.type]
        if self._left < 0:
            raise struct.error("an array counts too many empty messages")
        if fixedSize(field.type, self._specs) == 0:
            return at
        for _ in range(count):
            at = self.message(field.type, at)
        return at
