# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The settings of a local cluster: name, nodes, addresses, ports and heap."""

from __future__ import annotations

import ipaddress
import json
import os
import re
import uuid
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import psutil

from cassandra_ros.errors import ServerError
from cassandra_ros.own_files import open_regular, whole_file

MAX_NODES = 3
MIN_HEAP_MB = 256
"""Minimum Java heap of a node, MiB."""
OWN_HEAP_MB = 512, 4096
"""Default heap sizes, MiB: minimum of one node, and maximum of all nodes together."""
BESIDE_HEAP_MB = 450
"""Memory of a node in addition to its heap, MiB: code, threads, buffers and memtables."""
_MEMORY_LIMIT = Path("/sys/fs/cgroup/memory.max")
SETTINGS_FILE = "cluster.json"
_DRAFT = "cluster.draft"
_MAX_CHARS = 1 << 16
"""Maximum length of the settings that are read, characters."""
LOGIN_DIRECTORY = "login"
"""Name of the folder with keys and passwords of a cluster that requires a login."""


@dataclass(frozen=True)
class ClusterSettings:
    """The settings that are stored in the directory of a cluster."""

    cluster_name: str
    """Name that is unique per directory, so that Cassandra refuses data of another cluster."""
    nodes: int = 1
    host: str = "127.0.0.1"
    """Address of the first node; the other nodes have the next addresses."""
    port: int = 9042
    """CQL port of all nodes."""
    storage_port: int = 0
    """Port for the traffic between the nodes; 0 until the first start chooses one."""
    heap_mb: int = 0
    """Java heap of each node that the user chose, MiB; 0 = see own_heap_mb."""
    secure: bool = False
    """Whether the cluster requires a login and uses TLS."""

    @property
    def java_heap_mb(self) -> int:
        """Java heap of each node, MiB."""
        return self.heap_mb or own_heap_mb(self.nodes)

    def address(self, number: int) -> str:
        """Return the address of a node; the first node has number 1."""
        return str(ipaddress.IPv4Address(self.host) + (number - 1))


def own_heap_mb(nodes: int, memory_bytes: int | None = None) -> int:
    """Return the default heap of a node, MiB.

    The nodes share a quarter of the memory, at most 4 GiB, but each node gets at least 512 MiB.
    Every table needs a quarter of a MiB of it, even without rows.

    Args:
        nodes: Number of nodes.
        memory_bytes: Memory of the machine; None = read it (the limit of a container counts).
    """
    least, most = OWN_HEAP_MB
    memory = _memory_bytes() if memory_bytes is None else memory_bytes
    return max(least, min(most, memory // 4 >> 20) // nodes)


def needed_memory_mb(heap_mb: int) -> int:
    """Return the memory that a node with a full heap takes, MiB: the heap, and Java beside it."""
    return heap_mb + BESIDE_HEAP_MB


def free_memory_mb() -> int:
    """Return the memory that is free on this machine for new processes, MiB."""
    return int(psutil.virtual_memory().available) >> 20


def _memory_bytes() -> int:
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    try:
        return min(memory, int(_MEMORY_LIMIT.read_text(encoding="ascii")))
    except (OSError, ValueError):  # there is no container, or it has no limit
        return memory


def new_settings() -> ClusterSettings:
    """Return the default settings, for a new cluster."""
    return ClusterSettings(cluster_name=f"cassandra_ros_{uuid.uuid4().hex[:8]}")


def load_settings(directory: Path) -> ClusterSettings | None:
    """Return the settings of the cluster in a directory; None = there is no cluster.

    Raises:
        ServerError: The directory holds other files, or the settings cannot be read.
    """
    path = directory / SETTINGS_FILE
    try:
        # List foreign files first, so that files of a start that runs meanwhile do not count.
        foreign = _foreign(directory)
        with open(open_regular(path), encoding="utf-8") as file:
            values = json.loads(file.read(_MAX_CHARS))
        types = {field.name: field.type for field in fields(ClusterSettings)}
        settings = ClusterSettings(**{name: values[name] for name in types if name in values})
        for name, kind in types.items():  # each is annotated by a single type: str, int or bool
            if type(getattr(settings, name)).__name__ != kind:
                raise TypeError(f"{name} is not of type {kind}")
    except FileNotFoundError:
        if foreign:
            raise ServerError(
                f"{directory} holds other files ({', '.join(foreign[:4])}) and no {SETTINGS_FILE}: "
                "it may be the data of another Cassandra; choose an empty directory with --dir"
            ) from None
        return None
    except (OSError, ValueError, TypeError, AttributeError) as exc:
        raise ServerError(
            f"the settings of the local Cassandra in {path} cannot be read ({exc}); "
            "mend the file, or choose another directory with --dir"
        ) from exc
    return check_settings(settings)


def save_settings(directory: Path, settings: ClusterSettings) -> None:
    """Write the settings atomically: a crash leaves either the old or the new ones."""
    with whole_file(directory / SETTINGS_FILE, directory / _DRAFT) as file:
        file.write(f"{json.dumps(asdict(settings), indent=2)}\n".encode())


def change_settings(
    settings: ClusterSettings,
    nodes: int | None = None,
    host: str | None = None,
    port: int | None = None,
    heap: str | None = None,
    secure: bool | None = None,
) -> ClusterSettings:
    """Return the settings with the options that are not None, checked. The heap is a text, as 2G.

    Raises:
        ServerError: No cluster can be started with them.
    """
    changed = replace(
        settings,
        nodes=settings.nodes if nodes is None else nodes,
        host=settings.host if host is None else host,
        port=settings.port if port is None else port,
        heap_mb=settings.heap_mb if heap is None else parse_heap(heap),
        secure=settings.secure if secure is None else secure,
    )
    return check_settings(changed)


def parse_heap(text: str) -> int:
    """Return a heap size such as 512M or 2G in MiB; a bare number is MiB; ServerError: no size."""
    match = re.fullmatch(r"(\d+)\s*([mMgG]?)(?:i?[bB])?", text.strip())
    if not match:
        raise ServerError(f"--heap {text}: write a size such as 512M or 2G")
    return int(match.group(1)) * (1024 if match.group(2) in ("g", "G") else 1)


def check_settings(settings: ClusterSettings) -> ClusterSettings:
    """Return the settings if a cluster can be started with them.

    Raises:
        ServerError: It cannot; the text names the option.
    """
    try:
        first = ipaddress.IPv4Address(settings.host)
        loopback = first.is_loopback and (first + (settings.nodes - 1)).is_loopback
    except ValueError:
        loopback = False
    if not loopback:
        raise ServerError(
            f"--host {settings.host}: the local Cassandra listens on loopback only; give an "
            "address 127.x.y.z, or run a Cassandra of your own for other machines"
        )
    if not 1 <= settings.nodes <= MAX_NODES:
        raise ServerError(f"--nodes {settings.nodes}: 1 to {MAX_NODES} nodes can be started")
    if not 1 <= settings.port <= 65535:
        raise ServerError(f"--port {settings.port}: a port is a number from 1 to 65535")
    if settings.java_heap_mb < MIN_HEAP_MB:
        raise ServerError(f"--heap {settings.heap_mb}M: Cassandra needs {MIN_HEAP_MB}M or more")
    return settings


def _foreign(directory: Path) -> list[str]:
    """Return the names of files in a directory that do not belong to a local cluster."""
    try:
        names = {path.name for path in directory.iterdir()}
    except FileNotFoundError:
        return []
    except NotADirectoryError:
        raise ServerError(f"{directory} is a file; choose a directory with --dir") from None
    # In the default directory jars, the viewer's Studio and a recorder's spool may be before the
    # first start. A start that was killed early leaves its lock and a draft of its settings.
    return sorted(names - {"jars", "studio", "spool", "lock", SETTINGS_FILE, _DRAFT})
