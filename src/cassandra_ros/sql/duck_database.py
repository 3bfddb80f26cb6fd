# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A DuckDB in memory that can only read what it is given.

It reads no file, loads no extension, and no statement changes its settings. What does not fit into
its memory goes to a folder of its own, which is deleted with it.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from typing import Any

from cassandra_ros.errors import MissingDependency
from cassandra_ros.installation import optional_module
from cassandra_ros.messages.stamps import iso_time

MEMORY = "384MB"
"""Memory of DuckDB for one statement; joins and sorts of more go to disk."""
SPILL = "32GB"
"""Maximum size of what goes to disk."""
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


def _clock_macros(ns: int) -> list[str]:
    """Return now() and today() as constants, which bounds that were computed before agree with.

    KEY cannot be compared with a time that has a zone, so they have none.
    """
    now = iso_time(ns).rstrip("Z")
    return [
        f"CREATE MACRO now() AS TIMESTAMP_NS '{now}'",
        f"CREATE MACRO today() AS DATE '{now[:10]}'",
    ]


class DuckDatabase:
    """One DuckDB for one statement. Close it.

    Args:
        memory: Its memory, as DuckDB writes it: '384MB'.
        folder: Folder for what goes to disk; None = the system's folder for temporary files.

    Attributes:
        connection: DuckDB's connection.
        duckdb: The module.

    Raises:
        MissingDependency: DuckDB is not installed; the text says how to install it.
    """

    def __init__(self, memory: str = MEMORY, folder: str | None = None) -> None:
        if sys.version_info < _OLDEST:
            raise MissingDependency(
                "sql needs DuckDB 2, which needs Python 3.11 or later: ask from a machine that "
                "has it, or use executeCQL, toArrow or cassandra_bag lake here"
            )
        self.duckdb: Any = optional_module("duckdb", "sql")
        self._folder = tempfile.mkdtemp(prefix="cassandra_ros_sql_", dir=folder)
        try:
            self.connection: Any = self.duckdb.connect(":memory:", config=self._config(memory))
            for statement in (
                "SET TimeZone = 'UTC'",
                # The number of rows is unknown to DuckDB: it would compare each with each.
                "SET asof_loop_join_threshold = 0",
                *_clock_macros(time.time_ns()),
                _TF,
                "SET enable_external_access = false",
                "SET lock_configuration = true",
            ):
                self.connection.execute(statement)
        except BaseException:
            shutil.rmtree(self._folder, ignore_errors=True)
            raise

    def _config(self, memory: str) -> dict[str, Any]:
        return {
            "memory_limit": memory,
            "temp_directory": self._folder,
            "max_temp_directory_size": SPILL,
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
        kinds = [each.type for each in self.connection.extract_statements(text)]
        return kinds == [types.SELECT] or (pivots and kinds == [types.MULTI])

    def value(self, expression: str, params: Any) -> Any:
        """Return the value of an expression without columns; None = it has none, or an error."""
        try:
            text = f"SELECT {expression}"  # noqa: S608 (made by sqlglot of a checked tree)
            ((found,),) = self.connection.execute(text, params or None).fetchall()
        except self.duckdb.Error:
            return None
        return found

    def close(self) -> None:
        """Delete what is in memory and on disk; no statement may be running. Can be repeated."""
        try:
            self.connection.close()
        finally:
            shutil.rmtree(self._folder, ignore_errors=True)
