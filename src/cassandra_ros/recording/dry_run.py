# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A plan of a recording: which topics, and how. Nothing is written."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Mapping, Sequence

from cassandra_ros.errors import DefinitionError, InvalidOption, InvalidQuery
from cassandra_ros.messages.classes import installed_definition
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.query.protocols import Table
from cassandra_ros.recording.live_row import LiveTable
from cassandra_ros.recording.table_maker import differences
from cassandra_ros.recording.topic_settings import RecordingSettings, TopicSettings
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.query_result import Condition


@dataclass(frozen=True)
class PlannedTopic:
    """The plan for one topic."""

    topic: str
    msg_type: str
    """'' = it has no publisher yet."""
    format: str
    ttl: int
    """Seconds until a message expires; 0 = never."""
    stored: bool
    """Whether the topic has a table of this format already."""
    settings: Sequence[str]
    """Its other settings, as texts."""
    differences: Sequence[str]
    """Differences between the existing table and the settings, as texts."""
    problem: str = ""
    """Reason why the condition does not fit the topic's type; '' = it fits, or none is set."""


def plan_topics(
    catalog: Catalog, settings: RecordingSettings, types: Mapping[str, str]
) -> list[PlannedTopic]:
    """Return the plan for each topic, sorted by name. A topic with several tables has the first.

    Args:
        types: Type by topic, as the master knows it; '' = the master does not know it.
    """
    tables = list(catalog.keyspace.schema.tables(fresh=True).values())
    plan = []
    for topic, msg_type in sorted(types.items()):
        topic_settings = settings.of(topic)
        fmt = catalog.keyspace.new_tables.format_for(topic, format=topic_settings.format)
        stored = [table for table in tables if table.topic == topic and table.format == fmt]
        plan.append(
            PlannedTopic(
                topic,
                msg_type,
                fmt,
                stored[0].ttl if stored else topic_settings.ttl,
                bool(stored),
                _describe_settings(topic_settings),
                differences(topic_settings, stored[0]) if stored else [],
                _problem(catalog, topic, msg_type, topic_settings.where)
                if topic_settings.where
                else "",
            )
        )
    return plan


def _problem(catalog: Catalog, topic: str, msg_type: str, where: str) -> str:
    """Return why a condition does not fit a topic's fields; '' = it does, or they are unknown."""
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
            return [LiveTable(api_connection(topic, installed_definition(msg_type), ""))]
    except DefinitionError:  # not installed: the definition comes with the messages
        pass
    return catalog.get(topic).tables if catalog.exists(topic) else ()


def _describe_settings(topic_settings: TopicSettings) -> list[str]:
    texts: list[str | None] = [
        f"where {topic_settings.where}" if topic_settings.where else None,
        f"at most {topic_settings.rate_limit:g} Hz" if topic_settings.rate_limit else None,
        f"key {topic_settings.key_part}" if topic_settings.key_part else None,
        f"index on {', '.join(topic_settings.index)}" if topic_settings.index else None,
    ]
    return [text for text in texts if text]
