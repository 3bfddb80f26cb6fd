# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What would be recorded, and how: said before, without writing anything."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Mapping, Optional, Sequence

from cassandra_ros.recording.settings import Settings, TopicSettings
from cassandra_ros.recording.tables import differences
from cassandra_ros.topics.ros_cassandra import RosCassandra


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


def plan_topics(
    ros_cas: RosCassandra, settings: Settings, types: Mapping[str, str]
) -> list[PlannedTopic]:
    """Say how topics would be recorded.

    Args:
        types: Topic → its type as the master knows it; '' = it does not.
    """
    tables = list(ros_cas.parts.schema.tables(fresh=True).values())
    found = []
    for topic, msg_type in sorted(types.items()):
        wanted = settings.of(topic)
        fmt = ros_cas.parts.format_for(topic, asked=wanted.format)
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
            )
        )
    return found


def _described(wanted: TopicSettings) -> list[str]:
    texts: list[Optional[str]] = [
        f"where {wanted.where}" if wanted.where else None,
        f"at most {wanted.rate_limit:g} Hz" if wanted.rate_limit else None,
        f"key {wanted.key_part}" if wanted.key_part else None,
        f"index on {', '.join(wanted.index)}" if wanted.index else None,
    ]
    return [text for text in texts if text]
