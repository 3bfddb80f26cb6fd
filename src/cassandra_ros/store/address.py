# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where the store is: what the environment says, and what holds where nobody says anything."""

from __future__ import annotations

import os
from typing import Sequence

from cassandra_ros.errors import InvalidOption

DEFAULT_HOST = "127.0.0.1"
DEFAULT_PORT = 9042
DEFAULT_KEYSPACE = "ros"


def from_environment(name: str) -> str:
    """Return CASSANDRA_ROS_HOST, _PORT or _KEYSPACE; '' where it is not set."""
    return os.environ.get(f"CASSANDRA_ROS_{name}", "")


def host_names(host: str | Sequence[str] | None) -> list[str]:
    """List the addresses of a text, divided by commas, or a sequence; None = as usual."""
    given = (from_environment("HOST") or DEFAULT_HOST) if host is None else host
    names = given.split(",") if isinstance(given, str) else given
    return [name.strip() for name in names if name.strip()]


def port_number(port: int | str | None) -> int:
    """Check a port, None = as usual; raises InvalidOption for no whole number from 1 to 65535."""
    given = (from_environment("PORT") or DEFAULT_PORT) if port is None else port
    text = str(given)
    if not (text.isascii() and text.isdigit() and len(text) < 6 and 0 < int(text) < 65536):
        source = " (CASSANDRA_ROS_PORT)" if port is None else ""
        raise InvalidOption(f"{given!r}{source} is not a port: a number from 1 to 65535")
    return int(text)
