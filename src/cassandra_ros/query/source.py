# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The interface to a topic that the query language needs; the caller provides it."""

from __future__ import annotations

from typing import Callable, FrozenSet, Iterator, Optional, Protocol, Sequence, TypeVar

from cassandra_ros.keys import Position
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.query.plan.pushdown import Pushdown
from cassandra_ros.query.protocols import Row, Table

Columns = Callable[[Table], Optional[Sequence[str]]]
"""Function from a table to the names of its columns to be read, in their order; None = all."""
Writers = Optional[FrozenSet[int]]
"""Writer ids whose messages are read; None = all."""
RowT_co = TypeVar("RowT_co", bound=Row, covariant=True)


class Source(Protocol[RowT_co]):
    """The stored messages of one topic."""

    @property
    def name(self) -> str:
        """Name of the topic."""

    @property
    def tables(self) -> Sequence[Table]:
        """Tables of the topic, one for each definition and format.

        Empty before the first message.
        """

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
        """Yield the rows with a time in [key, to_key], ns, in time order; None = open.

        Args:
            wanted: Number of rows that will probably be taken; None = limit.
        """

    def versions(
        self,
        name: str,
        *,
        nodeID: Optional[str] = None,
        reverse: bool = False,
        run: Writers = None,
    ) -> Iterator[RowT_co]:
        """Yield the rows with a name, in time order; InvalidKey: the name is invalid."""

    def countTopicData(
        self,
        key: Optional[Stamp] = None,
        to_key: Optional[Stamp] = None,
        nodeID: Optional[str] = None,
        *,
        run: Writers = None,
    ) -> int:
        """Return the number of rows with a time in [key, to_key]."""

    def countBuckets(self) -> int:
        """Return the number of partitions: time ranges of a node in a table."""
