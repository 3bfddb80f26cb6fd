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
import tempfile
import time
from contextlib import suppress
from typing import Any

from cassandra_ros.client.sql import old_duckdb
from cassandra_ros.client.sql.topic_functions import MACROS
from cassandra_ros.errors import AnswerTooLarge
from cassandra_ros.installation import optional_module
from cassandra_ros.messages.stamps import iso_time
from cassandra_ros.places.earth import RADIUS_M

MEMORY = "384MB"
"""Memory of DuckDB for one statement; joins and sorts of more go to disk."""
SPILL_BYTES = 32 * 10**9
"""Maximum size of what goes to disk, bytes."""
TOO_LARGE = (
    "the statement needs more memory or disk space than it may use: select fewer columns, a "
    "shorter time range, or group its rows"
)
"""What is told where memory or disk space was lacking."""
_PREFIX = "cassandra_ros_sql_"
_NEW_SEC = 60.0
"""Age above which an unlocked folder is deleted, s. A younger one may be about to be locked."""
_SETTINGS = ("SET asof_loop_join_threshold = 0",)
"""The number of rows is unknown to DuckDB: it would compare each with each."""

# Makes tf('target', 'source'); the table of frames_table must be there.
_TF = (
    "CREATE MACRO tf(target, source) AS TABLE "
    "FROM query_table('tf_' || hex(target) || '_' || hex(source))"
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


def frames_table(target: str, source: str) -> str:
    """Return the name of the table that tf('target', 'source') reads."""
    return f"tf_{target.encode().hex()}_{source.encode().hex()}"


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
    """A folder for what goes to disk, deleted by ``close``.

    It is locked until then. A kill leaves it unlocked: the next one without a parent deletes it.

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

    def size(self) -> int:
        """Return the size of the files in it, bytes."""
        total = 0
        for folder, _, names in os.walk(self.path):
            for name in names:
                with suppress(FileNotFoundError):  # it was deleted meanwhile
                    total += os.stat(os.path.join(folder, name)).st_size
        return total

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
        spill: Maximum size of that, bytes; None = SPILL_BYTES.

    Attributes:
        connection: DuckDB's connection.
        duckdb: The module.

    Raises:
        MissingDependency: DuckDB is not installed; the text says how to install it.
        AnswerTooLarge: There is too little memory to begin.
    """

    def __init__(
        self, memory: str = MEMORY, folder: str | None = None, spill: int | None = None
    ) -> None:
        self.duckdb: Any = optional_module("duckdb", "sql")
        self._is_old = self.duckdb.__version__.startswith("1.")
        self._spill_bytes = SPILL_BYTES if spill is None else spill
        self._folder = SpillFolder(folder)
        try:
            self.connection: Any = self.duckdb.connect(":memory:", config=self._config(memory))
            for statement in (
                "SET TimeZone = 'UTC'",
                *(old_duckdb.SETTINGS if self._is_old else _SETTINGS),
                *_clock_macros(time.time_ns()),
                _TF,
                _distance_macro(),
                *MACROS,
                "SET enable_external_access = false",
                "SET lock_configuration = true",
            ):
                self.connection.execute(statement)
        except BaseException as exc:
            self._folder.close()
            if self.is_lack_of_memory(exc):
                raise AnswerTooLarge(TOO_LARGE) from exc
            raise

    def _config(self, memory: str) -> dict[str, Any]:
        return {
            "memory_limit": memory,
            "temp_directory": self._folder.path,
            "max_temp_directory_size": f"{self._spill_bytes}B",
            "autoinstall_known_extensions": "false",
            "autoload_known_extensions": "false",
            "preserve_insertion_order": "false",
            "python_enable_replacements": "false",
        }

    def is_select(self, text: str, pivots: bool = False) -> bool:
        """Return whether a text is one statement that only reads, as DuckDB parses it.

        Args:
            text: The text; a duckdb.Error is raised if it cannot be parsed.
            pivots: It has a PIVOT. Without IN that is two statements: the first collects the names
                of the columns.
        """
        types = self.duckdb.StatementType
        kinds = [statement.type for statement in self.connection.extract_statements(text)]
        pivot = [types.CREATE, types.SELECT] if self._is_old else [types.MULTI]
        return kinds == [types.SELECT] or (pivots and kinds == pivot)

    def add_table(self, name: str, source: Any) -> None:
        """Give DuckDB an object with Arrow's C stream interface as a table, read for each scan."""
        if self._is_old:
            old_duckdb.add_table(self.connection, name, source)
        else:
            self.connection.register(name, source)

    def select(self, text: str, params: Any) -> Any:
        """Have DuckDB check a statement; return it as a relation of DuckDB, not yet run."""
        if self._is_old:
            return old_duckdb.Select(self.connection, text, params)
        return self.connection.sql(text, params=params or None)

    def is_lack_of_memory(self, exc: BaseException) -> bool:
        """Return whether an error of a statement says that memory, or room on disk, was lacking.

        Where addresses are limited, a thread may be what finds no memory for its stack.
        """
        return (
            isinstance(exc, self.duckdb.OutOfMemoryException)
            or "Out of Memory" in str(exc)
            or (isinstance(exc, RuntimeError) and "can't start new thread" in str(exc))
        )

    def check_spill(self) -> None:
        """Check that no more is on disk than may be: DuckDB 1 does not count the rows it sorts.

        Another thread may be running a statement.

        Raises:
            duckdb.OutOfMemoryException: It is more.
        """
        if self._is_old and self._folder.size() > self._spill_bytes:
            raise self.duckdb.OutOfMemoryException(f"more than {self._spill_bytes} bytes on disk")

    def advice(self, reason: str, statement: str) -> str:
        """Return what to do about an error that only DuckDB 1 has; '' = every DuckDB has it."""
        return old_duckdb.advice(reason, statement) if self._is_old else ""

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
