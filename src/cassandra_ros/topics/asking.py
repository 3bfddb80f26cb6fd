# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a RosCassandra answers with the query language, which is loaded when it is asked."""

from __future__ import annotations

from typing import Any, Optional, Sequence

from cassandra_ros.keys import Position
from cassandra_ros.topics.keyspace_connection import KeyspaceConnection


class Asking(KeyspaceConnection):
    """Questions to the stored topics; see RosCassandra."""

    def executeCQL(
        self,
        statement: str,
        params: Sequence[Any] = (),
        *,
        nodeID: Optional[str] = None,
        limit: Optional[int] = None,
    ) -> Any:
        """Run a statement and return all its rows: a list of tuples with ``.columns``.

        SELECT gives what was asked for; DELETE one row with the number of messages that it
        removed; TRUNCATE, CREATE INDEX and DROP INDEX give no row.

        Args:
            statement: CQL with topic names, dotted fields and KEY (paper 3.2).
            params: Values for its ``?`` and ``%s`` markers.
            nodeID: Only messages of this node, for SELECT and DELETE; None = of all.
            limit: At most so many rows, for SELECT.

        Raises:
            InvalidQuery: Shows the statement with a caret under the spot.
        """
        from cassandra_ros.query import executeAll

        return executeAll(self, statement, params, nodeID=nodeID, limit=limit)

    def iterCQL(
        self,
        statement: str,
        params: Sequence[Any] = (),
        *,
        nodeID: Optional[str] = None,
        limit: Optional[int] = None,
        after: Optional[Position] = None,
    ) -> Any:
        """Run a SELECT lazily: an iterator of tuples with ``.columns``; as executeCQL."""
        from cassandra_ros.query import execute

        return execute(self, statement, params, nodeID=nodeID, limit=limit, after=after)
