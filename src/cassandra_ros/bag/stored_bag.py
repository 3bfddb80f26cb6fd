# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is stored, read and written as by class Bag of the module rosbag."""

from __future__ import annotations

import atexit
import io
import os
from dataclasses import replace
from enum import Enum
from functools import partial
from itertools import count
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

from cassandra_ros.arguments import check_list, check_new_topic
from cassandra_ros.bag.bag_order import in_bag_order
from cassandra_ros.bag.chunk import COMPRESSIONS
from cassandra_ros.bag.file_runs import runs_meant, runs_of_file, source_of, told_alike
from cassandra_ros.bag.message_sample import joined, read_samples
from cassandra_ros.bag.rosbag_errors import bag_error
from cassandra_ros.bag.summary import Summary, TopicSummary
from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.connection.address import from_environment
from cassandra_ros.errors import BagNotFound, InvalidOption, RunNotFound, TypeMismatch
from cassandra_ros.keys import new_writer_id
from cassandra_ros.messages.classes import installed_definition, serialize
from cassandra_ros.messages.connection_header import Connection, live_connection
from cassandra_ros.messages.stamps import Stamp, Time, to_ns
from cassandra_ros.tables.registry import Run
from cassandra_ros.topics.adder import now_ns
from cassandra_ros.topics.cassandra_topic import CassandraTopic
from cassandra_ros.topics.key_selection import spellings
from cassandra_ros.topics.message_objects import with_messages
from cassandra_ros.topics.message_writer import Handle, MessageWriter
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.stored_totals import TopicInfo

MOST_STAMPS = 100_000
"""Messages of a topic whose times tell its frequency, and publishers in one run; the first ones."""

ConnectionFilter = Callable[[str, str, str, str, Mapping[str, bytes]], object]
"""Called with topic, type, md5sum, definition and header of a connection."""
TopicNames = Union[None, str, Iterable[str]]


class BagMessage(NamedTuple):
    """A message as rosbag hands it out."""

    topic: str
    message: Any
    """The message; with raw=True (type, bytes, md5sum, position, class)."""
    timestamp: Stamp
    """When it was received."""


class BagMessageWithConnectionHeader(NamedTuple):
    """A message as rosbag hands it out with return_connection_header=True."""

    topic: str
    message: Any
    timestamp: Stamp
    connection_header: Mapping[str, bytes]


class TopicTuple(NamedTuple):
    """What get_type_and_topic_info tells of a topic."""

    msg_type: str
    message_count: int
    connections: int
    frequency: float | None
    """Hz, by the median of the periods; None of a single message."""


class CompressionTuple(NamedTuple):
    """What get_compression_info returns."""

    compression: str
    uncompressed: int
    """Bytes."""
    compressed: int
    """Bytes."""


class TypesAndTopicsTuple(NamedTuple):
    """What get_type_and_topic_info returns."""

    msg_types: Mapping[str, str]
    """Type -> md5sum."""
    topics: Mapping[str, TopicTuple]


class _Everything(Enum):
    EVERYTHING = "all that the keyspace holds"


EVERYTHING = _Everything.EVERYTHING
"""In the place of the name of a bag that is read."""
FileName = Union[str, bytes, "os.PathLike[str]", IO[bytes]]


class Bag:
    """A run of the store as if it were a bag: what a script does with rosbag.Bag it does with this.

    The times that it hands out are those of reception, in whose order messages are read. Topics
    that are not there are passed over, as by rosbag. Not safe to share between threads.

    Args:
        f: Path of a bag that was imported, or that a Bag wrote: links are followed, and no other
            file is taken for it. Or the name of a run, which an imported bag has from its file, or
            a writer id: where no file is called so here. Several runs of one name are read as one.
            A file object stands for its path, and is closed with the bag. Left out = all that the
            keyspace holds.
        mode: 'r' reads; 'w' writes a new run, in the place of what a Bag wrote to this path before;
            'a' adds to those of the name. 'w' and 'a' read, too.
        compression, chunk_threshold, allow_unindexed, options, skip_index: Taken so that a script
            need not change; they are about files. A store has formats instead. The first two are
            checked, and are attributes, for a script that writes a bag like this one.
        rosCas: A RosCassandra that is connected to a keyspace; it stays the caller's. None = one of
            its own, opened as the environment says (CASSANDRA_ROS_HOST, _PORT, _KEYSPACE; 'ros').
        nodeID: Reading: only messages of this robot, None = of all; writing: whose they are.
        format: Storage format of new topics, as addTopic takes it.

    Raises:
        BagNotFound: No run has this path or name (a RunNotFound, and as rosbag an OSError). The
            text names runs of other files that are called so, and how to open those; or the
            nearest names.
        BagError: Mode 'w', and an imported bag or a recording has this path or name: that is not
            overwritten.
        InvalidOption: An unknown mode or compression, a threshold or a name that cannot be used (a
            ValueError, as in rosbag); mode 'w' while another Bag still writes to this path.
        ConnectionFailed: No store answers.
    """

    version = 200
    """As of the bags that rosbag writes."""

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
            raise InvalidOption(f"mode={mode!r:.80} is none of 'r', 'w' and 'a'")
        if f is EVERYTHING and mode != "r":
            raise InvalidOption("a run that is written needs a name: Bag('patrol', 'w')")
        if options is not None and not isinstance(options, Mapping):
            raise InvalidOption("options must be a dict: {'compression': 'bz2'}")
        given: dict[str, Any] = {"compression": compression, "chunk_threshold": chunk_threshold}
        given.update(options or {})
        self.compression, self.chunk_threshold = given["compression"], given["chunk_threshold"]
        self.mode = mode
        self._file = f if isinstance(f, io.IOBase) else None
        name = "" if f is EVERYTHING else _path_of(f)
        self._own = rosCas is None
        self._store = rosCas or RosCassandra(keyspace=from_environment("KEYSPACE") or "ros")
        self._node = nodeID
        self._closed = False
        self._writer: MessageWriter | None = None
        self._handles: dict[object, Handle] = {}
        self._counter = count()
        self._before: frozenset[int] = frozenset()
        """Writer ids of what was in the bag when it was opened to be written."""
        self._numbers: Iterator[int] | None = None
        """Numbers of further connections; None = those of the bag are not looked up yet."""
        try:
            self.filename = name or str(self._store.keyspace)
            self._run = None if f is EVERYTHING else self._open(format)
        except BaseException:
            self.close()
            raise

    @property
    def options(self) -> dict[str, Any]:
        """The options of a bag that is written like this one."""
        return {"compression": self.compression, "chunk_threshold": self.chunk_threshold}

    @property
    def compression(self) -> str:
        """'none', 'bz2' or 'lz4', as it was given; the store packs messages in its own way."""
        return self._compression

    @compression.setter
    def compression(self, name: str) -> None:
        if name not in COMPRESSIONS:
            raise InvalidOption(f"compression={name!r:.80} is none of {', '.join(COMPRESSIONS)}")
        self._compression = name

    @property
    def chunk_threshold(self) -> int:
        """Bytes, 0 or more, as it was given; the store has no chunks of a file."""
        return self._chunk_threshold

    @chunk_threshold.setter
    def chunk_threshold(self, size: int) -> None:
        if not size >= 0:
            raise InvalidOption(f"chunk_threshold={size!r:.80} is less than 0 bytes")
        self._chunk_threshold = size

    def _open(self, format: str | None) -> frozenset[int]:
        """Return the writer ids that the bag is of; begin a run where it is to be written."""
        name, runs = self.filename, self._store.catalog.keyspace.registry.runs()
        found = frozenset(run.writer for run in runs_meant(runs, name))
        if self.mode == "r":
            return found or self._absent(name, runs)
        if self.mode == "w":
            found = self._make_room(name, runs)
        elif not found and os.path.isfile(name) and os.path.getsize(name):
            self._absent(name, runs)
        self._before = found
        writer = new_writer_id()
        base, source = os.path.basename(name), source_of(name)
        run = Run(self._node or "", writer, "api", base, source, format or "")
        self._writer = self._store.messageWriter(
            writer_id=writer, nodeID=run.node, format=format, run=run
        )
        atexit.register(self.close)  # a script that forgets to close loses nothing
        return found | {writer}

    def _absent(self, name: str, runs: Sequence[Run]) -> frozenset[int]:
        """Return the writer id that a name is, though no run has it; else raise BagNotFound."""
        alike = told_alike(runs, name)
        place = f"{name} is not stored in keyspace {self._store.keyspace}"
        if alike and (os.path.isfile(name) or os.path.basename(name) != name):
            raise BagNotFound(f"{place}; {alike}")
        if os.path.isfile(name):
            raise BagNotFound(f"{place}: store it first: cassandra_bag import {name}")
        try:
            return self._store.catalog.keyspace.runs.writers(name) or frozenset()
        except RunNotFound as exc:
            raise BagNotFound(str(exc)) from exc

    def _make_room(self, name: str, runs: Sequence[Run]) -> frozenset[int]:
        """Delete what a Bag wrote to this path before, as rosbag would empty its file."""
        before = runs_of_file(runs, name)
        named = [run for run in runs if run.name == name and run not in before]
        for run in named + [run for run in before if run.kind != "api"]:
            place = f" (of {run.source})" if run.source else ""
            raise bag_error(
                f"run {name}{place} is stored already in keyspace {self._store.keyspace}, and is "
                "not overwritten: add to it with mode 'a', choose another name or path, or remove "
                "it first with rosCas.upkeep.delete(run=…)"
            )
        mine = frozenset(run.writer for run in before if run.node == (self._node or ""))
        if mine:
            self._store.upkeep.delete(run=mine)
        return frozenset(run.writer for run in before) - mine

    def read_messages(
        self,
        topics: TopicNames = None,
        start_time: Time | None = None,
        end_time: Time | None = None,
        connection_filter: ConnectionFilter | None = None,
        raw: bool = False,
        return_connection_header: bool = False,
    ) -> Iterator[BagMessage | BagMessageWithConnectionHeader]:
        """Walk lazily through messages in the order of their reception, as rosbag.

        Those of equal times come by their connections, in the order that these have in the bag
        that was imported, or in which a Bag wrote to them first; else as they arrived.

        Args:
            topics: Their names, or one; None or none = all.
            start_time, end_time: Ends, both included, as a key is; None or 0 = open.
            connection_filter: Called with (topic, type, md5sum, definition, header) of each
                connection; only messages of those for which it returns true are read.
            raw: The message is (type, bytes, md5sum, position, class).
            return_connection_header: Yield (topic, message, t, header) instead of (topic, message,
                t).

        Raises:
            BagError: The bag is closed.
            InvalidKey: start_time or end_time is no time.
        """
        self.flush()
        ends = [None if not time else time for time in (start_time, end_time)]
        names, passing = self._topics(topics or None), None
        if connection_filter is not None:
            names, passing = self._filtered(names, connection_filter)
        if not names:
            return iter(())
        read = partial(
            self._store.readMessages,
            [topic.name for topic in names],
            nodeID=self._node,
            run=self._run,
            received=True,
        )
        rows = in_bag_order(read, *ends)
        return self._given(rows, passing, raw, return_connection_header)

    def _given(
        self,
        rows: Iterator[StoredRow],
        passing: AbstractSet[tuple[str, int]] | None,
        raw: bool,
        with_header: bool,
    ) -> Iterator[BagMessage | BagMessageWithConnectionHeader]:
        if passing is not None:
            rows = (row for row in rows if (row.table.name, row.conn) in passing)
        if raw:
            pairs: Iterator[tuple[StoredRow, Any]] = ((row, _raw(row)) for row in rows)
        else:
            pairs = with_messages(self._store.cassandra, rows)
        for row, message in pairs:
            one = BagMessage(row.topic, message, Stamp.from_ns(row.received))
            if with_header:
                yield BagMessageWithConnectionHeader(*one, dict(row.connection.fields))
            else:
                yield one

    def _topics(self, names: TopicNames) -> list[CassandraTopic]:
        """Return the topics of these names, None = all, that are stored."""
        every = {topic.name: topic for topic in self._store.getAllTopics()}
        if names is None:
            return list(every.values())
        wanted = {s for name in check_list("topics", names, "['/tf']") for s in spellings(name)}
        return [topic for name, topic in every.items() if name in wanted]

    def _filtered(
        self, topics: Sequence[CassandraTopic], test: ConnectionFilter
    ) -> tuple[list[CassandraTopic], set[tuple[str, int]]]:
        """Return the topics that have connections which pass, and those: (table, number)."""
        passing = {
            (table, conn)
            for table, conn, each in self._connections(topics)
            if test(each.topic, each.type, each.md5sum, each.definition_text, dict(each.fields))
        }
        tables = {table for table, _ in passing}
        return [t for t in topics if any(table.name in tables for table in t.tables)], passing

    def _connections(
        self, topics: Sequence[CassandraTopic]
    ) -> Iterator[tuple[str, int, Connection]]:
        tables = {table.name for topic in topics for table in topic.tables}
        return self._store.catalog.keyspace.connections.of_tables(tables)

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
        """Write a message; it is acknowledged when flush or close returns.

        Args:
            topic: Its name.
            msg: A message object; with raw (type, bytes, md5sum, class), as read_messages gives it
                or without the position.
            t: When it was received, as a key is; None = now.
            raw: msg is serialised.
            connection_header: Of the publisher; None = one is made.

        Raises:
            BagError: The bag is closed, or open for reading.
            TypeMismatch: msg is no message.
            InvalidKey, InvalidName, WriteFailed.
        """
        self._require_open()
        if self._writer is None:
            raise bag_error(f"{self.filename} is open for reading: open it with mode 'w' or 'a'")
        ns = now_ns(None) if t is None else to_ns(t)
        if raw:
            if not isinstance(msg, (tuple, list)) or len(msg) not in (4, 5):
                raise TypeMismatch("a raw message is (type, bytes, md5sum, class)")
            kind, wire, md5sum, cls = msg[0], bytes(msg[1]), msg[2], msg[-1]
        else:
            if not hasattr(type(msg), "_md5sum"):
                raise TypeMismatch(f"{msg!r:.80} is no message: give a message object")
            cls, wire = type(msg), serialize(msg)
            kind, md5sum = cls._type, cls._md5sum
        key: object = (topic, kind, md5sum)
        if connection_header is not None:
            key = live_connection(check_new_topic(topic), connection_header)
        handle = self._handles.get(key)
        if handle is None:
            made = key if isinstance(key, Connection) else _connection(topic, kind, md5sum, cls)
            made = replace(made, number=self._next_number())
            handle = self._handles[key] = self._writer.connect(made)
        self._writer.write(handle, ns, next(self._counter), wire)

    def _next_number(self) -> int:
        """Return the number of a new connection, behind those that were in the bag before."""
        if self._numbers is None:
            held = [info.table for info in self._store.info(run=self._before)]
            stored = (
                self._store.catalog.keyspace.connections.of_tables(held) if self._before else ()
            )
            self._numbers = count(max((each.number for _, _, each in stored), default=-1) + 1)
        return next(self._numbers)

    def get_message_count(self, topic_filters: TopicNames = None) -> int:
        """Count the messages of some topics, None = of all; by the directory."""
        return sum(info.count for info in self._infos(topic_filters))

    def _infos(self, topics: TopicNames = None) -> list[TopicInfo]:
        self.flush()
        names = None if topics is None else [topic.name for topic in self._topics(topics)]
        infos = self._store.info(names, nodeID=self._node, run=self._run)
        return [info for info in infos if info.count]

    def get_type_and_topic_info(self, topic_filters: TopicNames = None) -> TypesAndTopicsTuple:
        """Return the types of all topics, and of some or all what there is of them.

        Frequency and number of connections are found by the keys of the first MOST_STAMPS messages
        of each topic.
        """
        self.flush()
        counts: dict[str, int] = {}
        for info in self._infos():
            counts[info.topic] = counts.get(info.topic, 0) + info.count
        every = {topic.name: topic for topic in self._topics(None) if topic.name in counts}
        asked = {topic.name for topic in self._topics(topic_filters)}
        named = {table.name: name for name, topic in every.items() for table in topic.tables}
        stored: dict[str, list[Connection]] = {}
        for table, _, connection in self._connections(list(every.values())):
            stored.setdefault(named[table], []).append(connection)
        used: list[Connection] = []
        topics: dict[str, TopicTuple] = {}
        for name, topic in sorted(every.items()):
            found = stored.get(name, [])
            if name in asked or len({(each.type, each.md5sum) for each in found}) != 1:
                sample = joined(read_samples(topic, MOST_STAMPS, self._node, self._run).values())
                found = sample.connections
                if name in asked:
                    topics[name] = TopicTuple(
                        found[0].type, counts[name], len(found), sample.frequency
                    )
            used += found
        types: dict[str, str] = {}
        for connection in sorted(used, key=lambda each: each.number):
            types.setdefault(connection.type, connection.md5sum)
        return TypesAndTopicsTuple(dict(sorted(types.items())), topics)

    def get_compression_info(self) -> CompressionTuple:
        """Return how the messages are compressed: the store packs them in its own way, so 'none'.

        Both sizes are the serialised bytes of the messages.
        """
        size = self.size
        return CompressionTuple("none", size, size)

    def reindex(self) -> Iterator[int]:
        """Make the index anew, and yield the chunks that are read for it.

        The store keeps its index with each message, so this yields nothing.
        """
        self._require_open()
        return iter(())

    def set_encryptor(self, encryptor: str | None = None, param: str | None = None) -> None:
        """Choose how the chunks of a file are encrypted: the store has none.

        Raises:
            BagError: An encryptor is named. TLS and the server's disks keep what is stored secret.
        """
        if encryptor is not None:
            raise bag_error(
                f"encryptor={encryptor!r:.80} cannot be set: the store has no chunks to encrypt; "
                "use TLS and encrypted disks, or encrypt the bags that are exported"
            )

    def get_start_time(self) -> float:
        """Return when the first message was received, s since 1970; BagError: there is none."""
        return _seconds(self._ends()[0])

    def get_end_time(self) -> float:
        """Return when the last message was received, s since 1970; BagError: there is none."""
        return _seconds(self._ends()[1])

    def _ends(self) -> tuple[int, int]:
        times: list[int] = []
        for info in self._infos():
            if info.first_ns is not None and info.last_ns is not None:
                times += [info.first_ns, info.last_ns]
        own = [t.name for t in self._topics(None) if any(e.metadata.own_time for e in t.tables)]
        if own:  # its key is another time: each has to be looked at
            timed = [t.name for t in self._topics(None) if t.name not in own]
            times = [ns for i in self._infos(timed) for ns in (i.first_ns or 0, i.last_ns or 0)]
            rows = (self._store.getTopic(n).rows(run=self._run, nodeID=self._node) for n in own)
            times += [row.received for each in rows for row in each]
        if not times:
            raise bag_error(f"Bag contains no message: {self.filename}")
        return min(times), max(times)

    @property
    def size(self) -> int:
        """Serialised bytes of the messages."""
        return sum(info.bytes for info in self._infos())

    def flush(self) -> None:
        """Return when all that was written is acknowledged, and found by who reads."""
        self._require_open()
        if self._writer is not None:
            self._writer.flush()

    def _require_open(self) -> None:
        if self._closed:
            raise bag_error(f"{self.filename} is closed: open another Bag")

    def close(self) -> None:
        """Flush, and close the connection to the store if it is our own. Twice is harmless."""
        if self._closed:
            return
        self._closed = True
        atexit.unregister(self.close)
        try:
            if self._writer is not None:
                self._writer.close()
        finally:
            if self._own:
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
        """Return what str() says as YAML, or one of its facts: ROS's wiki shows scripts this.

        None where there is no such fact, as rosbag.
        """
        return self._summary().yaml(key)

    def _summary(self) -> Summary:
        types, topics = self.get_type_and_topic_info()
        lines = [TopicSummary(name, *topic) for name, topic in topics.items()]
        ends = self._ends() if topics else None
        return Summary(self.filename, self.size, ends, types, lines)


def _path_of(f: object) -> str:
    """Return the path that a file name means, or that of a file object."""
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
    return (row.type, row.wire, row.md5sum, row.position, row.message_class())


def _connection(topic: str, kind: str, md5sum: str, cls: Any) -> Connection:
    """Make the connection of messages whose publisher is not given."""
    text = getattr(cls, "_full_text", None) or installed_definition(kind).text
    header = {"topic": topic, "type": kind, "md5sum": md5sum, "message_definition": text}
    return live_connection(check_new_topic(topic), header)


def _seconds(ns: int) -> float:
    return Stamp.from_ns(ns).to_sec()  # type: ignore[no-any-return]
