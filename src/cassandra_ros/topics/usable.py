# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Which definition the messages of a connection are kept by, if any can be trusted."""

from __future__ import annotations

from contextlib import suppress
from typing import Optional

from cassandra_ros.errors import CorruptMessage, DefinitionError
from cassandra_ros.formats.table import formatClass
from cassandra_ros.messages.classes import installedDefinition
from cassandra_ros.messages.connection import Connection
from cassandra_ros.messages.definition import Definition, parseDefinition

FALLBACK_FORMAT = "binary"
"""Format of topics whose definition cannot be trusted: it needs none."""


def usableDefinition(
    connection: Connection, format_name: str
) -> tuple[Optional[Definition], Optional[str]]:
    """Return the definition of a connection that a format can work with, or why there is none."""
    try:
        definition = _definition(connection)
        fmt = formatClass(format_name)(connection.type, connection.md5sum, definition)
        if format_name != FALLBACK_FORMAT:
            fmt.requireClass()
        return definition, None
    except (DefinitionError, CorruptMessage) as exc:
        return None, (
            f"topic {connection.topic} is kept as binary, its fields cannot be queried: {exc}"
        )


def _definition(connection: Connection) -> Definition:
    text, md5sum = connection.definition_text, connection.md5sum
    if not text.strip():
        # Some publishers leave the definition out; an installed type of the md5 is as good.
        with suppress(DefinitionError):
            installed = installedDefinition(connection.type)
            if installed.md5sum == md5sum:
                return installed
    return parseDefinition(connection.type, text, md5sum)
