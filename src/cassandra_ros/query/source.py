# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the query language needs of a topic: whoever has the stored messages provides it."""

from __future__ import annotations

from typing import Callable, FrozenSet, Iterator, Optional, Protocol, Sequence, TypeVar

from cassandra_ros.keys import Position
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.query.plan.pushdown import Pushdown
from cassandra_ros.query.protocols import Row, Table

Columns = Callable[[Table], Optional[Sequence[str]]]
"""Gives for a table those of its columns that are to be read, in their order; None = all."""
Writers = Optional[FrozenSet[int]]
"""Writer ids whose messages are meant; None = all."""
RowT_co = TypeVar("RowT_co", bound=Row, covariant=True)


class Source(Protocol[RowT_co]):
    """The stored messages of one topic."""

    @property
    def name(self) -> str:
        """The topic's name."""

    @property
    def tables(self) -> Sequence[Table]:
        """Its tables, one for each definition and format; none before the first message."""

    def rows(
        self,
        key: Optional[int] = None,
        to_key: Optional[int] = None,
        *,
        nodeID: Optional[str] = None,
        limit: Optional[int] = None,
        after: Optional[Position] = None,
        reverse: bool = False,
        columns: Optional[Columns] = None,
        chooser: Optional[Pushdown] = None,
        run: Writers = None,
        wanted: Optional[int] = None,
    ) -> Iterator[RowT_co]:
        """Walk through the rows with a time in [key, to_key], ns, in its order; None = open.

        Args:
            wanted: How many are probably taken; None = limit.
        """

    def versions(
        self,
        name: str,
        *,
        nodeID: Optional[str] = None,
        reverse: bool = False,
        run: Writers = None,
    ) -> Iterator[RowT_co]:
        """Walk through the rows under one name, by time; InvalidKey: none can have such a name."""

    def countTopicData(
        self,
        key: Optional[Stamp] = None,
        to_key: Optional[Stamp] = None,
        nodeID: Optional[str] = None,
        *,
        run: Writers = None,
    ) -> int:
        """Count the rows with a time in [key, to_key]."""

    def countBuckets(self) -> int:
        """Count its partitions: time ranges of a node in a table."""
