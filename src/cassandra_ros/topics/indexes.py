# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The indexes of one topic: made on any field, filled with what is stored, removed."""

from __future__ import annotations

from typing import Optional

from cassandra_ros.arguments import check_field
from cassandra_ros.errors import InvalidName, InvalidOption, TopicNotFound
from cassandra_ros.keys import NAMED_FORMATS
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.index_field import IndexField, nearestFields
from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.topics.adder import Adder
from cassandra_ros.topics.index_filling import IndexFilling, Progress
from cassandra_ros.topics.topic_facts import TopicFacts
from cassandra_ros.topics.topic_table import TopicTable, definitionIn


class TopicIndexes(TopicFacts):
    """Indexes of one topic; see CassandraTopic."""

    _adder: Adder
    """Writes what addData is given; CassandraTopic has it."""

    def createIndex(self, field: str, progress: Optional[Progress] = None) -> int:
        """Make an index on a field, so that conditions on it read only the rows that they find.

        Others may record the topic meanwhile, and their rows are found in any case: a bucket that
        a writer has open is read without the index. Calling again for an index that is there
        goes on where it was interrupted, and takes in what was being written the last time.

        Args:
            field: Dotted path, as 'linear.x'; in an array of messages, as
                'transforms.child_frame_id', or an array of numbers or texts, it finds the
                messages that contain a value. Texts over 1 KiB, arrays over 256 elements and NaN
                are not indexed; their messages are read besides.
            progress: Called with (rows done, rows in all).

        Returns:
            How many stored messages were indexed.

        Raises:
            InvalidName: The type has no such field, or it cannot be indexed.
            InvalidOption: The messages are kept under names, or the field is an array that is the
                key.
            StoreUnavailable: Cassandra is rewriting the files of the topic (an index made
                meanwhile could miss rows), or is busy with other indexes; ask again later.
            TopicNotFound: The topic is gone, or has no type yet.
        """
        check_field(field)
        space = self._keyspace
        space.schema.tables(fresh=True)
        checkIndexable(self.name, self.tables, field)
        space.indexes.add(self.name, field, lambda metadata: _typeOf(metadata, field))
        self._adder.close()  # what it holds open could not be filled
        filling = IndexFilling(space.cassandra, space.directory, space.rows, field, progress)
        return filling.fill(self.tables)

    def hasIndex(self, field: str) -> bool:
        """Say whether every table of the topic whose type has the field has an index on it."""
        check_field(field)
        able = [table for table in self.tables if _typeOf(table.metadata, field) is not None]
        return bool(able) and all(field in table.metadata.indexes for table in able)

    def removeIndex(self, field: str) -> None:
        """Remove an index. The messages stay as they are.

        The column that carried it stays in the table: who is recording goes on filling it until
        its next stretch of time.

        Raises:
            InvalidName: There is no such index.
            InvalidOption: The key of the messages needs it.
            TopicNotFound: The topic is gone.
        """
        check_field(field)
        space = self._keyspace
        space.schema.tables(fresh=True)
        tables = self.tables
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
