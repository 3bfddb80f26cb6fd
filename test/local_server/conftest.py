# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A server that asks for a login, one for each module that wants it, and users of it."""

from __future__ import annotations

import pytest
from local_server.users import KEYSPACE, Stranger, make_users
from nodes.children import await_true

from cassandra_ros import RosCassandra
from cassandra_ros.local_server import LocalCluster, free_port


@pytest.fixture(scope="module")
def started(tmp_path_factory):
    """The server, and a stranger who knocked while it started."""
    folder = tmp_path_factory.mktemp("secure")
    cluster = LocalCluster(folder, port=free_port(), heap="512M", secure=True)
    try:
        with Stranger(cluster) as stranger:
            cluster.start(die_with_us=True)
            await_true(lambda: stranger.refusals > 20)
        yield cluster, stranger
    finally:
        cluster.stop()


@pytest.fixture(scope="module")
def cluster(started):
    return started[0]


@pytest.fixture(scope="module")
def cqlshrc(cluster):
    return str(cluster.security.cqlshrc)


@pytest.fixture(scope="module")
def users(cqlshrc, tmp_path_factory):
    """Credentials files of a viewer, a recorder and an owner of the keyspace."""
    return make_users(cqlshrc, tmp_path_factory.mktemp("users"))


@pytest.fixture(scope="module")
def enter(cqlshrc, users):
    """Makes a RosCassandra of one of the users."""
    return lambda role: RosCassandra(
        cqlshrc=cqlshrc, credentials=str(users[role]), keyspace=KEYSPACE
    )
