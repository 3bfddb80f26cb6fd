# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What every topic's table has: its columns, how files are merged, how long rows stay."""

from __future__ import annotations

from typing import Mapping

from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.store.names import quoteName, quoteText

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
_CHUNK_TTL_MARGIN_SEC = 86_400
_UNFINISHED = (
    "cassandra_ros makes the indexes of this table; one that stays like this was left by a "
    "client that died, is empty, and may be dropped"
)


def _storage(ttl: int, margin: int, *, merged: bool = True) -> str:
    """Return the options of a table for CQL.

    Args:
        ttl: Seconds until a message expires; 0 = never.
        margin: How much longer the rows of this table stay, seconds.
        merged: Whether its files are merged.
    """
    enabled = "" if merged else ", 'enabled': 'false'"
    if not ttl:
        return (
            "compaction = {'class': 'UnifiedCompactionStrategy', 'scaling_parameters': 'T4'"
            f"{enabled}}} AND default_time_to_live = 0"
        )
    minutes = max(1, ttl // _WINDOWS // 60)
    return (
        "compaction = {'class': 'TimeWindowCompactionStrategy', "
        f"'compaction_window_unit': 'MINUTES', 'compaction_window_size': {minutes}{enabled}}} "
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


def createTable(
    qualified: str, metadata: TopicMetadata, columns: Mapping[str, str], *, finished: bool
) -> str:
    """Return the CQL that makes the table of a topic.

    Args:
        qualified: Its name, quoted.
        metadata: For its comment, by which it is found.
        columns: All of them, name → CQL type.
        finished: Nothing is to be done before it is found and its files are merged.
    """
    listing = ", ".join(f"{quoteName(c)} {cql}" for c, cql in columns.items())
    comment = metadata.toComment() if finished else _UNFINISHED
    return (
        f"CREATE TABLE {qualified} ({listing}, "
        f'PRIMARY KEY (("_node", "{metadata.partition}"), "_t", "_seq")) '
        f"WITH comment = {quoteText(comment)} AND {_storage(metadata.ttl, 0, merged=finished)} "
        "AND compression = {'class': 'LZ4Compressor', 'chunk_length_in_kb': 16}"
    )


def finishTable(qualified: str, metadata: TopicMetadata, *, merged: bool) -> str:
    """Return the CQL that lets a table be found that was not finished when it was made."""
    return (
        f"ALTER TABLE {qualified} WITH comment = {quoteText(metadata.toComment())} "
        f"AND {_storage(metadata.ttl, 0, merged=merged)}"
    )


def createChunkTable(qualified: str, table: str, metadata: TopicMetadata) -> str:
    """Return the CQL that makes the table for the large messages of a topic's table."""
    partition = metadata.partition
    return (
        f'CREATE TABLE {qualified} ("_node" text, "{partition}" {KEY_TYPES[partition]}, '
        '"_t" bigint, "_seq" bigint, "_chunk" int, "_data" blob, '
        f'PRIMARY KEY (("_node", "{partition}", "_t", "_seq"), "_chunk")) '
        f"WITH comment = {quoteText(f'cassandra_ros chunks of {table}')} "
        f"AND {_storage(metadata.ttl, _CHUNK_TTL_MARGIN_SEC)} "
        "AND compression = {'class': 'LZ4Compressor', 'chunk_length_in_kb': 64, "
        "'min_compress_ratio': 1.1} AND speculative_retry = 'NEVER'"
    )
