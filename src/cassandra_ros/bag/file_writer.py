# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A file of messages that is being written, whatever its format."""

from __future__ import annotations

import itertools
import os
from abc import ABC, abstractmethod
from contextlib import ExitStack, suppress
from typing import IO, TypeVar

from cassandra_ros.errors import BagError
from cassandra_ros.messages.connection_header import Connection

_BUFFER_BYTES = 1 << 16
"""More than the header, so that its writing cannot fail before there is something to clean up."""
Self = TypeVar("Self", bound="FileWriter")


class FileWriter(ABC):
    """A bag or an MCAP that is being written; also a context manager.

    The file is OUT.active until close() renames it, as with ``rosbag record``; leaving the
    context by an exception removes it.

    Args:
        path: The file to make; an existing one is replaced at the end.

    Raises:
        BagError: The file cannot be made.
    """

    keeps_sent = False
    """Whether write keeps delay_ns and sequence."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = os.fspath(path)
        self._active = self.path + ".active"
        self._connections: dict[int, Connection] = {}
        self._resources = ExitStack()
        """What is closed with the file."""
        self._closed = False
        try:
            self._file: IO[bytes] = open(self._active, "wb", _BUFFER_BYTES)
        except OSError as exc:
            raise self._failure(exc) from exc

    def connection(self, connection: Connection, number: int | None = None) -> int:
        """Add a connection, written as it is before its first message; return its number.

        Args:
            number: Its number in this file, unique, in [0, 2**32 - 1]; None = the next free one,
                behind all others while there is one. Between equal times the lower number is read
                first.

        Raises:
            BagError: The number is taken.
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
            delay_ns: An MCAP says also when it was sent: so much later, ns; < 0 = earlier.
            sequence: And as which message of its publisher; 0 = it is not known.

        Raises:
            BagError: The disk is full or fails.
        """

    @abstractmethod
    def _finish(self) -> None:
        """Write what stands at the end of the file; OSError or BagError where that fails."""

    def close(self) -> None:
        """Write the index and give the file its name; twice is harmless.

        Raises:
            BagError: The disk is full or fails; the unfinished file is removed.
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
            raise BagError(f"{self.path} cannot be written: {exc.strerror}") from exc
        except BagError:
            self.discard()
            raise
        self._closed = True
        self._resources.close()

    def discard(self) -> None:
        """Close and remove the unfinished file; a file that was there before stays."""
        if self._closed:
            return
        self._closed = True
        self._resources.close()
        # Closing writes what is buffered, which fails once more where the disk is full.
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
        return BagError(f"{self._active} cannot be written: {cause.strerror}")
