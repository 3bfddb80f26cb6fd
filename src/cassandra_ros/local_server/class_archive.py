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
from cassandra_ros.local_server.nodes import archive_of
from cassandra_ros.local_server.ports import free_port
from cassandra_ros.local_server.processes import locked


def make_class_archive(say: Callable[[str], None]) -> bool:
    """Make the archive for our Java if it is missing; return whether it was missing.

    Raises:
        ServerError: There is no Java 17, or a server that writes the archive cannot be started.
    """
    archive, jars = archive_of(find_java(), jars_directory()), jars_directory()
    try:
        with locked(jars.parent / f".{jars.name}-classes.lock"):
            if archive.exists():
                return False
            say("starting Cassandra once, to archive its classes: later starts take less time")
            _make(archive)
    except OSError as exc:
        raise ServerError(f"the archive of classes cannot be kept in {jars}: {exc}") from exc
    return True


def _make(archive: Path) -> None:
    with tempfile.TemporaryDirectory(prefix=".classes-", dir=archive.parent.parent) as folder:
        draft = Path(folder) / archive.name
        cluster = LocalCluster(Path(folder) / "server", port=free_port(), archive=draft)
        try:
            cluster.start(die_with_us=True)
        finally:
            cluster.stop()
        if not draft.is_file():
            raise ServerError("Java has written no archive of classes")
        for old in archive.parent.glob("*.jsa"):  # of a Java that was updated
            old.unlink()
        os.replace(draft, archive)
