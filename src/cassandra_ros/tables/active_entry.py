# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Column ``entry`` of cr_active: the counts of one writer in one bucket, as bytes.

A byte that is 1 if the counts are final; number of messages, bytes, size of the largest, first and
last time, number of odd messages, as big-endian integers of eight bytes; then the names of the
filled shadow columns, with commas between them.
"""

from __future__ import annotations

import struct
from typing import Iterable, NamedTuple, Sequence

_COUNTS = struct.Struct(">?6q")
UNKNOWN = (0, 0, 0, 0, -1, 0)
"""Counts of a bucket of which none were noted yet."""


class ActiveEntry(NamedTuple):
    """Counts of one writer in one bucket."""

    closed: bool
    """Whether the counts are final."""
    counts: Sequence[int] = UNKNOWN
    """Messages, bytes, largest, t_min, t_max, odd: see BucketRow."""
    filled: Iterable[str] = ()

    def encoded(self) -> bytes:
        """Return the value of the column."""
        return _COUNTS.pack(self.closed, *self.counts) + ",".join(sorted(self.filled)).encode()


def decode_entry(entry: bytes) -> ActiveEntry:
    """Return what a value of the column says."""
    closed, *counts = _COUNTS.unpack_from(entry)
    names = entry[_COUNTS.size :]
    return ActiveEntry(closed, counts, names.decode().split(",") if names else ())


def is_closed(entry: bytes | None) -> bool:
    """Return whether the counts of an entry are final; None = no entry."""
    return entry is not None and entry[0] == 1


def messages_in(entry: bytes) -> bytes:
    """Return the number of messages of an entry, as a big-endian integer."""
    return entry[1:9]
