# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where a row lies: its position in the total order of a topic, cursors, writer ids."""

from __future__ import annotations

import base64
import json
import secrets
from typing import Iterable, NamedTuple

from cassandra_ros.errors import InvalidKey

KEY_FORMATS = ("time", "msg_part", "hash", "manual")
NAMED_FORMATS = ("hash", "manual")
"""Key formats whose rows are found by a text, not by their time."""
SECOND_NS = 1_000_000_000
MAX_NS = 2**32 * SECOND_NS - 1
"""The largest key: ROS 1 counts seconds in 32 bits (February 2106)."""

_LAST = chr(0x10FFFF)
"""Behind the names of all tables."""
_KINDS = [int, str, int, str]
MAX_WRITER = 2**31 - 1
COUNTER_BITS = 32


class Position(NamedTuple):
    """Place of a row in the one order that all reads and cursors follow."""

    t: int
    """Key time, nanoseconds since 1970."""
    node: str
    """nodeID, the entity that produced the message."""
    seq: int
    """Writer id << 32 | counter."""
    table: str
    name: str = ""
    """Key of a row that is found by name, else ''."""

    def among(self, tables: Iterable[str], reverse: bool = False) -> Position:
        """Return the place as it is among the rows of some tables.

        Where its own is none of them, another one has replaced that, and holds the row under a
        name that may come before or behind: the place is then behind all rows of its time, node
        and seq, in the direction of reading.
        """
        return self if self.table in tables else self._replace(table="" if reverse else _LAST)


class RowName(str):
    """The key of a message that is kept under a name (key formats ``manual`` and ``hash``).

    It is that text; besides it knows the one row that it was given for, so that ``getData`` of
    it gives this version, and ``getData`` of the plain text the newest.
    """

    t: int = 0
    """When this version was stored, ns."""
    node: str = ""
    seq: int = 0
    table: str = ""

    def __repr__(self) -> str:
        # As plain text where it is one, as the parts of a name that was given are.
        return f"RowName({str(self)!r} stored at {self.t} ns)" if self.table else repr(str(self))

    @classmethod
    def of(cls, position: Position) -> RowName:
        """Return the name of a row."""
        name = cls(position.name)
        name.t, name.node, name.seq, name.table = position[:4]
        return name


def new_writer_id() -> int:
    """Draw a writer id: 1 to 2**31 - 1."""
    return secrets.randbelow(MAX_WRITER) + 1


def writer_of(seq: int) -> int:
    """Return the writer id in a ``_seq``."""
    return seq >> COUNTER_BITS


def split_seq(seq: int) -> tuple[int, int]:
    """Return (writer id, counter) of a ``_seq``."""
    return seq >> COUNTER_BITS, seq & (2**COUNTER_BITS - 1)


def encode_cursor(position: Position) -> str:
    """Write a position as a short text without spaces."""
    parts = list(position) if position.name else list(position[:4])
    text = json.dumps(parts, separators=(",", ":"), ensure_ascii=False)
    return base64.urlsafe_b64encode(text.encode("utf-8", "surrogateescape")).decode("ascii")


def decode_cursor(text: str) -> Position:
    """Read a cursor back; InvalidKey where encode_cursor did not write it."""
    try:
        raw = base64.b64decode(text.encode("ascii"), altchars=b"-_", validate=True)
        parts = json.loads(raw.decode("utf-8", "surrogateescape"))
        if [type(part) for part in parts] not in (_KINDS, [*_KINDS, str]):
            raise TypeError(parts)
    except (TypeError, ValueError, RecursionError) as exc:
        raise InvalidKey(f"{text[:80]!r} is not a cursor of this package") from exc
    position = Position(*parts)
    if not (0 <= position.t <= MAX_NS and 0 <= position.seq < 2**63):
        raise InvalidKey(f"{text[:80]!r} is a cursor outside of all times and writers")
    return position


def is_behind(position: Position, after: Position | None, reverse: bool = False) -> bool:
    """Say whether a row comes after another in the direction of reading; None = before all."""
    if after is None:
        return True
    return position < after if reverse else position > after
