# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""How large an answer may become that is made whole before it is sent or written.

A page ends after the row that makes it long enough, yet one row may hold a field a thousand times,
and one message may be as large as the store takes. So each answer counts its bytes while it is
made, and ends with an error before it takes more than MOST_BYTES.
"""

from __future__ import annotations

from cassandra_ros.errors import AnswerTooLarge
from cassandra_ros.query.tree.json_values import to_json

MOST_BYTES = 64 * 2**20
"""Maximum size of an answer, or of one row of it, bytes."""
_NUMBER = 2
"""Minimum length of an element of a list as JSON, with its comma, bytes."""


class AnswerBound:
    """The bytes of one answer, counted before each part of it is made.

    Args:
        what: What becomes too large, as the subject of the error's sentence.
        remedy: What to ask instead, as the end of that sentence.

    Attributes:
        bytes: The size of the parts so far.
    """

    def __init__(self, what: str, remedy: str) -> None:
        self._what, self._remedy = what, remedy
        self.bytes = 0

    def take(self, size: int) -> None:
        """Count a part that is about to be made, bytes.

        Raises:
            AnswerTooLarge: The answer would have more than MOST_BYTES. The part is not counted.
        """
        if self.bytes + size > MOST_BYTES:
            raise self.error()
        self.bytes += size

    def error(self) -> AnswerTooLarge:
        """Return the error that says so."""
        limit = f"more than {MOST_BYTES // 2**20} MiB"
        return AnswerTooLarge(f"{self._what} would take {limit}; {self._remedy}")

    def json(self, value: object) -> str:
        """Return a value of a result as JSON text, as to_json; see take."""
        least = least_bytes(value)
        self.take(least)
        text = to_json(value)
        self.take(max(0, len(text) - least))
        return text


def least_bytes(value: object) -> int:
    """Return how many bytes a value of a result takes as text, at least."""
    if isinstance(value, (str, bytes, bytearray)):
        return len(value)
    if not isinstance(value, list):
        return _NUMBER
    if value and isinstance(value[0], (str, bytes, bytearray, list)):
        return sum(map(least_bytes, value))
    return _NUMBER * len(value)
