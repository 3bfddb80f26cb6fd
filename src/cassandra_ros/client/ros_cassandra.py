# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Class RosCassandra: topics in a Cassandra cluster (paper section 3, listing 1)."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import Any, Iterable, Iterator, Mapping, Sequence, Tuple, Union

from cassandra_ros.arguments import check_list, check_new_topic, check_text, check_topics
from cassandra_ros.client.explanation import Explanation
from cassandra_ros.client.sql.duck_database import MEMORY
from cassandra_ros.client.sql.sql_result import SqlResult
from cassandra_ros.client.sql.sql_statement import Params
from cassandra_ros.client.statements import Statements
from cassandra_ros.client.topics_frame import TopicsFrame
from cassandra_ros.errors import (
    CassandraRosError,
    InvalidName,
    InvalidOption,
    InvalidQuery,
    KeyspaceNotFound,
)
from cassandra_ros.installation import optional_module
from cassandra_ros.keys import Position
from cassandra_ros.messages.stamps import Time, duration_ns
from cassandra_ros.places.transforms.lookup import lookup_transform
from cassandra_ros.printable import public_names
from cassandra_ros.query.arrays.field_arrays import Fields
from cassandra_ros.query.plan.bounds import usual_frame
from cassandra_ros.query.plan.pushdown import Watch, unwatched
from cassandra_ros.read import Read
from cassandra_ros.store.connection.address import from_environment
from cassandra_ros.store.connection.cassandra import Cassandra
from cassandra_ros.store.tables.context_blob import RunContext
from cassandra_ros.store.tables.event_table import Event
from cassandra_ros.store.tables.registry import Loss
from cassandra_ros.topics.cassandra_topic import CassandraTopic
from cassandra_ros.topics.catalog import Catalog, Conditions, Pair, nearest_pairs
from cassandra_ros.topics.descriptions import InfoList, RunList
from cassandra_ros.topics.event_finder import EventRule
from cassandra_ros.topics.keyspace_list import KeyspaceInfo, list_keyspaces
from cassandra_ros.topics.message_adder import clock_ns
from cassandra_ros.topics.message_writer import MessageWriter, make_writer
from cassandra_ros.topics.new_tables import wished_topic, with_key
from cassandra_ros.topics.query_result import QueryResult, Rows
from cassandra_ros.topics.row_finder import Clock, Where, range_between
from cassandra_ros.topics.run_finder import RunName
from cassandra_ros.topics.run_list import list_runs
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.upkeep.conversion import Converted, convert_topic
from cassandra_ros.topics.upkeep.table_copy import Progress
from cassandra_ros.topics.upkeep.upkeep import Upkeep

NearDisk = Tuple[float, float, Union[float, str], str, str]
"""x, y and radius as in ``near``, the frame, and the robot; '' = to be found out."""


class RosCassandra:
    """Keeps ROS topics in a Cassandra cluster. Safe to share between threads.

    Args:
        host: One address, or several divided by commas; None = CASSANDRA_ROS_HOST, else 127.0.0.1.
        port: CQL port, 1 to 65535; None = CASSANDRA_ROS_PORT, else 9042.
        keyspace: Keyspace to connect; None = CASSANDRA_ROS_KEYSPACE, else none, until
            connectToKeyspace is called. The first write makes it.
        clock: Returns the time of messages without a key; None = that of a ROS node in this
            process, else wall clock.
        login: ``username password ssl_context cqlshrc credentials consistency answer_sec``, as in
            class Cassandra.

    Raises:
        ConnectionFailed: No server answers there, or it refuses the login.
        InvalidOption: The port is not valid, or a file cannot be read.
        InvalidName: The keyspace is not a keyspace name.
    """

    def __init__(
        self,
        host: str | None = None,
        port: int | None = None,
        *,
        keyspace: str | None = None,
        clock: Clock | None = None,
        **login: Any,
    ) -> None:
        self.cassandra = Cassandra(host, port, **login)
        self._clock = clock
        self._opened: Catalog | None = None
        keyspace = from_environment("KEYSPACE") or None if keyspace is None else keyspace
        if keyspace is not None:
            try:
                self._opened = Catalog(self.cassandra, keyspace, clock)
            except BaseException:
                self.cassandra.close()
                raise

    def connectToKeyspace(self, keyspace: str, make: bool = True) -> None:
        """Use this keyspace from now on; the first write makes tables in it.

        Topics that you got before stay in their keyspace until the next call or close.

        Args:
            keyspace: 1 to 48 letters, digits and underscores; case matters.
            make: Make it if it is missing, with a replication factor of min(3, nodes).

        Raises:
            InvalidName: The name is not a keyspace name.
            KeyspaceNotFound: It is missing and make is false; the text has similar names.
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
        """Return an object for another keyspace over the same connection.

        It can be used until this one is closed. Close only this one.

        Raises:
            InvalidName: The name is not a keyspace name.
            KeyspaceNotFound: It is missing; the text has similar names.
        """
        opened = Catalog(self.cassandra, keyspace, self._clock)
        opened.keyspace.side_tables.require_keyspace()
        other = copy(self)
        other._opened = opened
        return other

    def getKeyspaces(self) -> list[KeyspaceInfo]:
        """Return the keyspaces of the cluster that hold topics, sorted by name."""
        return list_keyspaces(self.cassandra)

    @property
    def keyspace(self) -> str | None:
        """Name of the connected keyspace, or None."""
        return None if self._opened is None else self._opened.keyspace.name

    @property
    def catalog(self) -> Catalog:
        """The topics of the connected keyspace. It is another object after connectToKeyspace.

        Raises KeyspaceNotFound if no keyspace is connected.
        """
        if self._opened is None:
            self.cassandra.require_open()
            raise KeyspaceNotFound("no keyspace is connected: call connectToKeyspace('ros') first")
        return self._opened

    def close(self) -> None:
        """Store the messages that are waiting and close the connection.

        A second call does nothing, nor does one in a fork of the process that connected.
        """
        try:
            if self._opened is not None and not self.cassandra.is_forked:
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
        format: str | None = None,
        *,
        msg_type: str | None = None,
        nodeID: str = "",
        ttl: int = 0,
        comment: str = "",
        key_format: str | None = None,
        key_part: str = "",
        metadata: Mapping[str, Any] | None = None,
        index: Sequence[str] = (),
    ) -> CassandraTopic:
        """Make a topic, or find it if it is stored already.

        Args:
            topic: Name of the topic, kept as given.
            format: Name of a storage format; None = that of its newest table, for a new topic
                'ros'.
                Another format than the stored one makes a second table, with a warning.
            msg_type: 'pkg/Name' of an installed type; None = the type that the ROS master knows,
                else that of the first message.
            nodeID: The robot or other source of its messages.
            ttl: Seconds until a message expires, 0 to MAX_TTL_SEC (some 18 years); 0 = never.
            comment: Free text.
            key_format: Key of a message: 'time' (its receive time), 'msg_part' (a field), 'hash'
                (its content) or 'manual' (a name that you give); None = as the topic is stored,
                else 'time'. See CassandraTopic.
            key_part: The field of 'msg_part', such as 'header.stamp'.
            metadata: Keys of your own for getMeta, with values that JSON gives back unchanged.
            index: Fields that get an index, such as 'linear.x'; see createIndex.

        Raises:
            TopicExists: It is stored with another type, key_format or ttl. (The comment and
                metadata of a stored topic stay as they are; setMeta changes them.)
            InvalidKey: The type does not have the field key_part, or one of index.
            InvalidName: The topic, nodeID or a key of metadata is not a valid name.
            InvalidOption, UnknownFormat, DefinitionError.
        """
        if msg_type is not None:
            check_text("msg_type", msg_type, error=InvalidName, wanted="one like 'std_msgs/String'")
        described = wished_topic(topic, format, nodeID, ttl, comment, metadata, index)
        return self.catalog.add(with_key(described, key_format, key_part), msg_type)

    def getTopic(self, topic: str) -> CassandraTopic:
        """Return a topic by its name, with or without the leading slash.

        Raises:
            TopicNotFound: There is no such topic; the text has similar names.
            InvalidName: The name is not a text.
        """
        return self.catalog.get(topic)

    def existTopic(self, topic: str) -> bool:
        """Return whether getTopic would find the topic."""
        return self.catalog.exists(topic)

    def getAllTopics(self, pattern: str | None = None) -> list[CassandraTopic]:
        """Return all topics, sorted by name.

        Args:
            pattern: Regular expression that the whole name must match; None = all.

        Raises:
            InvalidName: The pattern is not a regular expression.
        """
        if pattern is not None:
            check_text("pattern", pattern, error=InvalidName, wanted="a regular expression")
        return self.catalog.all(pattern)

    def removeTopic(self, topic: str) -> int:
        """Drop a topic; return the number of its messages. Raises like getTopic.

        A client that is writing the topic makes it again with its next message. Messages that it
        has written since they were counted are deleted too.
        """
        return self.catalog.remove(topic)

    def truncateTopic(self, topic: str) -> int:
        """Delete all messages of a topic; return their number. The topic and its metadata stay.

        If a client is writing the topic, the messages that are there when this begins are deleted,
        and later ones stay. Raises like getTopic.
        """
        return self.catalog.remove(topic, renew=True)

    def renameTopic(self, topic: str, new_name: str) -> None:
        """Give a topic another name. Its messages stay where they are, so this takes no time.

        A recorder that is writing the topic goes on in the renamed one for the publishers that it
        knows. A new publisher, or the next recording, makes a topic with the old name.

        Raises:
            TopicNotFound: There is no such topic.
            InvalidName: The new name is not a valid name.
            TopicExists: A topic has the new name already, with or without the leading slash.
        """
        self.catalog.rename(topic, check_new_topic(new_name))

    def convertTopic(self, topic: str, format: str, progress: Progress = None) -> Converted:
        """Store a topic in another format from now on, while others read it; see convert_topic."""
        name = self.catalog.get(topic).name
        self.catalog.adder.close()  # an open bucket of the topic would look like a recording
        return convert_topic(self.catalog.keyspace, name, format, progress)

    def messageWriter(self, *, nodeID: str = "", **options: Any) -> MessageWriter:
        """Return a writer of serialised messages of any topics; you must close it.

        Args:
            nodeID: As in addTopic, for all topics.
            options: ``writer_id format ttl linger_sec block_sec give_up_after_sec run on_loss``, as
                in class MessageWriter.
        """
        self.cassandra.require_open()
        return make_writer(self.catalog.keyspace, node=nodeID, **options)

    def info(
        self,
        topics: Iterable[str] | None = None,
        *,
        nodeID: str | None = None,
        run: RunName = None,
    ) -> InfoList:
        """Describe what is stored: counts, sizes and times by topic, table and node.

        The arguments are those of readMessages. With a node or run only the tables in which it has
        messages are listed.
        """
        return InfoList(self.catalog.infos(topics, nodeID, run))

    def runs(self, *, times: bool = False) -> RunList:
        """Return the recordings and imports, with their present state, counts and losses.

        Args:
            times: Whether the times of their first and last messages are looked up, too.
        """
        return RunList(list_runs(self.catalog.keyspace, self.catalog.tables(None), times))

    def runContext(self, run: RunName) -> RunContext | None:
        """Return parameters and node graph at the start of a run; None if they were not stored.

        If several runs have this name, the one that began last counts. Raises RunNotFound, also
        for None.
        """
        return self.catalog.keyspace.runs.context(run)

    def losses(
        self,
        topics: Iterable[str] | None = None,
        key: Time | None = None,
        to_key: Time | None = None,
        *,
        nodeID: str | None = None,
        run: RunName = None,
    ) -> list[Loss]:
        """Return the losses of topics, also of topics that have no table.

        The arguments are those of readMessages; losses whose time range meets the given one count.
        """
        names, catalog = check_topics(topics), self.catalog
        read = Read(range_between(key, to_key), catalog.whose(nodeID, run))
        return catalog.keyspace.runs.losses(names, read)

    def addEvent(
        self,
        name: str,
        start: Time,
        end: Time | None = None,
        *,
        nodeID: str = "",
        run: RunName = None,
        labels: Mapping[str, str] | None = None,
        values: Mapping[str, Any] | None = None,
    ) -> Event:
        """Give a time range of a robot a name; return the event. Two calls make two events.

        Args:
            name: Any text of 1 to 256 bytes.
            start, end: First and last time, both included; end None = the event lasts.
            nodeID: The robot; '' = the event is of all robots.
            run: Run to which the event belongs, by name (the newest of that name) or writer id.
            labels: Texts by name, as of a run.
            values: Numbers, texts, lists and the like by name, which JSON gives back unchanged.

        Raises:
            InvalidKey: A time is not valid, or the end is before the start.
            InvalidName: The name, nodeID, a label or a value cannot be stored.
            RunNotFound: There is no such run.
        """
        return self.catalog.keyspace.events.add(name, start, end, nodeID, run, labels, values)

    def endEvent(self, event: Event | str, end: Time | None = None) -> Event:
        """Set the end of an event, given itself or by its key, and return it as it is then.

        Args:
            end: Last time, included; None = now, by the clock of messages without a key.

        Raises:
            EventNotFound: The event was removed.
            InvalidKey: The end is not a time, or is before the start.
        """
        now = clock_ns(self._clock) if end is None else end
        return self.catalog.keyspace.events.end(event, now)

    def events(
        self,
        name: str | None = None,
        key: Time | None = None,
        to_key: Time | None = None,
        *,
        like: str | None = None,
        nodeID: str | None = None,
        run: RunName = None,
    ) -> Iterator[Event]:
        """Read events lazily, in order of their starts.

        Args:
            name: Name of the events; None = all names.
            key, to_key: Time range that the events meet, both ends included; None = open.
            like: Pattern of LIKE for the names, as 'bump%', instead of a name.
            nodeID: Robot of the events; those of all robots are included; None = any.
            run: Run of the events; those of no run are included; None = any.

        Raises:
            InvalidName, InvalidKey, RunNotFound: A name, a time or the run is not valid.
        """
        catalog = self.catalog
        within, whose = range_between(key, to_key), catalog.whose(nodeID, run)
        return catalog.keyspace.events.find(name, like, within, whose)

    def removeEvent(self, event: Event | str) -> None:
        """Delete an event, given itself or by its key; messages stay.

        Raises:
            EventNotFound: It is not stored (any more).
        """
        self.catalog.keyspace.events.remove(event)

    def readMessages(
        self,
        topics: Iterable[str] | None = None,
        key: Time | None = None,
        to_key: Time | None = None,
        *,
        nodeID: str | None = None,
        received: bool = False,
        where: Conditions = None,
        run: RunName = None,
        event: EventRule = None,
    ) -> Iterator[StoredRow]:
        """Read the rows of several topics lazily, merged by time.

        A row unpacks like a message of rosbag: ``for topic, msg, t in rosCas.readMessages()``,
        where t is the key time. Memory: some pages of rows for all topics together, and some for
        each topic with a condition.

        Args:
            topics: Names of topics, or one name; None = all.
            key, to_key: First and last key time, both included; None = open.
            nodeID: nodeID whose messages are read; None = all.
            run: Run whose messages are read, by name (of all runs with it) or writer id; None =
                all.
            received: Use receive times, as in a bag, also for topics with another key time.
            where: Topic → condition, a text or (text, parameters), that the topic's messages must
                satisfy.
            event: Name of events, or (name, seconds before, seconds after): only messages of a
                robot during its events, and in the time before and after each.

        Raises:
            TopicNotFound, RunNotFound: One of the topics is not stored, or there is no such run.
            EventNotFound: There is no such event of that time, robot and run.
            InvalidOption: A condition is for a topic that is not read.
            InvalidQuery: A condition is not valid.
            InvalidName, InvalidKey: A name or time is not valid.
        """
        names, catalog = check_topics(topics), self.catalog
        reads = catalog.reads_of(names, key, to_key, catalog.whose(nodeID, run), event)
        return catalog.read_parts(names, reads, where, received=received)

    def near(
        self,
        x: float,
        y: float,
        radius: float | str,
        frame: str = "",
        topics: Iterable[str] | None = None,
        key: Time | None = None,
        to_key: Time | None = None,
        *,
        robot: str = "",
        nodeID: str | None = None,
        where: Conditions = None,
        run: RunName = None,
    ) -> Iterator[StoredRow]:
        """Read lazily the rows of topics whose robot was near a place at that time.

        Args:
            x, y: Centre of a disk in the frame, metres; in frame 'WGS84' latitude and longitude,
                degrees.
            radius: Its radius, metres, or a text with the unit, as '20m' or '1.5km'; the rim is
                included.
            frame: '' = 'map', or 'WGS84' if the radius is a text.
            robot: The robot's frame in tf, or a topic with its poses; '' = found out, see
                doc/query.md.
            topics, key, to_key, nodeID, where, run: As in readMessages, also the errors.

        Raises:
            InvalidOption: The disk is not valid, no poses of the robot are stored, or several
                robots are possible.
        """
        names, catalog = check_topics(topics), self.catalog
        read = catalog.read_of(names, key, to_key, catalog.whose(nodeID, run))
        disk = x, y, radius, frame or usual_frame(radius), robot
        return _near_rows(catalog, disk, names, read, where)

    def nearestMessages(
        self,
        topic_a: str,
        topic_b: str,
        tolerance: Any,
        key: Time | None = None,
        to_key: Time | None = None,
        *,
        nodeID: str | None = None,
        where: Conditions = None,
        unpaired: bool = False,
        run: RunName = None,
    ) -> Iterator[Pair]:
        """Pair each message of one topic with the message of another that is nearest in time.

        Yields pairs (row, row) in the order of the first topic's key times. A message of the second
        topic may be in several pairs. Of two equally near messages the earlier one is taken, of
        equal times the first. A message without a partner is left out, as in ROS's ApproximateTime;
        with ``unpaired`` it comes with None, as in pandas' merge_asof.

        Args:
            topic_a, topic_b: Each message of the first topic is paired with one of the second.
            tolerance: Maximum distance of a partner, before or after: seconds or a Duration.
            key, to_key: Range of the first topic, as in readMessages; partners may be outside of
                it.
            nodeID, run, where: As in readMessages, for both topics.
            unpaired: Yield (row, None) for messages without a partner.

        Raises:
            InvalidKey: tolerance is not a length of time, or is negative.
            TopicNotFound, RunNotFound, InvalidOption, InvalidQuery: As in readMessages.
        """
        reach, catalog = duration_ns(tolerance), self.catalog
        first, second = catalog.get(topic_a), catalog.get(topic_b)
        whose = catalog.whose(nodeID, run)
        read = catalog.read_of([topic_a], key, to_key, whose)
        filters = catalog.filters(where, (topic_a, topic_b), whose)
        rows = catalog.merged(first.tables, filters, read)
        wider = replace(read, time_range=read.time_range.wider(reach))
        partners = catalog.merged(second.tables, filters, wider)
        return nearest_pairs(rows, partners, reach, unpaired)

    def toDataFrame(
        self,
        topics: Iterable[str],
        *,
        every: Any = None,
        nearest: str | None = None,
        within: Any = "1s",
        fields: Mapping[str, Fields] | None = None,
        key: Time | None = None,
        to_key: Time | None = None,
        nodeID: str | None = None,
        run: RunName = None,
    ) -> Any:
        """Return several topics as one pandas.DataFrame, with columns named '/topic.field'.

        The rows are at regular times (``every``), each with the last message of each topic at or
        before it; or at the times of the messages of one topic (``nearest``), each with the
        nearest message of each other topic, before or after. Of equally near messages, also of
        those with equal times, the first is taken; of equal times before a row of ``every`` the
        last. The index ``KEY`` is the time of a row, ``/topic.KEY`` that of the message, both exact
        to the nanosecond. Types and missing values are those of CassandraTopic.toDataFrame; where
        no message is near enough all values of the topic are missing.

        Args:
            topics: Names of topics, or one name.
            every: Time between two rows: seconds, '20ms', a Duration or a timedelta, above 0. The
                first row is at ``key``, None = at the first message of these topics.
            nearest: A topic with the times of the rows; it need not be one of ``topics``. Give this
                or ``every``.
            within: Maximum distance of a message from the time of its row, included; as ``every``,
                or 0.
            fields: Topic → its fields, as in CassandraTopic.toDataFrame; a topic without an entry
                = all.
            key, to_key: First and last time of rows, both included; None = open. Messages may be
                outside of it.
            nodeID: nodeID whose messages are read; None = all, which must be of one robot.
            run: Run whose messages are read, by name or writer id; None = all.

        Raises:
            InvalidOption: Not one of ``every`` and ``nearest`` is given, a length of time is not
                valid, the messages are of several robots, their keys are names, or there would be
                over 50,000,000 regular times.
            TopicNotFound, RunNotFound, InvalidName, InvalidKey: As in readMessages.
            InvalidQuery: A topic does not have a field.
            MissingDependency: pandas is not installed; the text says how to install it.
        """
        optional_module("pandas", "toDataFrame")  # before the messages are read
        names = check_topics(check_list("topics", topics, "['/scan', '/tf']")) or ()
        if (every is None) == (nearest is None):
            raise InvalidOption(
                "give every='20ms' for regular times, or nearest='/imu' for its own"
            )
        time_range = range_between(key, to_key)
        frame = TopicsFrame(self.catalog, names, fields, within, time_range, nodeID, run)
        return frame.every(every) if nearest is None else frame.nearest(nearest)

    @property
    def upkeep(self) -> Upkeep:
        """Work on stored topics: deletion, thinning, checks and repair, the index of places."""
        return Upkeep(self.catalog)

    @property
    def statements(self) -> Statements:
        """Runs statements, also parsed ones, and with a plan of your choice."""
        return Statements(self.catalog)

    def executeCQL(
        self,
        statement: str,
        params: Sequence[Any] = (),
        *,
        nodeID: str | None = None,
        limit: int | None = None,
        run: RunName = None,
    ) -> Rows:
        """Run a statement and return all its rows: a list of tuples with ``.columns``.

        DELETE returns one row with the number of deleted messages; TRUNCATE, CREATE INDEX and DROP
        INDEX return no rows.

        Args:
            statement: CQL with topic names, dotted fields and KEY (paper 3.2).
            params: Values for its ``?`` and ``%s`` markers.
            nodeID, run: nodeID and run of the messages, for SELECT and DELETE; None = all.
            limit: Maximum number of rows, for SELECT.

        Raises:
            InvalidQuery: The text shows the statement with a caret under the error.
            RunNotFound: There is no such run. (An unknown RUN in the statement only matches
                nothing.)
        """
        return self.statements.run(statement, params, nodeID, limit, run)

    def iterCQL(
        self,
        statement: str,
        params: Sequence[Any] = (),
        *,
        nodeID: str | None = None,
        limit: int | None = None,
        after: Position | None = None,
        run: RunName = None,
    ) -> QueryResult:
        """Run a SELECT lazily; return an iterator of tuples with ``.columns``. See executeCQL."""
        return self.statements.select(
            statement, params, node=nodeID, limit=limit, after=after, run=run
        )

    def explainCQL(
        self,
        statement: str,
        params: Sequence[Any] = (),
        *,
        nodeID: str | None = None,
        run: RunName = None,
    ) -> Explanation:
        """Run a SELECT statement and describe how it was answered; ``print`` the result.

        The description says which buckets were read and how, what the server checked, what was
        checked here, and the numbers of rows read and returned. Raises InvalidQuery like
        executeCQL.
        """
        return self.statements.explain(statement, params, nodeID, run)

    def sql(
        self,
        statement: str,
        params: Params = (),
        *,
        nodeID: str | None = None,
        run: RunName = None,
        memory: str = MEMORY,
        watch: Watch = unwatched,
    ) -> SqlResult:
        """Prepare a SELECT statement in DuckDB's SQL over any topics, see doc/sql.md.

        A topic is a table, named with or without its leading slash (with it in double quotes); its
        columns are those of CassandraTopic.toArrow, and EVENT. Further tables are topics, runs,
        losses, events, constants, ``tf('map', 'base_link')``, ``joints('/joint_states')`` and
        ``nearest('/imu', '/fix', '50ms')``; a topic of such a name needs its slash. The statement
        runs when you ask the result for rows: ``.df() .arrow() .fetchall()``, iteration, ``print``;
        each runs it anew. Only the columns are read that it names, and only the times, robots, runs
        and values to which its WHERE bounds each topic: ``.explain()`` tells.

        Args:
            statement: One SELECT.
            params: Values for its ``?`` in order, or for its ``$name`` by name.
            nodeID, run: nodeID and run of the messages, of all topics; None = all.
            memory: Memory of DuckDB, as it writes it. Joins and sorts of more go to disk.
            watch: Called repeatedly while the statement runs; an exception from it stops it.

        Raises:
            InvalidQuery: The text shows the statement with a caret under the error.
            RunNotFound: There is no such run.
            MissingDependency: DuckDB, sqlglot or pyarrow is not installed.
        """
        catalog = self.catalog
        whose = catalog.whose(nodeID, run)
        return SqlResult(catalog, statement, params, whose, memory=memory, watch=watch)

    def lookupTransform(
        self,
        target: str,
        source: str,
        time: Time,
        *,
        nodeID: str | None = None,
        tf: str = "/tf",
        tf_static: str = "/tf_static",
        run: RunName = None,
    ) -> Any:
        """Return the transform between two frames at any past time, as tf2 computes it.

        The time is that of the stamps in the headers. The last transform of a frame on tf_static
        holds at every time. Reading ends when both frames are connected and the time is between two
        transforms of each frame on the way, so a transform received more than 2 s out of order may
        be missed.

        Args:
            target, source: Frames to which, and from which, the transform takes points.
            time: A time, as in ``key``. 0 means, as in tf2, the newest time that all frames on the
                way have.
            nodeID, run: nodeID and run of the transforms, of both topics; None = all.
            tf, tf_static: Topics of moving and of fixed transforms. One of them may be missing.

        Returns:
            A geometry_msgs/TransformStamped: ``header.frame_id`` is target, ``child_frame_id``
            source, ``header.stamp`` the time (for 0 the one found, 0 if all frames are fixed).

        Raises:
            LookupException, ConnectivityException, ExtrapolationException: As in tf2; each is a
                TransformException of this package.
            TopicNotFound: Neither topic is stored.
            TypeMismatch: A topic does not hold transforms.
            MissingDependency: tf2_py is not installed.
            RunNotFound, InvalidKey, InvalidName.
        """
        writers = self.catalog.keyspace.runs.writers(run)
        return lookup_transform(
            self.catalog.get, nodeID, writers, target, source, time, tf, tf_static
        )


def _near_rows(
    catalog: Catalog,
    disk: NearDisk,
    topics: Iterable[str] | None,
    read: Read,
    where: Conditions,
) -> Iterator[StoredRow]:
    """Return the rows of topics (None = all) whose robot was on a disk; see RosCassandra.near.

    What is wrong is raised here, not when the first row is taken.
    """
    tables = catalog.tables(topics)
    names = sorted({table.metadata.topic for table in tables})
    # Before NEAR is joined: what is wrong with a condition of the caller stays an InvalidQuery.
    catalog.filters(where, names, read.whose)
    condition_by_name = {
        catalog.get(name).name: condition for name, condition in (where or {}).items()
    }
    conditions: dict[str, Where] = {
        name: _and_near(condition_by_name.get(name), disk) for name in names
    }
    try:
        with catalog.places.shared():
            filters = catalog.filters(conditions, names, read.whose)
            return catalog.merged(tables, filters, read)
    except InvalidQuery as exc:
        raise InvalidOption(exc.reason) from exc


def _and_near(where: Where | None, disk: NearDisk) -> Where:
    """Return the condition NEAR with its values, joined with another condition if there is one."""
    values = list(disk if disk[-1] else disk[:-1])
    near = f"NEAR({', '.join('?' * len(values))})"
    if where is None:
        return near, values
    text, params = (where, ()) if isinstance(where, str) else where
    # On separate lines, because the condition may end with a comment.
    return f"(\n{text}\n) AND {near}", [*params, *values]
