# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The driver's own wire: columns as raw bytes, large requests and answers without needless copies.

Our columns are encoded straight from the wire buffer and go back into one: decoding them into
Python values and encoding those again would cost twice and change signalling NaNs. So a session
of its own hands out each column as the bytes that Cassandra stores.
"""

from __future__ import annotations

import functools
import io
import socket
import ssl
import struct
from collections import deque
from functools import cached_property
from typing import Any, Callable, Sequence, Tuple

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

from cassandra_ros.connection.login import Tls
from cassandra_ros.connection.paging import RawRow
from cassandra_ros.connection.raw_page import RawPage
from cassandra_ros.connection.schema_changes import SchemaChanges

PROTOCOL_VERSION = 4
"""In version 5 all bytes are cut into segments of 128 KiB with checksums, which Python joins: 0.8
ms more CPU for each MB that is written, and 1 to 1.5 ms for each that is read. Of what it can do
besides we use nothing."""
BUFFER_BYTES = 1024 * 1024
"""What one call of the system takes or gives. With the driver's own 4,096 bytes an answer takes
hundreds of calls."""
DIRECT_BYTES = 16 * 1024
"""A request up to this is sent by the thread that makes it."""
_Column = Tuple[Any, ...]
"""Keyspace, table, name and type of a column, as the driver tells them."""

Prepared = Tuple[bool, bytes, Sequence[Any]]
"""True, the id of a prepared statement, its values."""

_HEAD = struct.Struct(">BBhBi")
_BATCH = struct.Struct(">BH")
"""Type of a batch and number of its statements, before these."""
_PLAIN = (ExecuteMessage, BatchMessage)
_Decoding = ProtocolHandler.message_types_by_opcode[ResultMessage.opcode]


class EncodedRows:
    """Statements of a batch, most of them encoded already.

    Args:
        encoded: The bytes of some.
        count: How many these are.
        others: Prepared ones, as the driver's own batches hold them.
    """

    def __init__(self, encoded: bytes, count: int, others: Sequence[Prepared]) -> None:
        self._encoded, self._count, self._others = encoded, count, others

    def __len__(self) -> int:
        return self._count + len(self._others)

    def write(self, buffer: io.BytesIO, msg: Any, protocol_version: int) -> None:
        """Write the body of the batch whose statements these are."""
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
        behind = io.BytesIO()
        rest.send_body(behind, protocol_version)
        with behind.getbuffer() as view:
            buffer.write(view[_BATCH.size :])
        with buffer.getbuffer() as view:
            _BATCH.pack_into(view, start, msg.batch_type.value, len(self))


class _Received:
    """What came and was not handed on yet, in the pieces in which it came.

    It stands where the driver has a BytesIO, into which each piece was copied, out of which each
    answer was, and what was left behind that with each answer.

    Attributes:
        ended: Nothing more will come.
    """

    def __init__(self) -> None:
        self._pieces: deque[memoryview] = deque()
        self._size = 0
        self.ended = False

    def write(self, piece: bytes) -> None:
        """Append a piece; an empty one is what a socket gives at its end."""
        if piece:
            self._pieces.append(memoryview(piece))
            self._size += len(piece)
        else:
            self.ended = True

    def tell(self) -> int:
        """Return how many bytes there are."""
        return self._size

    def getvalue(self) -> bytes:
        """Return all, for a message about an error."""
        return b"".join(self._pieces)

    def take(self, size: int) -> bytes:
        """Take so many bytes from the front; there are as many."""
        self._size -= size
        found = []
        while size:
            piece = self._pieces.popleft()
            if len(piece) > size:
                self._pieces.appendleft(piece[size:])
                piece = piece[:size]
            found.append(piece)
            size -= len(piece)
        return b"".join(found)


class _Alarm:
    """The timer of a request, which lets go of the request when that is answered.

    The driver's own holds it for good, and the request holds its timer: the messages in it would
    stay in memory until Python's cyclic collector comes round, minutes later.
    """

    def __init__(self, ring: Callable[[], None]) -> None:
        self._ring: Callable[[], None] | None = ring
        self.timer: Timer | None = None

    def __call__(self) -> None:
        ring = self._ring
        if ring is not None:
            ring()

    def cancel(self) -> None:
        """Ring no more."""
        timer, self.timer, self._ring = self.timer, None, None
        if timer is not None:
            timer.cancel()


class LargeBuffers(DefaultConnection):
    """A connection whose socket is read and written by the MB."""

    in_buffer_size = BUFFER_BYTES
    out_buffer_size = BUFFER_BYTES
    schema_changes: SchemaChanges
    """What is told of the schema's changes that the server pushes."""
    _frame: tuple[_Frame, int] | None = None
    """The answer that is being received, and the size of its body."""

    @classmethod
    def create_timer(cls, timeout: float, callback: Callable[[], None]) -> _Alarm:
        """Have the driver's thread call something in so many seconds."""
        alarm = _Alarm(callback)
        alarm.timer = super().create_timer(timeout, alarm)
        return alarm

    @classmethod
    def factory(cls, endpoint: object, timeout: float, *args: object, **kwargs: object) -> Any:
        """Connect as the driver does, and ask the server to push changes of the schema."""
        connection = super().factory(endpoint, timeout, *args, **kwargs)
        try:
            asked = RegisterMessage(event_list=["SCHEMA_CHANGE"])
            connection.wait_for_response(asked, timeout=timeout)
        except BaseException:
            connection.close()
            raise
        cls.schema_changes.connected()
        return connection

    def handle_pushed(self, response: Any) -> None:
        """Note a change of the schema, before any answer that comes behind it is handed on."""
        if response.event_type == "SCHEMA_CHANGE":
            self.schema_changes.pushed(response.event_args)
        super().handle_pushed(response)

    @cached_property
    def _iobuf(self) -> _Received:
        return _Received()

    def process_io_buffer(self) -> None:
        """Hand on each answer that is whole; of version 4, without segments."""
        self._hand_on()
        # The driver closes at the end only if nothing waits here, and reads it again and again.
        if self._iobuf.ended:
            self.close()

    def _hand_on(self) -> None:
        received = self._iobuf
        while True:
            if self._frame is None:
                if received.tell() < _HEAD.size:
                    return
                version, *kind, size = _HEAD.unpack(received.take(_HEAD.size))
                version &= 0x7F
                if version not in ProtocolVersion.SUPPORTED_VERSIONS or size < 0:
                    self.defunct(ProtocolError("what answers there does not speak CQL"))
                    return
                self._frame = _Frame(version, *kind, _HEAD.size, _HEAD.size + size), size
            frame, size = self._frame
            if received.tell() < size:
                return
            self._frame = None
            self.process_msg(frame, received.take(size))

    def push(self, data: bytes) -> None:
        """Send a small request, queue a large one; what is left over is cut off without a copy."""
        rest = self._send_now(data) if len(data) <= DIRECT_BYTES else data
        if rest is not None:
            super().push(memoryview(rest))

    def _send_now(self, data: bytes) -> bytes | None:
        """Send at once what may be; None = nothing is left to be queued.

        To wake the driver's thread for it takes as long as a third of a lookup. While its watcher
        is active (of libev's loop; another has none) it may be in the middle of a request.
        """
        plain = type(self._socket) is socket.socket  # TLS is of one thread
        if not plain or getattr(self, "_write_watcher_is_active", True):
            return data
        with self._deque_lock:
            if self.deque or self._write_watcher_is_active:
                return data
            try:
                sent = self._socket.send(data)
            except OSError:  # if it is more than a full buffer, the driver's thread meets it again
                return data
            if sent == len(data):
                return None
            self.deque.append(data[sent:])
        return b""  # wakes the driver's thread


def connection_class(tls: Tls | None, changes: SchemaChanges) -> type[LargeBuffers]:
    """Return the class of connections, which with TLS trust what is trusted of their host.

    Args:
        changes: Is told what they hear of the schema.
    """

    class Listening(LargeBuffers):
        schema_changes = changes

    if tls is None or not tls.certfiles:
        return Listening
    files, make = tls.certfiles, functools.lru_cache(maxsize=None)(tls.context)
    # The driver knows nodes by their addresses; the file may name them.
    names = {address: name for name in files for address in _addresses_of(name)}

    class Encrypted(Listening):
        def _wrap_socket_from_context(self) -> ssl.SSLSocket:
            address = self.endpoint.address
            self.ssl_context = make(address if address in files else names.get(address, address))
            return super()._wrap_socket_from_context()  # type: ignore[no-any-return]

    return Encrypted


def _addresses_of(name: str) -> set[object]:
    try:
        return {found[4][0] for found in socket.getaddrinfo(name, None)}
    except (OSError, UnicodeError):  # one that we do not connect to, perhaps
        return set()


class _RawResultMessage(_Decoding):  # type: ignore[misc, valid-type]
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
        known, body, start = _as_bytes(metadata), f.getvalue(), f.tell()
        kind = self.kind  # in a circle with the message its bytes would stay

        def cut() -> Sequence[RawRow]:
            rest, again = io.BytesIO(body), _RawResultMessage(kind)
            rest.seek(start)
            # The compiled parser binds its recv_results_metadata, so ours above is called.
            _Decoding.recv_results_rows(again, rest, version, types, known, policy)
            rows: Sequence[RawRow] = again.parsed_rows
            return rows

        self.recv_results_metadata(f, types)
        columns = self.column_metadata or known or ()
        self.column_names = [column[2] for column in columns]
        self.column_types = [column[3] for column in columns]
        self.parsed_rows = RawPage(body, f.tell(), len(columns), cut)


def _as_bytes(metadata: list[_Column] | None) -> list[_Column] | None:
    return [(*column[:3], BytesType) for column in metadata] if metadata else metadata


class RawProtocolHandler(ProtocolHandler):
    """Gives columns as the bytes that Cassandra stores."""

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
        """Encode a request as the driver does, but in one buffer: it copies a body twice."""
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
