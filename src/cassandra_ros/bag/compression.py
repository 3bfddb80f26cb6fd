# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Compression of chunks: none, bz2, and lz4 in the framing of ROS."""

from __future__ import annotations

import bz2
from typing import Any, Callable

from cassandra_ros.errors import BagError, MissingDependency

COMPRESSIONS = ("none", "bz2", "lz4")
_FEED_BYTES = 1 << 16
"""Compressed bytes handed over at once, so that a bomb is noticed before it fills the memory."""


def compressChunk(name: str, data: bytes) -> bytes:
    """Compress the content of a chunk.

    Args:
        name: One of COMPRESSIONS.
        data: The records of the chunk.

    Raises:
        MissingDependency: lz4, and the package roslz4 is not installed.
    """
    if name == "bz2":
        return bz2.compress(data)
    if name == "lz4":
        return bytes(_roslz4().compress(data))
    return data


MAX_CHUNK_BYTES = 2**30
"""rosbag closes a chunk at 768 KB; only a single larger message makes a larger one."""


def decompressChunk(name: str, data: bytes, size: int, where: str) -> bytes:
    """Give back the content of a chunk.

    Args:
        name: What the chunk's header calls its compression.
        data: The bytes that stand in the file.
        size: Length of the content as the header states it; never more is unpacked.
        where: Subject of the error's sentence.

    Raises:
        BagError: The compression is unknown, or the data does not give ``size`` bytes.
        MissingDependency: lz4, and the package roslz4 is not installed.
    """
    if size > MAX_CHUNK_BYTES:
        raise BagError(
            f"{where} states {size} bytes of content; chunks of over {MAX_CHUNK_BYTES} bytes are "
            "taken for damaged"
        )
    if name == "none":
        content = data
    elif name == "bz2":
        content = _unpack(bz2.BZ2Decompressor().decompress, data, size, where)
    elif name == "lz4":
        content = _unpack(_lz4(), data, size, where)
    else:
        raise BagError(f"{where} is compressed with {name!r}; known are {', '.join(COMPRESSIONS)}")
    if len(content) != size:
        raise BagError(f"{where} is damaged: it holds {len(content)} bytes, not {size}")
    return content


def _unpack(step: Callable[..., bytes], data: bytes, size: int, where: str) -> bytes:
    parts, have, position = [], 0, 0
    try:
        while position < len(data) and have <= size:
            part = step(data[position : position + _FEED_BYTES], size + 1 - have)
            parts.append(part)
            have += len(part)
            position += _FEED_BYTES
    except (OSError, EOFError, ValueError) as exc:
        raise BagError(f"{where} is damaged: its compressed data is not valid ({exc})") from exc
    if have > size:
        raise BagError(f"{where} is damaged: it unpacks to more than {size} bytes")
    return b"".join(parts)


def _lz4() -> Callable[..., bytes]:
    decompressor = _roslz4().LZ4Decompressor()

    def step(data: bytes, max_length: int) -> bytes:
        # At most one block of 4 MiB and 255 times the input comes out, whatever is declared.
        return bytes(decompressor.decompress(data))

    return step


def _roslz4() -> Any:
    try:
        import roslz4
    except ImportError as exc:
        raise MissingDependency(
            "chunks compressed with lz4 need the Python package roslz4: "
            "sudo apt-get install python3-roslz4"
        ) from exc
    return roslz4
