# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Checks before a start, so that failures are ServerErrors with a cause and a remedy."""

from __future__ import annotations

import shutil
from pathlib import Path

from cassandra_ros.errors import ServerError
from cassandra_ros.local_server import ports, processes
from cassandra_ros.local_server.cluster_settings import ClusterSettings
from cassandra_ros.local_server.cql import answers_cql
from cassandra_ros.local_server.nodes import Node
from cassandra_ros.own_files import open_regular

_NEEDED_BYTES = 768 << 20  # per node: the commit log alone may take 512 MiB


def make_directory(directory: Path, nodes: int, *, holds_data: bool = False) -> str:
    """Make the cluster's directory and check the free space of its disk.

    Args:
        holds_data: Only warn of too little space: existing data can still be read or deleted.

    Returns:
        A warning of too little space; '' = there is enough.

    Raises:
        ServerError: There is too little space, or the directory cannot be made.
    """
    warning = ""
    try:
        existing = next(path for path in (directory, *directory.parents) if path.is_dir())
        free, needed = shutil.disk_usage(existing).free, _NEEDED_BYTES * nodes
        if free < needed:
            warning = (
                f"{directory} has {free >> 20} MiB free, Cassandra needs {needed >> 20} MiB; make "
                "room"
            )
            if not holds_data:
                raise ServerError(f"no space: {warning}, or choose another directory with --dir")
            warning += ", or remove what is stored: it is started to be read, and may not take more"
        directory.mkdir(parents=True, exist_ok=True)
        return warning
    except OSError as exc:
        raise ServerError(
            f"{directory} cannot be made: {exc}; choose another directory with --dir"
        ) from exc


def check_change(
    directory: Path, old: ClusterSettings, new: ClusterSettings, running: bool
) -> None:
    """Refuse options that contradict the running cluster or the stored data.

    Raises:
        ServerError: An option contradicts them; the text names it.
    """
    if new.nodes != old.nodes:
        raise ServerError(
            f"{directory} holds a cluster of {old.nodes} node(s), not {new.nodes}; leave --nodes "
            "away, choose another --dir, or delete the data with: "
            "rosrun cassandra_ros local_cassandra clear --yes"
        )
    if running and new != old:
        raise ServerError(
            f"the Cassandra in {directory} runs already with other options (at "
            f"{old.host}:{old.port}, heap {old.java_heap_mb}M, "
            f"{'secure' if old.secure else 'not secure'}); stop it first, or choose another --dir"
        )
    if new.nodes > 1 and new.host != old.host:
        raise ServerError(
            f"the nodes in {directory} know each other as {old.host} and following; leave --host "
            "away, or choose another --dir"
        )


def note_stale_pid_file(node: Node) -> str:
    """Return a text about the stale pid file of a stopped node; '' = it has no pid file.

    A stop deletes the file, so the node was killed: its start checks the commit log and the tables.
    """
    if not node.pid_file.exists():
        return ""
    started = processes.read_start(node.pid_file)
    owner = processes.describe_process(started.pid) if started and started.pid else "no process"
    return f"{node.pid_file} is stale: it names {owner}, not this Cassandra"


def check_port(node: Node) -> None:
    """Check that the node's CQL port is free.

    Raises:
        ServerError: It is in use; the text names the process, if it is known.
    """
    port = node.settings.port
    if ports.await_the_dead(node.address, port):
        return
    text = (
        f"port {port} of {node.address} is taken by {ports.port_owner(port, node.address)}; end "
        "that, or choose another port with --port"
    )
    if answers_cql(node.address, port):
        text += (
            "\nIt speaks CQL: if it is the Cassandra that you want, nothing needs to be started; "
            f"the tools find it with --host {node.address} --port {port}"
        )
    raise ServerError(text)


def choose_storage_port(settings: ClusterSettings, addresses: list[str]) -> int:
    """Return a port for the traffic between the nodes that is free on all their addresses.

    Args:
        settings: Settings of the cluster. Their port is kept if it is free.
        addresses: Addresses of the nodes that are started.

    Raises:
        ServerError: The port that several nodes use already is taken.
    """
    port = settings.storage_port
    if port and all(ports.await_the_dead(address, port) for address in addresses):
        return port
    if port and settings.nodes > 1:
        # The nodes have stored each other's addresses with this port.
        taken = next((address for address in addresses if not ports.is_free(address, port)), "")
        raise ServerError(
            f"port {port}, by which the nodes speak to each other, is taken by "
            f"{ports.port_owner(port, taken)}; end that first"
        )
    return ports.free_port(*addresses)


_TAIL_LINES = 15
_TAIL_BYTES = 64 << 10

# (text in the log, its meaning and the remedy); the first text that is found counts.
_REASONS = (
    (
        "Saved cluster name",
        "the directory holds the data of another cluster; choose another --dir, or delete this "
        "data with: local_cassandra clear --yes",
    ),
    (
        "already exists, cancelling join",
        "the other nodes know one at this address, whose data are gone here; bring it back with: "
        "local_cassandra replace N, where N is its number",
    ),
    ("No space left on device", "the disk is full; make room, or choose another --dir"),
    ("Address already in use", "a port is taken by another program; choose another --port"),
    (
        "in use by another process",
        "a port was taken by another program while this one started; start again",
    ),
    ("Could not reserve enough space", "there is too little memory for the heap; lower --heap"),
    ("os::commit_memory", "there is too little memory for the heap; lower --heap"),
    ("Cannot allocate memory", "there is too little memory for the heap; lower --heap"),
    # With the package name, because Cassandra logs the option -XX:+ExitOnOutOfMemoryError.
    ("java.lang.OutOfMemoryError", "the heap is too small; give more with --heap"),
    ("CommitLogReplayException", "the commit log is damaged; the file is named in the log"),
    ("CorruptSSTableException", "a data file is damaged; it is named in the log"),
    ("Unsupported class file", "this Java is too old for Cassandra; Java 17 is needed"),
    (
        "Unable check disk space",
        "Java finds no mount point for the directory, as in a chroot whose root is an ordinary "
        "folder; start it as root, or bind-mount that folder on itself before entering it",
    ),
    ("Permission denied", "a file of the directory belongs to another user"),
)


def log_size(node: Node) -> int:
    """Return the size of the node's log, bytes; 0 = there is no log."""
    try:
        return node.log.stat().st_size
    except OSError:
        return 0


def log_since(node: Node, offset: int) -> str:
    """Return the text that the node has logged since its log had `offset` bytes."""
    # The log may have been rotated meanwhile.
    return _read(node.log, offset if log_size(node) >= offset else 0)


def explain_failure(node: Node, offset: int) -> str:
    """Return the reason for a failure, if it is known, and the last lines of the log, and its path.

    Args:
        node: The node that failed.
        offset: Size of its log before the start.
    """
    logged, printed = log_since(node, offset), _read(node.console, 0)
    reason = next((why for sign, why in _REASONS if sign in logged + printed), "")
    source, text = (node.log, logged) if logged.strip() else (node.console, printed)
    if any(word in printed for word in ("Error", "Exception")) and "ERROR" not in logged:
        source, text = node.console, printed
    lines = text.strip().splitlines()[-_TAIL_LINES:] or ["(nothing was logged)"]
    reason_lines = [f"Reason: {reason}."] if reason else []
    return "\n".join(
        [*reason_lines, f"The last lines of {source}:", *(f"  {line[:300]}" for line in lines)]
    )


def _read(path: Path, offset: int) -> str:
    """Return the text of a file from an offset on, at most _TAIL_BYTES; '' = it cannot be read."""
    try:
        with open(open_regular(path), "rb") as file:
            end = file.seek(0, 2)
            file.seek(max(offset, end - _TAIL_BYTES))
            return file.read().decode("utf-8", "replace")
    except OSError:
        return ""
