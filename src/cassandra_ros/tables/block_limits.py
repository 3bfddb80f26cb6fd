# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Maximum size of a block."""

from __future__ import annotations

from typing import NamedTuple

MAX_MESSAGES = 1024
MAX_BYTES = 256 * 1024
"""Maximum number of serialised bytes in a block."""
MIN_BYTES = 16 * 1024
ALL_BYTES = 64 * 1024 * 1024
"""Maximum number of bytes in all blocks of a bag together while they are being filled."""
ALONE_BYTES = 64 * 1024
"""Size from which a message gets a block of its own, bytes."""

MAX_CONTENT_BYTES = 16 * 1024 * 1024
"""Maximum size of what a block says that it holds, packed and serialised, bytes. A larger one was
changed; blocks that this package writes have at most a thirtieth of it."""


class Limits(NamedTuple):
    """Maximum number of messages and of serialised bytes in one block."""

    messages: int = MAX_MESSAGES
    bytes: int = MAX_BYTES


FULL = Limits()


def limits_for(connections: int) -> Limits:
    """Return the limits of blocks for ``connections`` blocks that are filled at the same time."""
    nbytes = max(MIN_BYTES, min(MAX_BYTES, ALL_BYTES // max(connections, 1)))
    # Each message takes some memory in addition to its bytes.
    return Limits(nbytes * MAX_MESSAGES // MAX_BYTES, nbytes)
