# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Short Java programs that a start needs, and the options that Cassandra's classes need of Java."""

from __future__ import annotations

from typing import Mapping, Sequence

from cassandra_ros.errors import ServerError
from cassandra_ros.local_server.processes import run_program

_OPENS = (
    "java.base/java.lang.module java.base/jdk.internal.loader java.base/jdk.internal.ref "
    "java.base/jdk.internal.reflect java.base/jdk.internal.math java.base/jdk.internal.module "
    "java.base/jdk.internal.util.jar java.base/sun.nio.ch java.base/java.io "
    "java.base/java.lang.reflect java.base/java.lang java.base/java.util java.base/java.nio "
    "jdk.management/com.sun.management.internal"
)
_EXPORTS = (
    "java.base/jdk.internal.misc java.base/java.lang.ref "
    "java.management.rmi/com.sun.jmx.remote.internal.rmi "
    "java.management/com.sun.jmx.remote.security java.rmi/sun.rmi.registry "
    "java.rmi/sun.rmi.server java.sql/java.sql jdk.unsupported/sun.misc"
)


def module_options() -> list[str]:
    """Return the options that allow Cassandra's classes to use internal packages of Java."""
    options = []
    for option, packages in (("--add-exports", _EXPORTS), ("--add-opens", _OPENS)):
        for package in packages.split():
            options += [option, f"{package}=ALL-UNNAMED"]
    return options


def run_to_end(
    command: Sequence[str], environment: Mapping[str, str], timeout_sec: float, failure: str
) -> None:
    """Run a program to its end.

    Args:
        environment: Variables in addition to ours. Secrets go this way: other users see arguments.
        failure: Beginning of the error text.

    Raises:
        ServerError: The program fails, or takes longer than the timeout.
    """
    status, output = run_program(command, timeout_sec, {**environment, "LC_ALL": "C.UTF-8"})
    if status:
        raise ServerError(f"{failure}: {output.strip()[-500:]}")
