# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a RosCassandra answers with the query language."""

from __future__ import annotations

from typing import Any, Optional, Sequence

from cassandra_ros.keys import Position
from cassandra_ros.query.explain import Explanation
from cassandra_ros.query.run import QueryResult, Rows
from cassandra_ros.topics.keyspace_connection import KeyspaceConnection
from cassandra_ros.topics.statements import Statements
from cassandra_ros.transforms.lookup import TransformFinder


class Asking(KeyspaceConnection):
    """Questions to the stored topics; see RosCassandra."""

    @property
    def statements(self) -> Statements:
        """Runs statements, also parsed ones and by a chosen plan."""
        return Statements(self.parts, self._topics)

    def executeCQL(
        self,
        statement: str,
        params: Sequence[Any] = (),
        *,
        nodeID: Optional[str] = None,
        limit: Optional[int] = None,
    ) -> Rows:
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
        return self.statements.run(statement, params, nodeID=nodeID, limit=limit)

    def iterCQL(
        self,
        statement: str,
        params: Sequence[Any] = (),
        *,
        nodeID: Optional[str] = None,
        limit: Optional[int] = None,
        after: Optional[Position] = None,
    ) -> QueryResult:
        """Run a SELECT lazily: an iterator of tuples with ``.columns``; as executeCQL."""
        return self.statements.select(statement, params, nodeID=nodeID, limit=limit, after=after)

    def explainCQL(
        self, statement: str, params: Sequence[Any] = (), *, nodeID: Optional[str] = None
    ) -> Explanation:
        """Run a SELECT statement and say how it was answered; ``print`` what comes back.

        Returns:
            An Explanation: how many buckets were read of how many and in which way (by an index,
            filtered by the server, whole), what the server checked, what was left to this side,
            rows read and returned.

        Raises:
            InvalidQuery: As executeCQL.
        """
        return self.statements.explain(statement, params, nodeID)

    def lookupTransform(
        self,
        target: str,
        source: str,
        time: Any,
        *,
        nodeID: Optional[str] = None,
        tf: str = "/tf",
        tf_static: str = "/tf_static",
    ) -> Any:
        """Return the transform between two frames at any past time, as tf2 computes it.

        The time is that of the stamps in the headers, whenever the transforms were received. What
        tf2 knows live, the last ten seconds, is here all that was recorded. A slash in front of a
        frame's name is ignored on both sides. A frame that is on tf_static is fixed: what was
        recorded of it last holds at every time. As soon as both frames are connected and the time
        lies between two transforms of each frame on the way, no more is read (one that was received
        over 2 s out of order may be missed then); an error comes when everything was read.

        Args:
            target: Frame to which the transform takes points.
            source: Frame from which it takes them.
            time: As a key: genpy.Time, int (ns), float (s) or ISO 8601 text. 0 means, as in tf2,
                the newest time that is recorded for all frames on the way.
            nodeID: Only transforms of this node, of both topics; None = of all.
            tf: Topic of the moving transforms.
            tf_static: Topic of the fixed ones. One of the two may be missing.

        Returns:
            A geometry_msgs/TransformStamped: ``header.frame_id`` is target, ``child_frame_id``
            source, and ``header.stamp`` the time that was asked for (of 0 the one that was found,
            0 where all frames are fixed).

        Raises:
            LookupException: A frame is in no transform.
            ConnectivityException: Nothing connects the frames.
            ExtrapolationException: The time lies outside of what is recorded of a frame.
            TransformException: Any of these three; the errors are this package's, with tf2's names.
            TopicNotFound: Neither topic is stored.
            TypeMismatch: A topic holds no transforms.
            MissingDependency: tf2_py is not installed.
            InvalidKey, InvalidName.
        """
        return TransformFinder(self._topics.get, nodeID).lookup(target, source, time, tf, tf_static)
