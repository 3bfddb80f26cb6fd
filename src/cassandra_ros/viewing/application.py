# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The viewer as an application of aiohttp: routes, pages, errors, and who may ask."""

from __future__ import annotations

from pathlib import Path
from typing import Sequence

from aiohttp import web
from aiohttp.typedefs import Handler

from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.errors import (
    AccessDenied,
    CassandraRosError,
    ConnectionFailed,
    InvalidQuery,
    KeyspaceNotFound,
    StoreUnavailable,
    TransformException,
)
from cassandra_ros.stores.fleet.fleet import Fleet
from cassandra_ros.viewing.answers import Json
from cassandra_ros.viewing.handler_threads import HandlerThreads
from cassandra_ros.viewing.route import Route
from cassandra_ros.viewing.routes import ROUTES
from cassandra_ros.viewing.security import Guard, check_settings
from cassandra_ros.viewing.viewer_context import ViewerContext
from cassandra_ros.viewing.viewer_settings import ViewerSettings

_ASKED_AGAIN = "no-cache"
"""Cache-Control of the pages: browsers check them at each use, mostly with the answer 304."""
_PINNED = "private, max-age=86400"
"""Cache-Control of the Studio's files, whose versions are fixed.

For its 22 MB of script the browser then also keeps the compiled code.
"""


def make_application(
    settings: ViewerSettings, source: RosCassandra | Fleet, routes: Sequence[Route] = ROUTES
) -> web.Application:
    """Return the viewer's application.

    Args:
        settings: Settings of the viewer; its address is used for the access rules only.
        source: The connected store, or several. The caller closes it; the application's cleanup
            closes it only if a handler does not end otherwise.
        routes: Routes of the API.

    Raises:
        InvalidOption: Other machines could read the store without a token.
    """
    check_settings(settings)
    guard, handling = Guard(settings), HandlerThreads(ViewerContext(source, settings))
    application = web.Application(middlewares=[_answer_errors, guard.check])
    application.on_response_prepare.append(guard.protect)
    application.on_shutdown.append(handling.stop)
    application.on_cleanup.append(handling.close)
    for route in routes:
        add = application.router.add_post if route.writes else application.router.add_get
        add(route.path, handling.handler(route))
    _add_pages(application.router, settings)
    return application


def _add_pages(router: web.UrlDispatcher, settings: ViewerSettings) -> None:
    """Serve the viewer's pages at the root, and Studio and dygraphs under their names."""
    router.add_get("/", _files_of(settings.web, "index.html"))
    router.add_get("/studio/{name:.+}", _files_of(settings.studio, kept=_PINNED))
    router.add_get("/dygraphs/{name:.+}", _files_of(settings.dygraphs))
    # Unknown paths of the API are errors of the API, with status 404 or 405.
    router.add_get("/{name:(?!api/).+}", _files_of(settings.web))


def _files_of(folder: Path, only: str = "", kept: str = _ASKED_AGAIN) -> Handler:
    """Return a handler that sends the files of a folder, which may be missing or made later.

    The address of a page is found without its ending, too: /ask leads to /ask.html.
    """

    async def send(request: web.Request) -> web.StreamResponse:
        name = only or request.match_info["name"]
        path = _inside(folder, name)
        if path is None and _inside(folder, f"{name}.html"):
            path_text, mark, query = request.raw_path.partition("?")
            raise web.HTTPFound(f"{path_text}.html{mark}{query}")
        if path is None:
            raise web.HTTPNotFound(text=f"there is no {request.path} here\n")
        return web.FileResponse(path, headers={"Cache-Control": kept})

    return send


def _inside(folder: Path, name: str) -> Path | None:
    """Return the path of a file in a folder; links in it are followed. None = no such file.

    Hidden files are not found, nor files outside the folder: '..' begins with a dot, too.
    """
    parts = name.split("/")
    if any(not name_part or name_part.startswith(".") or "\0" in name_part for name_part in parts):
        return None
    path = folder.joinpath(*parts)
    try:
        return path if path.is_file() else None
    except OSError:  # a name that is too long
        return None


@web.middleware
async def _answer_errors(request: web.Request, handler: Handler) -> web.StreamResponse:
    """Answer errors as JSON for the API, and as text for pages."""
    try:
        return await handler(request)
    except CassandraRosError as exc:
        return _error_answer(status_of(exc), type(exc).__name__, str(exc), exc)
    except web.HTTPError as exc:
        if not request.path.startswith("/api/"):
            raise
        answer = _error_answer(exc.status, type(exc).__name__, _text_of(request, exc), exc)
        if "Allow" in exc.headers:
            answer.headers["Allow"] = exc.headers["Allow"]
        return answer


def _text_of(request: web.Request, error: web.HTTPError) -> str:
    """Return the text of an error for which aiohttp gives only a status."""
    if isinstance(error, web.HTTPMethodNotAllowed):
        return f"{request.path} takes {error.headers['Allow']}, not {request.method}"
    if isinstance(error, web.HTTPNotFound):
        return f"there is no {request.path}; /api/openapi.json lists all paths"
    return error.text or error.reason


def _error_answer(status: int, name: str, text: str, error: Exception) -> web.Response:
    body: dict[str, Json] = {"error": name, "text": text.rstrip("\n")}
    if isinstance(error, InvalidQuery):
        body.update(statement=error.statement, position=error.position, reason=error.reason)
    return web.json_response(body, status=status)


def status_of(error: CassandraRosError) -> int:
    """Return the HTTP status of an error.

    503 = try again, 404 and 400 = change the request, 403 = the viewer's user lacks a right.
    """
    if isinstance(error, (ConnectionFailed, StoreUnavailable)):
        return 503
    if isinstance(error, AccessDenied):
        return 403
    # TopicNotFound and similar errors are KeyErrors.
    if isinstance(error, (KeyError, KeyspaceNotFound, TransformException)):
        return 404
    return 400 if isinstance(error, ValueError) else 500
