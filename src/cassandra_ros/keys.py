# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Positions of rows in the total order of a topic, cursors, writer ids."""

from __future__ import annotations

import base64
import json
import secrets
from typing import Iterable, NamedTuple

from cassandra_ros.errors import InvalidKey

KEY_FORMATS = ("time", "msg_part", "hash", "manual")
NAMED_FORMATS = ("hash", "manual")
"""Key formats whose rows are found by a name, not by a time."""
SECOND_NS = 1_000_000_000
MAX_NS = 2**32 * SECOND_NS - 1
"""Maximum key time, ns: ROS 1 counts seconds in 32 bits (February 2106)."""

_LAST = chr(0x10FFFF)
"""Text that sorts after the names of all tables."""
_KINDS = [int, str, int, str]
"""Types of the first four fields of Position."""
MAX_WRITER = 2**31 - 1
"""Maximum writer id."""
COUNTER_BITS = 32
"""Number of bits of the counter in a ``_seq``."""


class Position(NamedTuple):
    """The position of a row in the order that all reads and cursors follow."""

    t: int
    """Key time, ns since 1970."""
    node: str
    """nodeID: the robot that produced the message."""
    seq: int
    """Writer id << 32 | counter."""
    table: str
    name: str = ""
    """Name of a row that is found by its name, else ''."""

    def among(self, tables: Iterable[str], reverse: bool = False) -> Position:
        """Return the position relative to the rows of some tables.

        If the row's table is not among them, another table has replaced it. The name of that table
        may sort before or after the old name. So the result is a position after all rows with the
        same time, robot and seq, in the direction of reading.
        """
        return self if self.table in tables else self._replace(table="" if reverse else _LAST)


class RowName(str):
    """The key of a message that is stored under a name (key formats ``manual`` and ``hash``).

    It equals the name, but also identifies one row: ``getData`` with this object returns that
    version of the message, ``getData`` with the plain text the newest version.
    """

    t: int = 0
    """Time at which this version was stored, ns."""
    node: str = ""
    seq: int = 0
    table: str = ""

    def __repr__(self) -> str:
        # A RowName without a row (made by a text method, say) is shown as a plain text.
        return f"RowName({str(self)!r} stored at {self.t} ns)" if self.table else repr(str(self))

    @classmethod
    def of(cls, position: Position) -> RowName:
        """Return the name of the row at a position."""
        name = cls(position.name)
        name.t, name.node, name.seq, name.table = position[:4]
        return name


def new_writer_id() -> int:
    """Return a random writer id, 1 to 2**31 - 1."""
    return secrets.randbelow(MAX_WRITER) + 1


def writer_of(seq: int) -> int:
    """Return the writer id in a ``_seq``."""
    return seq >> COUNTER_BITS


def split_seq(seq: int) -> tuple[int, int]:
    """Return (writer id, counter) of a ``_seq``."""
    return seq >> COUNTER_BITS, seq & (2**COUNTER_BITS - 1)


def encode_cursor(position: Position) -> str:
    """Return a position as a short text without spaces."""
    parts = list(position) if position.name else list(position[:4])
    text = json.dumps(parts, separators=(",", ":"), ensure_ascii=False)
    return base64.urlsafe_b64encode(text.encode("utf-8", "surrogateescape")).decode("ascii")


def decode_cursor(text: str) -> Position:
    """Return the position in a cursor.

    Raises:
        InvalidKey: The text was not made by encode_cursor, or its time or writer cannot exist.
    """
    try:
        raw = base64.b64decode(text.encode("ascii"), altchars=b"-_", validate=True)
        parts = json.loads(raw.decode("utf-8", "surrogateescape"))
        if [type(value) for value in parts] not in (_KINDS, [*_KINDS, str]):
            raise TypeError(parts)
    except (TypeError, ValueError, RecursionError) as exc:
        raise InvalidKey(f"{text[:80]!r} is not a cursor of this package") from exc
    position = Position(*parts)
    if not (0 <= position.t <= MAX_NS and 0 <= position.seq < 2**63):
        raise InvalidKey(f"{text[:80]!r} is a cursor outside of all times and writers")
    return position


def is_after(position: Position, after: Position | None, reverse: bool = False) -> bool:
    """Return whether a row comes after another one in the direction of reading.

    Args:
        position: Position of the row.
        after: Position of the other row; None = before all rows.
        reverse: Whether rows are read from the last to the first.
    """
    if after is None:
        return True
    return position < after if reverse else position > after
