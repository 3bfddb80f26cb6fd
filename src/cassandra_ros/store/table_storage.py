# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What every topic's table has: its columns, how files are merged, how long rows stay."""

from __future__ import annotations

from cassandra_ros.metadata import TopicMetadata

OWN_COLUMNS = {
    "_conn": "bigint",
    "_size": "int",
    "_nchunks": "int",
    "_crc": "bigint",
    "_odd": "boolean",
    "_raw": "blob",
}
KEY_TYPES = {"_bucket": "bigint", "_key": "text"}
"""Second part of the partition key: a stretch of time, or the name of a message."""
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


def ownColumns(metadata: TopicMetadata) -> dict[str, str]:
    """Return the columns that the table of a topic has in every format: name → CQL type."""
    partition = metadata.partition
    return {
        **{"_node": "text", partition: KEY_TYPES[partition], "_t": "bigint", "_seq": "bigint"},
        **OWN_COLUMNS,
        **metadata.receivedColumns,
    }
