# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What stands before the columns of the format in the rows of a page, read at once."""

from __future__ import annotations

import struct
from itertools import repeat
from typing import Iterable, NamedTuple, Optional, Tuple

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.store.raw_page import Places, RawPage

_SIZED_AT = 40
"""Where in a listing the bytes of ``_size`` lie, behind three columns of eight bytes and its own
size."""
_BEGIN = struct.pack(">i", 8)
"""With which a listing begins: the size of ``_t``."""
_HEAD = np.dtype(
    [
        ("t_size", ">i4"),
        ("t", ">i8"),
        ("seq_size", ">i4"),
        ("seq", ">i8"),
        ("conn_size", ">i4"),
        ("conn", ">i8"),
        ("size_size", ">i4"),
        ("size", ">i4"),
        ("nchunks", ">i4"),
        ("crc", ">i4"),
        ("odd", ">i4"),
        ("raw", ">i4"),
    ]
)
"""A listing up to the columns of the format, where nothing is odd: each value behind its size."""
_RECEIVED = np.dtype([*_HEAD.descr, ("received_size", ">i4"), ("received", ">i8")])
_MARKS = {
    **dict.fromkeys(("t_size", "seq_size", "conn_size", "received_size"), 8),
    **dict.fromkeys(("nchunks", "crc", "odd", "raw"), -1),
    "size_size": 4,
}
"""What stands there then."""


class RowHeads(NamedTuple):
    """Where the rows of a page lie, and what our own columns say."""

    starts: Places
    begins: Places
    """Where the columns of the format begin."""
    ends: Places
    sizes: NDArray[np.int64]
    """Bytes of the messages."""
    values: Iterable[Tuple[bool, int, int, int, int, int]]
    """Of each row whether it is one in which nothing is odd; then ``_t``, ``_seq``, ``_conn``,
    ``_size`` and when the message was received, -1 = at ``_t``."""


def read_heads(page: RawPage, with_received: bool) -> Optional[RowHeads]:
    """Read our own columns of listings; None where they cannot be told apart.

    Where a row begins is a guess, see RawPage.bounds.
    """
    bounds, head = page.bounds(_SIZED_AT, _BEGIN), _RECEIVED if with_received else _HEAD
    if bounds is None:
        return None
    (starts, ends), data = bounds, np.frombuffer(page.body, np.uint8)
    fits = starts + head.itemsize <= ends
    shape = max(1, len(data) - head.itemsize + 1), head.itemsize
    views = np.lib.stride_tricks.as_strided(data, shape, (1, 1), writeable=False)
    heads = views[np.where(fits, starts, 0)].view(head)[:, 0]
    for name, wanted in _MARKS.items():
        if name in (head.names or ()):
            fits &= heads[name] == wanted
    received = heads["received"].tolist() if with_received else repeat(-1)
    own = (heads[name].tolist() for name in ("t", "seq", "conn", "size"))
    values = zip(fits.tolist(), *own, received)
    return RowHeads(starts, starts + head.itemsize, ends, heads["size"].astype(np.int64), values)
