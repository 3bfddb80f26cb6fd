# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A user of each role of a keyspace, in a Cassandra that asks for a login."""

from __future__ import annotations

import ssl
import struct
import threading

from cassandra_ros import RosCassandra
from cassandra_ros.cli import cassandra_bag
from cassandra_ros.local_server.cql import CqlRefused, CqlSession
from cassandra_ros.store.tables.role_grants import ROLES, role_name

KEYSPACE = "fleet"


def user_of(role):
    """Return the name of the user of a role."""
    return f"{role}_1"


def make_users(cqlshrc, folder):
    """Make roles and users of the keyspace; return the credentials file of each role's user."""
    store = ["--cqlshrc", cqlshrc, "--keyspace", KEYSPACE]
    for _ in range(2):  # repeating it changes nothing
        assert cassandra_bag.main(["roles", "--apply", *store]) == 0
    with RosCassandra(cqlshrc=cqlshrc, keyspace=KEYSPACE) as ours:
        return {role: make_user(ours, role, role, folder) for role in ROLES}


def make_user(store, name, role, folder):
    """Make a user that has a role of the keyspace; return its credentials file."""
    user, password = user_of(name), f"of {name}"
    for cql in (
        f"CREATE ROLE {user} WITH LOGIN = true AND PASSWORD = '{password}'",
        f"GRANT {role_name(KEYSPACE, role)} TO {user}",
    ):
        store.cassandra.execute_text(cql, what="making a user")
    file = folder / name
    file.write_text(f"[PlainTextAuthProvider]\nusername = {user}\npassword = {password}\n")
    file.chmod(0o600)
    return file


class Stranger:
    """Tries the public default password of a server all the while.

    Attributes:
        refusals: Number of times that the server refused it.
        let_in: Whether the server ever accepted it.
    """

    def __init__(self, cluster):
        self.refusals = 0
        self.let_in = False
        self._cluster = cluster
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._try)

    def _try(self):
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname = False
        context.verify_mode = ssl.CERT_NONE
        login = ("cassandra", "cassandra")
        settings = self._cluster.settings
        addresses = [node.address for node in self._cluster.nodes]
        while not self._ends.wait(0.01):
            for address in addresses:
                try:
                    CqlSession(address, settings.port, context, login).close()
                    self.let_in = True
                except CqlRefused:
                    self.refusals += 1
                except (OSError, struct.error):
                    continue  # no server answers there yet

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *exc_info):
        self._ends.set()
        self._thread.join()
