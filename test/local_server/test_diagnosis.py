# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
from __future__ import annotations

import pytest

from cassandra_ros.local_server.cluster_settings import new_settings
from cassandra_ros.local_server.nodes import Node
from cassandra_ros.local_server.preflight import explain_failure

STARTING = "INFO JVM Arguments: [-XX:+ExitOnOutOfMemoryError, -Xmx512M]\n"
# Two servers that start at once can choose the same port for the traffic between nodes.
TAKEN = "ConfigurationException: /127.0.0.1:17001 is in use by another process.  Change ..."
FULL = "java.lang.OutOfMemoryError: Java heap space"


@pytest.mark.parametrize(("line", "reason"), [(TAKEN, "port was taken"), (FULL, "heap is too")])
def test_the_options_of_java_are_no_reason(tmp_path, line, reason):
    node = Node(1, tmp_path, new_settings())
    node.log.parent.mkdir()
    node.log.write_text(STARTING + line)
    assert reason in explain_failure(node, 0).splitlines()[0]
