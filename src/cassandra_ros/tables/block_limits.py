# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""How much a block holds at the most."""

from __future__ import annotations

from typing import NamedTuple

MAX_MESSAGES = 1024
MAX_BYTES = 256 * 1024
"""Of serialised messages in a block."""
MIN_BYTES = 16 * 1024
ALL_BYTES = 64 * 1024 * 1024
"""What the blocks of all connections of a bag may hold together while they are filled."""
ALONE_BYTES = 64 * 1024
"""A larger message is a block of its own."""


class Limits(NamedTuple):
    """Most of what one block holds."""

    messages: int = MAX_MESSAGES
    bytes: int = MAX_BYTES


FULL = Limits()


def limits_for(connections: int) -> Limits:
    """Return the limits of blocks where so many are filled at once, in bounded memory."""
    nbytes = max(MIN_BYTES, min(MAX_BYTES, ALL_BYTES // max(connections, 1)))
    # A message takes some memory besides its bytes.
    return Limits(nbytes * MAX_MESSAGES // MAX_BYTES, nbytes)
