# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a comparison of a bag with the store finds."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from typing import Callable, List

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.stamps import isoTime
from cassandra_ros.topics.stored_row import StoredRow

SHOWN = 10
"""Differences that are kept in words; all are counted."""

Progress = Callable[[int], None]
"""Called with the messages of the bag that were compared since the last call."""

_SIZE_BYTES = 8


@dataclass
class VerifyReport:
    """Outcome of a comparison."""

    path: str
    scope: str
    """Which stored messages were compared, in words."""
    equal_messages: int = 0
    differences: int = 0
    """Messages that are missing, superfluous or different."""
    missing: int = 0
    """Those of them that the store lacks; the others are rows that are not of this bag."""
    first: List[str] = field(default_factory=list)
    """The first differences, a line each."""

    @property
    def equal(self) -> bool:
        """Whether bag and store hold the same."""
        return not self.differences

    def add(self, text: str, messages: int = 1) -> None:
        """Note a difference.

        Args:
            text: A line that says which message, and in what it differs.
            messages: How many messages it concerns.
        """
        self.differences += messages
        if len(self.first) < SHOWN:
            self.first.append(text)


def fingerprint(wire: bytes) -> bytes:
    """Shorten a message to 24 bytes that differ when the messages differ."""
    digest = hashlib.blake2b(wire, digest_size=16).digest()
    return len(wire).to_bytes(_SIZE_BYTES, "little") + digest


def rowFingerprint(row: StoredRow) -> bytes:
    """Shorten a stored message; one that cannot be read back equals no other."""
    try:
        return fingerprint(row.wire)
    except CorruptMessage:
        return b""


def describeBytes(bag: bytes, stored: bytes) -> str:
    """Say in what two different fingerprints differ."""
    if not stored:
        return "the stored message is damaged"
    sizes = [int.from_bytes(value[:_SIZE_BYTES], "little") for value in (bag, stored)]
    if sizes[0] != sizes[1]:
        return f"{sizes[0]} bytes in the bag, {sizes[1]} in the store"
    return f"its {sizes[0]} bytes differ"


def describePlace(topic: str, t_ns: int) -> str:
    """Name a message by its topic and time."""
    return f"{topic} at {isoTime(t_ns)}"
