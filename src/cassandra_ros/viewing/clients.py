# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Accept the connections of a viewer within limits: how many there are, and how long they may wait.

Idle connections are closed by aiohttp (``keepalive_timeout``), clients that do not read by the
kernel (TCP_USER_TIMEOUT). Only what neither of them does is here.
"""

from __future__ import annotations

import asyncio
import socket
from typing import Dict, Optional, cast

from aiohttp import web
from aiohttp.typedefs import Handler

from cassandra_ros.viewing.viewer_settings import Limits

_ACCEPTING_SEC = 1.0
"""Longest time from the acceptance of a connection until the server has got it, s."""
_REFUSED_SEC = 1.0
"""How long a connection above the limit may take to send its request, before it is closed, s."""


class Clients:
    """The protocol factory of a viewer's socket.

    Args:
        limits: How many connections, and how long they may take for their first head.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._server: Optional[web.Server] = None
        self._awaited: Dict[web.RequestHandler, asyncio.TimerHandle] = {}
        """Connections of which no request has come, and what closes them."""

    @web.middleware
    async def heard(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Note that a connection has sent the head of a request."""
        timer = self._awaited.pop(request.protocol, None)
        if timer is not None:
            timer.cancel()
        return await handler(request)

    async def listen(self, server: Optional[web.Server], host: str, port: int) -> asyncio.Server:
        """Listen for the connections of a server, and hand them over.

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
        """Return what answers a new connection."""
        server, loop = self._server, asyncio.get_running_loop()
        if server is None or self._connections(server, loop.time()) >= self._limits.clients:
            return _Refusal(self._limits.clients)
        protocol = server()
        self._awaited[protocol] = loop.call_later(self._limits.head_sec, self._late, protocol)
        return protocol

    def _connections(self, server: web.Server, now: float) -> int:
        """Count the connections, with those that are accepted and that the server has not got."""
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
    """Answers 503 to whatever is asked, and closes the connection.

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
        """Close the connection: closed before its request came it might not get the answer."""
        self._transport.close()

    def connection_lost(self, exc: Optional[Exception]) -> None:
        """Forget the connection."""
        self._end.cancel()
