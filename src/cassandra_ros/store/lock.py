# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The one lock under which tables are created, altered and dropped.

``IF NOT EXISTS`` on two coordinators gives the union of the columns, and two ALTERs can lose a
comment: Cassandra 4 and 5 change the schema without consensus. So every DDL statement is sent
by the holder of a row in ``cr_lock``, taken with a lightweight transaction.
"""

from __future__ import annotations

import logging
import time
import uuid
from typing import Any

from cassandra_ros.errors import CassandraRosError, SchemaConflict, StoreUnavailable
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.names import quoteName

_log = logging.getLogger(__name__)

LOCK_TTL_SEC = 120
WAIT_SEC = 150.0
_NAME = "schema"
_TRIES = 8


class SchemaLock:
    """Context manager that holds the schema lock of a keyspace.

    Args:
        cassandra: An open connection.
        keyspace: Whose tables are to be changed.

    Raises:
        SchemaConflict: Somebody else holds the lock for longer than 150 s.
    """

    def __init__(self, cassandra: Cassandra, keyspace: str) -> None:
        self._cassandra = cassandra
        self._table = f"{quoteName(keyspace)}.cr_lock"
        self._owner = uuid.uuid4()

    def __enter__(self) -> SchemaLock:
        deadline = time.monotonic() + WAIT_SEC
        pause = 0.02
        while not self._take():
            if time.monotonic() > deadline:
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
                f"DELETE FROM {self._table} WHERE name = ? IF owner = ?", (_NAME, self._owner)
            )
        except CassandraRosError as exc:
            if failure is None:
                raise
            # What went wrong under the lock says more.
            _log.warning("the schema lock runs out by itself within %d s: %s", LOCK_TTL_SEC, exc)

    def _take(self) -> bool:
        applied, owner = self._lwt(
            f"INSERT INTO {self._table} (name, owner) VALUES (?, ?) IF NOT EXISTS "
            f"USING TTL {LOCK_TTL_SEC}",
            (_NAME, self._owner),
        )
        # A first try that timed out on its way back may have taken it.
        return applied or owner == self._owner

    def renew(self) -> None:
        """Prove that the lock is still ours and start its time anew; before each statement.

        Raises:
            SchemaConflict: It ran out and somebody else may be changing the schema.
        """
        applied, _ = self._lwt(
            f"UPDATE {self._table} USING TTL {LOCK_TTL_SEC} SET owner = ? WHERE name = ? "
            "IF owner = ?",
            (self._owner, _NAME, self._owner),
        )
        if not applied:
            raise SchemaConflict(
                f"the schema lock in {self._table} ran out while it was held; try again"
            )

    def _lwt(self, cql: str, params: tuple[Any, ...]) -> tuple[bool, Any]:
        # Under contention a transaction may time out with its outcome unknown. All three of ours
        # name the owner, so asking again is safe.
        for left in reversed(range(_TRIES)):
            try:
                row = self._cassandra.executeOnce(cql, params, what="taking the schema lock")[0]
            except StoreUnavailable as exc:
                if not left:
                    raise
                _log.debug("%s; asking again", exc)
                time.sleep(0.2)
                continue
            # [applied] and, where refused, the columns of the row that stands in the way.
            return bool(row[0]), row[-1] if len(row) > 1 else None
        raise AssertionError("the loop above returns or raises")
