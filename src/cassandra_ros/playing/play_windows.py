# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The option ``around``: only windows around certain messages are played."""

from __future__ import annotations

from typing import NamedTuple, Optional

from cassandra_ros.errors import InvalidOption
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.playing.play_times import check_length
from cassandra_ros.topics.row_finder import Where

PIECE_NS = 60 * SECOND_NS
"""Maximum length of a piece of a window, ns.

Longer windows are played in pieces, so that playing can begin before all hits are known.
"""


class WindowRule(NamedTuple):
    """The messages around which windows are played (hits), and the lengths of a window."""

    topic: str
    condition: Where
    before: int
    """Length of a window before a hit, ns."""
    after: int
    """Length of a window after a hit, ns."""

    @classmethod
    def of(cls, around: object, before: object, after: object) -> Optional[WindowRule]:
        """Read the options around ('TOPIC: condition' or a pair), before and after (seconds).

        Returns:
            None if ``around`` is not given.

        Raises:
            InvalidOption: One of the options cannot be read.
        """
        reach = check_length("before", before), check_length("after", after)
        if around is None:
            return None
        pair = around.split(":", 1) if isinstance(around, str) else around
        if isinstance(pair, (tuple, list)) and len(pair) == 2 and isinstance(pair[0], str):
            topic, condition = pair[0].strip(), pair[1]
            if isinstance(condition, str):
                condition = condition.strip()
            if topic and condition:
                return cls(topic, condition, reach[0] or 0, reach[1] or 0)
        raise InvalidOption(
            f"around {around!r:.80} names no hits: write 'TOPIC: condition', for example "
            "'/battery: voltage < 11.0'"
        )
