# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Layouts of messages of equal size in a block, chosen for each group by a sample.

- Planes: all first bytes, all second bytes, …. A plane that rises in equal steps, as counters and
  stamps do, is stored as the differences of its bytes.
- Columns of 8 bytes, cut from the ends of the messages. A ``float64`` of a sensor with a few
thousand
  different values then repeats as a whole, while in planes each of its eight bytes repeats alone.
- Rows: plain, one after the other. For long messages that planes would hardly make smaller, such as
  random ``float32``: turning them and back would take half the time of storing them.

The first byte of a group is its layout. For planes one bit each follows: stored as differences.
"""

from __future__ import annotations

from typing import Callable, NamedTuple, Sequence, Union

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.errors import CorruptMessage

Bytes = NDArray[np.uint8]
BytesLike = Union[bytes, memoryview]

_PLANES, _COLUMNS, _ROWS = 0, 1, 2
_UNIT = 8
_SAMPLE_BYTES = 16 * 1024
_SAMPLE_SHARE = 2
"""The sample is at most one in this number of messages of a group."""
_LEAST = 16
"""Minimum number of messages in a sample."""
_SMALL = 4 * 1024
"""Size of a group in bytes below which it is always planes: a sample would cost more than it
saves."""
_WORTH = 0.97
"""Ratio of bytes below which columns are preferred to planes. Fields are read faster from
planes."""
_LONG, _STRETCHES = 1024, 4
"""Minimum size of a message that may be stored as rows, bytes; and number of parts of its
sample."""
_HARDLY = 0.8
"""Ratio of compressed to plain bytes above which planes of such messages are not worth their
time."""


class LaidGroup(NamedTuple):
    """A group that was read."""

    data: BytesLike
    """Its planes, or its messages one after the other."""
    as_planes: bool
    length: int
    """Number of bytes that the group takes in the block."""


def lay_out(wires: Sequence[bytes], cost: Callable[[bytes], int]) -> Sequence[BytesLike]:
    """Return the layout of at least one message of at least one byte, as parts to be joined.

    Args:
        wires: Messages of equal size.
        cost: Returns the compressed size of some bytes.
    """
    count, size = len(wires), len(wires[0])
    few = max(_LEAST, min(count // _SAMPLE_SHARE, _SAMPLE_BYTES // size))
    if size >= _LONG and _saves_little(_rows(wires[:few]), cost):
        return bytes((_ROWS,)), *wires
    rows = _rows(wires)
    if rows.nbytes < _SMALL:
        return bytes(1 + (size + 7) // 8), np.ascontiguousarray(rows.T).tobytes()
    sample = rows[:few]
    steps = np.diff(sample, axis=0)
    still = _counts(steps == 0)
    rises = _counts(steps[1:] == steps[:-1]) > still
    if size >= _UNIT:
        # Of long messages only the ends are tried, or trying would cost more than packing.
        tried = slice(-max(_UNIT, _SAMPLE_BYTES // len(sample) // _UNIT * _UNIT), None)
        ends = sample[:, tried]
        planes, rising = np.array(ends.T, order="C"), rises[tried]
        planes[rising, 1:] = steps[:, tried].T[rising]
        if cost(_columns(ends)) < _WORTH * cost(planes.tobytes()):
            return bytes((_COLUMNS,)), _columns(rows)
    planes = np.array(rows.T, order="C")  # always a copy: rows of one byte are planes already
    if rises.any():
        planes[rises, 1:] = np.diff(planes[rises], axis=1)
    return bytes((_PLANES,)), np.packbits(rises).tobytes(), planes.reshape(-1).data


def _rows(wires: Sequence[bytes]) -> Bytes:
    return np.frombuffer(b"".join(wires), np.uint8).reshape(len(wires), -1)


def read_layout(data: memoryview, size: int, count: int) -> LaidGroup:
    """Read the group at the beginning of some bytes.

    Raises:
        CorruptMessage: The bytes do not hold such a group.
    """
    kind = data[0] if len(data) else -1
    begin = 1 + (size + 7) // 8 if kind == _PLANES else 1
    end = begin + size * count
    if kind not in (_PLANES, _COLUMNS, _ROWS) or len(data) < end:
        raise CorruptMessage(f"a block does not hold {count} messages of {size} bytes as it says")
    if kind == _ROWS:
        return LaidGroup(data[begin:end], False, end)
    if kind == _COLUMNS:
        return LaidGroup(_from_columns(data[begin:end], size, count), False, end)
    rises = np.unpackbits(np.frombuffer(data, np.uint8, begin - 1, 1))[:size].astype(np.bool_)
    if not rises.any():
        return LaidGroup(data[begin:end], True, end)
    planes = np.frombuffer(data, np.uint8, size * count, begin).reshape(size, count).copy()
    planes[rises] = np.add.accumulate(planes[rises], axis=1, dtype=np.uint8)
    return LaidGroup(planes.tobytes(), True, end)


def _saves_little(sample: Bytes, cost: Callable[[bytes], int]) -> bool:
    """Return whether planes of some messages hardly compress."""
    count, size = sample.shape
    width = min(size, _SAMPLE_BYTES // count) // _STRETCHES
    begins = range(0, size - width + 1, (size - width) // (_STRETCHES - 1))
    parts = np.concatenate([sample[:, begin : begin + width] for begin in begins], axis=1)
    return bool(cost(np.ascontiguousarray(parts.T).tobytes()) > _HARDLY * parts.size)


def _counts(found: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Return the number of true values in each column of a matrix."""
    # Row by row: numpy would go along columns one byte at a time.
    counts: NDArray[np.int32] = np.add.reduce(found, axis=0, dtype=np.int32)
    return counts


def _columns(rows: Bytes) -> bytes:
    loose = rows.shape[1] % _UNIT
    units = np.ascontiguousarray(rows[:, loose:]).view("<u8")
    return np.ascontiguousarray(rows[:, :loose].T).tobytes() + units.T.tobytes()


def _from_columns(data: memoryview, size: int, count: int) -> bytes:
    loose = size % _UNIT
    rows = np.empty((count, size), np.uint8)
    rows[:, :loose] = np.frombuffer(data, np.uint8, loose * count).reshape(loose, count).T
    units = np.frombuffer(data, "<u8", size // _UNIT * count, loose * count)
    turned = np.ascontiguousarray(units.reshape(-1, count).T)
    rows[:, loose:] = turned.view(np.uint8).reshape(count, size - loose)
    return rows.tobytes()
