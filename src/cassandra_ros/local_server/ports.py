# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""TCP ports of this machine: which are free, which process uses one, how many clients it has."""

from __future__ import annotations

import random
import socket
import time
from typing import Any

import psutil

from cassandra_ros.errors import ServerError
from cassandra_ros.local_server.processes import command_line, describe_process

SERVER_PORTS = range(18_000, 32_768)
"""Ports that are chosen for servers: below those for outgoing connections."""
_DYING_SEC = 10.0
"""Maximum time to wait for the port of a process that is ending, s."""


def is_free(host: str, port: int) -> bool:
    """Return whether a server could listen on the port now."""
    with socket.socket() as probe:
        # As Java does: ignore closing connections of a server that was just stopped.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
            probe.listen(1)
        except OSError:
            return False
    return True


def free_port(*hosts: str) -> int:
    """Return a port that is free on all hosts and never used for outgoing connections.

    It is random, so that two servers that start at the same time choose different ones.

    Args:
        hosts: Addresses of this machine; none = 127.0.0.1.

    Raises:
        ServerError: All ports are in use.
    """
    hosts = hosts or ("127.0.0.1",)
    # The ports for outgoing connections are above this range. A client could take one of those
    # while a server that listened on it is restarted.
    for port in random.sample(SERVER_PORTS, len(SERVER_PORTS)):
        if all(is_free(host, port) for host in hosts):
            return port
    raise ServerError(f"no port of {', '.join(hosts)} from 18000 to 32767 is free")


def await_the_dead(host: str, port: int) -> bool:
    """Wait until processes that are ending have released a port; return whether it is free now.

    A killed process first frees its memory; on a busy machine its port is free seconds later. A
    process that is not ending is not waited for.
    """
    deadline = time.monotonic() + _DYING_SEC
    while not is_free(host, port):
        pids = [listener.pid for listener in _sockets(port, psutil.CONN_LISTEN, host)]
        if time.monotonic() > deadline or any(pid and command_line(pid) for pid in pids):
            return False
        time.sleep(0.05)
    return True


def port_owner(port: int, host: str = "") -> str:
    """Describe the process that listens on a TCP port of this machine; host '' = any address."""
    for listener in _sockets(port, psutil.CONN_LISTEN, host):
        return describe_process(listener.pid) if listener.pid else "a process of another user"
    return "an unknown process"


def count_clients(port: int) -> int:
    """Return the number of open connections to a port of this machine."""
    return len(_sockets(port, psutil.CONN_ESTABLISHED))


def _sockets(port: int, state: str, host: str = "") -> list[Any]:
    """Return the sockets of a local port that are in a state; host '' = all addresses."""
    addresses = (socket.gethostbyname(host), "0.0.0.0", "::")  # noqa: S104 - compared, not bound
    return [
        connection
        for connection in psutil.net_connections("tcp")
        if connection.status == state
        and connection.laddr.port == port
        and (not host or connection.laddr.ip.replace("::ffff:", "") in addresses)
    ]
