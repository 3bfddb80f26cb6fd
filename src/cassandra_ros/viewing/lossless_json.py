# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Values of a result as JSON without loss: numbers that JavaScript cannot hold become texts."""

from __future__ import annotations

import base64
import math
from typing import Sequence

from cassandra_ros.messages.stamps import is_time
from cassandra_ros.query.tree.json_values import AnswerBound
from cassandra_ros.viewing.answers import Json

_EXACT = 2**53
_FLOAT_BYTES = 20
"""Approximate length of a float with all its digits, characters."""
_FEWER = (
    "select fewer columns, one element of an array as data[0], or len(…) of it, or give cut, which "
    "shortens long values"
)


class JsonConverter:
    """A converter of values to JSON for one answer.

    Args:
        cut: Maximum number of elements of arrays, texts and bytes; longer ones become {first, of}.
            None = all elements.

    Converting raises AnswerTooLarge when all values together are larger than an answer may be.
    """

    def __init__(self, cut: int | None) -> None:
        self._cut = cut
        self._bound = AnswerBound("a row of the answer", _FEWER)

    @property
    def size(self) -> int:
        """Approximate size of the values converted so far, bytes."""
        return self._bound.bytes

    def shown(self, value: object) -> Json:
        """Return a value of a row as JSON; raises AnswerTooLarge."""
        self._bound.count_part(_FLOAT_BYTES if isinstance(value, float) else 8)
        if isinstance(value, (str, bytes, bytearray, list)):
            return self._several(value)
        if value is None or isinstance(value, bool):
            return value
        if isinstance(value, int):
            return int(value) if abs(value) <= _EXACT else str(int(value))
        if isinstance(value, float):
            return float(value) if math.isfinite(value) else repr(float(value))
        to_nsec = getattr(value, "to_nsec", None)
        return str(value) if to_nsec is None else str(to_nsec())

    def _several(self, value: str | bytes | bytearray | list[object]) -> Json:
        count = len(value)
        first = value if self._cut is None or count <= self._cut else value[: self._cut]
        if isinstance(first, list):
            shown: Json = [self.shown(element) for element in first]
        else:
            self._bound.count_part(len(first))
            text = first if isinstance(first, str) else base64.b64encode(first).decode("ascii")
            shown = str(text)
        return shown if first is value else {"first": shown, "of": count}

    def time_in(self, row: Sequence[object]) -> Json:
        """Return the first value of a row that is a time, ns; None = the row has no time."""
        time = next((value for value in row if is_time(value)), None)
        to_nsec = getattr(time, "to_nsec", None)
        return None if to_nsec is None else str(to_nsec())
