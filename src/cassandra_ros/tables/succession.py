# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Tables that take the place of others: which are read, and where the messages of the others lie.

A table that is filled unseen names in its comment those that it replaces. All follows from that one
comment: by the one change of it, from filling to filled, the table becomes visible and the others
invisible, at once. So whoever reads the comments sees the old tables or the new one,
never both and never neither.
"""

from __future__ import annotations

from typing import Mapping

from cassandra_ros.errors import SchemaConflict
from cassandra_ros.metadata import TopicMetadata


class Listing:
    """The topic tables of a keyspace, as their comments are at one moment. Never changed.

    Attributes:
        every: Name → metadata of all of them.
        visible: Those that are read.
        heirs: Table that was replaced → the one that has its messages now.
        leaving: Table that is read → the one that is being filled to replace it.
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
        """Say whether new messages may go into a table: not into one that others replace."""
        return table not in self.leaving and table not in self.heirs

    def check_staying(self, table: str) -> None:
        """Raise SchemaConflict where a table is, or was, being replaced."""
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
            f"when that has ended. Where nobody does it any more, 'cassandra_bag convert "
            f"{metadata.topic} --format {metadata.format}' brings it to its end"
        )
