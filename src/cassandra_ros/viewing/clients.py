# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The connections of a viewer's clients, and the limits of their number and waiting time.

aiohttp closes idle connections (``keepalive_timeout``), the kernel those of clients that do not
read (TCP_USER_TIMEOUT). This module does the rest.
"""

from __future__ import annotations

import asyncio
import socket
from typing import cast

from aiohttp import web
from aiohttp.typedefs import Handler

from cassandra_ros.viewing.viewer_settings import ClientLimits

_ACCEPTING_SEC = 1.0
"""Maximum time from the acceptance of a connection until the server lists it, s."""
_REFUSED_SEC = 1.0
"""Time that a connection above the limit has to send its request before it is closed, s."""


class Clients:
    """The protocol factory of a viewer's socket.

    Args:
        limits: Maximum number of connections, and maximum time for the head of their first request.
    """

    def __init__(self, limits: ClientLimits) -> None:
        self._limits = limits
        self._server: web.Server | None = None
        self._awaited: dict[web.RequestHandler, asyncio.TimerHandle] = {}
        """Timers that close the connections that have not sent a request yet."""

    @web.middleware
    async def heard(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Cancel the timer of a connection: it has sent the head of a request."""
        timer = self._awaited.pop(request.protocol, None)
        if timer is not None:
            timer.cancel()
        return await handler(request)

    async def listen(self, server: web.Server | None, host: str, port: int) -> asyncio.Server:
        """Listen on an address and hand the connections to a server.

        Raises:
            OSError: The address cannot be used.
        """
        self._server = server
        listener = await asyncio.get_running_loop().create_server(self._accept, host, port)
        for sock in listener.sockets:  # accepted sockets inherit it
            stalled_ms = max(1, round(1000 * self._limits.stalled_sec))
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, stalled_ms)
        return listener

    def _accept(self) -> asyncio.BaseProtocol:
        """Return the protocol of a new connection."""
        server, loop = self._server, asyncio.get_running_loop()
        if server is None or self._connections(server, loop.time()) >= self._limits.clients:
            return _Refusal(self._limits.clients)
        protocol = server()
        self._awaited[protocol] = loop.call_later(self._limits.head_sec, self._late, protocol)
        return protocol

    def _connections(self, server: web.Server, now: float) -> int:
        """Count the connections, including accepted ones that the server does not list yet."""
        accepted = now + self._limits.head_sec - _ACCEPTING_SEC
        coming = sum(
            protocol.transport is None and timer.when() > accepted
            for protocol, timer in self._awaited.items()
        )
        return len(server.connections) + coming

    def _late(self, protocol: web.RequestHandler) -> None:
        """Close a connection whose first head has not come in time."""
        if self._awaited.pop(protocol, None) is not None:
            protocol.force_close()


class _Refusal(asyncio.Protocol):
    """A connection above the limit, which is answered with 503 and closed.

    Args:
        clients: Maximum number of connections, for the text.
    """

    def __init__(self, clients: int) -> None:
        self._text = (
            f"this viewer already has {clients} connections: close pages that you do not need, "
            "and ask again\n"
        )

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Send the answer at once; the request may never come."""
        self._transport = transport = cast(asyncio.Transport, transport)
        body = self._text.encode()
        head = (
            "HTTP/1.1 503 Service Unavailable\r\nContent-Type: text/plain; charset=utf-8\r\n"
            f"Content-Length: {len(body)}\r\nRetry-After: 5\r\nConnection: close\r\n\r\n"
        )
        transport.write(head.encode() + body)
        loop = asyncio.get_running_loop()
        self._end = loop.call_later(_REFUSED_SEC, transport.close)

    def data_received(self, data: bytes) -> None:
        """Close the connection; closing it before its request came could discard the answer."""
        self._transport.close()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self._end.cancel()
