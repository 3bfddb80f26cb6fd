# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Names and literals in CQL: the only text that is ever put into a statement."""

from __future__ import annotations

import hashlib


def quote_name(name: str) -> str:
    """Quote a keyspace, table or column name for CQL."""
    return '"' + name.replace('"', '""') + '"'


def qualified(keyspace: str, table: str) -> str:
    """Return the name of a table or an index with its keyspace, quoted for CQL."""
    return f"{quote_name(keyspace)}.{quote_name(table)}"


def quote_text(text: str) -> str:
    """Return a text literal for CQL; only DDL needs it, all other values are bound."""
    return "'" + text.replace("'", "''") + "'"


def table_name(topic: str, md5sum: str, format_name: str, generation: int) -> str:
    """Return the name of a topic's table: 't_' and 32 hex digits (paper section 3: a hash).

    Args:
        generation: Number that is different each time the topic is made anew, so that no name is
            used twice: a stale prepared INSERT into a re-created table succeeds silently.
    """
    text = "\0".join((topic, md5sum, format_name, str(generation)))
    return "t_" + hashlib.md5(text.encode("utf-8", "surrogateescape")).hexdigest()


def chunk_table_name(table: str) -> str:
    """Return the name of the table that holds the chunks of a topic's large messages.

    Stores have tables of this name: with another rule their chunks would not be found. For '' it is
    what such names end with.
    """
    return table + "_c"
