# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Limit on the size of an answer that is made whole before it is sent or written.

A page ends after the row that reaches the page size. But one row may contain a field a thousand
times, and a message may be as large as the store accepts. Therefore each answer counts its bytes
while it is made, and fails before it takes more than MAX_ANSWER_BYTES.
"""

from __future__ import annotations

from cassandra_ros.errors import AnswerTooLarge
from cassandra_ros.query.tree.json_values import to_json

MAX_ANSWER_BYTES = 64 * 2**20
"""Maximum size of an answer, or of one row of it, bytes."""
_NUMBER = 2
"""Minimum length of an element of a list as JSON, with its comma, bytes."""


class AnswerBound:
    """Counter of the bytes of one answer, called before each part of it is made.

    Args:
        what: Name of what becomes too large, as the subject of the error's sentence.
        remedy: What to do instead, as the end of that sentence.

    Attributes:
        bytes: Size of the parts so far, bytes.
    """

    def __init__(self, what: str, remedy: str) -> None:
        self._what, self._remedy = what, remedy
        self.bytes = 0

    def count_part(self, size: int) -> None:
        """Count a part of ``size`` bytes that is about to be made.

        Raises:
            AnswerTooLarge: The answer would have more than MAX_ANSWER_BYTES. The part is not
                counted.
        """
        if self.bytes + size > MAX_ANSWER_BYTES:
            raise self.error()
        self.bytes += size

    def error(self) -> AnswerTooLarge:
        """Return the error for an answer that is too large."""
        limit = f"more than {MAX_ANSWER_BYTES // 2**20} MiB"
        return AnswerTooLarge(f"{self._what} would take {limit}; {self._remedy}")

    def json(self, value: object) -> str:
        """Count a value of a result and return it as JSON text, like to_json.

        Raises as ``count_part``.
        """
        least = least_bytes(value)
        self.count_part(least)
        text = to_json(value)
        self.count_part(max(0, len(text) - least))
        return text


def least_bytes(value: object) -> int:
    """Return the minimum size of a value of a result as text, bytes."""
    if isinstance(value, (str, bytes, bytearray)):
        return len(value)
    if not isinstance(value, list):
        return _NUMBER
    if value and isinstance(value[0], (str, bytes, bytearray, list)):
        return sum(map(least_bytes, value))
    return _NUMBER * len(value)
