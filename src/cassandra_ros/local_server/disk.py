# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Find out why a local Cassandra refuses writes: a full disk, which it does not report itself."""

from __future__ import annotations

import ipaddress
import shutil
import socket
from pathlib import Path

import psutil

from cassandra_ros.errors import ServerError
from cassandra_ros.local_server.cluster_settings import load_settings
from cassandra_ros.local_server.jars import default_directory
from cassandra_ros.local_server.nodes import Node, nodes_of
from cassandra_ros.local_server.preflight import log_since, log_size
from cassandra_ros.local_server.processes import command_line, find_server, is_server, read_start

LOW_BYTES = 64 << 20
"""Free space below which a disk counts as full, bytes. A commit log segment has 32 MiB."""
_STORAGE = "-Dcassandra.storagedir="
_STARTED = "Starting listening for CQL clients"
_FULL = ("No space left on device", "Insufficient disk space", "NoDiskAvailable")
_TAIL_BYTES = 64 << 10


def local_directory(host: str, port: int) -> Path | None:
    """Return the directory of the local Cassandra at an address.

    The default directory and those of running servers are considered. Return None if the server
    was not started by this package, or is on another machine.
    """
    try:
        address = socket.gethostbyname(host)
    except OSError:
        return None
    if not ipaddress.IPv4Address(address).is_loopback:
        return None
    if _is_at(default_directory(), address, port):
        return default_directory()
    return next(
        (directory for directory in _running_directories() if _is_at(directory, address, port)),
        None,
    )


def local_nodes(directory: Path) -> int:
    """Return the number of nodes of the local Cassandra of a directory; 0 = none of them runs."""
    nodes = _nodes(directory)
    return len(nodes) if any(find_server(node.config, node.pid_file) for node in nodes) else 0


def disk_trouble(directory: Path) -> str:
    """Return why the local Cassandra of a directory may refuse writes; '' = no known reason.

    The disk is full, or a node does not run.
    """
    full = full_disk(directory)
    if full:
        return full
    for node in _nodes(directory):
        if not find_server(node.config, node.pid_file):
            return (
                f"Cassandra node {node.number} of {directory} does not run; its log is {node.log}"
            )
    return ""


def full_disk(directory: Path) -> str:
    """Return a text if the disk is full, or was full since the server was started; else ''.

    A server whose disk was full refuses writes until it is started again.
    """
    nodes = _nodes(directory)
    if not nodes:
        return ""
    try:
        free = shutil.disk_usage(directory).free
    except OSError as exc:
        return f"{directory} cannot be read: {exc}"
    if free < LOW_BYTES:
        return f"the disk of {directory} is full: {free >> 20} MiB are free; make room there"
    for node in nodes:
        tail = log_since(node, max(0, log_size(node) - _TAIL_BYTES)).rpartition(_STARTED)[2]
        if any(sign in tail for sign in _FULL):
            return (
                f"the disk of {directory} was full ({node.log} tells of it) and has room again: "
                "stop and start the server with local_cassandra"
            )
    return ""


def _nodes(directory: Path) -> list[Node]:
    """Return the nodes of a local Cassandra; [] = none is there, or its settings cannot be read."""
    try:
        settings = load_settings(directory)
    except ServerError:
        return []
    return [] if settings is None else nodes_of(directory, settings)


def _is_at(directory: Path, address: str, port: int) -> bool:
    """Return whether the local Cassandra of a directory has a node at an address."""
    return any((node.address, node.settings.port) == (address, port) for node in _nodes(directory))


def _running_directories() -> list[Path]:
    """Return the directories of the local Cassandras whose servers run on this machine."""
    words = ((pid, word) for pid in psutil.pids() for word in command_line(pid))
    nodes = [(pid, Path(w[len(_STORAGE) :])) for pid, w in words if w.startswith(_STORAGE)]
    return [node.parent for pid, node in nodes if _is_here(pid, node)]


def _is_here(pid: int, node: Path) -> bool:
    """Return whether a server's folder is the one that we see by its path: not in a container."""
    return is_server(pid, node / "cassandra.yaml", read_start(node / "pid"))
