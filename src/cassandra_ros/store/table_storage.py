# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""How the files of a table are merged, and how long its rows stay."""

from __future__ import annotations

_WINDOWS = 25


def storage(ttl: int, margin: int) -> str:
    """Return the options of a table for CQL.

    Args:
        ttl: Seconds until a message expires; 0 = never.
        margin: How much longer the rows of this table stay, seconds.
    """
    if not ttl:
        return (
            "compaction = {'class': 'UnifiedCompactionStrategy', 'scaling_parameters': 'T4'} "
            "AND default_time_to_live = 0"
        )
    minutes = max(1, ttl // _WINDOWS // 60)
    return (
        "compaction = {'class': 'TimeWindowCompactionStrategy', "
        f"'compaction_window_unit': 'MINUTES', 'compaction_window_size': {minutes}}} "
        f"AND default_time_to_live = {ttl + margin} AND gc_grace_seconds = 10800"
    )
