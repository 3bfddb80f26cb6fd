# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A stored message: its bytes, read ahead if they are many; an object when it is accessed.

``with_messages`` makes the objects of many rows together.
"""

from __future__ import annotations

from collections import deque
from contextlib import suppress
from typing import Any, Iterable, Iterator, Sequence, Tuple, TypeVar, Union

from cassandra_ros.errors import (
    CassandraRosError,
    CorruptMessage,
    MessageNotFound,
    TopicNotFound,
)
from cassandra_ros.keys import Position, RowName, writer_of
from cassandra_ros.messages.classes import deserialize, deserialize_all
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.messages.stamps import Stamp, iso_time
from cassandra_ros.printable import public_names
from cassandra_ros.query.arrays.batch import Window
from cassandra_ros.store.connection.cassandra import Cassandra
from cassandra_ros.store.rows.fetch import ask_chunks, fetch_row, read_chunks
from cassandra_ros.store.tables.row_table import BlockKey, SentRequest, TableRow
from cassandra_ros.topics.topic_table import TopicTable

MessageIdentity = Tuple[int, str, int, str]
"""Key time (ns), node, seq and name of a message."""
Key = Union[Stamp, RowName]
"""Key by which one stored message is found again: its time, or its name."""
LARGE_AHEAD_BYTES = 8 * 1024 * 1024
"""Approximate maximum number of bytes of large messages that are requested or wait here."""
AHEAD_ROWS = 64
"""Maximum number of rows that wait here: rows of other sizes may be between the large ones."""
_Window = TypeVar("_Window", bound=Window)


class StoredRow:
    """One message of one topic. Unpacks like rosbag's: ``topic, msg, t = row``; t is the key time.

    Attributes:
        t, received: Key time and receive time, ns since 1970.
        node: nodeID; '' = not given.
        seq: Writer id << 32 | counter.
        table, conn: The TopicTable of the message, and the number of its connection in the table.
        size, chunked: Number of serialised bytes, and whether they are in the chunk table.
        odd: Whether some field is not held exactly in its column.
        columns: The format's columns, undecoded: all, or those that were requested; () after
            keep_wire.
        name: Name of the message; '' in topics with a time key.
    """

    __slots__ = (
        "_row _sent _wire chunked columns conn name node odd received seq size t table".split()
    )

    def __init__(self, row: TableRow, table: TopicTable) -> None:
        # By position: this is done for every message that is read.
        self.t, self.node, self.seq, _, self.conn, self.size, chunks = row[:7]
        _, self.odd, _, self.columns, self.name, received, block = row[7:14]
        self.received = self.t if received < 0 else received
        self.chunked = chunks > 0
        self.table = table
        self._row = row
        # The only column of a message in a block is the message, checked with its block. From the
        # columns of a row ``wire`` makes the message, and checks it.
        self._wire: bytes | None = row.raw
        if self.columns:
            self._wire = self.columns[0] if block else None
        self._sent: SentRequest | None = None

    def __iter__(self) -> Iterator[Any]:
        t = Stamp.from_ns(self.t, self.node, self.seq, self.table.name)
        return iter((self.topic, self.message(), t))

    def __dir__(self) -> list[str]:
        inner = "arrival ask block chunked columns conn keep_wire odd place position table was_read"
        return public_names(self, inner.split())

    def __repr__(self) -> str:
        text = f"{self.table.msg_type}, {self.size} bytes"
        if self.node:
            text += f" of {self.node}"
        name = f" {self.name!r}" if self.name else ""
        return f"<StoredRow {self.topic}{name} {iso_time(self.t)}: {text}>"

    @property
    def topic(self) -> str:
        """Name of the topic in which the message is stored."""
        return self.table.metadata.topic

    @property
    def run(self) -> str:
        """Name of the run that stored the message, or its writer id if the run has no name."""
        return self.table.runs.text(writer_of(self.seq))

    @property
    def position(self) -> Position:
        """Position of the row in the order of all reads."""
        return self._row.position

    @property
    def block(self) -> tuple[BlockKey | None, int]:
        """Block of the message (None = it has its own row), and its position in the block."""
        return self._row.block, self._row.place

    @property
    def identity(self) -> MessageIdentity:
        """Identity of the message in all tables, to which conversions may move it."""
        return (self.t, self.node, self.seq, self.name)

    @property
    def arrival(self) -> tuple[int, str, int, str]:
        """Position of the row in the order of reads by receive time."""
        return (self.received, self.node, self.seq, self.table.name)

    @property
    def key(self) -> Key:
        """Row key: exact time or name, with the place of the row."""
        if self.name:
            return RowName.of(self.position)
        return Stamp.from_ns(self.t, self.node, self.seq, self.table.name)

    @property
    def wire(self) -> bytes:
        """The serialised message, byte for byte as it was sent."""
        if self._wire is None:
            try:
                self._wire = read_wire(self.table, self._row, self._sent)
            except TopicNotFound:
                self._wire = self._wire_of_heir()
            self._sent = None
        return self._wire

    def ask(self) -> None:
        """Request the chunks of a large message, for which ``wire`` then waits."""
        with suppress(CassandraRosError):  # ``wire`` raises the error
            self._sent = ask_chunks(self.table, self._row)

    @property
    def was_read(self) -> bool:
        """Whether its bytes have been read."""
        return self._wire is not None

    def _wire_of_heir(self) -> bytes:
        """Read the message from the table that replaced its own; called in an except clause."""
        heir = self.table.heir(True)
        if heir is None:
            raise
        # The run may have got another robot, which its messages have in the new table.
        nodes = [self.position.node, *self.table.runs.robots(writer_of(self.seq))]
        positions = (self.position._replace(node=node) for node in dict.fromkeys(nodes))
        rows = (fetch_row(heir, position) for position in positions)
        row = next(filter(None, rows), None)
        if row is None:
            raise MessageNotFound(
                f"the message of topic {self.topic} at {self.t} was removed while it was read"
            )
        return read_wire(heir, row)

    def keep_wire(self) -> bytes:
        """Return the serialised message, and release the columns, so that it is held once."""
        wire = self.wire
        self.columns = ()
        self._row = self._row._replace(columns=(), raw=None)
        return wire

    @property
    def connection(self) -> Connection:
        """The connection over which the message came."""
        return self.table.connection(self.conn)

    @property
    def type(self) -> str:
        """Message type as its connection names it, 'pkg/Name'."""
        return self.connection.type

    @property
    def md5sum(self) -> str:
        """md5 of the message definition."""
        return self.table.metadata.md5sum

    def message_class(self) -> Any:
        """Return the class of the message: installed, generated, or RawMessage."""
        return self.table.message_class(self.conn)

    def message(self) -> Any:
        """Deserialise the message.

        Raises:
            CorruptMessage: The bytes are not a message of the type.
        """
        return deserialize(self.message_class(), self.wire)


def read_wire(table: TopicTable, row: TableRow, sent: SentRequest | None = None) -> bytes:
    """Return the serialised message of a row; ``sent``: its chunks if they were requested before.

    Raises:
        CorruptMessage: Its chunks are incomplete, or its columns make a message of another size.
        MessageNotFound: It was deleted since some of its columns were read.
    """
    topic = table.metadata.topic
    if row.nchunks:
        return read_chunks(table, row, sent)
    if row.raw is None and len(row.columns) < len(table.columns):
        whole = fetch_row(table, row.position)
        if whole is None:
            raise MessageNotFound(
                f"the message of topic {topic} at {row.t} was removed while it was read"
            )
        row = whole
    wire = table.format.decode_wire(row.columns, row.raw)
    if len(wire) != row.size:
        raise CorruptMessage(
            f"the message of topic {topic} at {row.t} has {len(wire)} bytes instead of "
            f"{row.size}: its columns were changed by another program"
        )
    return wire


def chunks_ahead(rows: Iterable[StoredRow | _Window]) -> Iterator[StoredRow | _Window]:
    """Yield rows, and windows among them, in order, with the next large rows requested ahead.

    Only for readers that need the messages. The first large message is requested when its bytes are
    accessed. While every yielded message is accessed, more and more are requested ahead; after one
    that was not, this begins anew.
    """
    waiting: deque[tuple[StoredRow | _Window, int]] = deque()
    """Rows and windows, and the number of bytes of each that have been requested or are here."""
    ahead_bytes = budget = 0
    for row in rows:
        if not waiting and (isinstance(row, Window) or not row.chunked):
            yield row
            continue
        nbytes = row.size if budget and (isinstance(row, Window) or row.chunked) else 0
        if nbytes and not isinstance(row, Window):
            row.ask()
        waiting.append((row, nbytes))
        ahead_bytes += nbytes
        while waiting and (ahead_bytes >= budget or len(waiting) > AHEAD_ROWS):
            first, nbytes = waiting.popleft()
            ahead_bytes -= nbytes
            yield first
            if not isinstance(first, Window) and first.chunked:
                budget = min(LARGE_AHEAD_BYTES, 2 * budget + first.size) if first.was_read else 0
    while waiting:
        yield waiting.popleft()[0]


MAX_ROWS = 512
"""Maximum number of rows whose messages are made together; a read begins with fewer."""
MADE_TOGETHER_BYTES = 512 * 1024
"""Maximum number of serialised bytes of messages that are made together."""
MADE_SINGLY_BYTES = 4 * 1024
"""Size in bytes above which messages are made one by one: copying their bytes would take as
long."""


def with_messages(
    cassandra: Cassandra, rows: Iterable[StoredRow]
) -> Iterator[tuple[StoredRow, Any]]:
    """Yield each row with its message.

    Rows are taken ahead, never more than have been yielded. An error of a row, or of reading rows,
    is raised when its row would be yielded.

    Args:
        cassandra: Connection of the read; after it is closed no more rows are yielded.

    Raises:
        CorruptMessage: The bytes of a row are not a message of its type.
        ConnectionFailed: The connection was closed.
    """
    waiting: list[StoredRow] = []
    yield_count = nbytes = 0
    try:
        for row in rows:
            large = row.chunked or row.size > MADE_SINGLY_BYTES
            if not large:
                waiting.append(row)
                nbytes += row.size
            if (
                large
                or len(waiting) >= min(MAX_ROWS, max(1, yield_count))
                or nbytes >= MADE_TOGETHER_BYTES
            ):
                batch, waiting, nbytes = waiting, [], 0
                yield_count += len(batch) + large
                if batch:
                    yield from _pairs(cassandra, batch)
            if large:
                yield row, row.message()
    except CassandraRosError:
        yield from _pairs(cassandra, waiting)
        raise
    yield from _pairs(cassandra, waiting)


def _pairs(cassandra: Cassandra, rows: Sequence[StoredRow]) -> Iterator[tuple[StoredRow, Any]]:
    """Yield rows with their messages, made together or, if that fails, one by one."""
    messages: Iterable[Any]
    try:
        messages = _messages(rows)
    except CassandraRosError:  # one row is damaged: make the messages one by one
        messages = (row.message() for row in rows)
    for pair in zip(rows, messages):
        cassandra.require_open()
        yield pair


def _messages(rows: Sequence[StoredRow]) -> Iterable[Any]:
    """Return the messages of rows, made together for each class."""
    by_class: dict[Any, list[int]] = {}
    for n, row in enumerate(rows):
        by_class.setdefault(row.message_class(), []).append(n)
    if len(by_class) == 1:
        (cls,) = by_class
        return deserialize_all(cls, [row.wire for row in rows])
    all_messages: list[Any] = [None] * len(rows)
    for cls, members in by_class.items():
        messages = deserialize_all(cls, [rows[n].wire for n in members])
        for n, message in zip(members, messages):
            all_messages[n] = message
    return all_messages
