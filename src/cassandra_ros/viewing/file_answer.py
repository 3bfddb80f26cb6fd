# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Send a file from our disk, whole or in parts."""

from __future__ import annotations

from aiohttp import web

from cassandra_ros.viewing.answers import SpooledFile


async def send_file(request: web.Request, file: SpooledFile) -> web.StreamResponse:
    """Send a finished file, or the part of it that Range asks for."""
    response = web.FileResponse(
        file.path, headers={"Content-Disposition": f'attachment; filename="{file.name}"'}
    )
    response.content_type = file.content_type
    return response
