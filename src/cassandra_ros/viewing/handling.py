# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Runs handlers on threads and sends what they return. Only here and in serving.py is async code.

While a handler runs the connection is watched: where the browser goes away ``call.gone`` is set,
and what a stream reads is closed.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Callable, Iterator, Mapping, Sequence, TypeVar, Union

from aiohttp import web
from aiohttp.typedefs import Handler

from cassandra_ros.errors import CassandraRosError, StoreUnavailable
from cassandra_ros.viewing.answers import Bytes, SpooledFile, Stream, json_bytes
from cassandra_ros.viewing.call import Call
from cassandra_ros.viewing.file_answer import send_file
from cassandra_ros.viewing.route import Route
from cassandra_ros.viewing.shared import Shared

PATIENCE_SEC = 2.0
"""How long handlers may go on at the end, before the store is closed under them."""
_POLL_SEC = 0.01
T = TypeVar("T")
_log = logging.getLogger(__name__)


class Handling:
    """The threads of a viewer, and what runs on them.

    Args:
        shared: The store, the settings and what handlers keep; closed with this.
    """

    def __init__(self, shared: Shared) -> None:
        self._shared = shared
        self._threads = ThreadPoolExecutor(shared.settings.threads, "viewer")
        self._calls: set[Call] = set()
        self._held_bytes = 0
        """Bytes of the answers that are being sent."""

    def handler(self, route: Route) -> Handler:
        """Return the coroutine that answers a route."""

        async def answer(request: web.Request) -> web.StreamResponse:
            headers = _headers(request)
            call = Call(self._shared, route, _query(request), headers, request.method)
            self._calls.add(call)
            try:
                found = await self._run(partial(_work, route, call))
                if isinstance(found, _Chunks):
                    return await self._send_stream(request, call, found)
                if isinstance(found, SpooledFile):
                    return await send_file(request, found)
                return await self._send_bytes(request, found)
            finally:
                call.gone.set()
                self._calls.discard(call)

        return answer

    def _run(self, work: Callable[[], T]) -> asyncio.Future[T]:
        # Of a task that is cancelled the thread cannot be: it looks at call.gone.
        return asyncio.wrap_future(self._threads.submit(work))

    async def _send_bytes(self, request: web.Request, found: Bytes) -> web.StreamResponse:
        """Send an answer piece by piece: a connection does not copy a large one as a whole."""
        piece = self._shared.settings.limits.piece_bytes
        if len(found.data) <= piece:
            return web.Response(
                body=found.data, content_type=found.content_type, headers=found.headers
            )
        with self._held(len(found.data)):
            response = web.StreamResponse(headers=found.headers)
            response.content_type = found.content_type
            response.content_length = len(found.data)
            await response.prepare(request)
            if request.method != "HEAD":
                view = memoryview(found.data)
                for start in range(0, len(view), piece):
                    await response.write(view[start : start + piece])
            await response.write_eof()
            return response

    @contextlib.contextmanager
    def _held(self, size: int) -> Iterator[None]:
        """Count some bytes that are held until a client has taken them.

        Raises:
            StoreUnavailable: All clients together would hold too many.
        """
        most = self._shared.settings.limits.answers_bytes
        if self._held_bytes + size > most:
            raise StoreUnavailable(
                f"the viewer is already sending {self._held_bytes / 1e6:.0f} MB to other clients, "
                f"of at most {most / 1e6:.0f} MB: ask again later, or for less"
            )
        self._held_bytes += size
        try:
            yield
        finally:
            self._held_bytes -= size

    async def _send_stream(
        self, request: web.Request, call: Call, chunks: _Chunks
    ) -> web.StreamResponse:
        """Send chunk by chunk; the next is asked for when the browser has taken the one before."""
        response = web.StreamResponse(headers=chunks.stream.headers)
        response.content_type = chunks.stream.content_type
        try:
            chunk = await self._run(chunks.next)  # before the headers: its error has a status
            await response.prepare(request)
            while chunk is not None and request.method != "HEAD":
                if chunk:
                    with self._held(len(chunk)):
                        await response.write(chunk)
                chunk = await self._run(chunks.next)
            if call.gone.is_set():  # it may have ended for that: nobody may take it for the whole
                raise StoreUnavailable("the viewer ends")
            await response.write_eof()
        except CassandraRosError as exc:
            if not response.prepared:
                raise
            _log.warning("%s was cut short: %s", request.path, exc)
            if request.transport is not None:
                request.transport.abort()
        finally:
            self._threads.submit(chunks.close)
        return response

    async def stop(self, application: web.Application) -> None:
        """Tell all handlers that nobody waits any more."""
        for call in self._calls:
            call.gone.set()

    async def close(self, application: web.Application) -> None:
        """Wait for the threads, and close what was kept; behind the last answer."""
        loop = asyncio.get_running_loop()
        patience = loop.time() + PATIENCE_SEC
        while self._calls and loop.time() < patience:
            await asyncio.sleep(_POLL_SEC)  # tasks that were cancelled give back what they hold
        ended = loop.run_in_executor(None, self._threads.shutdown)
        done, _ = await asyncio.wait([ended], timeout=PATIENCE_SEC)
        if not done:
            self._shared.store.close()  # what still reads there gets an error
            await ended
        self._shared.close()


class _Chunks:
    """The chunks of a stream, asked for by one thread at a time, and closed by whoever is last.

    Args:
        stream: What a handler returned.
    """

    def __init__(self, stream: Stream) -> None:
        self.stream = stream
        self._chunks: Iterator[bytes] = stream.chunks
        self._lock = threading.Lock()  # a generator that runs cannot be closed

    def next(self) -> bytes | None:
        """Return the next chunk; None: that was all."""
        with self._lock:
            return next(self._chunks, None)

    def close(self) -> None:
        """Wait for the chunk that is being made, and let the rest be. Twice is harmless."""
        with self._lock:
            close = getattr(self._chunks, "close", None)
            if close is not None:
                close()


def _work(route: Route, call: Call) -> Union[Bytes, SpooledFile, _Chunks]:
    """Answer a call, on a thread: what is JSON is written here, too."""
    answer = route.answer(call)
    if isinstance(answer, (Bytes, SpooledFile)):
        return answer
    if isinstance(answer, Stream):
        chunks = _Chunks(answer)
        if call.gone.is_set():
            chunks.close()
        return chunks
    return Bytes(json_bytes(answer), "application/json")


def _query(request: web.Request) -> Mapping[str, Sequence[str]]:
    return {name: request.query.getall(name) for name in request.query}


def _headers(request: web.Request) -> Mapping[str, str]:
    return {name.lower(): text for name, text in request.headers.items()}
