# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Replacement of a topic's tables by a new one, which is filled before readers see it."""

from __future__ import annotations

from typing import Callable, Sequence

from cassandra_ros.errors import SchemaConflict
from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.store.tables.schema import CACHE_SEC, Planner, Schema

SETTLE_SEC = CACHE_SEC + 1.0
"""Time after which every client has read the changed comments, s."""


def clear(schema: Schema, topic: str, forget: Callable[[str], None]) -> None:
    """Drop the tables of a topic that are not read: conversions that were killed have left them.

    Args:
        forget: Deletes the entries of a table; see ``drop``.
    """
    every = schema.listing(fresh=True).every
    drop(schema, sorted(name for name, m in every.items() if m.topic == topic), forget)


def begin(
    schema: Schema, plan: Planner, topic: str, olds: Sequence[str]
) -> tuple[str, TopicMetadata]:
    """Make the table that is to replace ``olds``; return its name and metadata.

    After SETTLE_SEC no client begins to write into the old tables, or to delete in them.

    Args:
        plan: Called under the lock with the metadata of the old tables.

    Raises:
        SchemaConflict: An old table is not read any more, or is being replaced already.
    """
    with schema.lock() as lock:
        listing = schema.listing(fresh=True)
        for old in olds:
            if old not in listing.visible or old in listing.leaving:
                raise SchemaConflict(
                    f"the tables of topic {topic} were removed or replaced by another "
                    "client just now; nothing was converted. Convert it again"
                )
        metadata, columns, shadows = plan([listing.visible[old] for old in olds])
        earlier = (name for old in olds for name in listing.visible[old].replaces)
        replaces = tuple(dict.fromkeys([*olds, *earlier]))
        metadata = metadata.with_(filling=True, replaces=replaces)
        name = schema.create((metadata, columns, shadows), lock)
    return name, schema.listing().every[name]


def finish(schema: Schema, name: str, olds: Sequence[str]) -> None:
    """Let a table replace the old ones for all readers, by one change of its comment.

    Raises:
        SchemaConflict: The table or an old one was dropped or replaced meanwhile.
    """
    with schema.lock() as lock:
        listing = schema.listing(fresh=True)
        metadata = listing.every.get(name)
        if metadata is None or not all(listing.leaving.get(old) == name for old in olds):
            topic = "the topic" if metadata is None else f"topic {metadata.topic}"
            raise SchemaConflict(
                f"{topic} was removed, or its tables changed by another client, while it was "
                "converted; nothing was lost by that. Convert it again"
            )
        schema.set_comment(name, metadata.with_(filling=False), lock)
    schema.tables(fresh=True)


def drop(schema: Schema, names: Sequence[str], forget: Callable[[str], None] | None = None) -> None:
    """Drop those of the tables that are not read.

    Args:
        forget: Called with the name of each table that was never filled, before it is dropped: if
            the program dies between the two, the next conversion finds the table and does both.
            After the drop its name stands nowhere. The names of the others are in the comment of
            the table that replaced them.
    """
    with schema.lock() as lock:
        listing = schema.listing(fresh=True)
        for name in names:
            if name in listing.visible:
                continue
            if forget is not None and name in listing.every and listing.every[name].filling:
                forget(name)
            schema.drop([name], lock)
    schema.tables(fresh=True)
