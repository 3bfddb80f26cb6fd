# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Common part of the writers of bags and MCAP files."""

from __future__ import annotations

import itertools
import os
from abc import ABC, abstractmethod
from contextlib import ExitStack, suppress
from typing import IO, TypeVar

from cassandra_ros.errors import BagError, cannot_write
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.store.tables.event_table import Event

_BUFFER_BYTES = 1 << 16
"""Size of the write buffer, bytes. It is larger than the header of a bag, so writing the header
cannot fail before the object is complete."""
Self = TypeVar("Self", bound="FileWriter")


class FileWriter(ABC):
    """A bag or an MCAP that is being written; also a context manager.

    The file is named OUT.active until close() renames it to OUT, as ``rosbag record`` does. If the
    context is left by an exception, the file is deleted.

    Args:
        path: The file to write; close() replaces an existing file.

    Raises:
        BagError: The file cannot be made, OUT.active exists, or OUT is a folder or a device.
    """

    keeps_publish_times = False
    """Whether the file format stores delay_ns and sequence, see write."""

    def add_event(self, event: Event) -> bool:
        """Write an event; return whether the file format can hold it: bags cannot."""
        return False

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = os.fspath(path)
        self._active = self.path + ".active"
        self._connections: dict[int, Connection] = {}
        """Connections that were added, by number, also those without messages yet."""
        self._resources = ExitStack()
        """Further files that are closed together with this one."""
        self._closed = False
        if os.path.exists(self.path) and not os.path.isfile(self.path):
            raise BagError(f"{self.path} is not a file that can be replaced; give another name")
        try:
            self._file: IO[bytes] = open(self._active, "xb", _BUFFER_BYTES)
        except FileExistsError as exc:
            raise BagError(
                f"{self._active} exists: it is being written, or was left by a recorder or an "
                "export that was killed; move it, or give another name"
            ) from exc
        except OSError as exc:
            raise self._failure(exc) from exc

    def connection(self, connection: Connection, number: int | None = None) -> int:
        """Add a connection; return its number. It is written before its first message.

        Args:
            number: Unique number of the connection in this file, 0 to 2**32 - 1. None = one more
                than the highest number, or if that is too large, the lowest free one. rosbag reads
                messages of equal time in the order of these numbers.

        Raises:
            BagError: The number is taken or out of range.
        """
        if number is None:
            number = max(self._connections, default=-1) + 1
            if number == 2**32:
                number = next(n for n in itertools.count() if n not in self._connections)
        if number in self._connections or not 0 <= number < 2**32:
            raise BagError(f"{self.path}: connection number {number} is taken or out of range")
        self._connections[number] = connection
        return number

    @abstractmethod
    def write(
        self, number: int, t_ns: int, data: bytes, delay_ns: int = 0, sequence: int = 0
    ) -> None:
        """Append a serialised message of a connection, received at t_ns, ns since 1970.

        Args:
            number: Number that ``connection`` has returned.
            delay_ns: publish_time minus t_ns, ns, modulo 2**64; may be negative. Only an MCAP
                stores it.
            sequence: Sequence number that the publisher gave, 0 = unknown. Only an MCAP stores it.

        Raises:
            BagError: The disk is full or fails.
        """

    @abstractmethod
    def _finish(self) -> None:
        """Write the end of the file: its index.

        ``close`` calls it once, and deletes the file after an error.

        Raises:
            OSError, BagError: The disk is full or fails.
        """

    def close(self) -> None:
        """Write the index and give the file its final name. A second call does nothing.

        Raises:
            BagError: The disk is full or fails; the unfinished file is deleted.
        """
        if self._closed:
            return
        try:
            self._finish()
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()
            os.replace(self._active, self.path)
        except OSError as exc:
            self.discard()
            raise BagError(cannot_write(self.path, exc)) from exc
        except BagError:
            self.discard()
            raise
        self._closed = True
        self._resources.close()

    def discard(self) -> None:
        """Close and delete the unfinished file. An existing file of the final name is kept."""
        if self._closed:
            return
        self._closed = True
        self._resources.close()
        # Closing writes the buffer, which fails again if the disk is full.
        with suppress(OSError):
            self._file.close()
        with suppress(OSError):
            os.unlink(self._active)

    def __enter__(self: Self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *exc: object) -> None:
        if kind is None:
            self.close()
        else:
            self.discard()

    def _failure(self, cause: OSError) -> BagError:
        return BagError(cannot_write(self._active, cause))
