# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A network between clients and a Cassandra node that can be slow, silent or cut."""

from __future__ import annotations

import contextlib
import queue
import socket
import threading
import time

PIECE = 64 * 1024
"""Maximum number of bytes that are passed on at once."""
PIECES_WAITING = 256
"""Maximum number of pieces that are on their way, in each direction of a connection."""


class Proxy:
    """Listens at an address and passes bytes on to the same port of a server, while it is open.

    Args:
        server: Address and port of the server.
        address: Address to listen at, and port; 0 = any free port.
    """

    def __init__(self, server: tuple[str, int], address: tuple[str, int]) -> None:
        self._server = server
        self.delay_sec = 0.0
        """Time for which bytes are on their way, s."""
        self.bytes_per_sec = 0.0
        """Maximum rate in each direction of a connection; 0 = no limit."""
        self._connections: list[_Connection] = []
        self._mutex = threading.Lock()
        self._listener = socket.create_server(address)
        self.host, self.port = self._listener.getsockname()
        threading.Thread(target=self._accept, args=(self._listener,), daemon=True).start()

    def __enter__(self) -> Proxy:
        return self

    def __exit__(self, *exc_info: object) -> None:
        if self._listener is not None:
            self.cut()

    def cut(self) -> None:
        """End all connections and refuse new ones."""
        with self._mutex:  # a connection that is being accepted would stay otherwise
            listener, self._listener = self._listener, None
            # A thread that waits in accept keeps the port open otherwise.
            with contextlib.suppress(OSError):
                listener.shutdown(socket.SHUT_RDWR)
            listener.close()
            self._end_connections()

    def mend(self) -> None:
        """Accept connections again, at the same port."""
        self._listener = socket.create_server((self.host, self.port))
        threading.Thread(target=self._accept, args=(self._listener,), daemon=True).start()

    def silence(self, *, new: bool = False) -> None:
        """Drop all bytes of the present connections, which stay open.

        Args:
            new: Whether connections that are made later are silent, too.
        """
        with self._mutex:
            self._silent_from_now = new
            for connection in self._connections:
                connection.silent = True

    def end_silence(self) -> None:
        """Pass bytes of new connections on again, and end those that were silent."""
        with self._mutex:
            self._silent_from_now = False
            self._end_connections()

    _silent_from_now = False

    def _end_connections(self) -> None:
        for connection in self._connections:
            connection.close()
        self._connections.clear()

    def _accept(self, listener: socket.socket) -> None:
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
                    server = socket.create_connection(self._server)
                    connection = _Connection(self, client, server, self._silent_from_now)
                except OSError:
                    client.close()  # the server is away, or the client gave up already
                    continue
                self._connections.append(connection)


class _Connection:
    """A connection of a client, and the one to the server."""

    def __init__(
        self, proxy: Proxy, client: socket.socket, server: socket.socket, silent: bool
    ) -> None:
        self._proxy = proxy
        self._sockets = client, server
        self.silent = silent
        for source, sink in ((client, server), (server, client)):
            source.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            waiting: queue.Queue = queue.Queue(PIECES_WAITING)
            threading.Thread(target=self._take, args=(source, waiting), daemon=True).start()
            threading.Thread(target=self._give, args=(sink, waiting), daemon=True).start()

    def close(self) -> None:
        for each in self._sockets:
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()

    def _take(self, source: socket.socket, waiting: queue.Queue) -> None:
        data = b"first"
        while data:
            try:
                data = source.recv(PIECE)
            except OSError:
                data = b""
            waiting.put((time.monotonic() + self._proxy.delay_sec, data))

    def _give(self, sink: socket.socket, waiting: queue.Queue) -> None:
        while True:
            due, data = waiting.get()
            time.sleep(max(0.0, due - time.monotonic()))
            if not data:
                self.close()
                return
            if self.silent:
                continue
            if self._proxy.bytes_per_sec:
                time.sleep(len(data) / self._proxy.bytes_per_sec)
            with contextlib.suppress(OSError):
                sink.sendall(data)
