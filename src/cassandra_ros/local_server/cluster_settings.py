# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a local cluster is: its name, nodes, addresses, ports and heap."""

from __future__ import annotations

import ipaddress
import json
import os
import re
import uuid
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

from cassandra_ros.errors import ServerError

MAX_NODES = 3
MIN_HEAP_MB = 256
OWN_HEAP_MB = 512, 4096
"""The least that a node takes unasked, and the most that all take together, MiB."""
_MEMORY_LIMIT = Path("/sys/fs/cgroup/memory.max")
SETTINGS_FILE = "cluster.json"
_DRAFT = "cluster.draft"
LOGIN_DIRECTORY = "login"
"""Where keys and passwords of a cluster that asks for them lie."""


@dataclass(frozen=True)
class Settings:
    """The facts that a cluster's directory remembers from start to start."""

    cluster_name: str
    """Unique per directory, so that Cassandra itself refuses data of another cluster."""
    nodes: int = 1
    host: str = "127.0.0.1"
    """Address of the first node; the others follow it."""
    port: int = 9042
    """Where CQL is spoken, on every node's address."""
    storage_port: int = 0
    """Where the nodes speak to each other; 0 until the first start chooses one."""
    heap_mb: int = 0
    """Java heap of each node as asked for, MiB; 0 = by the machine's memory."""
    secure: bool = False
    """Whether it asks for a password and speaks TLS."""

    @property
    def java_heap_mb(self) -> int:
        """Java heap of each node, MiB."""
        return self.heap_mb or own_heap_mb(self.nodes)

    def address(self, number: int) -> str:
        """Return the address of a node, counted from 1."""
        return str(ipaddress.IPv4Address(self.host) + (number - 1))


def own_heap_mb(nodes: int, memory_bytes: int | None = None) -> int:
    """Return the heap of a node that nobody named, MiB.

    The nodes share a quarter of the memory (None = of this machine, or of the container), but each
    gets at least 512 MiB. Every table keeps a quarter of a MiB of it, with or without rows.
    """
    least, most = OWN_HEAP_MB
    memory = _memory_bytes() if memory_bytes is None else memory_bytes
    return max(least, min(most, memory // 4 >> 20) // nodes)


def _memory_bytes() -> int:
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    try:
        return min(memory, int(_MEMORY_LIMIT.read_text(encoding="ascii")))
    except (OSError, ValueError):  # no container, or one without a limit
        return memory


def new_settings() -> Settings:
    """Return the settings of a cluster that does not exist yet."""
    return Settings(cluster_name=f"cassandra_ros_{uuid.uuid4().hex[:8]}")


def load_settings(directory: Path) -> Settings | None:
    """Read the settings of the cluster in a directory; None where there is none."""
    path = directory / SETTINGS_FILE
    try:
        # Before the settings are read: what another start makes meanwhile is nothing foreign.
        foreign = _foreign(directory)
        values = json.loads(path.read_text(encoding="utf-8"))
        known = {field.name: field.type for field in fields(Settings)}
        settings = Settings(**{name: values[name] for name in known if name in values})
        for name, kind in known.items():
            if type(getattr(settings, name)).__name__ != kind:
                raise TypeError(f"{name} is no {kind}")
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


def save_settings(directory: Path, settings: Settings) -> None:
    """Write the settings so that a crash leaves either the old or the new ones."""
    draft = directory / _DRAFT
    draft.write_text(json.dumps(asdict(settings), indent=2) + "\n", encoding="utf-8")
    os.replace(draft, directory / SETTINGS_FILE)


def change_settings(
    settings: Settings,
    nodes: int | None = None,
    host: str | None = None,
    port: int | None = None,
    heap: str | None = None,
    secure: bool | None = None,
) -> Settings:
    """Return the settings with the options that were given, checked."""
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
    """Return a heap size such as 512M or 2G in MiB; a bare number is MiB."""
    found = re.fullmatch(r"(\d+)\s*([mMgG]?)(?:i?[bB])?", text.strip())
    if not found:
        raise ServerError(f"--heap {text}: write a size such as 512M or 2G")
    return int(found.group(1)) * (1024 if found.group(2) in ("g", "G") else 1)


def check_settings(settings: Settings) -> Settings:
    """Return the settings if a cluster can be started with them; raise ServerError if not."""
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
    """Return the names of what did not come with a start that has not ended."""
    try:
        names = {path.name for path in directory.iterdir()}
    except FileNotFoundError:
        return []
    except NotADirectoryError:
        raise ServerError(f"{directory} is a file; choose a directory with --dir") from None
    # The jars of the default directory may have been installed before the first start, the Studio
    # of the viewer, too; and a start that was killed early leaves its lock, and a draft of its
    # settings.
    return sorted(names - {"jars", "studio", "lock", SETTINGS_FILE, _DRAFT})
