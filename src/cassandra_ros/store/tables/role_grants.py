# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Three roles with their rights on a keyspace, as CQL."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cassandra_ros.store.connection.cql_names import quote_name

if TYPE_CHECKING:
    from cassandra_ros.store.tables.side_tables import SideTables

_RIGHTS = {
    "viewer": ("SELECT",),
    "recorder": ("SELECT", "MODIFY", "CREATE", "ALTER"),
    "owner": ("ALL PERMISSIONS",),
}
ROLES = tuple(_RIGHTS)
"""Names of the roles. A viewer reads. A recorder also writes and deletes messages, and makes tables
and indexes of topics. An owner also removes topics and grants rights to others."""

_PROGRESS = "system_views"
"""Keyspace with the progress of index builds, which a client that makes an index reads."""


def role_name(keyspace: str, role: str) -> str:
    """Return the quoted name of a role of a keyspace."""
    return quote_name(f"{keyspace}_{role}")


def role_statements(keyspace: str) -> list[str]:
    """Return the statements that make the three roles of an existing keyspace.

    Running them again changes nothing.
    """
    statements = []
    for role, rights in _RIGHTS.items():
        name = role_name(keyspace, role)
        statements.append(f"CREATE ROLE IF NOT EXISTS {name}")
        statements += [
            f"GRANT {right} ON KEYSPACE {quote_name(keyspace)} TO {name}" for right in rights
        ]
        if role != "viewer":
            statements.append(f"GRANT SELECT ON KEYSPACE {_PROGRESS} TO {name}")
    return statements


def apply_roles(side_tables: SideTables) -> None:
    """Make the keyspace if it is missing, and its three roles.

    Raises:
        AccessDenied: The logged-in user may not make roles or grant these rights.
    """
    side_tables.make_keyspace()
    for statement in role_statements(side_tables.keyspace):
        side_tables.change_rights(statement)
