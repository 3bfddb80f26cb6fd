# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Send a file from our disk, whole or in parts, as those who go on with a download need it.

aiohttp's own answer of a file knows no tag but that of its time and size, and takes an If-Range
that names another one for none.
"""

from __future__ import annotations

import asyncio
import os
from pathlib import Path
from typing import IO

from aiohttp import web

from cassandra_ros.errors import StoreUnavailable
from cassandra_ros.viewing.answers import SpooledFile
from cassandra_ros.viewing.ranges import Part, asked_part, names_etag

_CHUNK_BYTES = 1 << 18


async def send_file(request: web.Request, file: SpooledFile) -> web.StreamResponse:
    """Send a finished file, or the part of it that Range asks for.

    Raises:
        StoreUnavailable: It is gone: to be asked for again.
    """
    loop = asyncio.get_running_loop()
    stream, etag, size = await loop.run_in_executor(None, _opened, file.path, file.etag)
    try:
        headers = {name.lower(): text for name, text in request.headers.items()}
        if names_etag(headers.get("if-none-match", ""), etag):
            return web.Response(status=304, headers={"ETag": f'"{etag}"'})
        if "if-match" in headers and not names_etag(headers["if-match"], etag):
            return web.Response(status=412)
        part = asked_part(headers, etag, size)
        response = web.StreamResponse(status=part.status, headers=part.headers())
        response.content_type = file.content_type
        response.headers["ETag"] = f'"{etag}"'
        response.headers["Content-Disposition"] = f'attachment; filename="{file.name}"'
        await response.prepare(request)
        if request.method != "HEAD":
            await _send_part(response, stream, part)
        await response.write_eof()
        return response
    finally:
        await asyncio.shield(loop.run_in_executor(None, stream.close))


def _opened(path: Path, etag: str) -> tuple[IO[bytes], str, int]:
    """Open a file; return it with its tag and size in bytes."""
    try:
        stream = path.open("rb")
    except OSError as exc:
        raise StoreUnavailable(f"{path.name} was removed meanwhile: ask for it again") from exc
    state = os.fstat(stream.fileno())
    return stream, etag or f"{state.st_mtime_ns:x}-{state.st_size:x}", state.st_size


async def _send_part(response: web.StreamResponse, stream: IO[bytes], part: Part) -> None:
    loop, left = asyncio.get_running_loop(), part.count
    await loop.run_in_executor(None, stream.seek, part.start)
    while left:
        chunk = await loop.run_in_executor(None, stream.read, min(left, _CHUNK_BYTES))
        if not chunk:
            raise ConnectionResetError("the file has become shorter")
        left -= len(chunk)
        await response.write(chunk)
