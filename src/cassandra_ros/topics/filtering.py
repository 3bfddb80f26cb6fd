# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The messages that a ``where=`` means."""

from __future__ import annotations

from typing import Any, Iterator, Optional, Sequence, Tuple, Union

from cassandra_ros.errors import InvalidQuery
from cassandra_ros.query.conditions import Condition
from cassandra_ros.query.protocols import Source
from cassandra_ros.topics.selection import LAST_NS
from cassandra_ros.topics.stored_row import StoredRow

Where = Union[str, Tuple[str, Sequence[Any]]]
"""A condition: what stands behind WHERE in CQL, or that and the values of its ``?``."""


class Filter:
    """The rows of one topic that satisfy a condition.

    A message satisfies a condition on the elements of an array of messages when one element does.

    Args:
        topic: Whose rows.
        where: The condition.
        nodeID: Only messages of this node; None = of all.

    Attributes:
        text: The condition as it was given.
        test: Tells whether a row of the topic satisfies it, whatever its node.

    Raises:
        InvalidQuery: It is no condition, or none on the topic's fields.
    """

    def __init__(
        self, topic: Source[StoredRow], where: Where, nodeID: Optional[str] = None
    ) -> None:
        self.text, params = _parts(where)
        self._topic = topic
        self._condition = Condition(self.text, params, nodeID)
        self.test = self._condition.test(topic.tables)

    def rows(
        self, low: int = 0, high: int = LAST_NS, *, reverse: bool = False, bare: bool = False
    ) -> Iterator[StoredRow]:
        """Walk through the rows with t in [low, high], ns, that satisfy it, in order of time.

        Args:
            low, high: Both included.
            reverse: Newest first.
            bare: Only keys are wanted, no messages.
        """
        return self._condition.rows(self._topic, low, high, reverse=reverse, bare=bare)


def _parts(where: Any) -> Tuple[str, Sequence[Any]]:
    if isinstance(where, str):
        return where, ()
    if isinstance(where, (tuple, list)) and len(where) == 2 and isinstance(where[0], str):
        return where[0], where[1]
    raise InvalidQuery(
        repr(where)[:200], 0, "where= takes a condition as text, or a pair (text, parameters)"
    )
