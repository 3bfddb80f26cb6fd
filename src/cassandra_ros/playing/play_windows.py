# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Around what windows are played, and in how long pieces."""

from __future__ import annotations

from typing import NamedTuple, Optional

from cassandra_ros.errors import InvalidOption
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.playing.times import check_length
from cassandra_ros.topics.row_finder import Where

PIECE_NS = 60 * SECOND_NS
"""A window that is longer is given in pieces: its hits need not all be known to begin with it."""


class Around(NamedTuple):
    """What windows are made around."""

    topic: str
    condition: Where
    before: int
    """How far a window reaches before a hit, ns."""
    after: int

    @classmethod
    def of(cls, around: object, before: object, after: object) -> Optional[Around]:
        """Read the options around, 'TOPIC: condition' or a pair, before and after, seconds.

        None where around is not given; InvalidOption where one of them is none.
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
