# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Planes of messages of which some are stored as differences, and decoded when they are read.

Most readers need few fields, so few planes: to decode all would take longer than to read them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]


class RisingPlanes:
    """A matrix (size, messages) with the methods of an array that readers of planes use.

    Args:
        stored: The matrix as it is stored.
        rises: For each row whether it is stored as differences.
    """

    def __init__(self, stored: Bytes, rises: NDArray[np.bool_]) -> None:
        self._stored, self._rises = stored, rises

    @property
    def shape(self) -> tuple[int, ...]:
        """Size of a message, and number of messages."""
        return self._stored.shape

    @property
    def size(self) -> int:
        """Number of bytes."""
        return self._stored.size

    def __len__(self) -> int:
        return len(self._stored)

    def __getitem__(self, key: Any) -> Bytes:
        """Return rows by a slice or indices of any shape, or with (:, key) columns."""
        if not isinstance(key, tuple):
            return _decoded(self._stored[key], self._rises[key])
        columns = key[1]
        found: Bytes = self._stored[:, columns].copy()
        rising = self._stored[self._rises]
        if isinstance(columns, (int, np.integer)):
            rising = rising[:, : columns + 1]
            found[self._rises] = np.add.reduce(rising, axis=1, dtype=np.uint8)
        else:
            found[self._rises] = np.add.accumulate(rising, axis=1, dtype=np.uint8)[:, columns]
        return found

    @property
    def T(self) -> Bytes:  # noqa: N802 - numpy's name
        """The messages one after the other: (messages, size)."""
        return self[:].T


def _decoded(stored: Bytes, rises: NDArray[np.bool_]) -> Bytes:
    """Return rows of which some are stored as differences."""
    if not rises.any():
        return stored
    found: Bytes = stored.copy()
    found[rises] = np.add.accumulate(stored[rises], axis=-1, dtype=np.uint8)
    return found
