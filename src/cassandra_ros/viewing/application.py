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
    CassandraRosError,
    ConnectionFailed,
    InvalidQuery,
    KeyspaceNotFound,
    StoreUnavailable,
    TransformException,
)
from cassandra_ros.viewing.answers import Json
from cassandra_ros.viewing.handling import Handling
from cassandra_ros.viewing.route import Route
from cassandra_ros.viewing.routes import ROUTES
from cassandra_ros.viewing.security import Guard, check_settings
from cassandra_ros.viewing.shared import Shared
from cassandra_ros.viewing.viewer_settings import ViewerSettings

_ASKED_AGAIN = "no-cache"
"""Files are asked for again each time, which 304 answers mostly."""
_PINNED = "private, max-age=86400"
"""Those of the Studio are pinned by their hash. Of 22 MB of script that it need not ask for again a
browser also keeps what its compiler made."""


def make_application(
    settings: ViewerSettings, store: RosCassandra, routes: Sequence[Route] = ROUTES
) -> web.Application:
    """Return the viewer's application.

    Args:
        settings: Where it listens (told only so that it knows whom to let in), what it may take.
        store: Connected to the keyspace that is shown. It stays the caller's to close; the
            application's cleanup closes it only where a handler does not end otherwise.
        routes: The API.

    Raises:
        InvalidOption: The settings would let everybody in.
    """
    check_settings(settings)
    guard, handling = Guard(settings), Handling(Shared(store, settings))
    application = web.Application(middlewares=[_errors_told, guard.check])
    application.on_response_prepare.append(guard.protect)
    application.on_shutdown.append(handling.stop)
    application.on_cleanup.append(handling.close)
    for route in routes:
        application.router.add_get(route.path, handling.handler(route))
    _add_pages(application.router, settings)
    return application


def _add_pages(router: web.UrlDispatcher, settings: ViewerSettings) -> None:
    """Serve our pages at the root, and what others made below its name, where it is installed."""
    router.add_get("/", _files_of(settings.web, "index.html"))
    router.add_get("/studio/{name:.+}", _files_of(settings.studio, kept=_PINNED))
    router.add_get("/dygraphs/{name:.+}", _files_of(settings.dygraphs))
    # Of the API what is not there is not found there, or asked by another method.
    router.add_get("/{name:(?!api/).+}", _files_of(settings.web))


def _files_of(folder: Path, only: str = "", kept: str = _ASKED_AGAIN) -> Handler:
    """Return what sends the files of a folder, and none beside it; it may be missing, or come."""

    async def send(request: web.Request) -> web.StreamResponse:
        path = _inside(folder, only or request.match_info["name"])
        if path is None:
            raise web.HTTPNotFound(text=f"there is no {request.path} here\n")
        return web.FileResponse(path, headers={"Cache-Control": kept})

    return send


def _inside(folder: Path, name: str) -> Path | None:
    """Return a file of a folder, also of one that a link in it names; None: it is not there.

    Nothing is found beside the folder, and nothing hidden: '..' begins with a point, too.
    """
    parts = name.split("/")
    if any(not part or part.startswith(".") or "\0" in part for part in parts):
        return None
    path = folder.joinpath(*parts)
    try:
        return path if path.is_file() else None
    except OSError:  # a name that is too long
        return None


@web.middleware
async def _errors_told(request: web.Request, handler: Handler) -> web.StreamResponse:
    """Answer errors as the clients of the API read them; to who opens a page, as text."""
    try:
        return await handler(request)
    except CassandraRosError as exc:
        return _told(status_of(exc), type(exc).__name__, str(exc), exc)
    except web.HTTPError as exc:
        if not request.path.startswith("/api/"):
            raise
        told = _told(exc.status, type(exc).__name__, _text_of(request, exc), exc)
        if "Allow" in exc.headers:
            told.headers["Allow"] = exc.headers["Allow"]
        return told


def _text_of(request: web.Request, error: web.HTTPError) -> str:
    """Say what is wrong where aiohttp only says the status."""
    if isinstance(error, web.HTTPMethodNotAllowed):
        return f"{request.path} takes {error.headers['Allow']}, not {request.method}"
    if isinstance(error, web.HTTPNotFound):
        return f"there is no {request.path}; /api/openapi.json says what there is"
    return error.text or error.reason


def _told(status: int, name: str, text: str, error: Exception) -> web.Response:
    body: dict[str, Json] = {"error": name, "text": text.rstrip("\n")}
    if isinstance(error, InvalidQuery):
        body.update(statement=error.statement, position=error.position, reason=error.reason)
    return web.json_response(body, status=status)


def status_of(error: CassandraRosError) -> int:
    """Return the status that tells an error: whose fault it is, and whether to try again."""
    if isinstance(error, (ConnectionFailed, StoreUnavailable)):
        return 503
    # TopicNotFound and its like are KeyErrors.
    if isinstance(error, (KeyError, KeyspaceNotFound, TransformException)):
        return 404
    return 400 if isinstance(error, ValueError) else 500
