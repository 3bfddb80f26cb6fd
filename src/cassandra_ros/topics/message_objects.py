# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Stored rows with their messages as objects, which are made for many rows together."""

from __future__ import annotations

from typing import Any, Dict, Iterable, Iterator, List, Sequence, Tuple

from cassandra_ros.connection.cassandra import Cassandra
from cassandra_ros.errors import CassandraRosError
from cassandra_ros.messages.classes import deserialize_all
from cassandra_ros.topics.stored_row import StoredRow

MAX_ROWS = 512
"""Maximum number of rows whose messages are made together; a read begins with fewer."""
MAX_BYTES = 512 * 1024
"""Maximum number of serialised bytes of messages that are made together."""
LARGE_BYTES = 4 * 1024
"""Size in bytes above which messages are made one by one: copying their bytes would take as
long."""


def with_messages(
    cassandra: Cassandra, rows: Iterable[StoredRow]
) -> Iterator[Tuple[StoredRow, Any]]:
    """Yield each row with its message.

    Rows are taken ahead, never more than have been yielded. An error of a row, or of reading rows,
    is raised when its row would be yielded.

    Args:
        cassandra: Connection of the read; after it is closed no more rows are yielded.

    Raises:
        CorruptMessage: The bytes of a row are not a message of its type.
        ConnectionFailed: The connection was closed.
    """
    waiting: List[StoredRow] = []
    given = held = 0
    try:
        for row in rows:
            large = row.chunked or row.size > LARGE_BYTES
            if not large:
                waiting.append(row)
                held += row.size
            if large or len(waiting) >= min(MAX_ROWS, max(1, given)) or held >= MAX_BYTES:
                taken, waiting, held = waiting, [], 0
                given += len(taken) + large
                if taken:
                    yield from _made(cassandra, taken)
            if large:
                yield row, row.message()
    except CassandraRosError:
        yield from _made(cassandra, waiting)
        raise
    yield from _made(cassandra, waiting)


def _made(cassandra: Cassandra, rows: Sequence[StoredRow]) -> Iterator[Tuple[StoredRow, Any]]:
    messages: Iterable[Any]
    try:
        messages = _messages(rows)
    except CassandraRosError:  # one row is damaged: make the messages one by one
        messages = (row.message() for row in rows)
    for pair in zip(rows, messages):
        cassandra.require_open()
        yield pair


def _messages(rows: Sequence[StoredRow]) -> Iterable[Any]:
    """Return the messages of rows, made together for each class."""
    by_class: Dict[Any, List[int]] = {}
    for n, row in enumerate(rows):
        by_class.setdefault(row.message_class(), []).append(n)
    if len(by_class) == 1:
        (cls,) = by_class
        return deserialize_all(cls, [row.wire for row in rows])
    made: List[Any] = [None] * len(rows)
    for cls, members in by_class.items():
        found = deserialize_all(cls, [rows[n].wire for n in members])
        for n, message in zip(members, found):
            made[n] = message
    return made
