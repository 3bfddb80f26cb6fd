# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A table whose files are not merged for a while."""

from __future__ import annotations

import time
from contextlib import contextmanager
from typing import Iterator, Mapping

from cassandra_ros.errors import StoreUnavailable
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.lock import SchemaLock
from cassandra_ros.store.names import quoteName, quoteText

QUIET_SEC = 30.0
"""How long merging that is going on is waited for."""
PAUSE_SEC = 0.05


@contextmanager
def paused(cassandra: Cassandra, keyspace: str, table: str, lock: SchemaLock) -> Iterator[None]:
    """Keep the files of a table from being merged; under the schema lock.

    Where an index is made just while a merge ends, Cassandra 5.0.8 takes the new file for a broken
    one and drops it from all indexes of the table: their rows are not found any more, without an
    error. A client that dies in here leaves the table unmerged until this is entered again.

    Raises:
        StoreUnavailable: The files are still being merged after 30 s.
    """
    options = _options(cassandra, keyspace, table)
    try:
        _alter(cassandra, keyspace, table, {**options, "enabled": "false"}, lock)
        _awaitQuiet(cassandra, keyspace, table, lock)
        yield
    finally:
        _alter(cassandra, keyspace, table, options, lock)


def resume(cassandra: Cassandra, keyspace: str, table: str, lock: SchemaLock) -> None:
    """Let the files of a table be merged again that somebody left paused; under the schema lock."""
    if _given(cassandra, keyspace, table).get("enabled", "true") != "true":
        _alter(cassandra, keyspace, table, _options(cassandra, keyspace, table), lock)


def _given(cassandra: Cassandra, keyspace: str, table: str) -> Mapping[str, str]:
    rows = cassandra.execute(
        "SELECT compaction FROM system_schema.tables WHERE keyspace_name = ? AND table_name = ?",
        (keyspace, table),
        what=f"reading how table {table} is compacted",
    )
    return {} if not rows else dict(rows[0][0])


def _options(cassandra: Cassandra, keyspace: str, table: str) -> dict[str, str]:
    given = _given(cassandra, keyspace, table)
    return {name: value for name, value in given.items() if name != "enabled"}


def _alter(
    cassandra: Cassandra, keyspace: str, table: str, options: Mapping[str, str], lock: SchemaLock
) -> None:
    pairs = ", ".join(f"{quoteText(name)}: {quoteText(value)}" for name, value in options.items())
    lock.renew()
    cassandra.schemaChange(
        f"ALTER TABLE {quoteName(keyspace)}.{quoteName(table)} WITH compaction = {{{pairs}}}",
        what=f"changing how table {table} is compacted",
    )


def tasks(cassandra: Cassandra, keyspace: str, table: str) -> dict[str, list[tuple[str, float]]]:
    """List what the nodes in reach are doing with the files of a table.

    Returns:
        Address of the node → pairs of kind and completion (0 to 1).
    """
    return cassandra.executeOnEach(
        "SELECT kind, completion_ratio FROM system_views.sstable_tasks "
        "WHERE keyspace_name = ? AND table_name = ?",
        (keyspace, table),
        what=f"asking whether table {table} is compacted",
    )


def _awaitQuiet(cassandra: Cassandra, keyspace: str, table: str, lock: SchemaLock) -> None:
    """Wait until no node in reach is rewriting files of a table, nor about to."""
    deadline = time.monotonic() + QUIET_SEC
    quiet = 0
    # One that was chosen just before it was forbidden may not be listed at once.
    while quiet < 2:
        busy = [task for rows in tasks(cassandra, keyspace, table).values() for task in rows]
        quiet = 0 if busy else quiet + 1
        if busy and time.monotonic() > deadline:
            kind, ratio = busy[0]
            raise StoreUnavailable(
                f"table {table} is being rewritten ({kind}, {100 * ratio:.0f} % done), and an "
                "index made meanwhile could miss rows; ask for it again when that has ended "
                "(nodetool compactionstats)"
            )
        lock.renew()
        time.sleep(PAUSE_SEC)
