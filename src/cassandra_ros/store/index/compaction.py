# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A table whose files are not merged for a while.

Where an index is made just while a merge ends, Cassandra 5.0.8 takes the new file for a broken one
and drops it from all indexes of the table: their rows are not found any more, without an error.
"""

from __future__ import annotations

import logging
import time
from contextlib import contextmanager
from typing import Iterator, Mapping

from cassandra_ros.errors import StoreUnavailable, TopicNotFound
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.lock import SchemaLock
from cassandra_ros.store.names import quoteName, quoteText

_log = logging.getLogger(__name__)

QUIET_SEC = 30.0
"""How long merging that is going on is waited for."""
PAUSE_SEC = 0.05
_ENABLED = "enabled"


class Compaction:
    """The merging of one table's files, by the nodes in reach; under the schema lock.

    Who dies while it is paused leaves it so: it goes on when somebody resumes it.
    """

    def __init__(self, cassandra: Cassandra, keyspace: str, table: str, lock: SchemaLock) -> None:
        self._cassandra = cassandra
        self._keyspace = keyspace
        self._table = table
        self._lock = lock

    def paused(self) -> bool:
        """Tell whether somebody has paused it."""
        return self._options().get(_ENABLED, "true") != "true"

    def pause(self) -> None:
        """Forbid it, and wait for what is going on.

        Raises:
            StoreUnavailable: Files are still being merged after 30 s; it is allowed again.
        """
        options = self._options()
        with self.told():
            self._alter({**options, _ENABLED: "false"})
            busy = self._awaitQuiet()
            if busy:
                self._alter(options)
        if busy:
            raise StoreUnavailable(
                f"table {self._table} is being rewritten ({busy}), and an index made meanwhile "
                "could miss rows; ask for it again when that has ended (nodetool compactionstats)"
            )

    def resume(self) -> None:
        """Allow it."""
        self._alter({name: value for name, value in self._options().items() if name != _ENABLED})

    @contextmanager
    def told(self) -> Iterator[None]:
        """Log that it stays paused where the block fails."""
        try:
            yield
        except BaseException:
            self.tell()
            raise

    def tell(self) -> None:
        """Log that it stays paused, and what ends that."""
        _log.warning(
            "the files of table %s are not merged until createIndex or removeIndex is called for "
            "its topic, for any field",
            self._table,
        )

    def _options(self) -> dict[str, str]:
        rows = self._cassandra.execute(
            "SELECT compaction FROM system_schema.tables "
            "WHERE keyspace_name = ? AND table_name = ?",
            (self._keyspace, self._table),
            what=f"reading how table {self._table} is compacted",
        )
        if not rows:
            raise TopicNotFound(f"table {self._keyspace}.{self._table} was removed meanwhile")
        return dict(rows[0][0])

    def _alter(self, options: Mapping[str, str]) -> None:
        pairs = ", ".join(f"{quoteText(k)}: {quoteText(v)}" for k, v in options.items())
        self._lock.renew()
        self._cassandra.schemaChange(
            f"ALTER TABLE {quoteName(self._keyspace)}.{quoteName(self._table)} "
            f"WITH compaction = {{{pairs}}}",
            what=f"changing how table {self._table} is compacted",
        )

    def _awaitQuiet(self) -> str:
        """Wait until no node in reach is rewriting files of the table, nor about to.

        Returns:
            What is still being done after 30 s, or ''.
        """
        deadline = time.monotonic() + QUIET_SEC
        quiet = 0
        # One that was chosen just before it was forbidden may not be listed at once.
        while quiet < 2:
            every = tasks(self._cassandra, self._keyspace, self._table)
            busy = [task for found in every.values() for task in found]
            quiet = 0 if busy else quiet + 1
            if busy and time.monotonic() > deadline:
                kind, ratio = busy[0]
                return f"{kind}, {100 * ratio:.0f} % done"
            self._lock.renew()
            time.sleep(PAUSE_SEC)
        return ""


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
