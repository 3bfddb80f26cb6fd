# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The topics of a keyspace by name: added, found, listed, removed."""

from __future__ import annotations

import difflib
import logging
import re
import threading
from dataclasses import replace
from typing import Mapping, Optional

from cassandra_ros.arguments import check_topic
from cassandra_ros.errors import (
    CassandraRosError,
    DefinitionError,
    InvalidName,
    TopicExists,
    TopicNotFound,
)
from cassandra_ros.messages.classes import installed_definition
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.graph import topic_type
from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.topics.cassandra_topic import CassandraTopic
from cassandra_ros.topics.indexes import check_unnamed
from cassandra_ros.topics.keyspace import Keyspace, Wish
from cassandra_ros.topics.message_writer import Adder
from cassandra_ros.topics.topic_table import TopicTable

_log = logging.getLogger(__name__)


class Catalog:
    """Finds topics by name, with or without the leading slash. Thread-safe.

    Topics that were added before their type is known live here until their first message.
    """

    def __init__(self, keyspace: Keyspace, adder: Adder) -> None:
        self._keyspace = keyspace
        self._adder = adder
        self._pending: dict[str, Wish] = {}
        self._mutex = threading.Lock()

    def add(self, topic: str, wish: Wish, msg_type: Optional[str]) -> CassandraTopic:
        """Make a topic, or find it; see RosCassandra.addTopic."""
        if wish.index:
            check_unnamed(topic, wish.key_format)
        self._keyspace.schema.tables(fresh=True)
        format_name = self._keyspace.format_for(topic, asked=wish.format)
        wish = replace(wish, format=format_name, asked=wish.format != "")
        stored = self._keyspace.tables.of_topic(topic)
        definition = self._definition_for(topic, msg_type, known=bool(stored))
        for table in stored:
            wish.check(table.metadata, definition)
        found = CassandraTopic(self._keyspace, self._adder, topic, wish)
        if not any(table.metadata.format == wish.format for table in stored):
            self._keyspace.schema.seen.discard((topic, wish.format))
            with self._mutex:
                self._pending[topic] = wish
        if definition is not None:
            try:
                self._keyspace.wished_table(topic, wish, definition)
            except CassandraRosError:
                with self._mutex:
                    self._pending.pop(topic, None)
                raise
        for field in wish.index:
            if found.tables and not found.hasIndex(field):
                found.createIndex(field)
        return found

    def _definition_for(
        self, topic: str, msg_type: Optional[str], known: bool
    ) -> Optional[Definition]:
        if msg_type is not None:
            return installed_definition(msg_type)
        found = None if known else topic_type(topic)
        try:
            return None if found is None else installed_definition(found)
        except DefinitionError as exc:
            _log.info("the type of topic %s is fixed by its first message: %s", topic, exc)
            return None

    def get(self, topic: str) -> CassandraTopic:
        """Find a topic.

        Raises:
            TopicNotFound: There is none; the text gives the nearest names.
        """
        name = self._find(topic, fresh=False) or self._find(topic, fresh=True)
        if name is not None:
            return self._topic(name)
        names = self.names()
        near = difflib.get_close_matches(topic, names, n=3, cutoff=0.5)
        hint = f"did you mean {', '.join(near)}?" if near else f"it holds {len(names)} topics"
        if not names:
            hint = self._keyspace.side_tables.absence() or hint
        raise TopicNotFound(
            f"topic {topic!r} is not stored in keyspace {self._keyspace.name}; {hint}"
        )

    def exists(self, topic: str) -> bool:
        """Say whether get would find the topic."""
        return self._find(topic, fresh=True) is not None

    def all(self, pattern: Optional[str]) -> list[CassandraTopic]:
        """List the topics whose whole name matches a regular expression, sorted."""
        try:
            wanted = re.compile(".*" if pattern is None else pattern, re.DOTALL)
        except (re.error, OverflowError, RecursionError) as exc:
            raise InvalidName(f"{pattern!r:.80} is not a regular expression: {exc}") from exc
        return [self._topic(name) for name in sorted(self.names()) if wanted.fullmatch(name)]

    def names(self, *, fresh: bool = True) -> set[str]:
        """List the names of all topics."""
        tables = self._keyspace.schema.tables(fresh=fresh)
        with self._mutex:
            for name, wish in list(self._pending.items()):
                if (name, wish.format) in self._keyspace.schema.seen:
                    del self._pending[name]  # its first message has come
            return {metadata.topic for metadata in tables.values()} | set(self._pending)

    def readable_tables(self) -> list[TopicTable]:
        """List the tables of all topics; one whose definition is unusable is left out, and said."""
        found: list[TopicTable] = []
        for topic in self.all(None):
            try:
                found.extend(topic.tables)
            except DefinitionError as exc:
                _log.error("topic %s is left out, it cannot be read here: %s", topic.name, exc)
        return found

    def remove(self, topic: str) -> None:
        """Drop a topic with all its messages."""
        name = self.get(topic).name
        self._drop(name, renew=False)
        with self._mutex:
            self._pending.pop(name, None)

    def truncate(self, topic: str) -> None:
        """Remove all messages of a topic, but not the topic."""
        self._drop(self.get(topic).name, renew=True)

    def _drop(self, name: str, renew: bool) -> None:
        self._adder.close()
        space = self._keyspace
        for table in space.schema.drop_topic(name, renew=renew):
            space.directory.forget(table)
            space.registry.forget(table)

    def rename(self, topic: str, new_name: str) -> None:
        """Give a topic another name."""
        name = self.get(topic).name
        if name in _spellings(new_name):
            raise TopicExists(
                f"topic {name} is found as {new_name} already, for the leading slash may be left "
                "out: give another name"
            )

        def check(tables: Mapping[str, TopicMetadata]) -> None:
            if new_name in self._pending or any(m.topic == new_name for m in tables.values()):
                raise TopicExists(
                    f"topic {name} cannot be renamed: {new_name} is stored already; remove or "
                    "rename that first"
                )

        with self._mutex:
            wish = self._pending.get(name)
        if wish is None or self._keyspace.tables.of_topic(name):
            self._keyspace.schema.change_topic(name, lambda m: m.with_(topic=new_name), check)
        else:
            check(self._keyspace.schema.tables(fresh=True))
        self._adder.close()
        with self._mutex:
            if self._pending.pop(name, None) is not None and wish is not None:
                self._pending[new_name] = wish

    def _find(self, topic: str, fresh: bool) -> Optional[str]:
        check_topic(topic)
        names = self.names(fresh=fresh)
        return next((name for name in _spellings(topic) if name in names), None)

    def _topic(self, name: str) -> CassandraTopic:
        with self._mutex:
            wish = self._pending.get(name)
        # By the comments alone: one table that cannot be read must not hide the other topics.
        tables = [m for _, m in sorted(self._keyspace.schema.tables().items()) if m.topic == name]
        if wish is None and not tables:
            raise TopicNotFound(f"topic {name} was removed from keyspace {self._keyspace.name}")
        if wish is None:
            wish = Wish.stored(tables[0], self._keyspace.format_for(name))
        wish = replace(wish, pending=not tables)
        return CassandraTopic(self._keyspace, self._adder, name, wish)


def _spellings(topic: str) -> tuple[str, str]:
    """Return the names that a topic is looked for by: the given one first."""
    return topic, topic[1:] if topic.startswith("/") else "/" + topic
