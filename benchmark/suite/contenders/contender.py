# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What every contender can be asked for."""

from __future__ import annotations

import hashlib
import struct
from pathlib import Path
from typing import Any, Iterable, Iterator

from suite.messages import Batch


class Contender:
    """Keeps the messages of one batch. Made anew for each writing.

    open() and close() are not measured; extend() and finish() are, which hand the messages over
    and return when they are kept as well as the contender keeps them.

    Args:
        batch: The messages.
        folder: A folder of its own.
    """

    name = ""
    path = ""
    """The file, of those that write one."""

    def __init__(self, batch: Batch, folder: Path) -> None:
        self.batch = batch
        self.folder = folder

    def open(self) -> None:
        """Make ready for writing."""

    def extend(self, first: int, last: int) -> None:
        """Write the messages from first to before last."""
        raise NotImplementedError

    def finish(self) -> None:
        """Return when everything is kept."""

    def open_reading(self) -> None:
        """Make ready for lookups and reading."""

    def objects(self) -> Iterator[Any]:
        """Yield all messages as objects, in order."""
        raise NotImplementedError

    def raw(self) -> Iterator[tuple[int, bytes]]:
        """Yield time and bytes of all messages, in order."""
        raise NotImplementedError

    def lookup(self, t_ns: int) -> Any:
        """Return the message that was received then."""
        raise NotImplementedError

    def size(self) -> int | None:
        """Return the size on disk; None where it cannot be told."""
        raise NotImplementedError

    def close(self) -> None:
        """Let go of what is open; what is stored stays."""

    def discard(self) -> None:
        """Close, and remove what is stored."""
        self.close()
        Path(self.path).unlink()


def digest(messages: Iterable[tuple[int, bytes]]) -> tuple[int, str]:
    """Return number and hash of messages: of their times, lengths and bytes."""
    found, count = hashlib.sha256(), 0
    for t_ns, wire in messages:
        found.update(struct.pack("<QI", t_ns, len(wire)))
        found.update(wire)
        count += 1
    return count, found.hexdigest()


class NotEqual(Exception):
    """What was read is not what was written."""


def verify(contender: Contender, batch: Batch) -> None:
    """Raise NotEqual where the contender does not give back the batch."""
    found, wanted = digest(contender.raw()), digest(zip(batch.times, batch.wires))
    if found != wanted:
        raise NotEqual(
            f"{contender.name}, {batch.kind}: read {found[0]:,} messages of {wanted[0]:,}"
            + ("" if found[0] != wanted[0] else ", others than were written")
        )
