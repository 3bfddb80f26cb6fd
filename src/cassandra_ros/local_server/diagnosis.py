# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Why a server did not start, told from what it left in its logs."""

from __future__ import annotations

from pathlib import Path

from cassandra_ros.local_server.nodes import Node

_TAIL_LINES = 15
_TAIL_BYTES = 64 << 10

# (what stands in the log, what it means and what to do); the first that is found counts.
_REASONS = (
    (
        "Saved cluster name",
        "the directory holds the data of another cluster; choose another --dir, or delete this "
        "data with: local_cassandra clear --yes",
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
    # With its package: Cassandra logs its options, -XX:+ExitOnOutOfMemoryError among them.
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
    """Return how long the node's log is now, bytes; 0 where there is none."""
    try:
        return node.log.stat().st_size
    except OSError:
        return 0


def log_since(node: Node, offset: int) -> str:
    """Return what the node has logged since its log was `offset` bytes long."""
    if log_size(node) < offset:
        offset = 0  # it was rolled over
    return _read(node.log, offset)


def explain_failure(node: Node, offset: int) -> str:
    """Return reason, last lines of the log and where it is, for an error text.

    Args:
        node: The node that did not start.
        offset: Length of its log before the start, bytes.
    """
    logged = log_since(node, offset)
    printed = _read(node.console, 0)
    reason = next((why for sign, why in _REASONS if sign in logged + printed), "")
    source, text = (node.log, logged) if logged.strip() else (node.console, printed)
    if any(word in printed for word in ("Error", "Exception")) and "ERROR" not in logged:
        source, text = node.console, printed
    lines = text.strip().splitlines()[-_TAIL_LINES:]
    return "\n".join(
        ([f"Reason: {reason}."] if reason else [])
        + [f"The last lines of {source}:"]
        + [f"  {line[:300]}" for line in lines or ["(nothing was logged)"]]
    )


def _read(path: Path, offset: int) -> str:
    try:
        with open(path, "rb") as file:
            end = file.seek(0, 2)
            file.seek(max(offset, end - _TAIL_BYTES))
            return file.read().decode("utf-8", "replace")
    except OSError:
        return ""
