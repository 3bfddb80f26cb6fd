# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Tables that replace others: which of them are read, and where the messages are now.

While a new table is being filled, its comment names the tables that it replaces. Everything follows
from this comment: one change of it, from filling to filled, makes the new table visible and the old
tables invisible at once. So a client that reads the comments sees either the old tables or the new
one.
"""

from __future__ import annotations

from typing import Mapping

from cassandra_ros.errors import SchemaConflict
from cassandra_ros.metadata import TopicMetadata


class Listing:
    """The topic tables of a keyspace, by their comments at one moment. Immutable.

    Attributes:
        every: Name → metadata of all tables.
        visible: Name → metadata of the tables that are read.
        heirs: Table that was replaced → the table that has its messages now.
        leaving: Table that is read → the table that is being filled to replace it.
        by_topic: Topic → names of its tables that are read, sorted.
    """

    def __init__(self, every: Mapping[str, TopicMetadata]) -> None:
        self.every = every
        filled = {name: m for name, m in every.items() if not m.filling}
        replaced = {old for m in filled.values() for old in m.replaces}
        self.visible = {name: m for name, m in filled.items() if name not in replaced}
        self.heirs = {old: name for name, m in self.visible.items() for old in m.replaces}
        self.leaving = {
            old: name
            for name, m in every.items()
            if m.filling
            for old in m.replaces
            if old in self.visible
        }
        self.by_topic: dict[str, list[str]] = {}
        for name, m in sorted(self.visible.items()):
            self.by_topic.setdefault(m.topic, []).append(name)

    def takes_rows(self, table: str) -> bool:
        """Return whether new messages may go into a table; not if it is being replaced."""
        return table not in self.leaving and table not in self.heirs

    def check_staying(self, table: str) -> None:
        """Raise SchemaConflict if a table was replaced or is being replaced."""
        heir = self.leaving.get(table) or self.heirs.get(table)
        if heir is None:
            return
        metadata = self.every[heir]
        if not metadata.filling:
            raise SchemaConflict(
                f"topic {metadata.topic} was converted to format {metadata.format} meanwhile; "
                "do it again"
            )
        raise SchemaConflict(
            f"topic {metadata.topic} is being converted to format {metadata.format}; do it again "
            f"when that has ended. If no client is at it any more, 'cassandra_bag convert "
            f"{metadata.topic} --format {metadata.format}' finishes it"
        )
