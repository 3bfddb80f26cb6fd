# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The settings of a viewer."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from cassandra_ros.viewing.studio import studio_folder

DEFAULT_HOST = "127.0.0.1"
DEFAULT_PORT = 8080
DEFAULT_CACHE_BYTES = 4 * 10**9
"""Default maximum size of all cached files, bytes."""
DEFAULT_THREADS = 16
"""Default number of handler threads."""


@dataclass(frozen=True)
class ClientLimits:
    """Limits for each client of a viewer, and for all clients together."""

    clients: int = 128
    """Maximum number of connections. A further one is answered with 503 and closed."""
    head_sec: float = 10.0
    """Time within which a new connection must have sent the head of its first request, s."""
    idle_sec: float = 60.0
    """Time within which the head of each further request must have come, s."""
    stalled_sec: float = 60.0
    """Time after which a client that does not read its answer is disconnected, s."""
    piece_bytes: int = 256 * 1024
    """Maximum size of a piece of an answer that is handed to a connection at once, bytes."""
    answers_bytes: int = 128 * 1024 * 1024
    """Maximum size of all answers that are being sent, bytes. A further answer is refused with
    503."""


@dataclass(frozen=True)
class ViewerSettings:
    """The address of a viewer, its access rules, its folders and its limits."""

    host: str = DEFAULT_HOST
    """Address on which it listens."""
    port: int = DEFAULT_PORT
    """Port on which it listens; 0 = any free port."""
    token: str = ""
    """Secret that each client must send; '' = none."""
    allow_origin: tuple[str, ...] = ()
    """Other sites whose pages may read the answers, as 'https://app.foxglove.dev'."""
    allow_writes: bool = False
    """Whether clients may add events, with the rights of the viewer's user in the store."""
    cache: Path | None = None
    """Folder for files that are being sent; None = a new one in the temporary folder. The viewer
    deletes its files when it ends."""
    cache_bytes: int = DEFAULT_CACHE_BYTES
    """Maximum size of all files in it, bytes."""
    threads: int = DEFAULT_THREADS
    """Maximum number of requests that are answered at the same time; further ones wait."""
    store_pause_sec: float = 30.0
    """Minimum time until one of several stores that did not answer is asked again, s."""
    limits: ClientLimits = ClientLimits()
    """Limits for clients."""
    web: Path = Path(__file__).absolute().with_name("web")
    """Folder of the viewer's own pages."""
    studio: Path = field(default_factory=studio_folder)
    """Folder of the packages of the Studio, each in a subfolder of its name; may be missing."""
    dygraphs: Path = Path("/usr/share/javascript/dygraphs")
    """Folder of Debian's libjs-dygraphs; may be missing."""
