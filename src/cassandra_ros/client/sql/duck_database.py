# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A DuckDB in memory that can only read what it is given.

It reads no file, loads no extension, and no statement changes its settings. What does not fit into
its memory goes to a folder of its own, which is deleted with it.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import sys
import tempfile
import time
from contextlib import suppress
from typing import Any

from cassandra_ros.client.sql.topic_functions import MACROS
from cassandra_ros.errors import MissingDependency
from cassandra_ros.installation import optional_module
from cassandra_ros.messages.stamps import iso_time
from cassandra_ros.places.earth import RADIUS_M

MEMORY = "384MB"
"""Memory of DuckDB for one statement; joins and sorts of more go to disk."""
SPILL = "32GB"
"""Maximum size of what goes to disk."""
_PREFIX = "cassandra_ros_sql_"
_NEW_SEC = 60.0
"""Age of a folder from which it is locked, if its process is running, s."""
_OLDEST = (3, 11)
"""Oldest Python for which there is a DuckDB 2; older releases of DuckDB push conditions into what
they scan, and compare NaN and joined keys wrongly there."""

_TF = (
    "CREATE MACRO tf(target, source) AS TABLE FROM "
    """query_table('"tf ' || replace(target || ' ' || source, '"', '""') || '"')"""
)
CONSTANT = (
    "CREATE MACRO constant(msg_type, named) AS "
    "(SELECT c.value::HUGEINT FROM constants c WHERE c.TYPE = msg_type AND c.NAME = named)"
)
"""Makes constant('pkg/Type', 'NAME'); the table constants must be there."""


def _distance_macro() -> str:
    """Return the macro lat_lon_distance, of four numbers or two messages with these fields.

    It is the haversine formula, written so that NULL and NaN stay what they are.
    """

    def metres(lat_a: str, lon_a: str, lat_b: str, lon_b: str) -> str:
        square = (
            f"(pow(sin(radians({lat_b} - {lat_a}) / 2), 2) + cos(radians({lat_a}))"
            f" * cos(radians({lat_b})) * pow(sin(radians({lon_b} - {lon_a}) / 2), 2))"
        )
        return f"{2 * RADIUS_M} * atan2(sqrt({square}), sqrt(abs(1 - {square})))"

    names = ("lat_a", "lon_a", "lat_b", "lon_b")
    fields = [f"struct_extract({m}, '{name}')" for m in "ab" for name in ("latitude", "longitude")]
    return (
        f"CREATE MACRO lat_lon_distance({', '.join(names)}) AS {metres(*names)}, "
        f"(a, b) AS {metres(*fields)}"
    )


def _clock_macros(ns: int) -> list[str]:
    """Return now() and today() as constants, which bounds that were computed before agree with.

    KEY cannot be compared with a time that has a zone, so they have none.
    """
    now = iso_time(ns).rstrip("Z")
    return [
        f"CREATE MACRO now() AS TIMESTAMP_NS '{now}'",
        f"CREATE MACRO today() AS DATE '{now[:10]}'",
    ]


class SpillFolder:
    """A folder for what goes to disk, deleted by ``close``, or by the next one if a kill ended it.

    Args:
        parent: Folder in which it lies; None = the system's folder for temporary files.

    Attributes:
        path: Its path.
    """

    def __init__(self, parent: str | None = None) -> None:
        if parent is None:
            _remove_abandoned(tempfile.gettempdir())
        self.path = tempfile.mkdtemp(prefix=_PREFIX, dir=parent)
        self._lock = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY)
        fcntl.flock(self._lock, fcntl.LOCK_EX)

    def close(self) -> None:
        """Delete it. Can be repeated."""
        lock, self._lock = self._lock, -1
        if lock >= 0:
            shutil.rmtree(self.path, ignore_errors=True)
            os.close(lock)


def _remove_abandoned(parent: str) -> None:
    """Delete the folders of this user whose processes have ended without deleting them."""
    for entry in os.scandir(parent):
        if not entry.name.startswith(_PREFIX):
            continue
        with suppress(OSError):  # it belongs to another user, its program runs, or it is gone
            lock = os.open(entry.path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                status = os.fstat(lock)
                if status.st_uid == os.getuid() and time.time() > status.st_mtime + _NEW_SEC:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    shutil.rmtree(entry.path, ignore_errors=True)
            finally:
                os.close(lock)


class DuckDatabase:
    """One DuckDB for one statement. Close it.

    Args:
        memory: Its memory, as DuckDB writes it: '384MB'.
        folder: Folder for what goes to disk; None = the system's folder for temporary files.
        spill: Maximum size of that, as DuckDB writes it; None = SPILL.

    Attributes:
        connection: DuckDB's connection.
        duckdb: The module.

    Raises:
        MissingDependency: DuckDB is not installed; the text says how to install it.
    """

    def __init__(
        self, memory: str = MEMORY, folder: str | None = None, spill: str | None = None
    ) -> None:
        if sys.version_info < _OLDEST:
            raise MissingDependency(
                "sql needs DuckDB 2, which needs Python 3.11 or later: ask from a machine that "
                "has it, or use executeCQL, toArrow or 'cassandra_bag export --parquet' here"
            )
        self.duckdb: Any = optional_module("duckdb", "sql")
        self._folder = SpillFolder(folder)
        try:
            self.connection: Any = self.duckdb.connect(
                ":memory:", config=self._config(memory, spill or SPILL)
            )
            for statement in (
                "SET TimeZone = 'UTC'",
                # The number of rows is unknown to DuckDB: it would compare each with each.
                "SET asof_loop_join_threshold = 0",
                *_clock_macros(time.time_ns()),
                _TF,
                _distance_macro(),
                *MACROS,
                "SET enable_external_access = false",
                "SET lock_configuration = true",
            ):
                self.connection.execute(statement)
        except BaseException:
            self._folder.close()
            raise

    def _config(self, memory: str, spill: str) -> dict[str, Any]:
        return {
            "memory_limit": memory,
            "temp_directory": self._folder.path,
            "max_temp_directory_size": spill,
            "autoinstall_known_extensions": "false",
            "autoload_known_extensions": "false",
            "preserve_insertion_order": "false",
            "python_enable_replacements": "false",
        }

    def is_select(self, text: str, pivots: bool = False) -> bool:
        """Return whether a text is one statement that only reads, as DuckDB parses it.

        Args:
            pivots: It has a PIVOT. Without IN that is two statements: the first collects the names
                of the columns.
        """
        types = self.duckdb.StatementType
        kinds = [statement.type for statement in self.connection.extract_statements(text)]
        return kinds == [types.SELECT] or (pivots and kinds == [types.MULTI])

    def value(self, expression: str, params: Any) -> Any:
        """Return the value of an expression without columns; None = it has none, or an error."""
        try:
            text = f"SELECT {expression}"  # noqa: S608 (made by sqlglot of a checked tree)
            ((value,),) = self.connection.execute(text, params or None).fetchall()
        except self.duckdb.Error:
            return None
        return value

    def close(self) -> None:
        """Delete what is in memory and on disk; no statement may be running. Can be repeated."""
        try:
            self.connection.close()
        finally:
            self._folder.close()
