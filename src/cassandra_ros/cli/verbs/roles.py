# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Print the CQL of three roles for a keyspace: viewer, recorder, owner; or make them.

A viewer reads (SELECT): player, query_server, export. A recorder also writes and deletes messages
and makes tables and indexes of topics (MODIFY, CREATE, ALTER): recorder, import. An owner may do
all with the keyspace, also drop what others made, and give rights. They are called
KEYSPACE_viewer and so on, and nobody logs in as one: each user is granted one.
"""

from __future__ import annotations

import argparse

from cassandra_ros.cli.json_answer import add_json_option, print_json
from cassandra_ros.cli.options import add_store_options, open_store
from cassandra_ros.tables.role_grants import ROLES, apply_roles, role_name, role_statements


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add --apply and the store."""
    parser.add_argument(
        "--apply",
        action="store_true",
        help="make them, and the keyspace where it is missing; who is logged in must be allowed to "
        "make roles (default: only print the statements, which asks no store)",
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
        if options.json:
            print_json({"keyspace": keyspace, "roles": names})
        else:
            print(f"keyspace {keyspace} has the roles {', '.join(names)}")
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
