# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A keyspace, the tables in it that do not belong to one topic, and the schema lock.

``IF NOT EXISTS`` on two coordinators gives the union of the columns, and two ALTERs can lose a
comment: Cassandra 4 and 5 change the schema without consensus. So every DDL statement is sent
by the holder of a row in ``cr_lock``, taken with a lightweight transaction.
"""

from __future__ import annotations

import difflib
import logging
import math
import re
import threading
import time
import uuid
from copy import copy
from typing import Callable, Mapping, Sequence, TypeVar

from cassandra_ros.errors import (
    CassandraRosError,
    InvalidName,
    KeyspaceNotFound,
    SchemaConflict,
    StoreUnavailable,
    TopicNotFound,
)
from cassandra_ros.metadata import SIDE_COMMENT
from cassandra_ros.store.connection.cassandra import Cassandra, CqlRow, SchemaChange
from cassandra_ros.store.connection.cql_names import qualified, quote_name, quote_text
from cassandra_ros.store.connection.requests import RETRY_SEC, Seconds

_log = logging.getLogger(__name__)
_Rows = TypeVar("_Rows")

LOCK_TTL_SEC = 120
"""Time after which the schema lock of a program that was killed runs out, s."""
WAIT_SEC = 150.0
"""Maximum time to wait for the schema lock, s."""
TELL_SEC = 5.0
"""Time after which a program that waits for the schema lock says so, s."""
MADE_SEC = 10.0
"""Maximum time for which a listed table may not be readable yet, s."""
_TRIES = 8
"""Maximum number of attempts for a lightweight transaction that times out."""
CHANGES_A_RENEWAL = 8
"""Number of DDL statements before which the lock is renewed, if it is older than LOCK_RENEWAL_SEC.
Even on a machine so busy that each takes some seconds they end long before the lock runs out."""
LOCK_RENEWAL_SEC = 1.0
"""Time after which the lock is renewed before further tables are made, s."""
_SCHEMA = "schema"
"""Name of the schema lock in the table of locks."""
_LOCK = "cr_lock"
_LOCK_COLUMNS = "name text PRIMARY KEY, owner uuid"

SIDE_TABLES = {
    # Connection headers without the definition, with the offset where it was cut out.
    "cr_connection": (
        "tbl text, conn bigint, topic text, number int, header blob, def_offset int, "
        "md5sum text, def_hash blob, PRIMARY KEY ((tbl, conn))"
    ),
    # Texts with different comments have the same md5sum, so the hash of the text identifies it.
    "cr_definition": "md5sum text, hash blob, text blob, PRIMARY KEY ((md5sum, hash))",
    # Directory: the (slot, node) pairs of each table, and every bucket of each pair by writer.
    "cr_node": "tbl text, slot bigint, node text, PRIMARY KEY ((tbl), slot, node)",
    "cr_bucket": (
        "tbl text, node text, slot bigint, bucket bigint, writer bigint, state text, "
        "heartbeat timestamp, n bigint, bytes bigint, largest bigint, t_min bigint, "
        "t_max bigint, odd bigint, deleted boolean, filled frozen<set<text>>, "
        "PRIMARY KEY ((tbl, node, slot), bucket, writer)"
    ),
    # The same entries in the order of time, for questions about all robots: in one column, because
    # a server reads a row of eleven in three times the time. See store/tables/directory.py.
    "cr_active": (
        "tbl text, slot bigint, bucket bigint, node text, writer bigint, entry blob, "
        "heartbeat timestamp, deleted boolean, "
        "PRIMARY KEY ((tbl, slot), bucket, node, writer)"
    ),
    # Recordings and imports; the writer id is the upper half of the _seq of their rows.
    "cr_run": (
        "node text, writer bigint, kind text, name text, source text, format text, "
        "host text, started timestamp, ended timestamp, labels frozen<map<text, text>>, "
        "stored frozen<map<text, bigint>>, lost frozen<map<text, bigint>>, "
        "PRIMARY KEY ((writer), node)"
    ),
}
LATER_TABLES = {
    # Many keyspaces never need these tables: each is made before its first row is written.
    # Messages that could not be recorded:
    "cr_loss": (
        "topic text, node text, writer bigint, kind text, first bigint, last bigint, n bigint, "
        "PRIMARY KEY ((topic), node, writer, kind, first)"
    ),
    # Parameters and node graph at the start of a run, and its last heartbeat.
    "cr_context": (
        "writer bigint, node text, heartbeat timestamp, interrupted timestamp, context blob, "
        "PRIMARY KEY ((writer), node)"
    ),
    # Send times and sequence numbers of messages of an MCAP file; see store/tables/sent_times.py.
    "cr_sent": (
        "writer bigint, node text, stripe bigint, sent blob, PRIMARY KEY ((writer, node), stripe)"
    ),
    # Squares of the ground in which robots were, and the poses whose visits are complete; see
    # store/tables/place_index.py.
    "cr_place": (
        "frame text, robot text, size int, x int, y int, node text, t_in bigint, writer bigint, "
        "t_out bigint, PRIMARY KEY ((frame, robot, size, x, y), node, t_in, writer)"
    ),
    "cr_placed": (
        "tbl text, node text, writer bigint, robot text, low bigint, high bigint, "
        "frames frozen<set<text>>, above frozen<map<text, text>>, "
        "PRIMARY KEY ((tbl), node, writer, robot)"
    ),
    # Named time ranges of robots, and the slots in which those of a name, or of any name, begin;
    # see store/tables/event_table.py.
    "cr_event": (
        "slot bigint, name text, t_start bigint, node text, id text, t_end bigint, writer bigint, "
        "labels frozen<map<text, text>>, vals text, "
        "PRIMARY KEY ((slot), name, t_start, node, id)"
    ),
    "cr_event_slot": (
        "named boolean, name text, slot bigint, reach bigint, "
        "PRIMARY KEY ((named, name), slot, reach)"
    ),
    # Books of copies to other stores: tables and their counterparts, and what is confirmed of each
    # bucket; see store/tables/copy_books.py.
    "cr_copy": (
        "target uuid, tbl text, place text, topic text, there text, refused text, "
        "PRIMARY KEY ((target), tbl)"
    ),
    "cr_copied": (
        "target uuid, tbl text, node text, slot bigint, bucket bigint, writer bigint, there text, "
        "heartbeat timestamp, seen bigint, final boolean, rule text, released boolean, "
        "rows bigint, n bigint, bytes bigint, t_max bigint, "
        "PRIMARY KEY ((target, tbl, node, slot), bucket, writer)"
    ),
    # Heartbeats of the target's buckets when all rows of a writer were there.
    "cr_copied_beat": (
        "target uuid, tbl text, node text, slot bigint, bucket bigint, writer bigint, "
        "heartbeat timestamp, PRIMARY KEY ((target, tbl, node, slot), bucket, writer)"
    ),
}


class SchemaLock:
    """Context manager that holds the schema lock; raises SchemaConflict after waiting for 150 s.

    It must not be entered twice, not even by one thread: the second object would wait for the
    first. The lock runs out LOCK_TTL_SEC after it was taken or renewed last.

    Args:
        name: Name of the lock, for another one in the same table.
    """

    def __init__(self, cassandra: Cassandra, keyspace: str, name: str = _SCHEMA) -> None:
        self._cassandra = cassandra
        self._table = qualified(keyspace, _LOCK)
        self._name = name
        self._owner = uuid.uuid4()
        self._held_since = -math.inf
        """Monotonic time just before the lock was taken or renewed last, s."""

    def __enter__(self) -> SchemaLock:
        start, is_logged = time.monotonic(), False
        pause = 0.02
        while not self._take():
            waited = time.monotonic() - start
            if waited > TELL_SEC and not is_logged:
                is_logged = True
                _log.warning("%s", self._wait_text())
            if waited > WAIT_SEC:
                raise SchemaConflict(
                    f"another client holds the schema lock in {self._table} for over "
                    f"{WAIT_SEC:.0f} s; try again when it has finished"
                )
            time.sleep(pause)
            pause = min(pause * 1.5, 0.5)
        return self

    def __exit__(self, failure: object, *exc_info: object) -> None:
        try:
            self._lwt(
                f"DELETE FROM {self._table} WHERE name = ? IF owner = ?", (self._name, self._owner)
            )
        except CassandraRosError as exc:
            if failure is None:
                raise
            # The error under the lock is the one that matters.
            _log.warning("the schema lock runs out by itself within %d s: %s", LOCK_TTL_SEC, exc)

    def _take(self) -> bool:
        """Try to take the lock; return whether we hold it."""
        self._held_since = time.monotonic()
        applied, owner = self._lwt(
            f"INSERT INTO {self._table} (name, owner) VALUES (?, ?) IF NOT EXISTS "
            f"USING TTL {LOCK_TTL_SEC}",
            (self._name, self._owner),
        )
        # An earlier try whose answer was lost may have taken the lock.
        return applied or owner == self._owner

    def _wait_text(self) -> str:
        """Return a text that says what is waited for, and until when at most."""
        cql = f"SELECT TTL(owner) FROM {self._table} WHERE name = ?"
        rows = self._cassandra.execute(cql, (self._name,), what="reading the schema lock")
        ttl = (rows[0][0] if rows else None) or LOCK_TTL_SEC
        return (
            f"waiting for the schema lock in {self._table}: another program makes or changes a "
            f"table. If it was killed meanwhile, its lock runs out in {ttl} s; else this program "
            f"waits up to {WAIT_SEC:.0f} s"
        )

    def change(self, cql: str, *, what: str) -> None:
        """Run one DDL statement like schema_change, after checking that we still hold the lock.

        Raises:
            SchemaConflict: The lock ran out, and another client may be changing the schema.
        """
        self.renew()
        self._cassandra.schema_change(cql, what=what)

    def change_all(self, changes: Sequence[SchemaChange]) -> None:
        """Run DDL statements that change different tables, as ``change`` runs one.

        Raises:
            SchemaConflict: The lock ran out. Some statements may have been carried out.
        """
        for first in range(0, len(changes), CHANGES_A_RENEWAL):
            if time.monotonic() - self._held_since > LOCK_RENEWAL_SEC:
                self.renew()
            self._cassandra.change_schema(changes[first : first + CHANGES_A_RENEWAL])

    def renew(self) -> None:
        """Check that we still hold the lock and restart its time; raises like ``change``."""
        self._held_since = time.monotonic()
        applied, _ = self._lwt(
            f"UPDATE {self._table} USING TTL {LOCK_TTL_SEC} SET owner = ? WHERE name = ? "
            "IF owner = ?",
            (self._owner, self._name, self._owner),
        )
        if not applied:
            raise SchemaConflict(
                f"the schema lock in {self._table} ran out while it was held; try again"
            )

    def _lwt(self, cql: str, params: tuple[object, ...]) -> tuple[bool, object]:
        """Run a lightweight transaction; return whether it was applied, and if not the owner.

        The owner is None if no client holds the lock.
        """
        # Under contention a transaction may time out with its outcome unknown. All three of ours
        # contain the owner, so they can be repeated.
        tries = 1
        while True:
            try:
                row = self._cassandra.execute_once(cql, params, what="taking the schema lock")[0]
                # [applied], and if it is false the columns of the row that is there already.
                return bool(row[0]), row[-1] if len(row) > 1 else None
            except StoreUnavailable as exc:
                if tries == _TRIES:
                    raise
                _log.debug("%s; asking again", exc)
                tries += 1
                time.sleep(0.2)


class SideTables:
    """The side tables of one keyspace, and the keyspace itself, which need not exist.

    Readers treat a missing table as an empty one. Writers call ``make`` before they write: the
    methods that insert or delete do not. Thread-safe.

    Raises:
        InvalidName: The name is not 1 to 48 letters, digits and underscores.
    """

    def __init__(self, cassandra: Cassandra, keyspace: str) -> None:
        if not isinstance(keyspace, str) or not re.match(r"[A-Za-z0-9_]{1,48}\Z", keyspace):
            raise InvalidName(
                f"{keyspace!r} is not a keyspace name: use 1 to 48 letters, digits and underscores"
            )
        self._cassandra = cassandra
        self.keyspace = keyspace
        names = (_LOCK, *SIDE_TABLES, *LATER_TABLES)
        self._qualified = {name: qualified(keyspace, name) for name in names}
        self.retry_sec: Seconds = RETRY_SEC
        """How long one request is retried, s."""
        self._there: frozenset[str] = frozenset()
        """Names of the tables that the keyspace had when they were listed last."""
        self._keyspace_made = False
        """Whether the keyspace is known to exist."""
        self._made = False
        """Whether all SIDE_TABLES are known to exist."""
        self._mutex = threading.Lock()

    def patient(self, retry_sec: Seconds) -> SideTables:
        """Return a copy with another retry time, s.

        What is known to exist is copied now: ``make`` and ``forget`` of one of the two objects do
        not act on the other.
        """
        patient = copy(self)
        patient.retry_sec = retry_sec
        return patient

    def has(self, name: str) -> bool:
        """Return whether a table exists; the server is asked each time until it does."""
        if name not in self._there:
            self._there = self._list()
        return name in self._there

    def select(
        self, table: str, names: str, where: str = "", params: Sequence[object] = (), *, what: str
    ) -> list[CqlRow]:
        """Return columns of the rows of a table that match a condition; '' = of all rows.

        The result is empty if the table is missing.
        """
        if not self.has(table):
            return []
        condition = f" WHERE {where}" if where else ""
        cql = f"SELECT {names} FROM {self.qualified(table)}{condition}"
        return _when_made(lambda: self._run(cql, params, what))

    def insert(
        self,
        table: str,
        columns: Mapping[str, object],
        what: str,
        *,
        now: Sequence[str] = (),
        ttl: int = 0,
    ) -> None:
        """Write a row.

        Args:
            columns: Name → value.
            now: Names of further columns, in which the server puts its time.
            ttl: How long the row stays, s; 0 = for ever.
        """
        names = ", ".join([*columns, *now])
        marks = ", ".join(["?"] * len(columns) + ["toTimestamp(now())"] * len(now))
        cql = f"INSERT INTO {self.qualified(table)} ({names}) VALUES ({marks}) USING TTL ?"
        self._run(cql, (*columns.values(), ttl), what)

    def insert_many(
        self, table: str, names: Sequence[str], rows: Sequence[CqlRow], what: str, *, ttl: int = 0
    ) -> None:
        """Write rows with these columns, for ttl seconds (0 = for ever)."""
        marks = ", ".join("?" for _ in names)
        cql = (
            f"INSERT INTO {self.qualified(table)} ({', '.join(names)}) VALUES ({marks}) USING TTL ?"
        )
        values = [(*row, ttl) for row in rows]
        self._cassandra.execute_many(cql, values, what=what, retry_sec=self.retry_sec)

    def select_many(
        self, table: str, names: str, where: str, params: Sequence[CqlRow], what: str
    ) -> list[list[CqlRow]]:
        """Return columns of the rows that match a condition, for each set of parameters.

        The result is empty, without a list for each set, if the table is missing.
        """
        if not self.has(table):
            return []
        cql = f"SELECT {names} FROM {self.qualified(table)} WHERE {where}"
        execute, retry_sec = self._cassandra.execute_many, self.retry_sec
        return _when_made(lambda: execute(cql, params, what=what, retry_sec=retry_sec))

    def delete(self, table: str, key: Sequence[str], values: Sequence[CqlRow], what: str) -> None:
        """Delete the rows with one of some values in the columns of the key."""
        where = " AND ".join(f"{name} = ?" for name in key)
        cql = f"DELETE FROM {self.qualified(table)} WHERE {where}"
        self._cassandra.execute_many(cql, values, what=what, retry_sec=self.retry_sec)

    def qualified(self, table: str) -> str:
        """Return the quoted name of a table with its keyspace."""
        return self._qualified[table]

    def _run(self, cql: str, params: Sequence[object], what: str) -> list[CqlRow]:
        return self._cassandra.execute(cql, params, what=what, retry_sec=self.retry_sec)

    def absence(self) -> str:
        """Return a sentence with similar names if the keyspace is missing; '' if it exists."""
        rows = self._cassandra.execute(
            "SELECT keyspace_name FROM system_schema.keyspaces", what="listing the keyspaces"
        )
        names = sorted(name for (name,) in rows if not name.startswith("system"))
        if self.keyspace in names:
            return ""
        near = difflib.get_close_matches(self.keyspace, names, n=3, cutoff=0.5)
        hint = f"did you mean {', '.join(near)}?" if near else "give the name of another,"
        where = f"{','.join(self._cassandra.hosts)}:{self._cassandra.port}"
        return (
            f"there is no keyspace {self.keyspace!r} at {where}; {hint} or make it: by a "
            f"recording, an import, or connectToKeyspace({self.keyspace!r})"
        )

    def require_keyspace(self) -> None:
        """Raise KeyspaceNotFound, with similar names, if the keyspace does not exist."""
        absence = self.absence()
        if absence:
            raise KeyspaceNotFound(absence)

    def make_keyspace(self) -> None:
        """Make the keyspace with min(3, nodes) copies; warn if an existing one has fewer.

        The copies lie in one data centre, so its nodes count.
        """
        if self._keyspace_made:
            return
        factor = min(3, self._cassandra.local_nodes())
        rows = self._cassandra.system_schema("keyspaces", "replication", self.keyspace)
        if rows:
            _warn_of_factor(self.keyspace, rows[0][0], factor)
        else:
            self._cassandra.require_nodes(self.keyspace)
            datacenter = quote_text(self._cassandra.local_datacenter())
            if factor > 1:
                _log.warning(
                    "making keyspace %s: %d nodes have to agree on it and on each of its tables, "
                    "which may take a minute or two",
                    self.keyspace,
                    self._cassandra.live_nodes(),
                )
            self._cassandra.schema_change(
                f"CREATE KEYSPACE IF NOT EXISTS {quote_name(self.keyspace)} WITH replication = "
                f"{{'class': 'NetworkTopologyStrategy', {datacenter}: {factor}}}",
                what=f"making keyspace {self.keyspace}",
            )
        self._keyspace_made = True

    def change_rights(self, statement: str) -> None:
        """Run a statement that makes a role or grants a right; it does not change the schema."""
        self._cassandra.execute_text(statement, what=statement)

    def make(self, *later: str) -> None:
        """Make the keyspace and its side tables if they are missing, before the first write.

        It takes the schema lock if a table is missing, so its caller must not hold it.

        Args:
            later: Those of LATER_TABLES that are about to be written.
        """
        with self._mutex:
            if self._made and self._there.issuperset(later):
                return
            self.make_keyspace()
            tables = {**SIDE_TABLES, **{name: LATER_TABLES[name] for name in later}}
            there = self._list()
            if _LOCK not in there:
                self._keyspace_made = False  # another client may have dropped it since
                self.make_keyspace()
                self._make_lock_table()
            if not there.issuperset(tables):
                with SchemaLock(self._cassandra, self.keyspace) as lock:
                    there = self._names()  # another client may have made some of them
                    lock.change_all(
                        [
                            (
                                f"CREATE TABLE IF NOT EXISTS {self.qualified(name)} "
                                f"({tables[name]}) WITH comment = {quote_text(SIDE_COMMENT)}",
                                f"making table {name}",
                            )
                            for name in sorted(set(tables) - there)
                        ]
                    )
                self._there = there | set(tables)
            else:
                self._there = there
            self._made = True

    def forget(self) -> None:
        """Check the keyspace and its side tables anew at the next ``make``."""
        with self._mutex:
            self._made = self._keyspace_made = False
            self._there = frozenset()

    def _make_lock_table(self) -> None:
        # The lock cannot guard its own creation. With a fixed id racing clients make the same
        # table; its columns never change, and it is never dropped while the keyspace exists.
        table_id = uuid.uuid5(uuid.NAMESPACE_URL, f"cassandra_ros/{self.keyspace}/{_LOCK}")
        self._cassandra.schema_change(
            f"CREATE TABLE IF NOT EXISTS {self.qualified(_LOCK)} ({_LOCK_COLUMNS}) "
            f"WITH id = {table_id} AND gc_grace_seconds = 3600",
            what=f"making table {_LOCK}",
        )

    def _list(self) -> frozenset[str]:
        """Return the names of all tables of the keyspace."""
        # A caller that looks for a table is about to use the keyspace.
        self._cassandra.use_keyspace(self.keyspace)
        return self._names()

    def _names(self) -> frozenset[str]:
        rows = self._cassandra.system_schema("tables", "table_name", self.keyspace)
        return frozenset(name for (name,) in rows)


def _when_made(read: Callable[[], _Rows]) -> _Rows:
    """Return what a read of a listed table gives: it is repeated while the table is being made.

    A server lists a new table a moment before it can be read.
    """
    deadline = time.monotonic() + MADE_SEC
    while True:
        try:
            return read()
        except TopicNotFound:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.05)


def _warn_of_factor(keyspace: str, replication: Mapping[str, str], factor: int) -> None:
    """Warn if an existing keyspace keeps fewer copies than ``factor`` in a data centre."""
    factors = [int(v) for k, v in replication.items() if k != "class" and str(v).isdigit()]
    if factors and min(factors) < factor:
        _log.warning(
            "keyspace %s keeps %d copies of each row where this cluster could keep %d; "
            "a lost node loses data: ALTER KEYSPACE … WITH replication, then repair",
            keyspace,
            min(factors),
            factor,
        )
