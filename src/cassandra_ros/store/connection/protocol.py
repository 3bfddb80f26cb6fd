# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The driver's protocol layer with raw columns and without needless copies of large messages.

Our columns are encoded straight from the wire bytes of messages and decoded back to such bytes.
Decoding columns to Python values and encoding these again would cost twice and change signalling
NaNs. So a separate session returns each column as the bytes that Cassandra stores: the rows of an
answer as received (``RawPage``), one byte string in which each column follows its size.

The connections also ask for the schema changes that servers push (``SchemaChanges``), by which a
cached list of tables is known to be old. A server pushes a change to every connection that has
asked for changes, and only then tells the client that made the change. So on such a connection the
answer to a request that began later comes after the change. A reader who compares marks after its
first answer therefore misses no change that was acknowledged before the read, and needs no extra
request for that.
"""

from __future__ import annotations

import functools
import io
import socket
import ssl
import struct
from collections import deque
from functools import cached_property
from typing import (
    Any,
    Callable,
    Iterator,
    Mapping,
    Sequence,
    Tuple,
    cast,
    overload,
)

import numpy as np
from cassandra import ProtocolVersion
from cassandra.cluster import DefaultConnection
from cassandra.connection import ProtocolError, Timer, _Frame
from cassandra.cqltypes import BytesType
from cassandra.protocol import (
    BatchMessage,
    ExecuteMessage,
    ProtocolHandler,
    RegisterMessage,
    ResultMessage,
)
from numpy.typing import NDArray

from cassandra_ros.store.connection.login import Tls
from cassandra_ros.store.connection.requests import RawRow


class KeyspaceChanges:
    """Tells whether the schema of one keyspace may have changed.

    Attributes:
        mark: An object that is another one after each change.
    """

    __slots__ = ("mark",)

    def __init__(self) -> None:
        self.mark = object()


class SchemaChanges:
    """The schema changes of the keyspaces that are in use. Thread-safe."""

    def __init__(self) -> None:
        self._followed: dict[str, KeyspaceChanges] = {}

    def of(self, keyspace: str) -> KeyspaceChanges:
        """Return the changes of a keyspace: one object, however often it is asked for."""
        return self._followed.setdefault(keyspace, KeyspaceChanges())

    def may_have_missed(self) -> None:
        """Note that changes may not have been heard: a connection is new, or was closed."""
        for changes in list(self._followed.values()):
            changes.mark = object()

    def pushed(self, change: Mapping[str, object]) -> None:
        """Note a change that a server has pushed, as the driver parsed it, on its thread."""
        changes = self._followed.get(str(change["keyspace"]))
        if changes is not None:
            changes.mark = object()


Offsets = NDArray[np.int64]
"""Offsets in the bytes of an answer."""
_size = struct.Struct(">i").unpack_from
_FOUR = struct.pack(">i", 4)

WIDE_ROW_BYTES = 64 * 1024
"""Average size of a row in bytes from which this module cuts the rows itself."""
PAGE_CUT_HERE_ROWS = 4
"""Maximum number of rows of a page that is always cut into rows here: starting the compiled parser
would take as long."""


class RawPage(Sequence[RawRow]):
    """Rows of an answer, which are cut into columns when they are first accessed.

    Args:
        body: Bytes of the answer.
        at: Offset of the number of rows, which stands before the first row.
        width: Number of columns of a row.
        cut: Cuts all rows by the driver's parser.

    Attributes:
        body: Bytes of the answer; empty after the rows were cut.
    """

    def __init__(
        self, body: bytes, at: int, width: int, cut: Callable[[], Sequence[RawRow]]
    ) -> None:
        self.body = body
        self._count, self._at = _size(body, at)[0], at + 4
        self._width = width
        self._cut: Callable[[], Sequence[RawRow]] | None = cut
        """None = the rows were cut and are in _rows."""
        self._rows: Sequence[RawRow] = ()
        self._last: int | None = None
        """Offset of the last row that bounds or views has come to; None = of no row."""

    def __len__(self) -> int:
        return int(self._count)

    def __iter__(self) -> Iterator[RawRow]:
        yield from self._all_rows()  # on first use: the driver only tests if there is an iterator

    @overload
    def __getitem__(self, index: int) -> RawRow: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[RawRow]: ...

    def __getitem__(self, index: int | slice) -> RawRow | Sequence[RawRow]:
        # The last row of a page that was read by bounds or views, without cutting all rows.
        if index == -1 and self._cut is not None and self._last is not None:
            return self.row(self._last)
        return self._all_rows()[index]

    def _all_rows(self) -> Sequence[RawRow]:
        """Cut the rows at the first call, and return them."""
        if self._cut is not None:
            here = self._count <= PAGE_CUT_HERE_ROWS or self._wide
            self._rows = self._cut_here() if here else self._cut()
            self.body, self._cut = b"", None  # or the rows would be in memory twice
        return self._rows

    @property
    def _wide(self) -> bool:
        """Whether rows are so long that each copy of them takes more time than cutting here."""
        return bool(len(self.body) >= WIDE_ROW_BYTES * self._count)

    def views(self) -> Iterator[RawRow]:
        """Yield the rows; columns of wide rows are views of the answer and are not kept here."""
        if self._cut is None or not self._wide:
            yield from self._all_rows()
            return
        body, at = cast(bytes, memoryview(self.body)), self._at  # callers read it like bytes
        for _ in range(self._count):
            self._last = at
            yield self._cut_row(body, at)
            at = self.end(at)

    def _cut_here(self) -> Sequence[RawRow]:
        """Cut all rows without the compiled parser, which would copy all columns once more."""
        rows, at = [], self._at
        for _ in range(self._count):
            rows.append(self.row(at))
            at = self.end(at)
        return rows

    def bounds(self, sized_at: int, mark: bytes) -> tuple[Offsets, Offsets] | None:
        """Guess where the rows begin and end; None if that is not possible.

        Rows with the same value in one column of four bytes are taken to be equally long, unless
        the bytes after such a row cannot be the beginning of a row. So the result is a guess. A
        caller who checks every size in a row that begins at its place, and finds that this row ends
        at the place of the next one, has checked the place of the next row too.

        Args:
            sized_at: Offset of that column in a row.
            mark: Bytes with which each row begins.
        """
        body, at, ends = self.body, self._at, []
        lengths: dict[int, int] = {}  # value of the column → length of the row
        try:
            offsets = self._alike(mark)
            if offsets is not None:
                self._last = int(offsets[-2])
                return offsets[:-1], offsets[1:]
            for _ in range(self._count):
                (value,) = _size(body, at + sized_at)
                end = at + lengths.get(value, 0)
                begins = body.startswith(mark, end) and body.startswith(_FOUR, end + sized_at - 4)
                if end == at or not (begins or end == len(body)):
                    end = self.end(at)
                    lengths[value] = end - at
                at = end
                ends.append(at)
        except struct.error:
            return None
        if at != len(body) or not ends:
            return None
        offsets = np.array([self._at, *ends], np.int64)
        self._last = int(offsets[-2])
        return offsets[:-1], offsets[1:]

    def _alike(self, mark: bytes) -> Offsets | None:
        """Return where rows of one length begin, and the end of the last.

        None if lengths differ.
        """
        at, size = self._at, len(self.body)
        length = self.end(at) - at
        if not self._count or at + self._count * length != size:
            return None
        offsets = np.arange(at, size + 1, length)
        begins = offsets[:-1, None] + np.arange(len(mark))
        data = np.frombuffer(self.body, np.uint8)
        return offsets if (data[begins] == np.frombuffer(mark, np.uint8)).all() else None

    def end(self, at: int) -> int:
        """Return the end of the row that begins at ``at``; struct.error: it has no end here."""
        for _ in range(self._width):
            at += 4 + max(0, _size(self.body, at)[0])
        return at

    def row(self, at: int) -> RawRow:
        """Return the columns of the row that begins at ``at``."""
        return self._cut_row(self.body, at)

    def _cut_row(self, body: bytes, at: int) -> RawRow:
        """Return the columns of a row of ``body``, which may be a memoryview."""
        columns: list[bytes | None] = []
        for _ in range(self._width):
            (size,) = _size(body, at)
            at += 4
            columns.append(None if size < 0 else body[at : at + size])
            at += max(0, size)
        return tuple(columns)


PROTOCOL_VERSION = 4
"""Version of the CQL protocol. Version 5 cuts all bytes into segments of 128 KiB with checksums,
which Python joins: 0.8 ms more processor time per MB written and 1 to 1.5 ms per MB read. We need
none of its other features."""
BUFFER_BYTES = 1024 * 1024
"""Maximum number of bytes that one system call reads or writes. With the driver's own 4,096 bytes
an answer takes hundreds of calls."""
DIRECT_BYTES = 16 * 1024
"""Maximum size of a request that the calling thread sends itself, bytes."""
_Column = Tuple[Any, ...]
"""Keyspace, table, name and type of a column, as the driver describes it."""

Prepared = Tuple[bool, bytes, Sequence[Any]]
"""True, the id of a prepared statement, its values."""

_HEAD = struct.Struct(">BBhBi")
"""Head of a request or an answer: version, flags, stream, opcode, size of the body."""
_BATCH = struct.Struct(">BH")
"""Type of a batch and number of its statements; the statements follow."""
_PLAIN = (ExecuteMessage, BatchMessage)
"""Types of the requests that are encoded here."""
_DecodedResult = ProtocolHandler.message_types_by_opcode[ResultMessage.opcode]


class EncodedRows:
    """Statements of a batch, most of them already encoded.

    Args:
        encoded: The bytes of the encoded statements.
        count: Number of the encoded statements.
        others: Prepared statements that are not encoded yet, as in the driver's own batches.
    """

    def __init__(self, encoded: bytes, count: int, others: Sequence[Prepared]) -> None:
        self._encoded, self._count, self._others = encoded, count, others

    def __len__(self) -> int:
        return self._count + len(self._others)

    def write(self, buffer: io.BytesIO, msg: Any, protocol_version: int) -> None:
        """Write the body of the batch ``msg`` with these statements."""
        # The driver encodes the other statements and the end. Its head counts only these.
        rest = BatchMessage(
            msg.batch_type,
            self._others,
            msg.consistency_level,
            msg.serial_consistency_level,
            msg.timestamp,
            msg.keyspace,
        )
        start = buffer.tell()
        buffer.write(bytes(_BATCH.size))
        buffer.write(self._encoded)
        rest_body = io.BytesIO()
        rest.send_body(rest_body, protocol_version)
        with rest_body.getbuffer() as view:
            buffer.write(view[_BATCH.size :])
        with buffer.getbuffer() as view:
            _BATCH.pack_into(view, start, msg.batch_type.value, len(self))


class _ReceiveBuffer:
    """Received bytes that no answer has taken yet, in the pieces in which they arrived.

    It replaces the driver's BytesIO. There each piece is copied in, each answer is copied out, and
    the remaining bytes are copied again with each answer.

    Attributes:
        ended: Whether the server has closed the connection.
    """

    def __init__(self) -> None:
        self._pieces: deque[memoryview] = deque()
        self._size = 0
        self.ended = False

    def write(self, piece: bytes) -> None:
        """Append a piece; an empty one means that the server has closed the connection."""
        if piece:
            self._pieces.append(memoryview(piece))
            self._size += len(piece)
        else:
            self.ended = True

    def tell(self) -> int:
        """Return the number of bytes here."""
        return self._size

    def getvalue(self) -> bytes:
        """Return all bytes, for an error text."""
        return b"".join(self._pieces)

    def pop_bytes(self, size: int) -> bytes:
        """Remove and return the first ``size`` bytes; the caller knows that there are enough."""
        self._size -= size
        pieces = []
        while size:
            piece = self._pieces.popleft()
            if len(piece) > size:
                self._pieces.appendleft(piece[size:])
                piece = piece[:size]
            pieces.append(piece)
            size -= len(piece)
        return b"".join(pieces)


class _RequestTimer:
    """The timer of a request, which drops its reference to the request when that is answered.

    The driver's own timer keeps the reference, and the request refers to its timer. The messages of
    the request would stay in memory until Python's cyclic collector runs, minutes later.
    """

    def __init__(self, ring: Callable[[], None]) -> None:
        self._ring: Callable[[], None] | None = ring
        self.timer: Timer | None = None

    def __call__(self) -> None:
        ring = self._ring
        if ring is not None:
            ring()

    def cancel(self) -> None:
        """Cancel the timer."""
        timer, self.timer, self._ring = self.timer, None, None
        if timer is not None:
            timer.cancel()


class BufferedConnection(DefaultConnection):
    """A connection whose socket is read and written in pieces of up to BUFFER_BYTES."""

    in_buffer_size = BUFFER_BYTES
    out_buffer_size = BUFFER_BYTES
    schema_changes: SchemaChanges
    """Receiver of the schema changes that the server pushes."""
    _frame: tuple[_Frame, int] | None = None
    """Header of the answer that is being received, and the size of its body in bytes."""

    @classmethod
    def create_timer(cls, timeout: float, callback: Callable[[], None]) -> _RequestTimer:
        """Call a function on the driver's thread after ``timeout`` seconds."""
        alarm = _RequestTimer(callback)
        alarm.timer = super().create_timer(timeout, alarm)
        return alarm

    @classmethod
    def factory(cls, endpoint: object, timeout: float, *args: object, **kwargs: object) -> Any:
        """Connect like the driver, and ask the server to push schema changes."""
        connection = super().factory(endpoint, timeout, *args, **kwargs)
        try:
            request = RegisterMessage(event_list=["SCHEMA_CHANGE"])
            connection.wait_for_response(request, timeout=timeout)
        except BaseException:
            connection.close()
            raise
        cls.schema_changes.may_have_missed()
        return connection

    def handle_pushed(self, response: Any) -> None:
        """Note a schema change, before any later answer is processed."""
        if response.event_type == "SCHEMA_CHANGE":
            self.schema_changes.pushed(response.event_args)
        super().handle_pushed(response)

    @cached_property
    def _iobuf(self) -> _ReceiveBuffer:
        """What the driver's reader writes to, and then calls process_io_buffer."""
        return _ReceiveBuffer()

    def process_io_buffer(self) -> None:
        """Process each complete answer; protocol version 4 has no segments."""
        self._process_answers()
        # The driver closes only if no bytes wait here; otherwise it reads the end again and again.
        if self._iobuf.ended:
            self.close()

    def _process_answers(self) -> None:
        received = self._iobuf
        while True:
            if self._frame is None:
                if received.tell() < _HEAD.size:
                    return
                version, *kind, size = _HEAD.unpack(received.pop_bytes(_HEAD.size))
                version &= 0x7F
                if version not in ProtocolVersion.SUPPORTED_VERSIONS or size < 0:
                    self.defunct(ProtocolError("what answers there does not speak CQL"))
                    return
                self._frame = _Frame(version, *kind, _HEAD.size, _HEAD.size + size), size
            frame, size = self._frame
            if received.tell() < size:
                return
            self._frame = None
            self.process_msg(frame, received.pop_bytes(size))

    def push(self, data: bytes) -> None:
        """Send a small request or queue a large one."""
        rest = self._send_now(data) if len(data) <= DIRECT_BYTES else data
        if rest is not None:
            super().push(memoryview(rest))  # which the driver cuts without copies

    def _send_now(self, data: bytes) -> bytes | None:
        """Send as many bytes as the socket takes; return the rest to be queued, None = no rest.

        The caller queues b'', too, because this wakes the driver's thread.

        Waking the driver's thread takes a third of the time of a lookup. While that thread's
        watcher is active it may be in the middle of a request. Only libev's event loop has this
        watcher.
        """
        plain = type(self._socket) is socket.socket  # a TLS socket belongs to one thread
        if not plain or getattr(self, "_write_watcher_is_active", True):
            return data
        with self._deque_lock:
            if self.deque or self._write_watcher_is_active:
                return data
            try:
                count = self._socket.send(data)
            except OSError:  # other than a full buffer: the driver's thread gets the same error
                return data
            if count == len(data):
                return None
            # Under the lock, so that no other request comes between.
            self.deque.append(data[count:])
        return b""


def connection_class(tls: Tls | None, changes: SchemaChanges) -> type[BufferedConnection]:
    """Return the class of connections, which with TLS trust the certificates of their own host.

    Args:
        changes: Receiver of the schema changes that the connections get.
    """

    class ListeningConnection(BufferedConnection):
        schema_changes = changes

    if tls is None or not tls.certfiles:
        return ListeningConnection
    files, make = tls.certfiles, functools.lru_cache(maxsize=None)(tls.context)
    # The driver knows nodes by address; the cqlshrc may name them.
    names = {address: name for name in files for address in _addresses_of(name)}

    class TlsConnection(ListeningConnection):
        def _wrap_socket_from_context(self) -> ssl.SSLSocket:
            address = self.endpoint.address
            self.ssl_context = make(address if address in files else names.get(address, address))
            return super()._wrap_socket_from_context()  # type: ignore[no-any-return]

    return TlsConnection


def _addresses_of(name: str) -> set[object]:
    """Return the IP addresses of a host; empty if it has no address."""
    try:
        return {info[4][0] for info in socket.getaddrinfo(name, None)}
    except (OSError, UnicodeError):  # maybe a host that we never connect to
        return set()


class _RawResultMessage(_DecodedResult):  # type: ignore[misc, valid-type]
    """An answer whose rows are a RawPage. The driver calls its methods."""

    column_metadata: list[_Column] | None
    column_names: list[str]
    column_types: list[object]
    parsed_rows: Sequence[RawRow]

    def recv_results_metadata(self, f: object, user_type_map: object) -> None:
        super().recv_results_metadata(f, user_type_map)
        self.column_metadata = _as_bytes(self.column_metadata)

    def recv_results_rows(
        self,
        f: io.BytesIO,
        version: int,
        types: object,
        metadata: list[_Column] | None,
        policy: object,
    ) -> None:
        schema, body, start = _as_bytes(metadata), f.getvalue(), f.tell()
        kind = self.kind  # a reference to the message would be a cycle and keep its bytes in memory

        def cut() -> Sequence[RawRow]:
            rest, again = io.BytesIO(body), _RawResultMessage(kind)
            rest.seek(start)
            # The compiled parser calls recv_results_metadata of its class, so ours above runs.
            _DecodedResult.recv_results_rows(again, rest, version, types, schema, policy)
            rows: Sequence[RawRow] = again.parsed_rows
            return rows

        self.recv_results_metadata(f, types)
        columns = self.column_metadata or schema or ()
        self.column_names = [column[2] for column in columns]
        self.column_types = [column[3] for column in columns]
        self.parsed_rows = RawPage(body, f.tell(), len(columns), cut)


def _as_bytes(metadata: list[_Column] | None) -> list[_Column] | None:
    """Return descriptions of columns with the type blob, so that no value is decoded."""
    return [(*column[:3], BytesType) for column in metadata] if metadata else metadata


class RawProtocolHandler(ProtocolHandler):
    """Protocol handler that returns columns as the bytes that Cassandra stores."""

    message_types_by_opcode = {
        **ProtocolHandler.message_types_by_opcode,
        ResultMessage.opcode: _RawResultMessage,
    }

    @classmethod
    def encode_message(
        cls,
        msg: Any,
        stream_id: int,
        protocol_version: int,
        compressor: object,
        allow_beta_protocol_version: bool,
    ) -> bytes:
        """Encode a request like the driver, but in one buffer: the driver copies the body twice."""
        special = msg.tracing or msg.custom_payload or compressor or allow_beta_protocol_version
        if special or not isinstance(msg, _PLAIN):
            return super().encode_message(  # type: ignore[no-any-return]
                msg, stream_id, protocol_version, compressor, allow_beta_protocol_version
            )
        buffer = io.BytesIO()
        buffer.write(bytes(_HEAD.size))
        rows = getattr(msg, "queries", None)
        if isinstance(rows, EncodedRows):
            rows.write(buffer, msg, protocol_version)
        else:
            msg.send_body(buffer, protocol_version)
        with buffer.getbuffer() as view:
            size = len(view) - _HEAD.size
            _HEAD.pack_into(view, 0, protocol_version, 0, stream_id, msg.opcode, size)
        return buffer.getvalue()
