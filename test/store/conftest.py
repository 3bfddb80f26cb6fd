# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A store behind a proxy, which lets requests fail."""

from __future__ import annotations

import pytest
from proxy import Proxy

from cassandra_ros import RosCassandra


@pytest.fixture
def proxy(cassandra):
    with Proxy(cassandra.host, cassandra.port) as running:
        yield running


@pytest.fixture
def far(proxy, keyspace):
    """A RosCassandra behind the proxy, on the keyspace of the test."""
    with RosCassandra(proxy.host, proxy.port, keyspace=keyspace) as store:
        yield store
