# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the machine knows of its ports: which are free, who holds one, who is connected."""

from __future__ import annotations

import os
import random
import socket
import time
from pathlib import Path

from cassandra_ros.errors import ServerError
from cassandra_ros.local_server.processes import command_line, describe_process

_SERVER_PORTS = range(18_000, 32_768)
_LISTEN = "0A"
_ESTABLISHED = "01"
_ANY = bytes(4)
_DYING_SEC = 10.0


def is_free(host: str, port: int) -> bool:
    """Tell whether a server could listen on the port now."""
    with socket.socket() as probe:
        # As Java does it: the closing connections of a server that just stopped do not count.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
            probe.listen(1)
        except OSError:
            return False
    return True


def free_port(host: str = "127.0.0.1") -> int:
    """Return a port of the host that is free now, and that no client gets for its end."""
    # What the system gives away by itself begins above: such a port may be taken by a client
    # while a server that listened on it is started again.
    candidates = random.sample(_SERVER_PORTS, len(_SERVER_PORTS))
    for port in candidates:
        if is_free(host, port):
            return port
    raise ServerError(f"no port of {host} from 18000 to 32767 is free")


def await_the_dead(host: str, port: int) -> bool:
    """Wait while the listener of a port is a process that is just ending.

    One that was killed gives its memory back first, and its port seconds later on a busy machine.

    Returns:
        Whether a server could listen on the port now.
    """
    deadline = time.monotonic() + _DYING_SEC
    while not is_free(host, port):
        if time.monotonic() > deadline or not all(map(_dying, _sockets(port, _LISTEN, host))):
            return False
        time.sleep(0.05)
    return True


def port_owner(port: int, host: str = "") -> str:
    """Describe who listens on a TCP port of this machine, as far as we may know it.

    Args:
        port: Its number.
        host: Only listeners of this address; '' = of any.
    """
    for words in _sockets(port, _LISTEN, host):
        pid = _pid_of_socket(words[9])
        return describe_process(pid) if pid else f"a process of user id {words[7]}"
    return "an unknown process"


def count_clients(port: int) -> int:
    """Return how many connections to a port of this machine are open."""
    return len(_sockets(port, _ESTABLISHED))


def _sockets(port: int, state: str, host: str = "") -> list[list[str]]:
    """Return the lines of the kernel's tables for a local port, as words."""
    address = socket.inet_aton(socket.gethostbyname(host)) if host else _ANY
    lines = []
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        try:
            lines += [line.split() for line in Path(table).read_text().splitlines()[1:]]
        except OSError:
            continue
    return [
        words
        for words in lines
        if words[3] == state
        and int(words[1].rsplit(":", 1)[1], 16) == port
        and (address == _ANY or _address(words) in (address, _ANY))
    ]


def _address(words: list[str]) -> bytes:
    """Return the last four bytes of the local address: all of one of IPv4, mapped or not."""
    return bytes.fromhex(words[1].rsplit(":", 1)[0])[-4:][::-1]


def _dying(words: list[str]) -> bool:
    """Tell whether the process that holds a socket has nothing left but that."""
    return int(words[7]) == os.getuid() and not command_line(_pid_of_socket(words[9]))


def _pid_of_socket(inode: str) -> int:
    wanted = f"socket:[{inode}]"
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and any(_target(link) == wanted for link in _open_files(entry)):
            return int(entry.name)
    return 0


def _open_files(process: Path) -> list[Path]:
    try:
        return list((process / "fd").iterdir())
    except OSError:  # it ended, or belongs to another user
        return []


def _target(link: Path) -> str:
    try:
        return os.readlink(link)
    except OSError:  # closed meanwhile
        return ""
