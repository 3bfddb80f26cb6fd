# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Address of the store: from the arguments, the environment, the cqlshrc, or the default."""

from __future__ import annotations

import os
import re
from typing import Sequence

from cassandra_ros.errors import InvalidOption

DEFAULT_HOST = "127.0.0.1"
DEFAULT_PORT = 9042
DEFAULT_KEYSPACE = "ros"
ANSWER_SEC = 10.0
"""Default time limit for the answer of one of several stores that are asked together, s."""


def from_environment(name: str) -> str:
    """Return CASSANDRA_ROS_HOST, _PORT, _KEYSPACE or _CQLSHRC; '' if the variable is not set."""
    return os.environ.get(f"CASSANDRA_ROS_{name}", "")


def host_names(host: str | Sequence[str] | None, usual: str = "") -> list[str]:
    """Return the addresses in a text with commas, or in a sequence.

    Args:
        host: The addresses; None or '' = CASSANDRA_ROS_HOST, else ``usual``, else this machine.
        usual: Addresses of the cqlshrc, divided by commas; '' = the cqlshrc has no address.
    """
    hosts = host or from_environment("HOST") or usual or DEFAULT_HOST
    names = hosts.split(",") if isinstance(hosts, str) else hosts
    return [name.strip() for name in names if name.strip()]


def port_number(port: int | str | None, usual: str = "", source: str = "") -> int:
    """Return a port as a number.

    Args:
        port: The port; None or '' = CASSANDRA_ROS_PORT, else ``usual``, else 9042.
        usual: Port of the cqlshrc; '' = the cqlshrc has no port.
        source: File that names ``usual``, for the error text.

    Raises:
        InvalidOption: It is not a whole number from 1 to 65535.
    """
    hint = ""
    value: int | str = DEFAULT_PORT
    if port is not None and port != "":
        value = port
    elif from_environment("PORT"):
        value, hint = from_environment("PORT"), " (CASSANDRA_ROS_PORT)"
    elif usual:
        value, hint = usual, f" ({source})"
    text = str(value)
    if not (text.isascii() and text.isdigit() and len(text) < 6 and 0 < int(text) < 65536):
        raise InvalidOption(f"{value!r}{hint} is not a port: a number from 1 to 65535")
    return int(text)


_ADDRESS = re.compile(
    r"(?P<host>\[[0-9A-Fa-f:.]+\]|[^:/\[\]\s]+)(?::(?P<port>[0-9]+))?(?:/(?P<keyspace>[A-Za-z0-9_]+))?"
)


def read_address(text: str, keyspace: str) -> tuple[str, int, str]:
    """Return host, port and keyspace of another store.

    Args:
        text: ``HOST[:PORT][/KEYSPACE]``; several hosts are divided by commas, an IPv6 address
            stands in brackets. Without a port it is 9042.
        keyspace: Keyspace if the text has none.

    Raises:
        InvalidOption: The text is not of this form.
    """
    match = _ADDRESS.fullmatch(text)
    if match is None:
        raise InvalidOption(
            f"{text!r} is not the place of a store: give HOST, HOST:PORT, HOST/KEYSPACE or "
            "HOST:PORT/KEYSPACE"
        )
    port = port_number(match["port"] or DEFAULT_PORT)
    return match["host"].strip("[]"), port, match["keyspace"] or keyspace
