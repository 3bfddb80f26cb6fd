# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The indexes of one topic: made on any field, filled with what is stored, removed."""

from __future__ import annotations

from typing import Optional

from cassandra_ros.errors import InvalidName, InvalidOption, TopicNotFound
from cassandra_ros.keys import NAMED_FORMATS
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.index_field import IndexField, nearestFields
from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.topics.adder import Adder
from cassandra_ros.topics.index_filling import IndexFilling, Progress
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.topic_table import TopicTable, definitionIn


class TopicIndexes:
    """Makes and removes the indexes of one topic; see CassandraTopic.createIndex.

    Args:
        keyspace: Where the topic is.
        adder: Writes what addData is given.
        topic: The topic's name.
    """

    def __init__(self, keyspace: Keyspace, adder: Adder, topic: str) -> None:
        self._keyspace = keyspace
        self._adder = adder
        self.name = topic

    @property
    def _tables(self) -> list[TopicTable]:
        return self._keyspace.tables.ofTopic(self.name)

    def create(self, field: str, progress: Optional[Progress] = None) -> int:
        """Make an index, or complete it; return how many stored messages were indexed."""
        space = self._keyspace
        space.schema.tables(fresh=True)
        checkIndexable(self.name, self._tables, field)
        space.indexes.add(self.name, field, lambda metadata: _typeOf(metadata, field))
        self._adder.close()  # what it holds open could not be filled
        filling = IndexFilling(space.cassandra, space.directory, space.rows, field, progress)
        return filling.fill(self._tables)

    def has(self, field: str) -> bool:
        """Say whether every table whose type has the field has an index on it."""
        able = [table for table in self._tables if _typeOf(table.metadata, field) is not None]
        return bool(able) and all(field in table.metadata.indexes for table in able)

    def remove(self, field: str) -> None:
        """Remove an index."""
        space = self._keyspace
        space.schema.tables(fresh=True)
        tables = self._tables
        if any(table.valued and table.keyPart().field == field for table in tables):
            raise InvalidOption(
                f"the index on {field} cannot be removed: it is the key_part of topic {self.name}, "
                "and getData finds messages by it"
            )
        listed = any(field in table.metadata.indexes for table in tables)
        if not listed and tables:
            checkIndexable(self.name, tables, field)
        if not space.indexes.drop(self.name, field):
            known = sorted({name for table in tables for name in table.metadata.indexes})
            hint = nearestFields(field, known) if known else "it has none"
            raise InvalidName(f"topic {self.name} has no index on {field!r}; {hint}")


def checkIndexable(topic: str, tables: list[TopicTable], field: str) -> None:
    """Check that an index on a field can be made in at least one of the tables of a topic."""
    if not tables:
        raise TopicNotFound(
            f"topic {topic} has no type yet: its first message fixes it; give index= to addTopic"
        )
    for table in tables:
        checkUnnamed(topic, table.metadata.key_format)
        if table.valued and table.keyPart().digest and table.keyPart().field == field:
            raise InvalidOption(
                f"field {field} is the key_part of topic {topic} and has an index for whole "
                "arrays; one for their elements cannot be made besides"
            )
    if not any(_typeOf(table.metadata, field) for table in tables):
        for table in tables:
            checkField(table.definition, field)
        raise InvalidName(
            f"topic {topic} has no usable definition to find a field {field!r} in: an index "
            "cannot be made"
        )


def checkUnnamed(topic: str, key_format: str) -> None:
    """Check that messages are not kept under names.

    Raises:
        InvalidOption: They are.
    """
    if key_format in NAMED_FORMATS:
        raise InvalidOption(
            f"topic {topic} cannot have an index: its messages are kept under names (key_format "
            f"{key_format}), and which of them an index covers is only noted for stretches of time"
        )


def checkField(definition: Optional[Definition], field: str) -> None:
    """Check that a type has a field that can be indexed.

    Raises:
        InvalidName: It has not; the text gives the nearest.
    """
    if definition is not None:
        IndexField(definition, field, "")


def _typeOf(metadata: TopicMetadata, field: str) -> Optional[str]:
    definition = definitionIn(metadata)
    if definition is None:
        return None
    try:
        return IndexField(definition, field, "").cql_type
    except InvalidName:
        return None
