# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

from nodes.children import await_true

from cassandra_ros.local_server import ports, processes

HERE = "127.0.0.77"
"""An address of this machine at which no other test listens."""


def listener(host=HERE):
    server = socket.socket()
    server.bind((host, 0))
    server.listen()
    return server, server.getsockname()[1]


def test_a_port_with_a_listener_is_not_free():
    server, port = listener()
    with server:
        assert not ports.is_free(HERE, port)
        assert ports.is_free("127.0.0.2", port)
    # Another test may listen there on all addresses for a moment.
    await_true(lambda: ports.is_free(HERE, port))


def test_a_listener_on_all_addresses_counts():
    server, port = listener("0.0.0.0")  # noqa: S104 (a free port, for a moment)
    with server:
        assert not ports.is_free("127.0.0.1", port)


def test_the_owner_of_a_port_is_named():
    server, port = listener("127.0.0.1")  # where others listen: none of them at this port
    with server:
        assert f"(pid {os.getpid()})" in ports.port_owner(port)


def test_a_port_is_known_by_its_address(monkeypatch):
    server, port = listener()
    with server:
        assert f"(pid {os.getpid()})" in ports.port_owner(port, HERE)
        assert ports.port_owner(port, "127.0.0.2") == "an unknown process"
        assert ports.await_the_dead("127.0.0.2", port)
        monkeypatch.setattr(ports, "time", SimpleNamespace(monotonic=time.monotonic))
        assert not ports.await_the_dead(HERE, port)  # it lives: nothing to wait for


def test_the_port_of_one_that_was_killed_is_waited_for(monkeypatch):
    monkeypatch.setattr(ports, "_DYING_SEC", 180.0)
    # What it gives back first takes a while.
    code = (
        "import socket, time\n"
        f"s = socket.create_server(({HERE!r}, 0)); held = b'x' * (1 << 29)\n"
        "print(s.getsockname()[1], flush=True); time.sleep(600)"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as child:
        port = int(child.stdout.readline())
        assert not ports.await_the_dead(HERE, port)
        child.kill()
        while processes.command_line(child.pid):
            time.sleep(0.001)
        assert ports.await_the_dead(HERE, port)


def test_clients_of_a_port_are_counted():
    server, port = listener("127.0.0.1")
    with server:
        assert ports.count_clients(port) == 0
        with socket.create_connection(("127.0.0.1", port)):
            connection, _ = server.accept()
            assert ports.count_clients(port) == 1
            connection.close()
        assert ports.count_clients(port) == 0


def test_a_port_without_owner():
    # Another test may start a server at the port that was free.
    await_true(lambda: ports.port_owner(ports.free_port()) == "an unknown process")


def test_a_free_port_is_none_that_clients_get():
    low = int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])
    for _ in range(20):
        port = ports.free_port()
        await_true(lambda: ports.is_free("127.0.0.1", port))  # noqa: B023 - another test may try it
        assert 1024 < port < max(low, 32_768)
