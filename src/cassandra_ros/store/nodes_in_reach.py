# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Which nodes of the cluster can be asked, each for itself."""

from __future__ import annotations

import time
from typing import Any

from cassandra.cluster import NoHostAvailable

PAUSE_SEC = 0.05


def nodesInReach(session: Any, deadline: float) -> list[Any]:
    """Return the nodes of our data centre that the driver can ask.

    Args:
        session: Of the driver. It is connected as soon as one node answers, and goes on with the
            others, which are waited for.
        deadline: How long at most, by time.monotonic().

    Raises:
        NoHostAvailable: There is none; the driver's own, to be translated.
    """
    while True:
        connected = session.get_pool_state()
        centres = {host.datacenter for host in connected}
        coming = any(
            host.is_up is not False and host not in connected and host.datacenter in centres
            for host in session.cluster.metadata.all_hosts()
        )
        if not coming or time.monotonic() > deadline:
            break
        time.sleep(PAUSE_SEC)
    found = [host for host in connected if host.is_up]
    if not found:
        raise NoHostAvailable("no node is in reach", {})
    return found
