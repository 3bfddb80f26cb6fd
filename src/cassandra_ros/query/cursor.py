# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where a result was left off, as a text that survives a restart of everybody."""

from __future__ import annotations

from typing import NamedTuple, Optional, Union

from cassandra_ros.errors import InvalidKey
from cassandra_ros.keys import Position, decodeCursor, encodeCursor

MAX_DIGITS = 18


class Place(NamedTuple):
    """Place in a result: behind some row of the message at a position."""

    given: int
    """Rows given so far, for the statement's LIMIT."""
    skip: int
    """Rows of the message at the position that were given; 0 = all."""
    position: Optional[Position]
    """None = the beginning."""

    @property
    def text(self) -> str:
        """The cursor that ``readPlace`` understands; '' at the beginning."""
        if self.position is None:
            return ""
        return f"{self.given}.{self.skip}.{encodeCursor(self.position)}"


START = Place(0, 0, None)


def readPlace(cursor: Union[str, Position, Place, None]) -> Place:
    """Read a cursor; a bare position means behind the message there.

    Raises:
        InvalidKey: It is none.
    """
    if cursor is None or cursor == "":
        return START
    if isinstance(cursor, Place):
        return cursor
    if isinstance(cursor, Position):
        return Place(0, 0, cursor)
    given, _, rest = str(cursor).partition(".")
    skip, _, position = rest.partition(".")
    if not all(n.isascii() and n.isdigit() and len(n) <= MAX_DIGITS for n in (given, skip)):
        raise InvalidKey(f"{str(cursor)[:80]!r} is not a cursor of this package")
    return Place(int(given), int(skip), decodeCursor(position))
