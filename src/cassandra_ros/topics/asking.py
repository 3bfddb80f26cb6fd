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

    def explainCQL(
        self, statement: str, params: Sequence[Any] = (), *, nodeID: Optional[str] = None
    ) -> Any:
        """Run a SELECT statement and say how it was answered; ``print`` what comes back.

        Returns:
            An Explanation: how many buckets were read of how many and in which way (by an index,
            filtered by the server, whole), what the server checked, what was left to this side,
            rows read and returned.

        Raises:
            InvalidQuery: As executeCQL.
        """
        from cassandra_ros.query.explain import explain

        return explain(self, statement, params, nodeID)
