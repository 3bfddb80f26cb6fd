# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Who may do what with a keyspace: three roles, as CQL."""

from __future__ import annotations

from cassandra_ros.connection.cql_names import quote_name
from cassandra_ros.tables.side_tables import SideTables

_RIGHTS = {
    "viewer": ("SELECT",),
    "recorder": ("SELECT", "MODIFY", "CREATE", "ALTER"),
    "owner": ("ALL PERMISSIONS",),
}
ROLES = tuple(_RIGHTS)
"""viewer reads; recorder also writes and deletes messages, and makes tables and indexes of topics;
owner also removes them, and gives rights to others."""

_PROGRESS = "system_views"
"""Where the server tells how far an index is built; who makes indexes asks it."""


def role_name(keyspace: str, role: str) -> str:
    """Return the name of a role of a keyspace, as it stands in CQL."""
    return quote_name(f"{keyspace}_{role}")


def role_statements(keyspace: str) -> list[str]:
    """Return the statements that make the three roles of a keyspace, which must exist.

    Repeating them changes nothing.
    """
    found = []
    for role, rights in _RIGHTS.items():
        name = role_name(keyspace, role)
        found.append(f"CREATE ROLE IF NOT EXISTS {name}")
        found += [f"GRANT {right} ON KEYSPACE {quote_name(keyspace)} TO {name}" for right in rights]
        if role != "viewer":
            found.append(f"GRANT SELECT ON KEYSPACE {_PROGRESS} TO {name}")
    return found


def apply_roles(side_tables: SideTables) -> None:
    """Make the keyspace, where it is missing, and its three roles.

    Raises:
        AccessDenied: Who is logged in may not make roles, or not give these rights.
    """
    side_tables.make_keyspace()
    for statement in role_statements(side_tables.keyspace):
        side_tables.change_rights(statement)
