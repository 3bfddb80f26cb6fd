# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Read and write stored messages with the methods of rosbag.Bag."""

from __future__ import annotations

import atexit
import io
import math
import os
import sys
from collections import Counter
from dataclasses import replace
from enum import Enum
from functools import lru_cache, partial
from itertools import count, groupby
from operator import attrgetter
from typing import (
    IO,
    AbstractSet,
    Any,
    Callable,
    Iterable,
    Iterator,
    Mapping,
    NamedTuple,
    Sequence,
    Union,
)

import numpy as np

from cassandra_ros.arguments import check_list, check_new_topic, check_topic
from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.errors import BagError, BagNotFound, InvalidOption, RunNotFound, TypeMismatch
from cassandra_ros.files.bag.file_formats import runs_of_content
from cassandra_ros.files.bag.format import COMPRESSIONS
from cassandra_ros.files.bag.identity import describe_same_name, runs_meant, runs_of_file, source_of
from cassandra_ros.files.bag.message_sample import MessageSample, join_samples, read_samples
from cassandra_ros.files.bag.summary import Summary, TopicSummary
from cassandra_ros.keys import MAX_NS, SECOND_NS, new_writer_id
from cassandra_ros.messages.classes import installed_definition, serialize
from cassandra_ros.messages.connection_header import Connection, live_connection
from cassandra_ros.messages.stamps import Stamp, Time, seconds_to_ns, to_ns
from cassandra_ros.store.connection.address import from_environment
from cassandra_ros.store.tables.registry import Run
from cassandra_ros.topics.cassandra_topic import CassandraTopic
from cassandra_ros.topics.message_adder import clock_ns
from cassandra_ros.topics.message_writer import Handle
from cassandra_ros.topics.stored_row import StoredRow, with_messages
from cassandra_ros.topics.stored_totals import TopicInfo

SORTED_BYTES = 32 << 20
"""Maximum size of the messages of one receive time that are sorted in memory, bytes. If there are
more, they are read again, once for each connection."""
_ROW_BYTES = 1000
"""Approximate memory that a row needs in addition to its message, bytes."""

RowsReceived = Callable[["Time | None", "Time | None"], Iterator[StoredRow]]
"""Function that reads the rows of a time range (ends included) in the order of receive time."""


def in_bag_order(read: RowsReceived, start: Time | None, end: Time | None) -> Iterator[StoredRow]:
    """Yield the rows that ``read`` returns; rows of equal time are sorted by connection number.

    Memory: the messages of one receive time, at most SORTED_BYTES and one message. Above that limit
    the messages of this time are read again, once for each connection.
    """
    for t_ns, group in groupby(read(start, end), attrgetter("received")):
        rows: list[StoredRow] = []
        numbers: set[int] = set()
        nbytes = 0
        for row in group:
            numbers.add(_number(row))
            nbytes += row.size + _ROW_BYTES
            if nbytes <= SORTED_BYTES:
                rows.append(row)
            else:
                rows.clear()
        if nbytes <= SORTED_BYTES:
            yield from rows if len(numbers) == 1 else sorted(rows, key=_number)
            continue
        at = Stamp.from_ns(t_ns)
        for number in sorted(numbers):
            yield from (row for row in read(at, at) if _number(row) == number)


def _number(row: StoredRow) -> int:
    """Return the number of a row's connection in its bag; -1 for that of a recording."""
    return row.connection.number


MOST_STAMPS = 100_000
"""Number of first messages of a topic from which its frequency and its connections are computed."""

ConnectionFilter = Callable[[str, str, str, str, Mapping[str, bytes]], object]
"""Function of (topic, type, md5sum, definition, header) that accepts or rejects a connection."""
TopicNames = Union[None, str, Iterable[str]]


class BagMessage(NamedTuple):
    """A message as rosbag returns it."""

    topic: str
    message: Any
    """The message; with raw=True (type, bytes, md5sum, position, class)."""
    timestamp: Stamp
    """Receive time."""


class BagMessageWithConnectionHeader(NamedTuple):
    """A message as rosbag returns it with return_connection_header=True."""

    topic: str
    message: Any
    timestamp: Stamp
    connection_header: Mapping[str, bytes]


class BagConnection(NamedTuple):
    """A connection as rosbag describes it: one publisher of one topic."""

    id: int
    topic: str
    datatype: str
    md5sum: str
    msg_def: str
    header: Mapping[str, bytes]


class TopicTuple(NamedTuple):
    """The information about one topic that get_type_and_topic_info returns."""

    msg_type: str
    message_count: int
    connections: int
    frequency: float | None
    """Rate, Hz: 1 / median period; None if the topic has a single message."""


class CompressionTuple(NamedTuple):
    """The result of get_compression_info."""

    compression: str
    uncompressed: int
    """Size of the messages before compression, bytes."""
    compressed: int
    """Size of the messages after compression, bytes."""


class TypesAndTopicsTuple(NamedTuple):
    """The result of get_type_and_topic_info."""

    msg_types: Mapping[str, str]
    """Type -> md5sum."""
    topics: Mapping[str, TopicTuple]


class _Everything(Enum):
    EVERYTHING = "all that the keyspace holds"


EVERYTHING = _Everything.EVERYTHING
"""Default of the first argument of Bag: read all runs of the keyspace."""
FileName = Union[str, bytes, "os.PathLike[str]", IO[bytes]]


class RunContents:
    """What some runs of a keyspace hold: topics, connections, counts and times.

    Args:
        store: The keyspace.
        name: Name of the bag, for errors.
        node: nodeID of the robot whose messages count; None = all robots.
        run: Writer ids of the runs; None = all.
    """

    def __init__(
        self, store: RosCassandra, name: str, node: str | None, run: frozenset[int] | None
    ) -> None:
        self._store, self._name, self._node, self._run = store, name, node, run

    def topics(self, names: TopicNames) -> list[CassandraTopic]:
        """Return the topics of the keyspace that rosbag selects by these names; no name = all.

        Topics of which these runs have no message are among them.
        """
        stored = self._store.getAllTopics()
        listed = [] if names is None else check_list("topics", names, "['/tf']")
        if not listed or (isinstance(names, str) and not names):
            return list(stored)
        selected = {_canonical(check_topic(name)) for name in listed}
        return [t for t in stored if not selected.isdisjoint((t.name, _canonical(t.name)))]

    def filter_connections(
        self, topics: Sequence[CassandraTopic], test: ConnectionFilter
    ) -> tuple[list[CassandraTopic], set[tuple[str, int]]]:
        """Apply a filter to the connections of topics.

        Returns:
            The topics with at least one accepted connection, and the accepted connections as
            (table name, ``_conn``).
        """
        topic_of = {table.name: topic.name for topic in topics for table in topic.tables}
        passing = {
            (table, conn)
            for table, conn, connection in self.connections(topics)
            if test(*_describe(0, topic_of[table], connection)[1:])  # [0] is the number
        }
        tables = {table for table, _ in passing}
        return [t for t in topics if any(table.name in tables for table in t.tables)], passing

    def connections(
        self, topics: Sequence[CassandraTopic]
    ) -> Iterator[tuple[str, int, Connection]]:
        """Yield table, ``_conn`` and connection of all stored connections of topics, of any run."""
        tables = {table.name for topic in topics for table in topic.tables}
        return self._store.catalog.keyspace.connections.of_tables(tables)

    def held_connections(
        self, topics: Iterable[CassandraTopic]
    ) -> Iterator[tuple[str, Connection]]:
        """Yield the connections that have messages in the bag, with the names of their topics.

        The rows of a topic are read until all its connections were seen, else to the end.
        """
        for topic in topics:
            missing = {
                (table, conn): connection for table, conn, connection in self.connections([topic])
            }
            rows = topic.rows(nodeID=self._node, run=self._run, columns=lambda table: ())
            for row in rows:
                connection = missing.pop((row.table.name, row.conn), None)
                if connection is not None:
                    yield topic.name, connection
                if not missing:
                    break

    def rows_received(
        self, topics: Sequence[CassandraTopic], start: Time | None, end: Time | None
    ) -> Iterator[StoredRow]:
        """Yield the rows of topics of a time range, ends included, by their receive times."""
        names, node, run = [topic.name for topic in topics], self._node, self._run
        return self._store.readMessages(names, start, end, nodeID=node, run=run, received=True)

    def sample(self, topic: CassandraTopic) -> MessageSample:
        """Return what the first MOST_STAMPS messages of a topic tell of its rate and publishers."""
        return join_samples(read_samples(topic, MOST_STAMPS, self._node, self._run).values())

    def counts(self) -> Counter[str]:
        """Return the number of messages by topic, for topics that have any."""
        counts: Counter[str] = Counter()
        for info in self.infos():
            counts[info.topic] += info.count
        return counts

    def by_name(self, names: TopicNames) -> dict[str, list[CassandraTopic]]:
        """Return the stored topics that rosbag selects by each name."""
        return {name: self.topics(name) for name in check_list("topics", names, "['/tf']")}

    def infos(self, names: Sequence[str] | None = None) -> list[TopicInfo]:
        """Return the counts and times of some topics, None = all, that have messages."""
        infos = self._store.info(names, nodeID=self._node, run=self._run)
        return [info for info in infos if info.count]

    def ends(self) -> tuple[int, int]:
        """Return the receive times of the first and the last message, ns.

        Raises:
            BagError: There is no message.
        """
        times: list[int] = []
        for info in self.infos():
            if info.first_ns is not None and info.last_ns is not None:
                times += [info.first_ns, info.last_ns]
        own_time_topics = [
            t.name for t in self.topics(None) if any(e.metadata.own_time for e in t.tables)
        ]
        if own_time_topics:
            # The keys of these topics are not receive times, so all their rows are read.
            timed = [t.name for t in self.topics(None) if t.name not in own_time_topics]
            times = [ns for i in self.infos(timed) for ns in (i.first_ns or 0, i.last_ns or 0)]
            for name in own_time_topics:
                rows = self._store.getTopic(name).rows(run=self._run, nodeID=self._node)
                times += [row.received for row in rows]
        if not times:
            raise bag_error(f"Bag contains no message: {self._name}")
        return min(times), max(times)


class BagRun:
    """A new run that a Bag writes.

    Args:
        store: The keyspace.
        run: The run.
        before: Writer ids of the runs that the bag had when it was opened.
    """

    def __init__(self, store: RosCassandra, run: Run, before: frozenset[int]) -> None:
        self._store = store
        self._before = before
        self._handles: dict[object, Handle] = {}
        """Handle by connection, where the caller gave a header; else by topic, type, md5 and text.
        """
        self._counter = count()
        self._numbers: Iterator[int] | None = None
        """Numbers for new connections; None = the highest stored number is not known yet."""
        self._writer = store.messageWriter(
            writer_id=run.writer, nodeID=run.node, format=run.format or None, run=run
        )

    def write(
        self,
        topic: str,
        msg: Any,
        t: Time | None,
        raw: bool,
        connection_header: Mapping[str, str | bytes] | None,
    ) -> None:
        """Write a message, see Bag.write; errors are the same."""
        ns = clock_ns(None) if t is None else to_ns(t)
        if raw:
            if not isinstance(msg, (tuple, list)) or len(msg) not in (4, 5):
                raise TypeMismatch("a raw message is (type, bytes, md5sum, class)")
            kind, wire, md5sum, cls = msg[0], bytes(msg[1]), msg[2], msg[-1]
        else:
            if not hasattr(type(msg), "_md5sum"):
                raise TypeMismatch(f"{msg!r:.80} is not a message: give a message object")
            cls, wire = type(msg), serialize(msg)
            kind, md5sum = cls._type, cls._md5sum
        # With the text: definitions that differ in brackets of arrays of messages have one md5.
        key: object = (topic, kind, md5sum, getattr(cls, "_full_text", None))
        if connection_header is not None:
            key = live_connection(check_new_topic(topic), connection_header)
        handle = self._handles.get(key)
        if handle is None:
            connection = (
                key if isinstance(key, Connection) else _connection(topic, kind, md5sum, cls)
            )
            connection = replace(connection, number=self._next_number())
            handle = self._handles[key] = self._writer.connect(connection)
        self._writer.write(handle, ns, next(self._counter), wire)

    def _next_number(self) -> int:
        """Return the number of a new connection: higher than all that the bag had when opened.

        So messages of equal time are read in the order in which their connections were written
        first.
        """
        if self._numbers is None:
            tables = [info.table for info in self._store.info(run=self._before)]
            stored = (
                self._store.catalog.keyspace.connections.of_tables(tables) if self._before else ()
            )
            self._numbers = count(
                max((connection.number for _, _, connection in stored), default=-1) + 1
            )
        return next(self._numbers)

    def flush(self) -> None:
        """Wait until the store has acknowledged all messages."""
        self._writer.flush()

    def close(self) -> None:
        """Wait until the store has acknowledged all messages, and end the run."""
        self._writer.close()


class Bag:
    """A run of the store with the methods of rosbag.Bag, so that scripts need not change.

    All times are receive times, and messages are read in their order. As in rosbag, topics that do
    not exist are ignored. Not safe to share between threads.

    Args:
        f: Path of an imported bag, or of a bag that an object of this class wrote; symbolic links
            are followed. If no such file exists here, also the name of a run (an imported bag has
            the name of its file) or a writer id. Several runs of one name are read as one. A file
            object means its path, and is closed with the bag. Omitted = all runs of the keyspace.
        mode: 'r' reads; 'w' writes a new run, and deletes the run that a Bag wrote to this path
            before; 'a' adds to the runs of this path or name. 'w' and 'a' can read, too.
        compression, chunk_threshold, allow_unindexed, options, skip_index: Accepted so that a
            script need not change; they concern files, and have no effect on the store. The first
            two are checked, and are attributes, for scripts that write a bag like this one.
        rosCas: A RosCassandra that is connected to a keyspace; the caller closes it. None = make a
            connection from the environment (CASSANDRA_ROS_HOST, _PORT, _KEYSPACE or 'ros').
        nodeID: When reading, the robot whose messages are read, None = all robots. When writing,
            the robot that the messages belong to.
        format: Storage format of new topics, as in addTopic.

    Raises:
        BagNotFound: No run has this path or name (a RunNotFound and, as in rosbag, an OSError). The
            text names runs of other files with this base name and how to open them, or the nearest
            names.
        BagError: With mode 'w': an imported bag or a recording has this path or name, and is not
            overwritten.
        InvalidOption: The mode or compression is unknown, or the threshold or the name cannot be
            used (a ValueError, as in rosbag). With mode 'w': another Bag still writes to this path.
        ConnectionFailed: No store answers.
    """

    version = 200
    """Version of the bag format that rosbag reports, 2.0."""

    def __init__(
        self,
        f: FileName | _Everything = EVERYTHING,
        mode: str = "r",
        compression: str = "none",
        chunk_threshold: int = 768 * 1024,
        allow_unindexed: bool = False,
        options: Mapping[str, Any] | None = None,
        skip_index: bool = False,
        *,
        rosCas: RosCassandra | None = None,
        nodeID: str | None = None,
        format: str | None = None,
    ) -> None:
        if mode not in ("r", "w", "a"):
            raise InvalidOption(f"mode={mode!r:.80} is not one of 'r', 'w' and 'a'")
        if f is EVERYTHING and mode != "r":
            raise InvalidOption("a run that is written needs a name: Bag('patrol', 'w')")
        if options is not None and not isinstance(options, Mapping):
            raise InvalidOption("options must be a dict: {'compression': 'bz2'}")
        settings: dict[str, Any] = {"compression": compression, "chunk_threshold": chunk_threshold}
        settings.update(options or {})
        self.compression = settings["compression"]
        self.chunk_threshold = settings["chunk_threshold"]
        self.mode = mode
        self._file = f if isinstance(f, io.IOBase) else None
        name = "" if f is EVERYTHING else _path_of(f)
        self._owns_store = rosCas is None
        self._store = rosCas or RosCassandra(keyspace=from_environment("KEYSPACE") or "ros")
        self._node = nodeID
        self._closed = False
        self._new_run: BagRun | None = None
        """Run that is written; None = the mode is 'r'."""
        try:
            self.filename = name or str(self._store.keyspace)
            runs = None if f is EVERYTHING else self._open(format)
            self._stored = RunContents(self._store, self.filename, nodeID, runs)
        except BaseException:
            self.close()
            raise

    @property
    def options(self) -> dict[str, Any]:
        """The options with which a script can write a bag like this one."""
        return {"compression": self.compression, "chunk_threshold": self.chunk_threshold}

    @property
    def compression(self) -> str:
        """'none', 'bz2' or 'lz4', as given to the constructor. It has no effect on the store."""
        return self._compression

    @compression.setter
    def compression(self, name: str) -> None:
        if name not in COMPRESSIONS:
            raise InvalidOption(f"compression={name!r:.80} is not one of {', '.join(COMPRESSIONS)}")
        self._compression = name

    @property
    def chunk_threshold(self) -> int:
        """Chunk size, bytes, as given to the constructor. It has no effect on the store."""
        return self._chunk_threshold

    @chunk_threshold.setter
    def chunk_threshold(self, size: int) -> None:
        if not size >= 0:
            raise InvalidOption(f"chunk_threshold={size!r:.80} is less than 0 bytes")
        self._chunk_threshold = size

    def _open(self, format: str | None) -> frozenset[int]:
        """Return the writer ids of the bag's runs. If the mode is 'w' or 'a', begin a new run.

        Raises:
            BagNotFound, BagError: As the class. With mode 'a' a run may be missing, but not where a
                file has this name: its messages would seem to be in the new run.
        """
        name, runs = self.filename, self._store.catalog.keyspace.registry.runs()
        if self.mode == "w":
            writers = _make_room(self._store, self._node or "", name, runs)
        else:
            meant = runs_meant(runs, name) or runs_of_content(runs, name)
            writers = frozenset(run.writer for run in meant)
        if self.mode == "r":
            return writers or _writers_named(self._store, name, runs)
        if self.mode == "a" and not writers and os.path.isfile(name) and os.path.getsize(name):
            _writers_named(self._store, name, runs)  # raises BagNotFound
        writer = new_writer_id()
        base, source = os.path.basename(name), source_of(name)
        run = Run(self._node or "", writer, "api", base, source, format or "")
        self._new_run = BagRun(self._store, run, writers)
        atexit.register(self.close)  # a script that does not close the bag loses no messages
        return writers | {writer}

    def read_messages(
        self,
        topics: TopicNames = None,
        start_time: Time | None = None,
        end_time: Time | None = None,
        connection_filter: ConnectionFilter | None = None,
        raw: bool = False,
        return_connection_header: bool = False,
    ) -> Iterator[BagMessage | BagMessageWithConnectionHeader]:
        """Yield messages lazily in the order of their receive times, as rosbag does.

        Messages of equal time are ordered by connection: as in the imported bag, or in the order
        in which a Bag first wrote to the connections; otherwise in the order of arrival.

        Args:
            topics: Names of topics, or one name; None or an empty list = all. As in rosbag,
                slashes that are doubled or at the end do not count.
            start_time, end_time: First and last receive time, both included, in any form that a
                key may have; None or 0 = open.
            connection_filter: Function of (topic, type, md5sum, definition, header); only messages
                of connections for which it returns a true value are read.
            raw: Yield (type, bytes, md5sum, position, class) instead of the message.
            return_connection_header: Yield (topic, message, t, header) instead of (topic, message,
                t).

        Raises:
            BagError: The bag is closed.
            InvalidKey: start_time or end_time is not a time.
        """
        contents = self._contents
        ends = start_time or None, _within_ros(end_time or None)
        selected, passing = contents.topics(topics), None
        if connection_filter is not None:
            selected, passing = contents.filter_connections(selected, connection_filter)
        if not selected:
            return iter(())
        rows = in_bag_order(partial(contents.rows_received, selected), *ends)
        return self._messages_of(rows, passing, raw, return_connection_header)

    def _messages_of(
        self,
        rows: Iterator[StoredRow],
        passing: AbstractSet[tuple[str, int]] | None,
        raw: bool,
        with_header: bool,
    ) -> Iterator[BagMessage | BagMessageWithConnectionHeader]:
        """Yield the messages of rows as read_messages does.

        Args:
            passing: Table name and ``_conn`` of the connections that are read; None = all.
        """
        if passing is not None:
            rows = (row for row in rows if (row.table.name, row.conn) in passing)
        if raw:
            pairs: Iterator[tuple[StoredRow, Any]] = ((row, _raw(row)) for row in rows)
        else:
            pairs = with_messages(self._store.cassandra, rows)
        for row, message in pairs:
            bag_message = BagMessage(row.topic, message, Stamp.from_ns(row.received))
            if with_header:
                yield BagMessageWithConnectionHeader(*bag_message, dict(row.connection.fields))
            else:
                yield bag_message

    def _get_connections(
        self, topics: TopicNames = None, connection_filter: ConnectionFilter | None = None
    ) -> Iterator[BagConnection]:
        """Yield the connections that have messages in the bag, for scripts that use this of rosbag.

        If other runs have messages of a topic, all rows of the topic in this bag are looked at.
        ``id`` is the number in the imported bag, or of a recording the position among the others.

        Args:
            topics, connection_filter: As in read_messages.
        """
        contents = self._contents
        held = contents.held_connections(contents.topics(topics))
        pairs = sorted(held, key=lambda pair: pair[1].number)
        numbers = [connection.number for _, connection in pairs]
        are_unique = len(set(numbers)) == len(numbers) and min(numbers, default=0) >= 0
        for place, (topic, connection) in enumerate(pairs):
            described = _describe(connection.number if are_unique else place, topic, connection)
            if connection_filter is None or connection_filter(*described[1:]):
                yield described

    def __iter__(self) -> Iterator[BagMessage | BagMessageWithConnectionHeader]:
        return self.read_messages()

    def write(
        self,
        topic: str,
        msg: Any,
        t: Time | None = None,
        raw: bool = False,
        connection_header: Mapping[str, str | bytes] | None = None,
    ) -> None:
        """Write a message. The store has acknowledged it when flush or close returns.

        Args:
            topic: Name of the topic.
            msg: A message object; with ``raw`` a tuple (type, bytes, md5sum, class) or the tuple
                with a position that read_messages yields.
            t: Receive time, in any form that a key may have; None = now.
            raw: Whether msg is such a tuple.
            connection_header: Connection header of the publisher; None = make one.

        Raises:
            BagError: The bag is closed, or open for reading only.
            TypeMismatch: msg is not a message.
            InvalidKey, InvalidName, WriteFailed.
        """
        self._require_open()
        if self._new_run is None:
            raise bag_error(f"{self.filename} is open for reading: open it with mode 'w' or 'a'")
        self._new_run.write(topic, msg, t, raw, connection_header)

    def get_message_count(self, topic_filters: TopicNames = None) -> int:
        """Return the number of messages of some topics, None = all, from the directory.

        As in rosbag, a topic that has several of the names counts for each of them.
        """
        contents = self._contents
        counts = contents.counts()
        if topic_filters is None:
            return sum(counts.values())
        return sum(
            counts.get(topic.name, 0)
            for topics in contents.by_name(topic_filters).values()
            for topic in topics
        )

    def get_type_and_topic_info(self, topic_filters: TopicNames = None) -> TypesAndTopicsTuple:
        """Return the message types of all topics, and information about some topics, None = all.

        Frequency and number of connections are computed from the first MOST_STAMPS messages of
        each topic.
        """
        contents = self._contents
        counts = contents.counts()
        filled_topics = {t.name: t for t in contents.topics(None) if t.name in counts}
        filters = list(filled_topics) if topic_filters is None else topic_filters
        names_of = {
            name: [topic.name for topic in topics if topic.name in counts]
            for name, topics in contents.by_name(filters).items()
        }
        sampled = {name for names in names_of.values() for name in names}
        topic_of = {
            table.name: name for name, topic in filled_topics.items() for table in topic.tables
        }
        stored: dict[str, list[Connection]] = {}
        for table, _, connection in contents.connections(list(filled_topics.values())):
            stored.setdefault(topic_of[table], []).append(connection)
        used: list[Connection] = []
        samples: dict[str, MessageSample] = {}
        # Other runs may have connections of other types: only messages tell those of this bag.
        for name, topic in filled_topics.items():
            connections = stored.get(name, [])
            if (
                name in sampled
                or len({(connection.type, connection.md5sum) for connection in connections}) != 1
            ):
                samples[name] = contents.sample(topic)
                connections = samples[name].connections
            used += connections
        topics: dict[str, TopicTuple] = {}
        for name, topic_names in sorted(names_of.items()):
            whole = join_samples(samples[topic] for topic in topic_names)
            if topic_names:
                topics[name] = TopicTuple(
                    whole.connections[0].type,
                    sum(counts[topic] for topic in topic_names),
                    len(whole.connections),
                    whole.frequency,
                )
        types: dict[str, str] = {}
        for connection in sorted(used, key=lambda connection: connection.number):
            types.setdefault(connection.type, connection.md5sum)
        return TypesAndTopicsTuple(dict(sorted(types.items())), topics)

    def get_compression_info(self) -> CompressionTuple:
        """Return 'none' and the size of the serialised messages, bytes, twice.

        The store compresses messages in its own way, which does not concern the files of rosbag.
        """
        size = self.size
        return CompressionTuple("none", size, size)

    def reindex(self) -> Iterator[int]:
        """Do nothing, and yield nothing: the store needs no index that could be rebuilt."""
        self._require_open()
        return iter(())

    def set_encryptor(self, encryptor: str | None = None, param: str | None = None) -> None:
        """Accept None only: the store has no chunks that could be encrypted.

        Raises:
            BagError: An encryptor is named. Use TLS and encrypted disks instead.
        """
        if encryptor is not None:
            raise bag_error(
                f"encryptor={encryptor!r:.80} cannot be set: the store has no chunks to encrypt; "
                "use TLS and encrypted disks, or encrypt the bags that are exported"
            )

    def get_start_time(self) -> float:
        """Return the receive time of the first message, s since 1970; BagError if it is empty.

        A float cannot express every ns. In whatever way the float is converted to a time, that is
        not after the message, so read_messages(start_time=…) includes it.
        """
        ns = self._contents.ends()[0]
        return _nearest_seconds(ns, lambda time: time <= ns, 0.0)

    def get_end_time(self) -> float:
        """Return the receive time of the last message, s since 1970; BagError if it is empty.

        In whatever way the float is converted to a time, that is not before the message.
        """
        ns = self._contents.ends()[1]
        return _nearest_seconds(ns, lambda time: time >= ns, math.inf)

    @property
    def size(self) -> int:
        """Size of the serialised messages, bytes."""
        return sum(info.bytes for info in self._contents.infos())

    @property
    def _contents(self) -> RunContents:
        """What its runs hold, with all that was written until now; BagError if it is closed."""
        self.flush()
        return self._stored

    def flush(self) -> None:
        """Wait until the store has acknowledged all written messages, so that readers find them."""
        self._require_open()
        if self._new_run is not None:
            self._new_run.flush()

    def _require_open(self) -> None:
        if self._closed:
            raise bag_error(f"{self.filename} is closed: open another Bag")

    def close(self) -> None:
        """Flush, and close the connection to the store if this object made it.

        A second call does nothing.
        """
        if self._closed:
            return
        self._closed = True
        atexit.unregister(self.close)
        try:
            if self._new_run is not None:
                self._new_run.close()
        finally:
            if self._owns_store:
                self._store.close()
            if self._file is not None:
                self._file.close()

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def __repr__(self) -> str:
        state = "closed" if self._closed else f"mode {self.mode}"
        return f"<Bag {self.filename!r} of keyspace {self._store.keyspace}, {state}>"

    def __str__(self) -> str:
        return self._summary().text()

    def _get_yaml_info(self, key: str | None = None) -> str | None:
        """Return the facts of str() as YAML, or one of them. The ROS wiki tells scripts to use it.

        Return None if there is no fact of this name, as rosbag does.
        """
        return self._summary().yaml(key)

    def _summary(self) -> Summary:
        types, topics = self.get_type_and_topic_info()
        lines = [TopicSummary(name, *topic) for name, topic in topics.items()]
        ends = self._contents.ends() if topics else None
        return Summary(self.filename, self.size, ends, types, lines)


def _writers_named(store: RosCassandra, name: str, runs: Sequence[Run]) -> frozenset[int]:
    """Return the writer ids for a name that no run has: it may be a writer id without a run.

    Raises:
        BagNotFound: It is not.
    """
    same_name = describe_same_name(runs, name)
    place = f"{name} is not stored in keyspace {store.keyspace}"
    if same_name and (os.path.isfile(name) or os.path.basename(name) != name):
        raise BagNotFound(f"{place}; {same_name}")
    if os.path.isfile(name):
        raise BagNotFound(f"{place}: store it first: cassandra_bag import {name}")
    try:
        return store.catalog.keyspace.runs.writers(name) or frozenset()
    except RunNotFound as exc:
        raise BagNotFound(str(exc)) from exc


def _make_room(store: RosCassandra, node: str, name: str, runs: Sequence[Run]) -> frozenset[int]:
    """Delete the runs that a Bag wrote to this path before, as rosbag overwrites its file.

    Return the writer ids of those that stay, because they belong to other robots.

    Raises:
        BagError: A run of another kind, or of another path, has this path or name.
    """
    before = runs_of_file(runs, name)
    named = [run for run in runs if run.name == name and run not in before]
    for run in named + [run for run in before if run.kind != "api"]:
        place = f" (of {run.source})" if run.source else ""
        raise bag_error(
            f"run {name}{place} is stored already in keyspace {store.keyspace}, and is "
            "not overwritten: add to it with mode 'a', choose another name or path, or remove "
            "it first with rosCas.upkeep.delete(run=…)"
        )
    deleted = frozenset(run.writer for run in before if run.node == node)
    if deleted:
        store.upkeep.delete(run=deleted)
    return frozenset(run.writer for run in before) - deleted


def _path_of(f: object) -> str:
    """Return the path of a file name or of a file object.

    Raises:
        BagError: The file object is not a binary one.
        InvalidOption: There is no path.
    """
    if isinstance(f, io.IOBase):
        if "b" not in getattr(f, "mode", "b"):
            raise bag_error("a file object must be opened in binary mode: open(path, 'rb')")
        f = getattr(f, "name", None)
        if not isinstance(f, (str, bytes)):
            raise InvalidOption("a file object stands for the path of its file; this one has none")
    if not f or not isinstance(f, (str, bytes, os.PathLike)):
        raise InvalidOption(
            f"f={f!r:.80} names no bag: give a run's name or a path; without f all is read that "
            "the keyspace holds"
        )
    return os.fsdecode(f)


def _raw(row: StoredRow) -> tuple[object, ...]:
    """Return a message as rosbag does with raw=True, see BagMessage."""
    return (row.type, row.wire, row.connection.md5sum, row.position, row.message_class())


def _connection(topic: str, kind: str, md5sum: str, cls: Any) -> Connection:
    """Make a connection for messages whose publisher is unknown.

    Args:
        cls: Class of the messages; without a definition of its own the installed one is taken.
    """
    text = getattr(cls, "_full_text", None) or installed_definition(kind).text
    header = {"topic": topic, "type": kind, "md5sum": md5sum, "message_definition": text}
    return live_connection(check_new_topic(topic), header)


def _describe(number: int, topic: str, connection: Connection) -> BagConnection:
    """Return a connection as rosbag describes it, under the present name of its topic."""
    facts = connection.type, connection.md5sum, connection.definition_text
    return BagConnection(number, topic, *facts, dict(connection.fields))


def _canonical(name: str) -> str:
    """Return a name as roslib.names.canonicalize_name does: without superfluous slashes."""
    return "/" * name.startswith("/") + "/".join(filter(None, name.split("/")))


def _within_ros(end: Time | None) -> Time | None:
    """Return the end of a time range; an object or a float after the last time of ROS is open."""
    if isinstance(end, float) and seconds_to_ns(end) > MAX_NS:
        return None
    to_nsec = getattr(end, "to_nsec", None)  # of a time of genpy
    return None if to_nsec is not None and to_nsec() > MAX_NS else end


def _nearest_seconds(ns: int, fits: Callable[[int], bool], towards: float) -> float:
    """Return the float nearest to a time, s, of which every usual conversion fits.

    Args:
        ns: The time, ns.
        fits: Whether the result of a conversion, ns, may be returned.
        towards: In which direction another float is searched: 0.0 or infinity.
    """
    seconds: float = Stamp.from_ns(ns).to_sec()
    while not all(
        fits(time)
        # Ours, that of rospy.Time, and that of a script which counts nanoseconds.
        for time in (seconds_to_ns(seconds), _truncated_ns(seconds), int(seconds * SECOND_NS))
    ):
        seconds = float(np.nextafter(seconds, towards))
    return seconds


def _truncated_ns(seconds: float) -> int:
    """Return the ns of a genpy Time of these seconds, which is refused above 2**32 s."""
    whole = int(seconds)
    return whole * SECOND_NS + int((seconds - whole) * SECOND_NS)


def bag_error(text: str) -> BagError:
    """Return a BagError; where rosbag is imported in this process, also a ROSBagException."""
    return _rosbag_error()(text) if "rosbag.bag" in sys.modules else BagError(text)


@lru_cache(maxsize=None)
def _rosbag_error() -> type[BagError]:
    """Return the class of our errors that rosbag's users catch; made only where rosbag is there."""
    from rosbag.bag import ROSBagException

    class StoredBagError(BagError, ROSBagException):
        """A BagError of class Bag that is also a ROSBagException."""

        __module__, __qualname__ = BagError.__module__, BagError.__qualname__

        @property
        def value(self) -> str:
            """The error text, under the name that rosbag uses."""
            return str(self)

        def __reduce__(self) -> tuple[object, ...]:
            return bag_error, self.args

    return StoredBagError
