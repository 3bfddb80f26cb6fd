# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Names of indexes, as CREATE INDEX gives them: one for a field of a topic in a keyspace."""

from __future__ import annotations

from typing import Mapping

from cassandra_ros.errors import InvalidName
from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.store.schema import Schema

Named = Mapping[str, TopicMetadata]
"""Metadata of tables, by table."""


class IndexNames:
    """The names of the indexes of a keyspace."""

    def __init__(self, schema: Schema) -> None:
        self._schema = schema

    def known(self) -> dict[str, list[tuple[str, str]]]:
        """Return name -> (topic, field) of each index that bears it, mostly one."""
        return _known(self._schema.tables(fresh=True))

    def give(self, topic: str, field: str, name: str) -> None:
        """Call the index of a field so; it need not be there yet.

        Raises:
            InvalidName: Another index is called so.
            TopicNotFound: The topic is gone.
        """

        def check(tables: Named) -> None:
            for other in _known(tables).get(name, []):
                if other != (topic, field):
                    raise InvalidName(
                        f"the index on {other[0]} ({other[1]}) is called {name} already; choose "
                        "another name"
                    )

        def change(metadata: TopicMetadata) -> TopicMetadata:
            return metadata.with_(index_names={**metadata.index_names, name: field})

        self._schema.changeTopic(topic, change, check)


def _known(tables: Named) -> dict[str, list[tuple[str, str]]]:
    found: dict[str, set[tuple[str, str]]] = {}
    for metadata in tables.values():
        for name, field in _valid(metadata).items():
            found.setdefault(name, set()).add((metadata.topic, field))
    return {name: sorted(indexed) for name, indexed in found.items()}


def _valid(metadata: TopicMetadata) -> dict[str, str]:
    return {name: f for name, f in metadata.index_names.items() if f in metadata.indexes}
