# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Class RosCassandra: topics in a Cassandra cluster (paper section 3, listing 1)."""

from __future__ import annotations

from typing import Any, Iterable, Iterator, Optional, Sequence, TypeVar

from cassandra_ros.errors import KeyspaceNotFound
from cassandra_ros.formats.table import DEFAULT_FORMAT
from cassandra_ros.keys import Position, newWriterId
from cassandra_ros.messages.connection import Connection
from cassandra_ros.messages.stamps import toNs
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.registry import Run
from cassandra_ros.store.write_stats import LossCallback
from cassandra_ros.store.writer import RowWriter
from cassandra_ros.topics.adder import Adder
from cassandra_ros.topics.cassandra_topic import CassandraTopic, Time
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.clock import Clock
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.message_writer import MessageWriter
from cassandra_ros.topics.reading import LAST_NS, TopicInfo
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_table import TopicTable
from cassandra_ros.topics.wish import Wish

_Part = TypeVar("_Part")


class RosCassandra:
    """Keeps ROS topics in a Cassandra cluster. Safe to share between threads.

    Args:
        host: One address, or several divided by commas.
        port: CQL port.
        keyspace: Connected at once when given.
        clock: Returns the time for messages without a key; default rospy's where a node runs
            in this process, else wall clock.
        consistency: Name of a Cassandra consistency level.
        username, password, ssl_context: Where the cluster asks for them.

    Raises:
        ConnectionFailed: Nobody answers there; the text says how to start a server.
    """

    def __init__(
        self,
        host: str = "127.0.0.1",
        port: int = 9042,
        *,
        keyspace: Optional[str] = None,
        clock: Optional[Clock] = None,
        consistency: str = "LOCAL_QUORUM",
        username: Optional[str] = None,
        password: Optional[str] = None,
        ssl_context: Any = None,
    ) -> None:
        login: Any = {"username": username, "password": password, "ssl_context": ssl_context}
        self.cassandra = Cassandra(host, port, consistency=consistency, **login)
        self._clock = clock
        self._parts: Optional[Keyspace] = None
        self._adder: Optional[Adder] = None
        self._catalog: Optional[Catalog] = None
        if keyspace is not None:
            try:
                self.connectToKeyspace(keyspace)
            except BaseException:
                self.cassandra.close()
                raise

    # ---------------------------------------------------------------- keyspace

    def connectToKeyspace(self, keyspace: str) -> None:
        """Work in this keyspace from now on; it is made when missing.

        Topics that were got before stay in theirs until the next call or close.

        Args:
            keyspace: 1 to 48 letters, digits and underscores; case matters.

        Raises:
            InvalidName: It is not a keyspace name.
        """
        parts = Keyspace(self.cassandra, keyspace)
        if self._adder is not None:
            self._adder.close()
        self._parts = parts
        self._adder = Adder(parts, self._clock)
        self._catalog = Catalog(parts, self._adder)

    @property
    def keyspace(self) -> Optional[str]:
        """The connected keyspace's name, or None."""
        return None if self._parts is None else self._parts.name

    @property
    def parts(self) -> Keyspace:
        """The connected keyspace: schema, directory, registry, rows."""
        return _connected(self._parts)

    # ---------------------------------------------------------------- topics

    def addTopic(
        self,
        topic: str,
        format: str = DEFAULT_FORMAT,
        *,
        msg_type: Optional[str] = None,
        nodeID: str = "",
        ttl: int = 0,
        comment: str = "",
    ) -> CassandraTopic:
        """Make a topic, or find it where it is stored already in this format.

        Args:
            topic: Its name, kept as it is given.
            format: Name of a storage format.
            msg_type: 'pkg/Name' of an installed type; None = the type that the ROS master
                knows, else that of the first message.
            nodeID: The entity (robot) that produces its messages.
            ttl: Seconds until a message expires; 0 = never.
            comment: Free text.

        Raises:
            TopicExists: It is stored with another type, ttl or nodeID than given.
            UnknownFormat, InvalidName, DefinitionError.
        """
        wish = Wish(format, nodeID, int(ttl), comment)
        return _connected(self._catalog).add(topic, wish, msg_type)

    def getTopic(self, topic: str) -> CassandraTopic:
        """Return a topic by its name, with or without the leading slash.

        Raises:
            TopicNotFound: There is none; the text gives the nearest names.
        """
        return _connected(self._catalog).get(topic)

    def existTopic(self, topic: str) -> bool:
        """Say whether getTopic would find the topic."""
        return _connected(self._catalog).exists(topic)

    def getAllTopics(self, pattern: Optional[str] = None) -> list[CassandraTopic]:
        """Return all topics, sorted by name.

        Args:
            pattern: Only those whose whole name matches this regular expression.

        Raises:
            InvalidName: The pattern is not a regular expression.
        """
        return _connected(self._catalog).all(pattern)

    def removeTopic(self, topic: str) -> None:
        """Drop a topic with all its messages.

        Raises:
            TopicNotFound: There is none.
        """
        _connected(self._catalog).remove(topic)

    # ---------------------------------------------------------------- messages of many topics

    def messageWriter(
        self,
        *,
        writer_id: Optional[int] = None,
        format: str = DEFAULT_FORMAT,
        nodeID: str = "",
        ttl: int = 0,
        linger_sec: float = 0.2,
        give_up_after_sec: float = 60.0,
        run: Optional[Run] = None,
        on_loss: Optional[LossCallback] = None,
    ) -> MessageWriter:
        """Make a writer of serialised messages; close it.

        Args:
            writer_id: Repeats of the same import give the same; None = a random one.
            format: For topics that are not stored yet.
            nodeID: The entity that produces the messages.
            ttl: Seconds until a message expires; 0 = never.
            linger_sec: How long a message may wait to be sent together with others.
            give_up_after_sec: How long the writing of a message is tried.
            run: Description of the recording or import, kept in the store.
            on_loss: Called with (topic, messages, error) for what was given up; without it
                the writer raises.
        """
        parts = self.parts
        number = newWriterId() if writer_id is None else writer_id
        timing: Any = {"linger_sec": linger_sec, "give_up_after_sec": give_up_after_sec}
        place = (parts.cassandra, parts.schema, parts.directory)
        rows = RowWriter(*place, number, on_loss=on_loss, **timing)
        return MessageWriter(
            *(parts, rows, number), format=format, nodeID=nodeID, ttl=ttl, run=run, on_loss=on_loss
        )

    def readMessages(
        self,
        topics: Optional[Iterable[str]] = None,
        key: Optional[Time] = None,
        to_key: Optional[Time] = None,
        *,
        nodeID: Optional[str] = None,
    ) -> Iterator[StoredRow]:
        """Walk lazily through the rows of several topics, merged by time.

        Args:
            topics: Their names; None = all.
            key, to_key: Ends, both included; None = open.
            nodeID: Only messages of this node; None = of all.
        """
        low = 0 if key is None else toNs(key)
        high = LAST_NS if to_key is None else toNs(to_key)
        nodes: Optional[Sequence[str]] = None if nodeID is None else (nodeID,)
        return self.parts.rows.read(self._tables(topics), low, high, nodes=nodes)

    def _tables(self, topics: Optional[Iterable[str]]) -> list[TopicTable]:
        if topics is None:
            return _connected(self._catalog).readableTables()
        # A topic may be named twice: with and without its leading slash.
        named = {topic.name: topic for topic in map(self.getTopic, topics)}
        return [table for topic in named.values() for table in topic.tables]

    def connection(self, table: str, conn: int) -> Connection:
        """Return the connection that a row of a table names."""
        return self.parts.connections.get(table, conn)

    def info(self, topics: Optional[Iterable[str]] = None) -> list[TopicInfo]:
        """Describe what is stored: counts, sizes and times by topic, table and node."""
        return self.parts.rows.info(self._tables(topics))

    def runs(self) -> list[Run]:
        """List the recordings and imports of the keyspace."""
        return self.parts.registry.runs()

    # ---------------------------------------------------------------- queries

    def executeCQL(
        self,
        statement: str,
        params: Sequence[Any] = (),
        *,
        nodeID: Optional[str] = None,
        limit: Optional[int] = None,
    ) -> Any:
        """Run a statement and return all its rows: a list of tuples with ``.columns``.

        Args:
            statement: CQL with topic names, dotted fields and KEY (paper 3.2).
            params: Values for its ``?`` and ``%s`` markers.
            nodeID: Only messages of this node; None = of all.
            limit: At most so many rows.

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
        """Run a statement lazily: an iterator of tuples with ``.columns``; as executeCQL."""
        from cassandra_ros.query import execute

        return execute(self, statement, params, nodeID=nodeID, limit=limit, after=after)

    # ---------------------------------------------------------------- end

    def close(self) -> None:
        """Store what is on its way and close the connection. Twice is harmless."""
        try:
            if self._adder is not None:
                self._adder.close()
        finally:
            self.cassandra.close()

    def __enter__(self) -> RosCassandra:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()


def _connected(part: Optional[_Part]) -> _Part:
    if part is None:
        raise KeyspaceNotFound("no keyspace is connected: call connectToKeyspace('ros') first")
    return part
