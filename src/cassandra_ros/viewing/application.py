# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The viewer as an application of aiohttp: routes, pages, and who may ask. Only here is async code.

A handler runs on a thread of a bounded pool. While it runs the connection is watched: where the
browser goes away its ``call.gone`` is set, and a stream is closed.
"""

from __future__ import annotations

import asyncio
import json
import logging
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Callable, Iterator, Mapping, Sequence

from aiohttp import web
from aiohttp.typedefs import Handler

from cassandra_ros.errors import CassandraRosError, ConnectionFailed, InvalidQuery, StoreUnavailable
from cassandra_ros.topics.ros_cassandra import RosCassandra
from cassandra_ros.viewing.answers import Answer, Bytes, Json, SpooledFile, Stream
from cassandra_ros.viewing.call import Call
from cassandra_ros.viewing.file_answer import send_file
from cassandra_ros.viewing.route import Route
from cassandra_ros.viewing.routes import ROUTES
from cassandra_ros.viewing.security import Guard, check_settings
from cassandra_ros.viewing.settings import ViewerSettings
from cassandra_ros.viewing.shared import Shared

MAX_BODY_BYTES = 2**20
"""Of what is posted: statements."""
_log = logging.getLogger(__name__)


def make_application(
    settings: ViewerSettings, store: RosCassandra, routes: Sequence[Route] = ROUTES
) -> web.Application:
    """Return the viewer's application; its cleanup closes all but the store.

    Args:
        settings: Where it listens, which it is told only so that it knows whom to let in.
        store: Connected to the keyspace that is shown; stays the caller's to close.
        routes: The API.

    Raises:
        InvalidOption: The settings let everybody in.
    """
    check_settings(settings)
    guard, viewer = Guard(settings), Viewer(Shared(store, settings))
    application = web.Application(
        middlewares=[_errors_as_json, guard.check], client_max_size=MAX_BODY_BYTES
    )
    application.on_response_prepare.append(guard.protect)
    application.on_cleanup.append(viewer.close)
    for route in routes:
        application.router.add_route(route.method, route.path, viewer.handler(route))
        if route.method == "GET":
            application.router.add_route("HEAD", route.path, viewer.handler(route))
    _add_pages(application.router, settings)
    return application


def _add_pages(router: web.UrlDispatcher, settings: ViewerSettings) -> None:
    """Serve our pages at the root and the packages of others below their names, where present."""

    async def home(request: web.Request) -> web.StreamResponse:
        return web.FileResponse(settings.web / "index.html")

    router.add_get("/", home)
    for prefix, folder in (("/studio", settings.studio), ("/dygraphs", settings.dygraphs)):
        # It may be installed while the viewer runs: what is missing now is no mistake.
        router.add_get(prefix + "/{name:.+}", _folder(folder))
    router.add_get("/{name:.+}", _folder(settings.web))


def _folder(folder: Path) -> Handler:
    """Return the handler that sends the files of a folder, and none beside it."""

    async def send(request: web.Request) -> web.StreamResponse:
        name = request.match_info["name"]
        try:
            root = folder.resolve()
            path = (root / name).resolve()
            inside = root in path.parents and path.is_file()
        except (OSError, ValueError, RuntimeError):  # too long, a NUL, links in a circle
            inside = False
        if not inside:
            raise web.HTTPNotFound(text=f"there is no {request.path} here\n")
        # no-cache: asked again each time, and mostly answered by 304.
        return web.FileResponse(path, headers={"Cache-Control": "no-cache"})

    return send


@web.middleware
async def _errors_as_json(request: web.Request, handler: Handler) -> web.StreamResponse:
    """Answer errors as the API's clients read them; pages keep a text."""
    try:
        return await handler(request)
    except CassandraRosError as exc:
        return _error(status_of(exc), type(exc).__name__, str(exc), exc)
    except web.HTTPError as exc:
        if not request.path.startswith("/api/"):
            raise
        return _error(exc.status, type(exc).__name__, exc.text or exc.reason, exc)


def _error(status: int, name: str, text: str, exc: Exception) -> web.Response:
    body: dict[str, Json] = {"error": name, "text": text.rstrip("\n")}
    if isinstance(exc, InvalidQuery):
        body.update(position=exc.position, reason=exc.reason, statement=exc.statement)
    return web.json_response(body, status=status)


def status_of(error: CassandraRosError) -> int:
    """Return the status that tells an error: whose fault it is, and whether to try again."""
    if isinstance(error, (ConnectionFailed, StoreUnavailable)):
        return 503
    if isinstance(error, KeyError):  # TopicNotFound and its like
        return 404
    return 400 if isinstance(error, ValueError) else 500


class Viewer:
    """Runs handlers on threads and sends what they return.

    Args:
        shared: The store, the settings and what handlers keep; closed with this.
    """

    def __init__(self, shared: Shared) -> None:
        self._shared = shared
        self._threads = ThreadPoolExecutor(shared.settings.threads, "viewer")

    def handler(self, route: Route) -> Handler:
        """Return the coroutine that answers a route."""

        async def answer(request: web.Request) -> web.StreamResponse:
            posted = await request.read() if route.body else b""
            call = Call(
                self._shared, route, _query(request), _headers(request), request.method, posted
            )
            try:
                found = await self._run(route.answer, call)
                return await self._send(request, found)
            finally:
                call.gone.set()

        return answer

    async def _run(self, work: Callable[[Call], Answer], call: Call) -> Answer:
        """Run a handler; where nobody waits any more it is told, and its stream closed."""
        running = asyncio.wrap_future(self._threads.submit(_worked, work, call))
        try:
            return await asyncio.shield(running)
        except asyncio.CancelledError:
            call.gone.set()
            running.add_done_callback(self._discard)
            raise

    def _discard(self, done: asyncio.Future[Answer]) -> None:
        if done.cancelled() or done.exception() is not None:
            return
        answer = done.result()
        if isinstance(answer, Stream):
            self._threads.submit(_close, answer.chunks)

    async def _send(self, request: web.Request, answer: Answer) -> web.StreamResponse:
        if isinstance(answer, Bytes):
            return web.Response(
                body=answer.data, content_type=answer.content_type, headers=answer.headers
            )
        if isinstance(answer, SpooledFile):
            return await send_file(request, answer)
        if isinstance(answer, Stream):
            return await self._send_stream(request, answer)
        raise TypeError(type(answer))  # _worked leaves none else

    async def _send_stream(self, request: web.Request, stream: Stream) -> web.StreamResponse:
        """Send chunk by chunk; the next is asked for when the browser has taken the one before."""
        chunks = stream.chunks
        step: asyncio.Future[bytes | None] | None = None
        response = web.StreamResponse(headers=stream.headers)
        response.content_type = stream.content_type
        try:
            step = asyncio.wrap_future(self._threads.submit(next, chunks, None))
            chunk = await asyncio.shield(step)  # before the headers: its error has a status
            await response.prepare(request)
            while chunk is not None and request.method != "HEAD":
                await response.write(chunk)
                step = asyncio.wrap_future(self._threads.submit(next, chunks, None))
                chunk = await asyncio.shield(step)
            await response.write_eof()
            return response
        except CassandraRosError:
            if response.prepared and request.transport is not None:
                _log.exception("%s: cut short", request.path)
                request.transport.abort()
                return response
            raise
        finally:
            self._close_after(step, chunks)

    def _close_after(
        self, step: asyncio.Future[bytes | None] | None, chunks: Iterator[bytes]
    ) -> None:
        """Close an iterator when nothing runs in it any more: a generator cannot be before."""
        if step is None or step.done():
            self._threads.submit(_close, chunks)
        else:
            step.add_done_callback(lambda done: self._close_after(done, chunks))

    async def close(self, application: web.Application) -> None:
        """Wait for what still runs, and close what was kept."""
        await asyncio.get_running_loop().run_in_executor(None, self._threads.shutdown)
        self._shared.close()


def _close(chunks: Iterator[bytes]) -> None:
    close = getattr(chunks, "close", None)
    if close is not None:
        close()


def _query(request: web.Request) -> Mapping[str, Sequence[str]]:
    return {name: request.query.getall(name) for name in request.query}


def _headers(request: web.Request) -> Mapping[str, str]:
    return {name.lower(): text for name, text in request.headers.items()}


def _worked(work: Callable[[Call], Answer], call: Call) -> Answer:
    """Answer a call, what is JSON as its bytes: large ones take their time here, on a thread."""
    answer = work(call)
    if isinstance(answer, (Bytes, Stream, SpooledFile)):
        return answer
    text = json.dumps(
        answer, ensure_ascii=False, allow_nan=False, separators=(",", ":")
    )
    return Bytes(text.encode("utf-8", "surrogatepass"), "application/json")
