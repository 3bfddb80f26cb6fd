# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Print the CQL that makes three roles for a keyspace: viewer, recorder, owner; or make them.

A viewer may read (SELECT), for player, query_server and export. A recorder may also write and
delete messages and make tables and indexes (MODIFY, CREATE, ALTER), for recorder and import. An
owner may do everything with the keyspace: also drop tables of others, and grant rights. The roles
are called KEYSPACE_viewer and so on. They cannot log in; grant one of them to each user.
"""

from __future__ import annotations

import argparse

from cassandra_ros.cli.json_answer import add_json_option, print_json, tell
from cassandra_ros.cli.options import add_store_options, open_store
from cassandra_ros.store.tables.role_grants import ROLES, apply_roles, role_name, role_statements


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add --apply and the store."""
    parser.add_argument(
        "--apply",
        action="store_true",
        help="make the roles, and the keyspace if it is missing; your login must be allowed to "
        "make roles (default: only print the statements, without a store)",
    )
    add_json_option(parser)
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Print the statements, or run them."""
    keyspace = options.keyspace
    if options.apply:
        with open_store(options, make=True) as ros_cas:
            apply_roles(ros_cas.catalog.keyspace.side_tables)
        names = [role_name(keyspace, role) for role in ROLES]
        text = f"keyspace {keyspace} has the roles {', '.join(names)}"
        tell(options, {"keyspace": keyspace, "roles": names}, text)
        return 0
    if options.json:
        print_json({"keyspace": keyspace, "statements": role_statements(keyspace)})
        return 0
    for statement in role_statements(keyspace):
        print(f"{statement};")
    print("-- A user of one of them; in cqlsh, where no other program sees the password:")
    print("-- CREATE ROLE ann WITH LOGIN = true AND PASSWORD = 'choose one';")
    print(f"-- GRANT {role_name(keyspace, 'viewer')} TO ann;")
    return 0
