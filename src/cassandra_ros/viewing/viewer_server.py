# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The server of a viewer: it listens, answers, and ends with a signal."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import signal
import socket
from typing import AsyncIterator, Callable, Sequence, cast
from urllib.parse import quote

from aiohttp import web
from aiohttp.typedefs import Handler

from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.errors import InvalidOption
from cassandra_ros.stores.fleet.fleet import Fleet
from cassandra_ros.viewing.application import make_application
from cassandra_ros.viewing.fleet_routes import FLEET_ROUTES
from cassandra_ros.viewing.route import Route
from cassandra_ros.viewing.routes import ROUTES
from cassandra_ros.viewing.security import is_loopback
from cassandra_ros.viewing.viewer_settings import ClientLimits, ViewerSettings

MAX_LINE_BYTES = 64 * 1024
"""Maximum length of an address, bytes. It may name hundreds of topics; aiohttp allows 8 KB."""
LAST_ANSWERS_SEC = 0.5
"""Maximum time at the end for answers that are being sent, s."""
_ACCEPTING_SEC = 1.0
"""Maximum time from the acceptance of a connection until the server lists it, s."""
_REFUSED_SEC = 1.0
"""Time that a connection above the limit has to send its request before it is closed, s."""


def serve(
    settings: ViewerSettings, source: RosCassandra | Fleet, ready: Callable[[str], None]
) -> None:
    """Serve until Ctrl-C or SIGTERM; called from the main thread.

    Args:
        settings: Settings of the viewer.
        source: The connected store, or several stores that are shown as one; the caller closes it.
        ready: Called with the address for a browser, with the token, once the viewer listens.

    Raises:
        InvalidOption: The viewer cannot listen on this address; the text says why.
    """
    asyncio.run(_serve(settings, source, ready))


async def _serve(
    settings: ViewerSettings, source: RosCassandra | Fleet, ready: Callable[[str], None]
) -> None:
    hurry = source.hurry if isinstance(source, Fleet) else source.cassandra.outage.hurry
    loop, ended = asyncio.get_running_loop(), asyncio.Event()

    def end() -> None:
        hurry()
        ended.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, end)
    async with listening(settings, source) as port:
        ready(address(settings, port))
        await ended.wait()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.remove_signal_handler(number)  # a second Ctrl-C ends at once


@contextlib.asynccontextmanager
async def listening(
    settings: ViewerSettings, source: RosCassandra | Fleet, routes: Sequence[Route] | None = None
) -> AsyncIterator[int]:
    """Listen and answer while the context is open; yield the port.

    Args:
        routes: Routes of the API; None = those of one store, or of several.

    Raises:
        InvalidOption: The viewer cannot listen on this address; the text says why.
    """
    clients = Clients(settings.limits)
    if routes is None:
        routes = FLEET_ROUTES if isinstance(source, Fleet) else ROUTES
    application = make_application(settings, source, routes)
    application.middlewares.insert(0, clients.heard)
    runner = web.AppRunner(
        application,
        access_log=None,
        keepalive_timeout=settings.limits.idle_sec,
        max_line_size=MAX_LINE_BYTES,
        handler_cancellation=True,  # a client that disconnects ends its handler
        shutdown_timeout=LAST_ANSWERS_SEC,
    )
    await runner.setup()
    listener: asyncio.Server | None = None
    try:
        try:
            listener = await clients.listen(runner.server, settings.host, settings.port)
        except OSError as exc:
            raise InvalidOption(_why_not(settings, exc)) from exc
        yield listener.sockets[0].getsockname()[1]
    finally:
        if listener is not None:
            listener.close()
        await runner.cleanup()


def address(settings: ViewerSettings, port: int) -> str:
    """Return the address to open in a browser, with the token if there is one."""
    host = settings.host
    if host in ("", "0.0.0.0", "::"):  # noqa: S104 -- not listened on here
        host = socket.gethostname()
    name = f"[{host}]" if ":" in host else host
    query = f"?token={quote(settings.token)}" if settings.token else ""
    return f"http://{name}:{port}/{query}"


def _why_not(settings: ViewerSettings, error: OSError) -> str:
    where = f"{settings.host} port {settings.port}"
    if error.errno == errno.EADDRINUSE:
        return (
            f"{where} is taken by another program, perhaps by another viewer: give another one, "
            f"as --port {settings.port + 1}, or --port 0 for any that is free"
        )
    if error.errno == errno.EACCES:
        return f"{where}: you may not listen there; give --port of 1024 or more"
    hint = "" if is_loopback(settings.host) else ": --host is an address of this machine"
    return f"the viewer cannot listen on {where}{hint} ({error.strerror or error})"


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
