# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Builds of the indexes of a table on the nodes, and merges of its files, which must not overlap.

If an index is made just while a merge ends, Cassandra 5.0.8 takes the new file for a broken one and
drops it from all indexes of the table: rows in it are not found any more, without an error. Each
node builds the indexes of all tables one after the other. When a build begins, its set of files is
fixed, and they must not be merged before it ends.
"""

from __future__ import annotations

import logging
import time
from contextlib import contextmanager
from typing import AbstractSet, Iterator, Mapping

from cassandra_ros.errors import StoreUnavailable, TopicNotFound
from cassandra_ros.metadata import SHADOW
from cassandra_ros.store.connection.cassandra import Cassandra
from cassandra_ros.store.connection.cql_names import qualified, quote_text
from cassandra_ros.store.tables.side_tables import SchemaLock

_log = logging.getLogger(__name__)

MERGES_END_SEC = 30.0
"""How long to wait for merges that are in progress, s."""
BUILD_START_SEC = 30.0
"""How long Cassandra may take to begin to build an index, s."""
PAUSE_SEC = 0.05
"""Interval at which a wait asks the nodes, s."""
_ENABLED = "enabled"
"""Option of a table's compaction by which merging is forbidden."""
_BUILD = "secondary index build"
"""Kind of a task that builds an index."""


class IndexBuilds:
    """Pauses merges for the builds of one table's indexes, and waits for these builds.

    It acts on all reachable nodes, under the schema lock. If a client dies while merging is paused,
    it stays paused until another client calls ``resume_merging``.
    """

    def __init__(self, cassandra: Cassandra, keyspace: str, table: str, lock: SchemaLock) -> None:
        self._cassandra = cassandra
        self._keyspace = keyspace
        self._table = table
        self._lock = lock

    def pause_merging(self) -> None:
        """Forbid merging the table's files, and wait for merges in progress.

        After another error merging may stay paused, which is logged.

        Raises:
            StoreUnavailable: Files are still being merged after 30 s; merging is allowed again.
        """
        options = self._options()
        with self.paused_told():
            self._alter({**options, _ENABLED: "false"})
            busy = self._await_quiet()
            if busy:
                self._alter(options)
        if busy:
            raise StoreUnavailable(
                f"table {self._table} is being rewritten ({busy}), and an index made meanwhile "
                "could miss rows; ask for it again when that has ended (nodetool compactionstats)"
            )

    def resume_merging(self) -> None:
        """Allow merging again if a client has paused it; first wait until all builds have begun.

        Raises:
            StoreUnavailable: A build has not begun after 30 s; merging stays paused.
        """
        options = self._options()
        if options.pop(_ENABLED, "true") != "true":
            self.await_builds(self.indexes(), BUILD_START_SEC)
            self._alter(options)

    @contextmanager
    def paused_told(self) -> Iterator[None]:
        """Run a block; if it fails, log that merging stays paused."""
        try:
            yield
        except BaseException:
            self.tell_paused()
            raise

    def tell_paused(self) -> None:
        """Log that merging stays paused, and how to resume it."""
        _log.warning(
            "the files of table %s are not merged until createIndex or removeIndex is called for "
            "its topic, for any field",
            self._table,
        )

    def _options(self) -> dict[str, str]:
        rows = self._cassandra.system_schema("tables", "compaction", self._keyspace, self._table)
        if not rows:
            raise TopicNotFound(f"table {self._keyspace}.{self._table} was removed meanwhile")
        return dict(rows[0][0])

    def _alter(self, options: Mapping[str, str]) -> None:
        pairs = ", ".join(f"{quote_text(k)}: {quote_text(v)}" for k, v in options.items())
        self._lock.change(
            f"ALTER TABLE {qualified(self._keyspace, self._table)} WITH compaction = {{{pairs}}}",
            what=f"changing how table {self._table} is compacted",
        )

    def _await_quiet(self) -> str:
        """Wait until no node merges files of the table; return what is left after 30 s, or ''."""
        deadline = time.monotonic() + MERGES_END_SEC
        quiet = 0
        # A merge that was chosen just before merging was forbidden may be listed a moment later.
        while quiet < 2:
            busy = [task for node_tasks in self.tasks().values() for task in node_tasks]
            quiet = 0 if busy else quiet + 1
            if busy and time.monotonic() > deadline:
                kind, ratio = busy[0]
                return f"{kind}, {100 * ratio:.0f} % done"
            self._lock.renew()
            time.sleep(PAUSE_SEC)
        return ""

    def tasks(self) -> dict[str, list[tuple[str, float]]]:
        """Return the tasks of each node: address → pairs of kind and completion (0 to 1)."""
        return self._cassandra.execute_on_each(
            "SELECT kind, completion_ratio FROM system_views.sstable_tasks "
            "WHERE keyspace_name = ? AND table_name = ?",
            (self._keyspace, self._table),
            what=f"asking whether table {self._table} is compacted",
        )

    def indexes(self) -> set[str]:
        """Return the names of the table's indexes that belong to this package."""
        rows = self._cassandra.system_schema("indexes", "index_name", self._keyspace, self._table)
        return {name for (name,) in rows if name.startswith(self._table + SHADOW)}

    def drop_index(self, index: str) -> None:
        """Drop an index of the table by its name. If its build still waits, it runs without it.

        Raises:
            StoreUnavailable: It failed, and failed again when it was repeated.
        """
        what = f"dropping an index of table {self._table}"
        cql = f"DROP INDEX IF EXISTS {qualified(self._keyspace, index)}"
        try:
            self._lock.change(cql, what=what)
        except StoreUnavailable as exc:
            # On a busy machine Cassandra 5.0.8 may fail by a null pointer of its own, before or
            # after the index was dropped.
            _log.info("index %s is dropped again if it is still there: %s", index, exc)
            self._cassandra.await_same_schema(what)
            if index in self.indexes():
                self._lock.change(cql, what=what)

    def await_builds(self, names: AbstractSet[str], seconds: float) -> None:
        """Wait until each node has begun the last of the table's indexes, or has built them all.

        Args:
            names: Names of all indexes that the schema has for the table.

        Raises:
            StoreUnavailable: A node has not begun after ``seconds``.
        """
        deadline = time.monotonic() + seconds
        while not self._has_begun_on_each(names):
            if time.monotonic() > deadline:
                raise StoreUnavailable(
                    f"Cassandra has not begun to build an index of table {self._table} within "
                    f"{seconds:.0f} s: it builds one after the other, and is busy with those of "
                    "other tables (nodetool compactionstats); ask again when that has ended"
                )
            self._lock.renew()
            time.sleep(PAUSE_SEC)

    def _has_begun_on_each(self, names: AbstractSet[str]) -> bool:
        """Return whether each node has begun to build every index; see ``begun``."""
        answers = self._cassandra.execute_on_each(
            "SELECT table_name, index_name, is_building FROM system_views.sai_column_indexes "
            "WHERE keyspace_name = ?",
            (self._keyspace,),
            what=f"waiting for an index of table {self._table}",
        )
        at_work = self.tasks()
        return all(
            begun(
                names,
                {name: unbuilt for owner, name, unbuilt in rows if owner == self._table},
                any(kind == _BUILD for kind, _ in at_work.get(node, ())),
            )
            for node, rows in answers.items()
        )


def begun(names: AbstractSet[str], builds: Mapping[str, bool], at_work: bool) -> bool:
    """Return whether a node has begun to build every index that the schema has for a table.

    Args:
        names: Names of the table's indexes in the schema.
        builds: Indexes that the node lists, name → whether its build waits or runs.
        at_work: Whether the node is building an index of the table.
    """
    unbuilt = sum(builds.values())
    # With two unbuilt indexes it is not known which of them the node is building.
    return names <= builds.keys() and (not unbuilt or (unbuilt == 1 and at_work))
