# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Limits for the unpacked size of files: a small file can be made that fills memory and disk.

Repeated bytes pack to almost nothing, so a bag of some kilobytes may hold gigabytes of messages.
"""

from __future__ import annotations

from cassandra_ros.errors import BagTooLarge

MAX_CHUNK_BYTES = 2**28
"""Maximum size of the content of a compressed chunk, bytes. rosbag closes a chunk at 768 KB, and
MCAP's writers at some MB; only a single larger message makes a larger one."""
MAX_PLAIN_BYTES = 2**30
"""Maximum size of a chunk that is not compressed, bytes: the file itself is as large."""
MAX_RATIO = 1000
"""Maximum ratio of the content of all chunks to the size of the file. It counts from
MAX_CHUNK_BYTES of content on."""
MAX_TRUSTED_BYTES = 2**32 - 1
"""Maximum size of a chunk's content where large chunks are allowed, bytes: a bag can state no
larger size."""


class Allowance:
    """Counts how much of a file has been unpacked, and refuses chunks above the limits.

    Args:
        file_bytes: Size of the file.
        large_chunks: The user trusts the file: a chunk may have up to MAX_TRUSTED_BYTES of
            content, and the file may unpack to any size.
    """

    def __init__(self, file_bytes: int, large_chunks: bool = False) -> None:
        self._large_chunks = large_chunks
        self._most = max(MAX_CHUNK_BYTES, MAX_RATIO * file_bytes)
        self._taken = 0

    def take(self, compression: str, size: int, packed: int, where: str) -> None:
        """Count a chunk before it is unpacked. The caller unpacks at most ``size`` bytes of it.

        Args:
            compression: Name of the compression that the chunk states.
            size: Size of the content that the chunk states, bytes.
            packed: Size of the chunk in the file, bytes.
            where: Name of the chunk in the error text.

        Raises:
            BagTooLarge: The chunk is too large, or all chunks up to this one are.
        """
        largest, most = max(size, packed), self.most(compression)
        if largest > most:
            raise BagTooLarge(
                f"{where} states {largest} bytes of content; chunks of over {most} bytes are not "
                f"read{self._remedy()}"
            )
        self._taken += size
        if self._taken > self._most and not self._large_chunks:
            raise BagTooLarge(
                f"{where} makes {self._taken} bytes of content up to here; a file that unpacks to "
                f"more than {MAX_RATIO} times its size is not read{self._remedy()}"
            )

    def most(self, compression: str) -> int:
        """Return the maximum size of a chunk's content, bytes."""
        if self._large_chunks:
            return MAX_TRUSTED_BYTES
        return MAX_PLAIN_BYTES if compression in ("", "none") else MAX_CHUNK_BYTES

    def _remedy(self) -> str:
        if self._large_chunks:
            return ""
        return (
            ", for such files are damaged, or made to fill the memory and the disk; if you trust "
            "this one: --allow-large-chunks"
        )
