# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Class MessageWriter: stores serialised messages of any topics."""

from __future__ import annotations

import logging
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Callable, Mapping, NamedTuple, Sequence

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.arguments import (
    check_integer,
    check_labels,
    check_new_node,
    check_new_topic,
    check_run_name,
    check_seconds,
    check_ttl,
)
from cassandra_ros.errors import (
    CassandraRosError,
    CorruptMessage,
    DefinitionError,
    InvalidKey,
    InvalidOption,
    StoreUnavailable,
    TopicNotFound,
)
from cassandra_ros.keys import COUNTER_BITS, MAX_NS, MAX_WRITER, new_writer_id
from cassandra_ros.messages.classes import installed_definition
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.messages.definition import Definition, read_definition
from cassandra_ros.messages.formats.table import FALLBACK_FORMAT, format_class
from cassandra_ros.metadata import ANY_MD5, Kind, TopicMetadata, message_kind
from cassandra_ros.store.blocks.block_builder import FULL, BlockBuilder, BlockLimits
from cassandra_ros.store.rows.writer import GONE, LossCallback, RowWriter, WriteStats
from cassandra_ros.store.tables.registry import Run
from cassandra_ros.store.tables.row_table import NewRow
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.new_tables import NewTable
from cassandra_ros.topics.topic_table import TopicTable

_log = logging.getLogger(__name__)

TakeBack = Callable[["Handle", int, int, bytes], None]
"""Keeps a message that the store did not take: its handle, time (ns), counter and bytes."""
Longs = NDArray[np.int64]
Wires = Sequence[bytes]

MAX_COUNTER = (1 << COUNTER_BITS) - 1
MAX_REMOVALS = 5
"""Number of removals of its topic after which a message that is being written is given up."""
TABLE_PAUSE_SEC = 0.5
"""Interval at which a silent store is asked for the table that replaces a dropped one, s."""
MAX_HANDLES = 1024
"""Maximum number of connections with cached handles. Anonymous publishers come without end."""


class Asked(NamedTuple):
    """A connection whose messages will be written: arguments of MessageWriter.connect."""

    connection: Connection
    bucket_ns: int | None = None
    span_ns: int | None = None
    large: bool = False
    format: str | None = None
    like: TopicMetadata | None = None


@dataclass(frozen=True)
class Handle:
    """An open connection of a writer: the table of its messages, and how they are stored."""

    connection: Connection
    table: TopicTable
    conn: int
    node: str
    format_wish: str | None
    """Name of the requested format; None = no format was requested."""
    warning: str | None = None
    """Reason for which the topic is stored in another way than requested."""
    blocks: BlockBuilder | None = field(default=None, compare=False, repr=False)
    """Gathers the messages into blocks; None = each message has its own row."""

    @property
    def topic(self) -> str:
        """Name of the topic."""
        return self.table.metadata.topic

    @property
    def format(self) -> str:
        """Name of the format in which the messages are stored."""
        return self.table.metadata.format


class MessageWriter:
    """Writes messages of any topic under one writer id. Thread-safe.

    The run is stored at once, and again with counts when the writer is closed.

    Args:
        keyspace: Keyspace to write to.
        writer_id: 1 to 2**31 - 1; a repeated import must use the same id.
        linger_sec: How long a message may wait to be sent together with others, s.
        block_sec: How long a message may wait in a block (format packed), s; None = until the block
            is full. Only then equal messages make equal blocks, which repeated imports need.
        limits: Maximum size of a block.
        give_up_after_sec: How long the writing of a message is retried, s.
        format, node, ttl: As in addTopic, for all topics; with ttl None rows expire as the topic
            was made.
        run: Description of the recording or import, stored with it.
        on_loss: Called with (topic, number of messages, error) of losses; None = the writer raises.
        given: The caller makes the handles; a dropped table of theirs is an error.
        connections: Connections that will be written; see ``make_tables``.
    """

    def __init__(
        self,
        keyspace: Keyspace,
        writer_id: int,
        *,
        linger_sec: float = 0.2,
        block_sec: float | None = None,
        limits: BlockLimits = FULL,
        give_up_after_sec: float = 60.0,
        format: str | None = None,
        node: str = "",
        ttl: int | None = 0,
        run: Run | None = None,
        on_loss: LossCallback | None = None,
        given: bool = False,
        connections: Sequence[Asked] = (),
    ) -> None:
        keyspace.side_tables.make()
        self.writer_id = writer_id
        self._run = run
        self._keyspace = keyspace
        self._format = format
        self._node = node
        self._ttl = ttl
        self._on_loss = on_loss
        self._given = given
        self._handles: dict[tuple[Connection, str | None, str], Handle] = {}
        """Connection, requested format and nodeID → handle."""
        self._topics: dict[str, str] = {}
        """Table → topic under which its messages are counted."""
        self._refused: dict[str, WriteStats] = {}
        """Table → messages that were lost before its rows took them."""
        self._told: set[str] = set()
        """Names of the removed tables for which a warning was logged."""
        self._warned: set[str] = set()
        """Warnings of handles that were logged: each is logged once, for all its publishers."""
        self._mutex = threading.Lock()
        self._renewing = threading.Lock()
        """Held while a removed table is made anew; taken before ``_mutex``."""
        self._closed = False
        self._take_back: TakeBack | None = None
        self._high = writer_id << COUNTER_BITS
        """Upper half of every ``_seq``."""
        self.make_tables(connections)
        if run is not None:
            keyspace.registry.put_run(run, started=True)
        self._rows = RowWriter(
            keyspace.cassandra,
            keyspace.schema,
            keyspace.directory,
            writer_id,
            linger_sec=linger_sec,
            block_sec=block_sec,
            limits=limits,
            give_up_after_sec=give_up_after_sec,
            on_loss=on_loss,
            on_beat=None if run is None else self._beat,
        )

    def _beat(self) -> None:
        # A run without messages has no bucket with a heartbeat.
        if self._run is not None:
            self._keyspace.registry.put_heartbeat(self.writer_id, self._run.node)

    def connect(
        self,
        connection: Connection,
        bucket_ns: int | None = None,
        *,
        span_ns: int | None = None,
        large: bool = False,
        format: str | None = None,
        node: str | None = None,
        like: TopicMetadata | None = None,
    ) -> Handle:
        """Prepare for the messages of a connection: its table, definition and header.

        If its definition is empty, broken or hostile, it is stored as it is and the messages are
        stored as ``binary``; the handle's warning says so. A definition that does not agree with
        the md5sum of the header is used, with a warning: the messages lie in the table of the
        definition's md5sum, and the header is stored as it is.

        Args:
            connection: Topic and header.
            bucket_ns: Length of the buckets if the table is made here, ns; None = 1 min for types
                with arrays, otherwise 10 min.
            span_ns: Maximum time range of a block if the table is made here, ns; None = 10 s.
            large: Whether messages over 512 KiB will come, so that their chunk table is made now.
            format, node: Format and nodeID in place of the writer's.
            like: Metadata of the topic's former table, for a table that is made here.

        Raises:
            SchemaConflict, StoreUnavailable: The table cannot be made.
        """
        node = self._node if node is None else check_new_node(node)
        key = (connection, format or self._format, node)
        with self._mutex:
            handle = self._handles.get(key)
        if handle is not None and handle.table.name not in self._rows.gone:
            stored = self._keyspace.tables.by_name(handle.table.name)
            if stored is not None and stored.metadata.topic == connection.topic:
                return handle
            # Another client has renamed or removed the topic.
            like = like or (handle.table.metadata if stored is None else None)
        request = Asked(connection, bucket_ns, span_ns, large, key[1], like)
        new, warning = self._new_table(request)
        table = self._shared_table(connection, new.metadata)
        if table is None:
            table = self._keyspace.new_tables.make(new.metadata, new.definition, large=new.large)
        warning = warning or self._other_ttl(table.metadata)
        conn = self._keyspace.connections.put(table.name, connection)
        return self._keep(key, Handle(connection, table, conn, node, key[1], warning))

    def make_tables(self, several: Sequence[Asked]) -> None:
        """Find or make the tables of several connections together, and store their headers.

        It takes a fraction of the time in which ``connect`` makes one after the other.

        Raises:
            SchemaConflict, StoreUnavailable: The tables cannot be made. Some may have been made.
        """
        requests = [request._replace(format=request.format or self._format) for request in several]
        pairs = [(self._new_table(request)[0], request.connection) for request in requests]
        # ``connect`` first looks for the table that has messages of such a connection.
        pairs = [(new, connection) for new, connection in pairs if new.metadata.md5sum != ANY_MD5]
        if not pairs:
            return
        tables = self._keyspace.new_tables.make_all([new for new, _ in pairs])
        self._keyspace.connections.put_all(
            [
                (table.name, connection)
                for table, (_, connection) in zip(tables, pairs)
                if table is not None
            ]
        )

    def _new_table(self, request: Asked) -> tuple[NewTable, str | None]:
        """Return the table that is made for a connection if it is missing, and a warning or None.

        The warning says why the definition, or the format, is not the requested one.
        """
        connection, like = request.connection, request.like
        check_new_topic(connection.topic)
        name = request.format or (like.format if like is not None else None)
        format = name or self.format_of(connection)
        definition, warning = usable_definition(connection, format)
        metadata = replace(
            like or TopicMetadata("", "", "", "", 0, ttl=self._ttl or 0),
            topic=connection.topic,
            msg_type=connection.type,
            md5sum=connection_kind(connection).md5sum,
            format=format if definition is not None else FALLBACK_FORMAT,
            bucket_ns=request.bucket_ns or 0,
            span_ns=request.span_ns or 0,
            definition=definition.text if definition else connection.definition_text,
        )
        return NewTable(metadata, definition, request.large), warning

    def _shared_table(self, connection: Connection, new: TopicMetadata) -> TopicTable | None:
        """Return the table for several types that already has messages of this connection.

        None if no table has, or if the connection has an md5sum: then its kind finds the table.
        """
        if new.md5sum != ANY_MD5:
            return None
        space = self._keyspace
        for table in space.tables.of_topic(connection.topic):
            name = table.name
            metadata = table.metadata
            if (metadata.md5sum, metadata.format) != (ANY_MD5, new.format):
                continue
            if space.schema.takes_rows(name) and space.connections.has(name, connection):
                return table
        return None

    def format_of(self, connection: Connection) -> str:
        """Return the format in which a connection's topic is stored, or would be by default."""
        md5sum = connection_kind(connection).md5sum
        return self._keyspace.new_tables.format_for(connection.topic, md5sum)

    def _other_ttl(self, stored: TopicMetadata) -> str | None:
        """Return a warning if a table has another ttl than requested; None if it has not."""
        if self._ttl in (None, stored.ttl):
            return None
        return (
            f"topic {stored.topic} was made with a ttl of {stored.ttl} s, and that holds for what "
            f"is stored now, not {self._ttl} s (0 = never)"
        )

    def _keep(self, key: tuple[Connection, str | None, str], handle: Handle) -> Handle:
        """Cache a handle of a table that takes rows; return it ready, after its warning."""
        if handle.warning and handle.warning not in self._warned:
            self._warned.add(handle.warning)
            _log.warning("%s", handle.warning)
        # Also after a conversion that was given up: the table takes rows again.
        self._rows.gone.discard(handle.table.name)
        self._told.discard(handle.table.name)
        handle = self.ready(handle)
        with self._mutex:
            while len(self._handles) >= MAX_HANDLES:
                self._handles.pop(next(iter(self._handles)))
            self._handles[key] = handle
            return handle

    def ready(self, handle: Handle) -> Handle:
        """Return the handle, with a block builder if its table is packed; note it for ``stats``."""
        table = handle.table
        if table.packed:
            key_time = table.key_time if table.metadata.own_time else None
            again = partial(self._block_message_anew, handle)
            blocks = self._rows.builder(table, handle.node, handle.conn, key_time, again)
            handle = replace(handle, blocks=blocks)
        with self._mutex:
            self._topics[table.name] = handle.topic
        return handle

    def current(self, handle: Handle) -> Handle:
        """Return the handle for the next messages of a handle's connection.

        This is the handle itself while its table exists. If another client has removed or replaced
        the table, it is a handle of the table in which the topic goes on, made if it is missing.

        Raises:
            TopicNotFound: The table was removed, and the caller makes the handles (``given``).
            SchemaConflict, StoreUnavailable: The next table cannot be made.
        """
        while handle.table.name in self._rows.gone:
            if self._given:
                raise TopicNotFound(f"topic {handle.topic} was removed by another client")
            later = self._latest_handle(handle)
            if later is None:
                # One thread makes the table; those with rows of the removed table wait for it.
                with self._renewing:
                    later = self._latest_handle(handle) or self._connect_anew(handle)
            if handle.table.name not in self._told:
                self._tell_moved(handle, later)
            handle = later
        return handle

    def _latest_handle(self, handle: Handle) -> Handle | None:
        """Return the latest handle of a handle's connection; None if its table was removed, too."""
        with self._mutex:
            latest = self._handles.get((handle.connection, handle.format_wish, handle.node))
        return None if latest is None or latest.table.name in self._rows.gone else latest

    def _connect_anew(self, handle: Handle) -> Handle:
        """Return a handle of the table in which the topic of a removed table goes on.

        The caller holds ``_renewing``.
        """
        schema = self._keyspace.schema
        self._keyspace.side_tables.forget()  # the whole keyspace may have been dropped
        schema.tables(fresh=True)
        like = handle.table.metadata
        like = like.with_(format=schema.format_after(handle.table.name, like.format), cut=True)
        later = self.connect(
            handle.connection,
            like.bucket_ns,
            span_ns=like.span_ns,
            large=handle.table.has_chunks,
            format=handle.format_wish,
            node=handle.node,
            like=like,
        )
        if later.table.metadata.noting_cut() != later.table.metadata:  # made by another client
            schema.change_topic(handle.topic, TopicMetadata.noting_cut)
        return later

    def _tell_moved(self, handle: Handle, later: Handle) -> None:
        """Log once for a removed table where the messages go now."""
        with self._mutex:
            first = handle.table.name not in self._told
            self._told.add(handle.table.name)
        if first:
            _log.warning(
                "the table of topic %s was removed or replaced by another client: new messages go "
                "into %s",
                handle.topic,
                "its successor" if later.table.name != handle.table.name else "it anew",
            )

    def write(
        self, handle: Handle, t_ns: int, counter: int, wire: bytes, name: str = ""
    ) -> NewRow | None:
        """Take one serialised message; blocks while too many bytes are on their way.

        Args:
            t_ns: Receive time, ns, 0 to MAX_NS.
            counter: Arrival order in this run (or position in the bag), 0 to 2**32 - 1.
            name: Name of the message in a topic with names; '' = the topic's name.

        Returns:
            Its row; None if it is in a block, was refused and reported to on_loss, or given back.

        Raises:
            InvalidKey: Time or counter is out of range.
            WriteFailed: Earlier messages were given up (only without on_loss).
            TopicNotFound, SchemaConflict, StoreUnavailable: As ``current`` (only without on_loss).
        """
        if not (0 <= t_ns <= MAX_NS and 0 <= counter < 1 << COUNTER_BITS):
            raise InvalidKey(
                f"a message of topic {handle.topic} has time {t_ns} ns and counter {counter}; "
                f"times are 0 to {MAX_NS} ns, counters below 2**{COUNTER_BITS}"
            )
        seq = self._high | counter
        blocks = handle.blocks
        try:
            if blocks is not None and blocks.add_message(t_ns, seq, wire):
                return None
            tries = 1
            while True:
                try:
                    if handle.table.name in self._rows.gone:
                        return self._put(self._current(handle), t_ns, seq, wire, name)
                    return self._put(handle, t_ns, seq, wire, name)
                except GONE:  # another client removed the table; its topic goes on in a new one
                    if tries == MAX_REMOVALS:
                        raise
                    tries += 1
        except CassandraRosError as exc:
            if self._take_back is not None and isinstance(exc, StoreUnavailable):
                self._take_back(handle, t_ns, counter, wire)
                return None
            if self._on_loss is None:
                raise
            with self._mutex:
                self._refused.setdefault(handle.table.name, WriteStats()).lose(1, str(exc))
            self._on_loss(handle.topic, 1, exc)
            return None

    def write_run(self, handle: Handle, times: Longs, counters: Longs, wires: Wires) -> None:
        """Take several messages in this order, like write but faster.

        Args:
            times, counters: Receive time and counter of each message, as in ``write``.
        """
        count = 0
        lowest = min(times.min(initial=0), counters.min(initial=0))
        in_range = times.max(initial=0) <= MAX_NS and counters.max(initial=0) <= MAX_COUNTER
        # With on_loss, errors are reported for single messages, so these are written one by one.
        if len(wires) and lowest >= 0 and in_range and self._on_loss is None:
            seqs = self._high | counters
            handle = self._current(handle)
            if handle.blocks is not None:
                count = handle.blocks.add_messages(times, seqs, wires)
            else:
                count = self._put_rows(handle, times, seqs, wires)
        rest = zip(times[count:].tolist(), counters[count:].tolist(), wires[count:])
        for t_ns, counter, wire in rest:
            self.write(handle, t_ns, counter, wire)

    def _put_rows(self, handle: Handle, times: Longs, seqs: Longs, wires: Wires) -> int:
        """Write several messages as rows.

        Return the number of messages written before the first one that ``write`` must take: its
        columns must be made now, its table has an index or was dropped, or an error must be raised.
        """
        table = handle.table
        count = 0
        rows = table.make_rows(times.tolist(), seqs.tolist(), handle.conn, wires)
        again = partial(self._row_anew, handle)
        ends = np.flatnonzero(np.diff(times // table.metadata.bucket_ns)) + 1
        for end in [*ends.tolist(), len(rows)]:
            count += self._rows.add_run(table, handle.node, rows[count:end], again)
            if count < end:
                break
        return count

    def _block_message_anew(self, handle: Handle, t_ns: int, seq: int, wire: bytes) -> None:
        # ``ready`` gave the builder this method with a handle that had no builder yet.
        self._write_anew(self.ready(handle), t_ns, seq, wire)

    def _row_anew(self, handle: Handle, row: NewRow) -> None:
        self._write_anew(handle, row.t, row.seq, row.wire)

    def _current(self, handle: Handle) -> Handle:
        """Return the current handle; wait for a silent store as long as for a row."""
        start = time.monotonic()
        while True:
            try:
                return self.current(handle)
            except StoreUnavailable:
                over = self._keyspace.cassandra.outage.left_sec <= 0
                if over or time.monotonic() >= self._rows.patience.ends(start):
                    raise
                time.sleep(TABLE_PAUSE_SEC)

    def _put(self, handle: Handle, t_ns: int, seq: int, wire: bytes, name: str) -> NewRow | None:
        """Put a message into a block or a row; return the row.

        Raises one of GONE if the table was dropped.
        """
        if handle.blocks is not None:
            if not handle.blocks.add_message(t_ns, seq, wire):
                raise TopicNotFound(f"topic {handle.topic} was removed by another client")
            return None
        row = handle.table.make_row(t_ns, seq, handle.conn, wire, name)
        again = partial(self._write_anew, handle, t_ns, seq, wire, name)
        self._rows.add(handle.table, handle.node, row, again)
        return row

    def _write_anew(self, handle: Handle, t_ns: int, seq: int, wire: bytes, name: str = "") -> None:
        """Give back a message that a silent store did not take, or write that of a dropped table.

        The RowWriter calls it without its lock, on its own thread or on that of ``flush``.
        """
        counter = seq & MAX_COUNTER
        if self._take_back is not None and handle.table.name not in self._rows.gone:
            self._take_back(handle, t_ns, counter, wire)
        else:
            self.write(handle, t_ns, counter, wire, name)

    @property
    def pending_bytes(self) -> int:
        """Approximate number of bytes that wait here to be stored."""
        return self._rows.pending_bytes

    def stats(self) -> dict[str, WriteStats]:
        """Return the numbers of stored and lost messages, by topic."""
        stats: dict[str, WriteStats] = {}
        with self._mutex:
            counts_of_tables = [*self._rows.stats.items(), *self._refused.items()]
            topics = dict(self._topics)
        for name, counts in counts_of_tables:
            stats.setdefault(topics.get(name, name), WriteStats()).add(counts)
        return stats

    def hurry(self, seconds: float) -> None:
        """Limit the retries of waiting messages to ``seconds`` from now, or from an answer."""
        self._rows.patience.hurry(seconds)

    def give_back(self, take_back: TakeBack) -> None:
        """Stop trying: what a silent store has not taken by now goes to ``take_back``.

        It is called on any thread, for messages that were written before and for those that are
        written from now on. ``close`` then leaves the buckets open and the run without an end.
        """
        self._take_back = take_back
        self._rows.gives_back = True
        self._rows.patience.hurry(0.0)

    def flush(self) -> None:
        """Return when every message is acknowledged or counted as lost; raises like close."""
        self._rows.flush()

    def close(self, lost: Mapping[str, int] | None = None) -> None:
        """Flush, close the buckets in the directory, note the end of the run. Twice is harmless.

        Args:
            lost: Numbers of lost messages by topic, stored with the run, if the caller counts more
                losses than this object sees (a full buffer).

        Raises:
            WriteFailed: Messages were given up (only without on_loss).
        """
        if self._closed:
            return
        self._closed = True
        self._rows.close()
        if self._run is not None and self._take_back is None:
            stats = self.stats()
            # What an earlier import of the same file has stored of other topics is still there.
            stored = {**self._run.stored, **{t: counts.stored for t, counts in stats.items()}}
            if lost is None:
                lost = {topic: counts.lost for topic, counts in stats.items() if counts.lost}
                lost = {**self._run.lost, **lost}
            run = replace(self._run, stored=stored, lost=lost)
            self._keyspace.registry.put_run(run, ended=True)

    def __enter__(self) -> MessageWriter:
        return self

    def __exit__(self, failure: object, *exc_info: object) -> None:
        self.close()
        if failure is not None and self._run is not None:
            self._keyspace.registry.put_heartbeat(self.writer_id, self._run.node, interrupted=True)


def make_writer(
    keyspace: Keyspace,
    *,
    writer_id: int | None = None,
    format: str | None = None,
    node: str = "",
    ttl: int = 0,
    linger_sec: float = 0.2,
    block_sec: float | None = 0.5,
    give_up_after_sec: float = 60.0,
    run: Run | None = None,
    on_loss: LossCallback | None = None,
) -> MessageWriter:
    """Check the arguments of RosCassandra.messageWriter and make the writer; None = random id."""
    if run is not None and not isinstance(run, Run):
        raise InvalidOption(f"run={run!r:.80} describes no run: give a tables.registry.Run")
    if format is not None:
        format_class(format)
    if run is not None:
        check_run_name(run.name)
        check_labels(run.labels)
    if writer_id is None:
        writer_id = new_writer_id()
    return MessageWriter(
        keyspace,
        check_integer("writer_id", writer_id, 1, MAX_WRITER, InvalidKey),
        format=format,
        node=check_new_node(node),
        ttl=check_ttl(ttl),
        linger_sec=check_seconds("linger_sec", linger_sec),
        block_sec=None if block_sec is None else check_seconds("block_sec", block_sec),
        give_up_after_sec=check_seconds("give_up_after_sec", give_up_after_sec),
        run=run,
        on_loss=on_loss,
    )


def usable_definition(
    connection: Connection, format_name: str
) -> tuple[Definition | None, str | None]:
    """Return a definition that the format can use, or None; and a warning if something is odd.

    Raises:
        UnknownFormat: No format has this name.
    """
    try:
        definition = _usable_definition(
            connection.type, connection.md5sum, connection.definition_text, format_name
        )
    except (DefinitionError, CorruptMessage) as exc:
        return None, (
            f"topic {connection.topic} is kept as binary, its fields cannot be queried: {exc}"
        )
    if definition.md5sum == connection.md5sum:
        return definition, None
    return definition, (
        f"topic {connection.topic}: the definition of {connection.type} has md5 "
        f"{definition.md5sum}, not {connection.md5sum[:80]!r} as its connection says; the messages "
        "are read by the definition, and the header of the connection is stored as it is"
    )


def connection_kind(connection: Connection) -> Kind:
    """Return the kind of the messages of a connection, by its definition.

    If the definition is unusable, the md5sum is that of the header.
    """
    definition, _ = usable_definition(connection, FALLBACK_FORMAT)
    if definition is not None:
        return definition.kind
    return message_kind(connection.md5sum, connection.type, None)


@lru_cache(maxsize=256)
def _usable_definition(msg_type: str, md5sum: str, text: str, format_name: str) -> Definition:
    """Return a definition after it was checked that the format can use it; raises if it cannot."""
    definition = _definition(msg_type, md5sum, text)
    fmt = format_class(format_name)(msg_type, md5sum, definition)
    if format_name != FALLBACK_FORMAT:
        fmt.require_class()
    return definition


def _definition(msg_type: str, md5sum: str, text: str) -> Definition:
    """Return the definition in a text, or that of the installed type if the text is empty."""
    if not text.strip():
        # Some publishers leave the definition out: use an installed type with this md5.
        with suppress(DefinitionError):
            installed = installed_definition(msg_type)
            if installed.md5sum == md5sum:
                return installed
    return read_definition(msg_type, text, md5sum)
