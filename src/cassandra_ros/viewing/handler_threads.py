# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Runs handlers on threads and sends their answers.

If the browser disconnects while a handler runs, ``call.gone`` is set and the iterator of a stream
is closed.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import IO, Callable, Iterator, TypeVar

from aiohttp import ETag, web
from aiohttp.typedefs import Handler

from cassandra_ros.client.sql.statement_processes import STATEMENTS_AT_ONCE
from cassandra_ros.errors import CassandraRosError, StoreUnavailable
from cassandra_ros.viewing.answers import Bytes, CachedFile, StreamedBody, json_bytes
from cassandra_ros.viewing.api_call import ApiCall
from cassandra_ros.viewing.route import Route
from cassandra_ros.viewing.viewer_context import ViewerContext

PATIENCE_SEC = 2.0
"""Maximum time that running handlers get at the end before the store is closed, s."""
_POLL_SEC = 0.01
"""Interval at which the end checks for running handlers, s."""
T = TypeVar("T")
_log = logging.getLogger(__name__)
_ANSWER_READ_BYTES = 1 << 18
"""Number of bytes of a file that are read at once while it is sent."""


class HandlerThreads:
    """The threads of a viewer and the calls that they answer.

    Args:
        shared: The store, the settings and the caches of the viewer; ``close`` closes it.
    """

    def __init__(self, shared: ViewerContext) -> None:
        self._shared = shared
        self._threads = ThreadPoolExecutor(shared.settings.threads, "viewer")
        self._in_turn = ThreadPoolExecutor(STATEMENTS_AT_ONCE, "viewer-turn")
        """Threads of the calls that take turns, so that those which wait hold no other one."""
        self._calls: set[ApiCall] = set()
        self._held_bytes = 0
        """Size of the answers that are being sent, bytes."""

    def handler(self, route: Route) -> Handler:
        """Return the coroutine that answers a route."""

        async def answer(request: web.Request) -> web.StreamResponse:
            query = {name: request.query.getall(name) for name in request.query}
            headers = {name.lower(): text for name, text in request.headers.items()}
            call = ApiCall(self._shared, route, query, headers, request.method)
            self._calls.add(call)
            try:
                threads = self._in_turn if route.takes_turns(call) else self._threads
                body = await self._run(partial(_work, route, call), threads)
                if isinstance(body, _Chunks):
                    return await self._send_stream(request, call, body)
                if isinstance(body, CachedFile):
                    return await send_file(request, body)
                return await self._send_bytes(request, body)
            finally:
                call.gone.set()
                self._calls.discard(call)

        return answer

    def _run(
        self, work: Callable[[], T], threads: ThreadPoolExecutor | None = None
    ) -> asyncio.Future[T]:
        # Cancelling the task does not end the thread: it checks call.gone.
        return asyncio.wrap_future((threads or self._threads).submit(work))

    async def _send_bytes(self, request: web.Request, body: Bytes) -> web.StreamResponse:
        """Send an answer piece by piece, so that the connection does not copy a large one."""
        piece = self._shared.settings.limits.piece_bytes
        if len(body.data) <= piece:
            return web.Response(
                body=body.data, content_type=body.content_type, headers=body.headers
            )
        with self._hold_bytes(len(body.data)):
            response = web.StreamResponse(headers=body.headers)
            response.content_type = body.content_type
            response.content_length = len(body.data)
            await response.prepare(request)
            if request.method != "HEAD":
                view = memoryview(body.data)
                for start in range(0, len(view), piece):
                    await response.write(view[start : start + piece])
            await response.write_eof()
            return response

    @contextlib.contextmanager
    def _hold_bytes(self, size: int) -> Iterator[None]:
        """Count bytes of an answer until the client has read them.

        Raises:
            StoreUnavailable: The answers of all clients together would be too large.
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
        self, request: web.Request, call: ApiCall, chunks: _Chunks
    ) -> web.StreamResponse:
        """Send a stream; a chunk is made when the browser has read the one before."""
        response = web.StreamResponse(headers=chunks.stream.headers)
        response.content_type = chunks.stream.content_type
        try:
            chunk = await self._run(chunks.next)  # before the headers: its error has a status
            await response.prepare(request)
            while chunk is not None and request.method != "HEAD":
                if chunk:
                    with self._hold_bytes(len(chunk)):
                        await response.write(chunk)
                chunk = await self._run(chunks.next)
            if call.gone.is_set():  # the stream may have ended early: it must not look complete
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
        """Tell all handlers that their clients do not wait any more."""
        for call in self._calls:
            call.gone.set()

    async def close(self, application: web.Application) -> None:
        """Wait for the threads and close the caches; called after the last answer."""
        loop = asyncio.get_running_loop()
        patience = loop.time() + PATIENCE_SEC
        while self._calls and loop.time() < patience:
            await asyncio.sleep(_POLL_SEC)  # cancelled tasks release their files
        ended = loop.run_in_executor(None, self._shut_down)
        done, _ = await asyncio.wait([ended], timeout=PATIENCE_SEC)
        if not done:
            self._shared.source.close()  # handlers that still read get an error
            await ended
        self._shared.close()

    def _shut_down(self) -> None:
        for threads in (self._in_turn, self._threads):
            threads.shutdown()


class _Chunks:
    """The chunks of a stream; one thread at a time makes or closes them.

    Args:
        stream: The answer of a handler.
    """

    def __init__(self, stream: StreamedBody) -> None:
        self.stream = stream
        self._chunks: Iterator[bytes] = stream.chunks
        self._lock = threading.Lock()  # a running generator cannot be closed

    def next(self) -> bytes | None:
        """Return the next chunk; None = the end."""
        with self._lock:
            return next(self._chunks, None)

    def close(self) -> None:
        """Wait for the chunk that is being made and drop the rest; a second call does nothing."""
        with self._lock:
            close = getattr(self._chunks, "close", None)
            if close is not None:
                close()


def _work(route: Route, call: ApiCall) -> Bytes | CachedFile | _Chunks:
    """Answer a call; JSON is written here, on the handler's thread."""
    answer = route.answer(call)
    if isinstance(answer, (Bytes, CachedFile)):
        return answer
    if isinstance(answer, StreamedBody):
        chunks = _Chunks(answer)
        if call.gone.is_set():
            chunks.close()
        return chunks
    return Bytes(json_bytes(answer), "application/json")


async def send_file(request: web.Request, file: CachedFile) -> web.StreamResponse:
    """Send a finished file, or the part of it that Range asks for.

    Raises:
        StoreUnavailable: The file was removed; the client may ask again.
    """
    if request.if_none_match is not None and _names(request.if_none_match, file.etag):
        return web.Response(status=304, headers={"ETag": f'"{file.etag}"'})
    if request.if_match is not None and not _names(request.if_match, file.etag):
        return web.Response(status=412)
    loop = asyncio.get_running_loop()
    stream, size = await loop.run_in_executor(None, _open_file, file.path)
    try:
        offsets = asked_offsets(request, file.etag, size)
        response = _response(file, offsets, size)
        await response.prepare(request)
        if request.method != "HEAD":
            await _send_part(response, stream, range(size) if offsets is None else offsets)
        await response.write_eof()
        return response
    finally:
        await asyncio.shield(loop.run_in_executor(None, stream.close))


def asked_offsets(request: web.BaseRequest, etag: str, size: int) -> range | None:
    """Return the offsets of the bytes that Range asks for, which may be no byte; None = the file.

    The file is the answer, as RFC 9110 allows, to a Range that is malformed, of another unit or of
    several ranges. So it is where If-Range names another content: a client that resumes a download
    must not get the end of another file. If-Range may give a date, which does not name a content.

    Args:
        etag: Tag of the file, without quotes.
        size: Size of the file, bytes.
    """
    if request.headers.get("If-Range", f'"{etag}"').strip() != f'"{etag}"':
        return None
    try:
        byte_range = request.http_range
    except ValueError:
        return None
    return None if byte_range.start is None else range(*byte_range.indices(size))


def _names(tags: tuple[ETag, ...], etag: str) -> bool:
    """Say whether a list of tags, as of If-None-Match, names one, or all by a star."""
    return any(tag.value in ("*", etag) for tag in tags)


def _response(file: CachedFile, offsets: range | None, size: int) -> web.StreamResponse:
    """Make the answer, with all of its headers, before anything is sent."""
    response = web.StreamResponse()
    response.content_type = file.content_type
    response.content_length = size if offsets is None else len(offsets)
    response.headers["Accept-Ranges"] = "bytes"
    response.headers["ETag"] = f'"{file.etag}"'
    response.headers["Content-Disposition"] = f'attachment; filename="{file.name}"'
    if offsets:
        response.set_status(206)
        response.headers["Content-Range"] = f"bytes {offsets[0]}-{offsets[-1]}/{size}"
    elif offsets is not None:
        response.set_status(416)
        response.headers["Content-Range"] = f"bytes */{size}"
    return response


def _open_file(path: Path) -> tuple[IO[bytes], int]:
    """Open a file; return it with its size in bytes."""
    try:
        stream = path.open("rb")
    except OSError as exc:
        raise StoreUnavailable(f"{path.name} was removed meanwhile: ask for it again") from exc
    return stream, os.fstat(stream.fileno()).st_size


async def _send_part(response: web.StreamResponse, stream: IO[bytes], offsets: range) -> None:
    loop = asyncio.get_running_loop()
    remaining = len(offsets)
    await loop.run_in_executor(None, stream.seek, offsets.start)
    while remaining:
        chunk = await loop.run_in_executor(None, stream.read, min(remaining, _ANSWER_READ_BYTES))
        if not chunk:
            raise ConnectionResetError("the file has become shorter")
        remaining -= len(chunk)
        await response.write(chunk)
