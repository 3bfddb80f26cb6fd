# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Class RosCassandra: topics in a Cassandra cluster (paper section 3, listing 1)."""

from __future__ import annotations

from copy import copy
from typing import Any, Iterable, Iterator, Mapping, Optional, Sequence

from cassandra_ros.arguments import check_new_topic, check_text
from cassandra_ros.client.near_rows import near_rows
from cassandra_ros.client.statements import Statements
from cassandra_ros.connection.address import from_environment
from cassandra_ros.connection.cassandra import Cassandra
from cassandra_ros.errors import CassandraRosError, InvalidName, KeyspaceNotFound
from cassandra_ros.keys import Position
from cassandra_ros.messages.stamps import Time, duration_ns
from cassandra_ros.printable import public_names
from cassandra_ros.query.explain import Explanation
from cassandra_ros.query.run import QueryResult, Rows
from cassandra_ros.tables.context_blob import RunContext
from cassandra_ros.tables.registry import Loss
from cassandra_ros.topics.cassandra_topic import CassandraTopic
from cassandra_ros.topics.catalog import Catalog, Conditions, Pair, nearest_pairs
from cassandra_ros.topics.descriptions import Infos, RunList
from cassandra_ros.topics.key_selection import Clock
from cassandra_ros.topics.keyspace import wished_topic, with_key
from cassandra_ros.topics.keyspace_list import KeyspaceInfo, list_keyspaces
from cassandra_ros.topics.message_writer import MessageWriter, make_writer
from cassandra_ros.topics.run_finder import RunName
from cassandra_ros.topics.run_list import list_runs
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.transforms.lookup import lookup_transform
from cassandra_ros.upkeep.conversion import Converted, convert_topic
from cassandra_ros.upkeep.table_copy import Progress
from cassandra_ros.upkeep.upkeep import Upkeep


class RosCassandra:
    """Keeps ROS topics in a Cassandra cluster. Safe to share between threads.

    Args:
        host: One address, or several divided by commas; None = CASSANDRA_ROS_HOST, else 127.0.0.1.
        port: CQL port, 1 to 65535; None = CASSANDRA_ROS_PORT, else 9042.
        keyspace: Connected at once; None = CASSANDRA_ROS_KEYSPACE. What first writes makes it.
        clock: Returns the time of messages without a key; None = a node's own, else wall clock.
        login: ``username password ssl_context cqlshrc credentials consistency``, as class Cassandra
            has them.

    Raises:
        ConnectionFailed, InvalidOption: Nobody answers there, or refuses us; no port, no file.
    """

    def __init__(
        self,
        host: Optional[str] = None,
        port: Optional[int] = None,
        *,
        keyspace: Optional[str] = None,
        clock: Optional[Clock] = None,
        **login: Any,
    ) -> None:
        self.cassandra = Cassandra(host, port, **login)
        self._clock = clock
        self._opened: Optional[Catalog] = None
        keyspace = from_environment("KEYSPACE") or None if keyspace is None else keyspace
        if keyspace is not None:
            try:
                self._opened = Catalog(self.cassandra, keyspace, clock)
            except BaseException:
                self.cassandra.close()
                raise

    def connectToKeyspace(self, keyspace: str, make: bool = True) -> None:
        """Work in this keyspace from now on; tables are made in it by what first writes.

        Topics that were got before stay in theirs until the next call or close.

        Args:
            keyspace: 1 to 48 letters, digits and underscores; case matters.
            make: Make it where it is missing, with a replication factor of min(3, nodes).

        Raises:
            InvalidName: It is not a keyspace name.
            KeyspaceNotFound: It is missing and make is false; the text gives the nearest names.
        """
        opened = Catalog(self.cassandra, keyspace, self._clock)
        if make:
            opened.keyspace.side_tables.make_keyspace()
        else:
            opened.keyspace.side_tables.require_keyspace()
        if self._opened is not None:
            self._opened.adder.close()
        self._opened = opened

    def inKeyspace(self, keyspace: str) -> RosCassandra:
        """Return an object that works in another keyspace over the same connection.

        It can be used until this one is closed, which also ends what it does; close this one only.

        Raises:
            InvalidName: It is not a keyspace name.
            KeyspaceNotFound: It is missing; the text gives the nearest names.
        """
        opened = Catalog(self.cassandra, keyspace, self._clock)
        opened.keyspace.side_tables.require_keyspace()
        other = copy(self)
        other._opened = opened
        return other

    def getKeyspaces(self) -> list[KeyspaceInfo]:
        """List the keyspaces of the cluster that hold topics, sorted by name."""
        return list_keyspaces(self.cassandra)

    @property
    def keyspace(self) -> Optional[str]:
        """The connected keyspace's name, or None."""
        return None if self._opened is None else self._opened.keyspace.name

    @property
    def catalog(self) -> Catalog:
        """The topics of the connected keyspace; raises KeyspaceNotFound where none is connected."""
        self.cassandra.require_open()
        if self._opened is None:
            raise KeyspaceNotFound("no keyspace is connected: call connectToKeyspace('ros') first")
        return self._opened

    def close(self) -> None:
        """Store what is on its way and close the connection. Twice is harmless."""
        try:
            if self._opened is not None:
                self._opened.adder.close()
        finally:
            self.cassandra.close()

    def __enter__(self) -> RosCassandra:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def __dir__(self) -> list[str]:
        return public_names(self, ("cassandra", "catalog", "statements"))

    def __repr__(self) -> str:
        try:
            topics = f"{len(self.catalog.names())} topics in keyspace {self.keyspace}"
        except CassandraRosError as exc:
            topics = str(exc)
        where = f"{','.join(self.cassandra.hosts)} port {self.cassandra.port}"
        return f"<RosCassandra {where}: {topics}>"

    def _repr_html_(self) -> str:
        return self.info()._repr_html_()

    def addTopic(
        self,
        topic: str,
        format: Optional[str] = None,
        *,
        msg_type: Optional[str] = None,
        nodeID: str = "",
        ttl: int = 0,
        comment: str = "",
        key_format: Optional[str] = None,
        key_part: str = "",
        metadata: Optional[Mapping[str, Any]] = None,
        index: Sequence[str] = (),
    ) -> CassandraTopic:
        """Make a topic, or find it where it is stored already.

        Args:
            topic: Its name, kept as it is given.
            format: Name of a storage format; None = that of its newest table, of a new topic
                'ros'. Another than it is stored in means a second table, and a warning.
            msg_type: 'pkg/Name' of an installed type; None = that which the ROS master knows,
                else the first message's.
            nodeID: The entity (robot) that produces its messages.
            ttl: Seconds until a message expires, 0 to MAX_TTL_SEC (some 18 years); 0 = never.
            comment: Free text.
            key_format: What finds a message: 'time' (when it was received), 'msg_part' (a field),
                'hash' (its content) or 'manual' (a name that you give); None = as the topic is
                stored, else 'time'. See CassandraTopic.
            key_part: The field of 'msg_part', as 'header.stamp'.
            metadata: Keys of your own, for getMeta; values that JSON gives back as they are.
            index: Fields that are to have an index, as 'linear.x'; see createIndex.

        Raises:
            TopicExists: It is stored with another type, key_format or ttl than given. (The comment
                and metadata of a stored topic stay as they are: setMeta changes them.)
            InvalidKey, InvalidName: The type has no such field as key_part, or one of index; topic,
                nodeID or a key of metadata cannot be a name.
            InvalidOption, UnknownFormat, DefinitionError.
        """
        if msg_type is not None:
            check_text("msg_type", msg_type, error=InvalidName, wanted="one like 'std_msgs/String'")
        wanted = wished_topic(topic, format, nodeID, ttl, comment, metadata, index)
        return self.catalog.add(with_key(wanted, key_format, key_part), msg_type)

    def getTopic(self, topic: str) -> CassandraTopic:
        """Return a topic by its name, with or without the leading slash.

        Raises:
            TopicNotFound, InvalidName: There is none (the text gives the nearest), it is no text.
        """
        return self.catalog.get(topic)

    def existTopic(self, topic: str) -> bool:
        """Say whether getTopic would find the topic."""
        return self.catalog.exists(topic)

    def getAllTopics(self, pattern: Optional[str] = None) -> list[CassandraTopic]:
        """Return all topics, sorted by name.

        Args:
            pattern: Only those whose whole name matches this regular expression.

        Raises:
            InvalidName: The pattern is not a regular expression.
        """
        if pattern is not None:
            check_text("pattern", pattern, error=InvalidName, wanted="a regular expression")
        return self.catalog.all(pattern)

    def removeTopic(self, topic: str) -> int:
        """Drop a topic; return how many messages it had. Raises as getTopic does.

        A client that writes the topic makes it anew with its next message; what it has written
        since the messages were counted is gone, too.
        """
        return self.catalog.remove(topic)

    def truncateTopic(self, topic: str) -> int:
        """Remove all messages of a topic; return how many. It and its metadata stay.

        Under a client that writes the topic those messages are deleted that are there when this
        begins; what comes later stays. Raises as getTopic does.
        """
        return self.catalog.remove(topic, renew=True)

    def renameTopic(self, topic: str, new_name: str) -> None:
        """Give a topic another name. Its messages stay where they are: this takes no time.

        A recorder that is writing the topic goes on into the renamed one for the publishers that
        it knows; the next one, or the next recording, makes the topic anew.

        Raises:
            TopicNotFound, InvalidName: There is none, or the new name is not one.
            TopicExists: A topic has the new name already, with or without the leading slash.
        """
        self.catalog.rename(topic, check_new_topic(new_name))

    def convertTopic(self, topic: str, format: str, progress: Progress = None) -> Converted:
        """Keep a stored topic in another format, while others read it; see convert_topic."""
        name = self.catalog.get(topic).name
        self.catalog.adder.close()  # an open bucket of it would look like a recording
        return convert_topic(self.catalog.keyspace, name, format, progress)

    def messageWriter(self, *, nodeID: str = "", **options: Any) -> MessageWriter:
        """Make a writer of serialised messages of any topics; close it.

        Args:
            nodeID: As addTopic takes it, for all topics.
            options: ``writer_id format ttl linger_sec block_sec give_up_after_sec run on_loss``, as
                class MessageWriter describes them.
        """
        return make_writer(self.catalog.keyspace, node=nodeID, **options)

    def info(
        self,
        topics: Optional[Iterable[str]] = None,
        *,
        nodeID: Optional[str] = None,
        run: RunName = None,
    ) -> Infos:
        """Describe what is stored: counts, sizes and times by topic, table and node.

        Of a node or run there are only the tables in which they have messages.
        """
        return Infos(self.catalog.infos(topics, nodeID, run))

    def runs(self) -> RunList:
        """List the recordings and imports, with state, counts and losses as they are now."""
        return RunList(list_runs(self.catalog.keyspace, self.catalog.tables(None)))

    def runContext(self, run: RunName) -> Optional[RunContext]:
        """Return parameters and node graph at the start of a run; None where none were kept.

        Of several runs of one name the one that began last counts. Raises RunNotFound.
        """
        return self.catalog.keyspace.runs.context(run)

    def losses(
        self,
        topics: Optional[Iterable[str]] = None,
        key: Optional[Time] = None,
        to_key: Optional[Time] = None,
        *,
        nodeID: Optional[str] = None,
        run: RunName = None,
    ) -> list[Loss]:
        """List what should have been recorded and was not, also of topics that are not stored.

        The arguments are those of readMessages: a loss counts whose time range is touched.
        """
        return self.catalog.losses(topics, key, to_key, nodeID, run)

    def readMessages(
        self,
        topics: Optional[Iterable[str]] = None,
        key: Optional[Time] = None,
        to_key: Optional[Time] = None,
        *,
        nodeID: Optional[str] = None,
        received: bool = False,
        where: Conditions = None,
        run: RunName = None,
    ) -> Iterator[StoredRow]:
        """Walk lazily through the rows of several topics, merged by time.

        A row unpacks as a message of rosbag does: ``for topic, msg, t in rosCas.readMessages()``,
        where t is the key time. Memory: some pages of rows for all topics together, and for each
        that has a condition.

        Args:
            topics: Their names, or one; None = all.
            key, to_key: Ends, both included; None = open.
            nodeID: Only messages of this node; None = of all.
            run: Only messages of this run, by its name (of all that have it) or writer id.
            received: By the time of reception, as a bag has them, also where a topic's key is
                another time.
            where: Topic -> condition, a text or (text, parameters): of these topics only the
                messages that satisfy it.

        Raises:
            TopicNotFound, RunNotFound: One of the topics is not stored, or there is no such run.
            InvalidOption, InvalidQuery: A condition is for a topic that is not read; is none.
            InvalidName, InvalidKey: A name or time is none.
        """
        return self.catalog.read(
            topics, key, to_key, node=nodeID, received=received, where=where, run=run
        )

    def near(
        self,
        x: float,
        y: float,
        radius: float,
        frame: str = "map",
        topics: Optional[Iterable[str]] = None,
        key: Optional[Time] = None,
        to_key: Optional[Time] = None,
        *,
        robot: str = "",
        nodeID: Optional[str] = None,
        where: Conditions = None,
        run: RunName = None,
    ) -> Iterator[StoredRow]:
        """Walk lazily through the rows of topics whose robot was near a place then.

        Args:
            x, y, radius: In the frame, metres; the rim is included.
            robot: Its frame in tf, or a topic of its poses; '' = found out, see doc/query.md.
            topics, key, to_key, nodeID, where, run: As of readMessages; errors, too, and
                InvalidOption where no pose tells it, or several robots may be meant.
        """
        disk, ends = (x, y, radius, frame, robot), (key, to_key)
        return near_rows(self.catalog, disk, topics, ends, nodeID, run, where)

    def nearestMessages(
        self,
        topic_a: str,
        topic_b: str,
        tolerance: Any,
        key: Optional[Time] = None,
        to_key: Optional[Time] = None,
        *,
        nodeID: Optional[str] = None,
        where: Conditions = None,
        unpaired: bool = False,
        run: RunName = None,
    ) -> Iterator[Pair]:
        """Pair each message of one topic with the message of another that is nearest in time.

        Pairs are (row, row), lazily in the order of the first topic's key times. A message of the
        second may be the partner of several. Of two that are equally near the earlier one is
        taken, of equal times the first. One without a partner is left out, as by ROS's
        ApproximateTime; with ``unpaired`` it comes with None, as by pandas' merge_asof.

        Args:
            topic_a, topic_b: Each message of the first looks for a partner in the second.
            tolerance: How far a partner may be, before or behind: seconds or a Duration.
            key, to_key: Ends for the first topic, as of readMessages; partners may lie outside.
            nodeID, run, where: As of readMessages, for both topics.
            unpaired: Give (row, None) for messages that have no partner.

        Raises:
            InvalidKey: tolerance is no length of time, or negative.
            TopicNotFound, InvalidOption, InvalidQuery: As of readMessages.
        """
        reach, space = duration_ns(tolerance), self.catalog
        first, second = space.get(topic_a), space.get(topic_b)
        time_range = space.time_range([topic_a], key, to_key)
        filters = space.filters(where, (topic_a, topic_b), nodeID, run)
        whose, wider = space.whose(nodeID, run), time_range.wider(reach)
        rows = space.merged(first.tables, filters, time_range, whose)
        partners = space.merged(second.tables, filters, wider, whose)
        return nearest_pairs(rows, partners, reach, unpaired)

    @property
    def upkeep(self) -> Upkeep:
        """Deletes messages, thins what is old, reads everything back and mends it."""
        return Upkeep(self.catalog)

    @property
    def statements(self) -> Statements:
        """Runs statements, also parsed ones and by a chosen plan."""
        return Statements(self.catalog)

    def executeCQL(
        self,
        statement: str,
        params: Sequence[Any] = (),
        *,
        nodeID: Optional[str] = None,
        limit: Optional[int] = None,
        run: RunName = None,
    ) -> Rows:
        """Run a statement and return all its rows: a list of tuples with ``.columns``.

        DELETE gives one row, the number of messages that it removed; TRUNCATE, CREATE INDEX and
        DROP INDEX give no row.

        Args:
            statement: CQL with topic names, dotted fields and KEY (paper 3.2).
            params: Values for its ``?`` and ``%s`` markers.
            nodeID, run: Only messages of these, for SELECT and DELETE; None = of all.
            limit: At most so many rows, for SELECT.

        Raises:
            InvalidQuery: Shows the statement with a caret under the spot.
            RunNotFound: run is none; in the statement an unknown RUN only finds nothing.
        """
        return self.statements.run(statement, params, nodeID, limit, run)

    def iterCQL(
        self,
        statement: str,
        params: Sequence[Any] = (),
        *,
        nodeID: Optional[str] = None,
        limit: Optional[int] = None,
        after: Optional[Position] = None,
        run: RunName = None,
    ) -> QueryResult:
        """Run a SELECT lazily: an iterator of tuples with ``.columns``; as executeCQL."""
        return self.statements.select(
            statement, params, node=nodeID, limit=limit, after=after, run=run
        )

    def explainCQL(
        self,
        statement: str,
        params: Sequence[Any] = (),
        *,
        nodeID: Optional[str] = None,
        run: RunName = None,
    ) -> Explanation:
        """Run a SELECT statement and say how it was answered; ``print`` what comes back.

        That is which buckets were read and how, what the server checked, what was left to this
        side, rows read and returned. Raises InvalidQuery as executeCQL does.
        """
        return self.statements.explain(statement, params, nodeID, run)

    def lookupTransform(
        self,
        target: str,
        source: str,
        time: Time,
        *,
        nodeID: Optional[str] = None,
        tf: str = "/tf",
        tf_static: str = "/tf_static",
        run: RunName = None,
    ) -> Any:
        """Return the transform between two frames at any past time, as tf2 computes it.

        The time is that of the stamps in the headers. What was recorded last of a frame on
        tf_static holds at every time. Reading ends as soon as both frames are connected and the
        time lies between two transforms of each frame on the way: one received over 2 s out of
        order may be missed.

        Args:
            target, source: Frames to which, and from which, the transform takes points.
            time: As a key. 0 means, as in tf2, the newest that all frames on the way have.
            nodeID, run: Only transforms of these, of both topics; None = of all.
            tf, tf_static: Topics of moving and of fixed transforms. One of them may be missing.

        Returns:
            A geometry_msgs/TransformStamped: ``header.frame_id`` is target, ``child_frame_id``
            source, ``header.stamp`` the time (for 0 the one found, 0 where all frames are fixed).

        Raises:
            LookupException, ConnectivityException, ExtrapolationException: As of tf2; each is a
                TransformException of this package.
            TopicNotFound: Neither topic is stored.
            TypeMismatch, MissingDependency: A topic holds no transforms; there is no tf2_py.
            InvalidKey, InvalidName.
        """
        writers = self.catalog.keyspace.runs.writers(run)
        return lookup_transform(
            self.catalog.get, nodeID, writers, target, source, time, tf, tf_static
        )
