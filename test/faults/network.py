# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A network of this process and its children alone, in which servers can be cut off.

A cut is made by rules of the kernel's routing: bytes to and from a port are dropped. Connections
stay open and are silent; new ones fail at once.
"""

from __future__ import annotations

import contextlib
import ctypes
import shutil
import subprocess
from typing import Iterator

_CLONE_NEWNET = 0x40000000
_RULE = 10
"""Priority of the rules of a cut, before that of the table of local addresses."""
_LOCAL_TABLE = 100

own = False
"""Whether this process has a network of its own."""


class NoNetwork(Exception):
    """This process cannot have a network of its own; the text says why."""


def enter() -> None:
    """Give this process, and the children that it starts from now on, a network of their own.

    Raises:
        NoNetwork: The process may not, or the kernel or the command ``ip`` lacks something.
    """
    global own
    if not own:
        if not shutil.which("ip"):
            raise NoNetwork("the command ip is missing")
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.unshare(_CLONE_NEWNET):
            raise NoNetwork("only root can make a network of its own")
        _ip("link", "set", "lo", "up")
        # Rules come before this table only if it does not have priority 0.
        _ip("rule", "add", "pref", _LOCAL_TABLE, "lookup", "local")
        _ip("rule", "del", "pref", 0)
        own = True


@contextlib.contextmanager
def cut(address: str, port: int) -> Iterator[None]:
    """Drop all bytes to and from a port while the context is open.

    Args:
        address: Address of a server, or a range like 127.77.0.0/24.
        port: Its TCP port.
    """
    rules = (("to", address, "dport", port), ("from", address, "sport", port))
    with contextlib.ExitStack() as made:
        for direction, where, side, number in rules:
            rule = ("pref", _RULE, direction, where, "ipproto", "tcp", side, number)
            _ip("rule", "add", *rule, "blackhole")
            made.callback(_ip, "rule", "del", *rule)
        yield


def _ip(*words: object) -> None:
    done = subprocess.run(["ip", *map(str, words)], capture_output=True, text=True)
    if done.returncode:
        raise NoNetwork(f"ip {' '.join(map(str, words))}: {done.stderr.strip()}")
