# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a viewer is started with."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from cassandra_ros.installation import shipped_file
from cassandra_ros.viewing.studio import studio_folder

DEFAULT_HOST = "127.0.0.1"
DEFAULT_PORT = 8080
DEFAULT_SPOOL_BYTES = 4 * 10**9
DEFAULT_THREADS = 16


def _web_folder() -> Path:
    return shipped_file("web/index.html").parent


@dataclass(frozen=True)
class Limits:
    """What all clients of a viewer together, and each of them, may take."""

    clients: int = 128
    """Maximum number of connections. A further one is answered with 503 and closed."""
    head_sec: float = 10.0
    """Time within which a new connection must have sent the head of its first request, s."""
    idle_sec: float = 60.0
    """Time within which the head of each further request must have come, s."""
    stalled_sec: float = 60.0
    """Time after which a client that takes nothing of its answer is disconnected, s."""
    piece_bytes: int = 256 * 1024
    """Maximum number of bytes of an answer that are handed to a connection at once."""
    answers_bytes: int = 128 * 1024 * 1024
    """Maximum number of bytes of all answers that are being sent together. A further answer is
    refused with 503."""


@dataclass(frozen=True)
class ViewerSettings:
    """Where a viewer listens, whom it lets in, and what it may take of the disk."""

    host: str = DEFAULT_HOST
    """The address that it listens on."""
    port: int = DEFAULT_PORT
    """0 = one that is free."""
    token: str = ""
    """What who asks must know; '' = nobody is asked."""
    allow_origin: tuple[str, ...] = ()
    """Other sites whose pages may read the answers, as 'https://app.foxglove.dev'."""
    spool: Path | None = None
    """A folder for files that are being sent; None = a new one below the temporary folder. What
    the viewer has put there is gone when it has ended."""
    spool_bytes: int = DEFAULT_SPOOL_BYTES
    """What the files in it take together, at most."""
    threads: int = DEFAULT_THREADS
    """Questions that are answered at the same time; others wait."""
    limits: Limits = Limits()
    """What clients may take."""
    web: Path = field(default_factory=_web_folder)
    """Our own pages."""
    studio: Path = field(default_factory=studio_folder)
    """The packages of the Studio, each in a folder of its name; may be missing."""
    dygraphs: Path = Path("/usr/share/javascript/dygraphs")
    """Debian's libjs-dygraphs; may be missing."""
