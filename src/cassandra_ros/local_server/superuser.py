# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The password of Cassandra's superuser, set before the first start of a node.

Cassandra makes its superuser with a public default password where its table of roles is empty. So
the table is filled before: no port is ever open on which the default password is valid.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Sequence

from cassandra_ros.errors import ServerError
from cassandra_ros.local_server.jars import server_file
from cassandra_ros.local_server.java_programs import module_options, run_to_end

_TABLE = Path("data/system_auth/roles-5bc52802de2535edaeab188eecebb090")
"""Folder of the table of roles in a node's directory. Its id is the same in every Cassandra."""
_MARK = "superuser"
"""Name of an empty file in a node's directory: the node has the password."""
_GENERATION = 1_000_000
"""Number of the written file of the table, above those of a node that ran without a login."""
_TIMEOUT_SEC = 120.0
_FAILURE = "the password of Cassandra's superuser could not be set"


def set_superuser(
    directories: Sequence[Path], password: str, java: str, jars: Path, scratch: Path
) -> None:
    """Give Cassandra's superuser a password on those stopped nodes that do not have it yet.

    A password that was changed by CQL stays.

    Args:
        directories: Directories of the nodes.
        password: The password.
        java: Path of Java.
        jars: Directory of Cassandra's jars.
        scratch: Directory for temporary files, on the same disk, readable by its owner only.

    Raises:
        ServerError: The table of roles cannot be written.
    """
    nodes = [
        node
        for node in directories
        if not ((node / _MARK).exists() and (node / _TABLE).is_dir())  # its data may be gone
    ]
    if not nodes:
        return
    try:
        with tempfile.TemporaryDirectory(prefix="superuser_", dir=scratch) as name:
            drafts = [Path(name) / str(number) for number in range(len(nodes))]
            for draft in drafts:
                draft.mkdir()
            _write(drafts, password, java, jars, Path(name))
            for node, draft in zip(nodes, drafts):
                _move(draft, node)
    except OSError as exc:
        raise ServerError(f"{_FAILURE}: {exc}") from exc


def _move(draft: Path, node: Path) -> None:
    node.mkdir(mode=0o700, exist_ok=True)
    (node / _TABLE).mkdir(parents=True, exist_ok=True)
    # Cassandra finds a file of a table by its part Data.db, which is therefore moved last.
    for file in sorted(draft.iterdir(), key=lambda path: path.name.endswith("Data.db")):
        version, _, rest = file.name.split("-", 2)
        os.replace(file, node / _TABLE / f"{version}-{_GENERATION}-{rest}")
    (node / _MARK).touch()


def _write(drafts: list[Path], password: str, java: str, jars: Path, folder: Path) -> None:
    """Compile Superuser.java with the compiler that Cassandra brings, and run it."""
    # The optimizing compiler would take longer than these programs.
    common = [java, "-XX:TieredStopAtLevel=1", "-Xshare:auto", "-Xmx256M"]
    common += ["-cp", f"{folder}{os.pathsep}{jars / '*'}"]
    compiler = "org.eclipse.jdt.internal.compiler.batch.Main"
    # Only the jars that the program names: another one has a package java.lang.
    needed = [jar for name in ("cassandra-all", "jbcrypt") for jar in jars.glob(f"{name}-*.jar")]
    compiling = [*common, compiler, "-17", "-proc:none", "-nowarn"]
    compiling += ["-cp", os.pathsep.join(map(str, needed)), "-d", str(folder)]
    compiling.append(str(server_file("Superuser.java")))
    run_to_end(compiling, {}, _TIMEOUT_SEC, _FAILURE)
    places = [f"-D{name}={folder}" for name in ("cassandra.storagedir", "cassandra.logdir")]
    logging = f"-Dlogback.configurationFile={server_file('logback.xml').as_uri()}"
    options = [*module_options(), *places, logging, f"-Djava.io.tmpdir={folder}"]
    words = [*common, *options, "Superuser", *map(str, drafts)]
    run_to_end(words, {"SUPERUSER_PASSWORD": password}, _TIMEOUT_SEC, _FAILURE)
