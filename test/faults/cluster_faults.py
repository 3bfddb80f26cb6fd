# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Faults of a cluster of three nodes with three copies of each row, while a recorder writes."""

from __future__ import annotations

import shutil
import time
from typing import Callable

from faults import network
from faults.trial import Skipped, Trial
from faults.world import Server

NETWORK = "127.77.0.0/24"
"""Addresses of the nodes."""


def one_node_killed(trial: Trial) -> None:
    """One of three nodes is killed with SIGKILL, and started again later."""
    trial.server = trial.world.cluster
    _, publisher = trial.record()
    publisher.await_share(0.3)
    trial.server.kill(2)
    trial.await_normal()
    publisher.await_share(0.5)
    trial.server.start()


def two_nodes_killed(trial: Trial) -> None:
    """Two of three nodes are killed with SIGKILL, and started again."""
    trial.server = trial.world.cluster
    _, publisher = trial.record()
    publisher.await_share(0.3)
    trial.server.kill(2)
    trial.server.kill(3)
    publisher.await_share(0.2)
    trial.server.start()
    trial.await_normal()


def node_replaced(trial: Trial) -> None:
    """One of three nodes is killed and loses its data, and an empty one takes its place."""
    trial.server = trial.world.cluster
    _, publisher = trial.record()
    publisher.await_share(0.3)
    trial.server.kill(3)
    node = trial.server.cluster.nodes[2]
    shutil.rmtree(node.directory / "data")
    shutil.rmtree(node.directory / "commitlog", ignore_errors=True)
    trial.server.cluster.replace(3, die_with_us=True)
    trial.await_normal()


def one_node_unreachable(trial: Trial) -> None:
    """The network between clients and one of three nodes is cut for 30 s (short form: 10 s)."""
    _cut(trial, lambda server: (server.hosts[0], server.port))


def nodes_separated(trial: Trial) -> None:
    """The network between the three nodes is cut for 30 s (short form: 10 s), not to clients."""
    _cut(trial, lambda server: (NETWORK, server.cluster.settings.storage_port))


def _cut(trial: Trial, where: Callable[[Server], tuple[str, int]]) -> None:
    if not network.own:
        raise Skipped("only make faults, run by root, has a network of its own")
    trial.server = trial.world.cluster
    _, publisher = trial.record()
    publisher.await_share(0.3)
    with network.cut(*where(trial.server)):
        time.sleep(trial.seconds(10, 30))
    trial.await_normal()


def one_node_frozen(trial: Trial) -> None:
    """One of three nodes is frozen for 30 s (short form: 10 s): nothing reaches it."""
    trial.server = trial.world.cluster
    _, publisher = trial.record()
    publisher.await_share(0.3)
    with trial.server.frozen(1):
        time.sleep(trial.seconds(10, 30))
    trial.await_normal()


FAULTS = (
    one_node_killed,
    two_nodes_killed,
    node_replaced,
    one_node_unreachable,
    nodes_separated,
    one_node_frozen,
)
