# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the paper measured in 2013 (4.2), on its machine: quoted, never measured here.

Core i5-540M of 2.53 GHz, Samsung SSD PM800, Cassandra 1.1.3, MongoDB 2.0.4, ROS Fuerte, Python 2.7.
"""

from __future__ import annotations

SOURCE = "paper, 2013"

LOOKUP_MS = {
    "Cassandra": {100: 1.71, 1_000_000: 2.03},
    "MongoDB, index": {1_000_000: 4.84},
    "MongoDB": {1_000_000: 551.75},
}
"""Median of 1,000 lookups by key, by messages stored (fig. 6)."""

BAG_SCAN_SEC = {100: 0.0054, 1_000: 0.0546, 10_000: 0.5521, 100_000: 5.52, 1_000_000: 56.43}
"""Median time of a query of a bag file, by messages in it (fig. 7)."""

QUERY_SEC = {"Cassandra": {1_000: 1.55, 4_000: 1.72}}
"""Time of a WHERE clause, by messages that it returned (fig. 7)."""
