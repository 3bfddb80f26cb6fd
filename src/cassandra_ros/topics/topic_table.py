# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A topic table with its ROS side: the definition and the format that its columns follow."""

from __future__ import annotations

import logging
import threading
from typing import Optional

from cassandra_ros.errors import DefinitionError
from cassandra_ros.formats.cassandra_topic_ import CassandraTopic_
from cassandra_ros.formats.table import formatClass
from cassandra_ros.messages.definition import Definition, parseDefinition
from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.store.connection import Cassandra
from cassandra_ros.store.row_table import RowTable
from cassandra_ros.store.schema import Schema

_log = logging.getLogger(__name__)


class TopicTable(RowTable):
    """Rows of one topic, one md5 and one format."""

    def __init__(
        self,
        cassandra: Cassandra,
        keyspace: str,
        name: str,
        metadata: TopicMetadata,
        definition: Optional[Definition],
    ) -> None:
        self.definition = definition
        """None where the stored definition is not one; the rows are bytes then."""
        self.format: CassandraTopic_ = formatClass(metadata.format)(
            metadata.msg_type, metadata.md5sum, definition
        )
        columns = tuple(self.format.getColValidationClasses())
        super().__init__(cassandra, keyspace, name, metadata, columns)


class TopicTables:
    """The topic tables of a keyspace as objects, made once each. Thread-safe."""

    def __init__(self, cassandra: Cassandra, schema: Schema) -> None:
        self._cassandra = cassandra
        self._schema = schema
        self._made: dict[str, TopicTable] = {}
        self._mutex = threading.Lock()

    def get(self, name: str, metadata: TopicMetadata) -> TopicTable:
        """Return the object of a table; its metadata follow the comment."""
        with self._mutex:
            table = self._made.get(name)
            if table is None:
                definition = _definition(metadata)
                table = TopicTable(
                    self._cassandra, self._schema.keyspace, name, metadata, definition
                )
                self._made[name] = table
            table.metadata = metadata
            return table

    def byName(self, name: str) -> Optional[TopicTable]:
        """Return a table by its name, or None where there is none of this name now."""
        metadata = self._schema.tables().get(name)
        return None if metadata is None else self.get(name, metadata)

    def ofTopic(self, topic: str) -> list[TopicTable]:
        """List the tables of a topic: one for each md5 and format."""
        tables = sorted(self._schema.tables().items())
        return [self.get(name, m) for name, m in tables if m.topic == topic]


def _definition(metadata: TopicMetadata) -> Optional[Definition]:
    try:
        return parseDefinition(metadata.msg_type, metadata.definition, metadata.md5sum)
    except DefinitionError as exc:
        _log.debug("topic %s has no usable definition: %s", metadata.topic, exc)
        return None
