# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A TCP proxy before the real Cassandra that holds back or fails the requests a test names.

It understands where the requests and answers of the native protocol 4 begin and end, no more:
whatever no test names goes through byte for byte, and only an answer that a test asks for is ours.
"""

from __future__ import annotations

import socket
import struct
import threading
from typing import NamedTuple

from cassandra import ConsistencyLevel
from cassandra.protocol import BatchMessage, ExecuteMessage, QueryMessage, SupportedMessage

EXECUTE, BATCH, QUERY = ExecuteMessage.opcode, BatchMessage.opcode, QueryMessage.opcode
_ERROR = 0x00
_HEAD = struct.Struct(">BBhBi")  # version, flags, stream, opcode, length of the body
_ONE_NODE = struct.pack(">Hii", ConsistencyLevel.LOCAL_ONE, 0, 1)  # received 0 of 1
_WITH_PAGING_STATE = 0x08
WAIT_SEC = 180


def _text(text):
    return struct.pack(">H", len(text)) + text.encode()


TIMED_OUT = {
    BATCH: struct.pack(">i", 0x1100) + _text("by the proxy") + _ONE_NODE + _text("UNLOGGED_BATCH"),
    EXECUTE: struct.pack(">i", 0x1001) + _text("by the proxy"),
}
"""What a server says that is too busy: a batch may be stored all the same."""
READ_TIMED_OUT = struct.pack(">i", 0x1200) + _text("by the proxy") + _ONE_NODE + b"\0"


class Frame(NamedTuple):
    """One request or answer."""

    version: int
    flags: int
    stream: int
    opcode: int
    body: bytes

    def packed(self):
        return _HEAD.pack(*self[:4], len(self.body)) + self.body


def asks_on(frame):
    """Say whether a request is one for a further page of a result."""
    if frame.opcode != EXECUTE:
        return False
    at = 2 + struct.unpack_from(">H", frame.body)[0]  # behind the statement's id
    _, flags = struct.unpack_from(">HB", frame.body, at)
    return bool(flags & _WITH_PAGING_STATE)


class Caught:
    """The requests that a test has named, in the order in which they came.

    Args:
        wanted: Says whether a request is one of them.
        stored: They reach the server, and the client is told of a failure behind its answer.
        failed: The client is told of a failure; else they only come late.
        most: Maximum number of requests that are caught.
    """

    def __init__(self, wanted, *, stored=False, failed=True, most=2**31):
        self.wanted = wanted
        self.stored = stored
        self.failed = failed
        self.frames = []
        self._most = most
        self._came = threading.Condition()
        self._go_on = threading.Event()
        self._go_on.set()

    def hold(self):
        """Answer none of them until release is called."""
        self._go_on.clear()
        return self

    def release(self):
        self._go_on.set()

    def wait(self, count=1):
        """Return when a number of requests has come."""
        with self._came:
            assert self._came.wait_for(lambda: len(self.frames) >= count, WAIT_SEC)

    def takes(self, frame):
        with self._came:
            if len(self.frames) >= self._most or not self.wanted(frame):
                return False
            self.frames.append(frame)
            self._came.notify_all()
            return True

    def wait_for_release(self):
        self._go_on.wait()


class Proxy:
    """Listens on a port of its own while it is a context.

    Args:
        host, port: The real server.
    """

    def __init__(self, host, port):
        self._server = host, port
        self._caught = []
        self.late_pushes = False
        """What the server pushes of itself comes as late as it may: before the next answer, but for
        those to the driver's heartbeats."""
        self.answered_bytes = 0
        """Number of bytes of the server's answers."""
        self._pairs = []
        self._mutex = threading.Lock()
        self._listener = socket.create_server((host, 0))
        self.host, self.port = self._listener.getsockname()

    def catch(self, wanted, **options):
        """Catch the requests for which ``wanted(frame)`` is true; see Caught."""
        self._caught.append(Caught(wanted, **options))
        return self._caught[-1]

    def __enter__(self):
        self._serve()
        return self

    def __exit__(self, *exc_info):
        for caught in self._caught:
            caught.release()
        if self._listener is not None:
            self.cut()

    def freeze(self):
        """Answer nothing more that the connections of now ask, but their heartbeats."""
        for pair in self._pairs:
            pair.frozen = True

    def cut(self):
        """Act like a server that has ended: close the connections and do not listen."""
        with self._mutex:  # a connection that is being accepted would stay otherwise
            listener, self._listener = self._listener, None
            listener.shutdown(socket.SHUT_RDWR)
            listener.close()
            while self._pairs:
                self._pairs.pop().close()

    def mend(self):
        """Be there again, at the same port."""
        self._listener = socket.create_server((self.host, self.port))
        self._serve()

    def _serve(self):
        threading.Thread(target=self._accept, args=(self._listener,), daemon=True).start()

    def _accept(self, listener):
        while True:
            try:
                client, _ = listener.accept()
            except OSError:
                return
            with self._mutex:
                if self._listener is not listener:
                    client.close()
                    return
                try:
                    self._pairs.append(_Pair(client, socket.create_connection(self._server), self))
                except OSError:
                    client.close()  # the server is away, or the client gave up already


class _Pair:
    """One connection of the client, and ours to the server."""

    def __init__(self, client, server, proxy):
        self._sockets = {"client": client, "server": server}
        self._proxy = proxy
        self._caught = proxy._caught
        self._pushed = []
        self._writing = {"client": threading.Lock(), "server": threading.Lock()}
        self._failing = {}
        self.frozen = False
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for sender, take in (("client", self._request), ("server", self._answer)):
            threading.Thread(target=self._pump, args=(sender, take), daemon=True).start()

    def close(self):
        for each in self._sockets.values():
            try:
                each.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass  # it was closed by the other side
            each.close()

    def _pump(self, sender, take):
        try:
            with self._sockets[sender].makefile("rb") as source:
                for frame in self._frames(source):
                    take(frame)
        except (OSError, EOFError, ValueError):
            self.close()

    def _frames(self, source):
        while True:
            head = _HEAD.unpack(_exactly(source, _HEAD.size))
            yield Frame(*head[:4], _exactly(source, head[4]))

    def _request(self, frame):
        caught = next((each for each in self._caught if each.takes(frame)), None)
        if caught is None:
            self._send("server", frame)
        elif caught.stored:
            self._failing[frame.stream] = frame, caught
            self._send("server", frame)
        else:
            threading.Thread(target=self._late, args=(frame, caught), daemon=True).start()

    def _late(self, frame, caught):
        caught.wait_for_release()
        try:
            if caught.failed:
                self._fail(frame)
            else:
                self._send("server", frame)
        except OSError:
            pass  # who had sent it is gone

    def _fail(self, frame):
        body = TIMED_OUT.get(frame.opcode, READ_TIMED_OUT)
        self._send("client", Frame(frame.version | 0x80, 0, frame.stream, _ERROR, body))

    def _answer(self, frame):
        with self._proxy._mutex:
            self._proxy.answered_bytes += len(frame.body)
        if self.frozen and frame.opcode != SupportedMessage.opcode:
            return
        if frame.stream < 0 and self._proxy.late_pushes:
            self._pushed.append(frame)
            return
        while self._pushed and frame.opcode != SupportedMessage.opcode:
            self._send("client", self._pushed.pop(0))
        request, caught = self._failing.pop(frame.stream, (None, None))
        if caught is not None:
            threading.Thread(target=self._late, args=(request, caught), daemon=True).start()
            return
        self._send("client", frame)

    def _send(self, receiver, frame):
        packed = frame.packed()
        with self._writing[receiver]:
            self._sockets[receiver].sendall(packed)


def _exactly(source, size):
    data = source.read(size)
    if len(data) < size:
        raise EOFError
    return data
