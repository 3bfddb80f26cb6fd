# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A stored message as the library hands it on: bytes first, an object when asked for."""

from __future__ import annotations

from contextlib import suppress
from typing import Any, Iterator, Optional, Tuple, Union

from cassandra_ros.errors import (
    CassandraRosError,
    CorruptMessage,
    MessageNotFound,
    TopicNotFound,
)
from cassandra_ros.keys import Position, RowName, writer_of
from cassandra_ros.messages.classes import deserialize
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.messages.stamps import Stamp, iso_time
from cassandra_ros.printable import public_names
from cassandra_ros.store.fetch import ask_chunks, fetch_row, read_chunks
from cassandra_ros.tables.row_table import BlockKey, Sent, TableRow
from cassandra_ros.topics.topic_table import TopicTable

Place = Tuple[int, str, int, str]
"""Key time, node, seq and name."""
Key = Union[Stamp, RowName]
"""What finds one stored message again: a time, or the name under which it is kept."""


class StoredRow:
    """One message of one topic. Unpacks like rosbag's: ``topic, msg, t = row``; t is the key time.

    Attributes:
        t, received: Key time, and when the message was received, ns since 1970.
        node: nodeID, '' when nobody said.
        seq: Writer id << 32 | counter.
        table, conn: The TopicTable in which it lies, and the number of its connection in that.
        size, chunked: Serialised bytes, and whether they lie in the chunk table.
        odd: Whether some field is not held exactly in its column.
        columns: The format's columns, undecoded: all of them, or those that were asked for.
        name: The name under which it is kept; '' where it is found by time.
    """

    __slots__ = (
        "_row _sent _wire chunked columns conn name node odd received seq size t table".split()
    )

    def __init__(self, row: TableRow, table: TopicTable) -> None:
        self.t, self.node, self.seq, _, self.conn, self.size, chunks = row[:7]
        _, self.odd, _, self.columns, self.name, received, block = row[7:14]
        self.received = self.t if received < 0 else received
        self.chunked = chunks > 0
        self.table = table
        self._row = row
        # What comes out of a block was checked with it, and what has no columns was made of them.
        self._wire: Optional[bytes] = row.raw
        if self.columns:
            self._wire = self.columns[0] if block else None
        self._sent: Optional[Sent] = None

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
        """The topic under which it is stored."""
        return self.table.metadata.topic

    @property
    def run(self) -> str:
        """Name of the run that stored it, or its writer id where that has none."""
        return self.table.runs.text(writer_of(self.seq))

    @property
    def position(self) -> Position:
        """Its place in the order of all reads."""
        return self._row.position

    @property
    def block(self) -> Tuple[Optional[BlockKey], int]:
        """The block in which it lies, None where it has a row of its own, and its place there."""
        return self._row[13:15]

    @property
    def place(self) -> Place:
        """What it is known by whatever table it lies in: one that is converted lies in another."""
        return (self.t, self.node, self.seq, self.name)

    @property
    def arrival(self) -> tuple[int, str, int, str]:
        """Its place in the order of reads by the time of reception."""
        return (self.received, self.node, self.seq, self.table.name)

    @property
    def key(self) -> Key:
        """The row key: exact time or name, and where the row lies."""
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
                self._wire = self._moved_wire()
            self._sent = None
        return self._wire

    def ask(self) -> None:
        """Ask for the chunks of a large message, which ``wire`` waits for then."""
        with suppress(CassandraRosError):  # it is told to whoever reads it
            self._sent = ask_chunks(self.table, self._row)

    @property
    def was_read(self) -> bool:
        """Whether its bytes have been read."""
        return self._wire is not None

    def _moved_wire(self) -> bytes:
        """Read the message in the table that replaced its own; in an except clause."""
        heir = self.table.heir(True)
        if heir is None:
            raise
        row = fetch_row(heir, self.position)
        if row is None:
            raise MessageNotFound(
                f"the message of topic {self.topic} at {self.t} was removed while it was read"
            )
        return read_wire(heir, row)

    def keep_wire(self) -> bytes:
        """Return the serialised message, and let go of the columns that it was made of."""
        wire = self.wire
        self.columns = ()
        self._row = self._row._replace(columns=(), raw=None)
        return wire

    @property
    def connection(self) -> Connection:
        """The connection over which it came."""
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


def read_wire(table: TopicTable, row: TableRow, sent: Optional[Sent] = None) -> bytes:
    """Return the serialised message of a row, whose chunks may have been asked for already.

    Raises:
        CorruptMessage: Its chunks are incomplete, or its columns give another message.
        MessageNotFound: It was removed since some of its columns were read.
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
            f"{row.size}: its columns were changed by somebody else"
        )
    return wire
