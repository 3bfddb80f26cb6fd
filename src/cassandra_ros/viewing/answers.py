# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a handler may return: anything JSON can hold, or one of these.

Of the JSON ours is strict: NaN and the infinities, which JSON does not know, are refused. Who may
meet them writes null or a text.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Iterator, Mapping, Sequence, Union

Json = Union[None, bool, int, float, str, "Sequence[Json]", "Mapping[str, Json]"]

BYTES = "application/octet-stream"


@dataclass(frozen=True)
class Bytes:
    """A body that is small and whole."""

    data: bytes
    content_type: str = BYTES
    headers: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Stream:
    """A body that is made while it is sent, never faster than the browser takes it.

    The chunks are asked for one after the other, each on some thread of the pool. Where the browser
    goes away the iterator is closed. Until the first chunk is there an error is told as one; after
    it the connection is cut, so that nobody takes a part for the whole.
    """

    chunks: Iterator[bytes]
    content_type: str = BYTES
    headers: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class SpooledFile:
    """A finished file on our disk, of which a browser may ask for parts (Range, If-Range, HEAD)."""

    path: Path
    name: str
    """As which it is saved, like 'window.bag'."""
    content_type: str = BYTES
    etag: str = ""
    """Of the content, without quotes; '' = of the file's time and size."""


Answer = Union[Json, Bytes, Stream, SpooledFile]
