# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Send a file from our disk, whole or in parts, as clients need it that resume a download.

aiohttp parses the headers of the request. Its ``web.FileResponse`` is not used: it makes the tag of
a file from time and size, while ours stays the same where the file is written anew or streamed; and
it ignores an If-Range that names another tag, so that a client would join parts of two files.
"""

from __future__ import annotations

import asyncio
import os
from pathlib import Path
from typing import IO

from aiohttp import ETag, web

from cassandra_ros.errors import StoreUnavailable
from cassandra_ros.viewing.answers import CachedFile

_CHUNK_BYTES = 1 << 18


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
        chunk = await loop.run_in_executor(None, stream.read, min(remaining, _CHUNK_BYTES))
        if not chunk:
            raise ConnectionResetError("the file has become shorter")
        remaining -= len(chunk)
        await response.write(chunk)
