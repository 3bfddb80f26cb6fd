# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What would be recorded, and how: said before, without writing anything."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Mapping, Optional, Sequence

from cassandra_ros.errors import DefinitionError, InvalidOption, InvalidQuery
from cassandra_ros.messages.classes import installed_definition
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.query.protocols import Table
from cassandra_ros.recording.tables import differences
from cassandra_ros.recording.topic_settings import Settings, TopicSettings
from cassandra_ros.recording.unstored import UnstoredTable
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.query_result import Condition


@dataclass(frozen=True)
class PlannedTopic:
    """How one topic would be recorded."""

    topic: str
    msg_type: str
    """'' = nobody publishes it yet."""
    format: str
    ttl: int
    """Seconds until a message expires; 0 = never."""
    stored: bool
    """It has a table of this format already."""
    settings: Sequence[str]
    """What else holds for it."""
    differences: Sequence[str]
    """In which ways what is stored is not as the settings want it."""
    problem: str = ""
    """Why the topic's condition does not fit its type; '' = it fits, or no condition is set."""


def plan_topics(
    catalog: Catalog, settings: Settings, types: Mapping[str, str]
) -> list[PlannedTopic]:
    """Say how topics would be recorded.

    Args:
        types: Topic → its type as the master knows it; '' = it does not.
    """
    tables = list(catalog.keyspace.schema.tables(fresh=True).values())
    found = []
    for topic, msg_type in sorted(types.items()):
        wanted = settings.of(topic)
        fmt = catalog.keyspace.new_tables.format_for(topic, asked=wanted.format)
        own = [m for m in tables if m.topic == topic and m.format == fmt]
        found.append(
            PlannedTopic(
                topic,
                msg_type,
                fmt,
                own[0].ttl if own else wanted.ttl,
                bool(own),
                _described(wanted),
                differences(wanted, own[0]) if own else [],
                _problem(catalog, topic, msg_type, wanted.where) if wanted.where else "",
            )
        )
    return found


def _problem(catalog: Catalog, topic: str, msg_type: str, where: str) -> str:
    """Say why a condition does not fit the fields of a topic; '' = it does, or they are unknown."""
    tables = _known_tables(catalog, topic, msg_type)
    try:
        if tables:
            Condition(where).test(tables)
    except (InvalidQuery, InvalidOption) as exc:
        return f"the condition of topic {topic} cannot be checked: {exc}"
    return ""


def _known_tables(catalog: Catalog, topic: str, msg_type: str) -> Sequence[Table]:
    """Return the installed type as a table, else the tables in which the topic is stored."""
    try:
        if msg_type:
            return [UnstoredTable(api_connection(topic, installed_definition(msg_type), ""))]
    except DefinitionError:  # not installed: its messages bring the definition
        pass
    return catalog.get(topic).tables if catalog.exists(topic) else ()


def _described(wanted: TopicSettings) -> list[str]:
    texts: list[Optional[str]] = [
        f"where {wanted.where}" if wanted.where else None,
        f"at most {wanted.rate_limit:g} Hz" if wanted.rate_limit else None,
        f"key {wanted.key_part}" if wanted.key_part else None,
        f"index on {', '.join(wanted.index)}" if wanted.index else None,
    ]
    return [text for text in texts if text]
