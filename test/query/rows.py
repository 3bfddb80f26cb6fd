# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Messages as rows, without a database, and their fields as plain Python finds them."""

from __future__ import annotations

from collections import namedtuple
from io import BytesIO

from query.brute_force import plain

from cassandra_ros.messages.definition import definition_of

Row = namedtuple("Row", "t node wire table odd columns key topic")
Table = namedtuple(
    "Table", "name definition topic by_field named runs", defaults=[False, False, None]
)


def table_of(definition, topic="/topic"):
    name = "none" if definition is None else definition.md5sum
    return Table(name, definition, topic)


def row_of(msg=None, t=1, node="", wire=None, table=None):
    if wire is None:
        buffer = BytesIO()
        msg.serialize(buffer)
        wire = buffer.getvalue()
    if table is None:
        table = table_of(definition_of(type(msg)))
    return Row(t, node, wire, table, False, (), t, table.topic)


def attribute(msg, path):
    """Follow a dotted path through a message object; lists are mapped over."""
    if isinstance(msg, (list, tuple)):
        return [attribute(element, path) for element in msg]
    if not path:
        return plain(msg)
    name, _, rest = path.partition(".")
    if not hasattr(msg, name):
        name += "_"  # a keyword of Python
    return attribute(getattr(msg, name), rest)
