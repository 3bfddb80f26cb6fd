# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A message on its way into a table, and what the table's indexes hold of it."""

from __future__ import annotations

import struct
from typing import Callable, NamedTuple, Optional, Sequence, Tuple

Indexed = Tuple[Sequence[Optional[bytes]], bool]
"""Encoded values of the shadow columns (None = unset), and whether the row must be marked odd."""

_PACK = struct.Struct(">qqqi")
_SPLIT = struct.Struct("8s8s8s4s")


class NewRow(NamedTuple):
    """A message on its way into a table."""

    t: int
    """Key time, ns; 0 where equal messages are kept once."""
    seq: int
    """Writer id << 32 | counter, fixed before the first attempt; 0 as above."""
    conn: int
    wire: bytes
    columns: Sequence[bytes | None]
    """Encoded values of the format's columns, and of those that say when it was received; None =
    unset."""
    odd: bool
    raw: bytes | None
    name: str = ""


class Shadows(NamedTuple):
    """The columns that carry a table's indexes."""

    names: tuple[str, ...]
    values: Callable[[bytes], Indexed]
    """From the serialised message."""


def encodeOwn(t: int, seq: int, conn: int, size: int) -> tuple[bytes, ...]:
    """Encode ``_t``, ``_seq``, ``_conn`` and ``_size`` as Cassandra stores them."""
    return _SPLIT.unpack(_PACK.pack(t, seq, conn, size))
