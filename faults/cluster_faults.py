# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Faults of a cluster of three nodes with three copies of each row, while a recorder writes."""

from __future__ import annotations

import shutil
import time

from faults.proxy import Proxy
from faults.trial import Place, Trial


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
    """The network to one of three nodes is silent for 30 s (short form: 10 s)."""
    trial.server = trial.world.cluster
    proxies, port = [], 0
    for host in trial.server.hosts:
        proxy = Proxy((host, trial.server.port), (host, port))
        proxies.append(trial.open.enter_context(proxy))
        port = proxy.port
    place = Place(",".join(trial.server.hosts), port)
    _, publisher = trial.record(place=place)
    publisher.await_share(0.3)
    proxies[0].silence(new=True)
    time.sleep(trial.seconds(10, 30))
    proxies[0].end_silence()
    trial.await_normal()


def one_node_frozen(trial: Trial) -> None:
    """One of three nodes is frozen for 30 s (short form: 10 s): nothing reaches it."""
    trial.server = trial.world.cluster
    _, publisher = trial.record()
    publisher.await_share(0.3)
    with trial.server.frozen(1):
        time.sleep(trial.seconds(10, 30))
    trial.await_normal()


FAULTS = ()
