# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The interface to a topic that the query language needs; the caller provides it."""

from __future__ import annotations

from typing import Iterator, Protocol, Sequence, TypeVar

from cassandra_ros.query.protocols import Row, Table
from cassandra_ros.read import Read

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

    def read(self, read: Read) -> Iterator[RowT_co]:
        """Yield the rows that a read asks for, in its order.

        Raises:
            InvalidKey: The read asks for an invalid name.
        """

    def count(self, read: Read) -> int:
        """Return the number of rows in the time range of a read, of its nodes and writers."""

    def countBuckets(self) -> int:
        """Return the number of partitions: time ranges of a node in a table."""
