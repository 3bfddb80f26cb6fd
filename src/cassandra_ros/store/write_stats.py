# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What became of rows that were to be written."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable

from cassandra_ros.errors import CassandraRosError

LossCallback = Callable[[str, int, CassandraRosError], None]
"""Takes (topic, rows, why) of what was given up; called on any thread."""


@dataclass
class WriteStats:
    """What became of the rows of one table so far."""

    stored: int = 0
    bytes: int = 0
    """Serialised bytes of the stored messages."""
    lost: int = 0
    reason: str = ""
    """Why the first lost ones were lost."""
