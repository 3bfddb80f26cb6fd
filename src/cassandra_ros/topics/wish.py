# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What addTopic asked for."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Mapping, Optional

from cassandra_ros.messages.definition import Definition
from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.topics.keyspace import defaultBucket


@dataclass(frozen=True)
class Wish:
    """What addTopic asked for; kept until the first message tells the type."""

    format: str
    nodeID: str = ""
    ttl: int = 0
    comment: str = ""
    key_format: str = ""
    """'' = as it is stored, else 'time'."""
    key_part: str = ""
    user: Mapping[str, Any] = field(default_factory=dict)
    asked: bool = True
    """addTopic named the format; else it is the one that is stored."""
    pending: bool = True
    """Added in this process, perhaps without a table yet."""

    def metadata(self, topic: str, definition: Optional[Definition]) -> TopicMetadata:
        """Return what the comment of the topic's table is to say."""
        return TopicMetadata(
            topic=topic,
            msg_type=definition.type if definition else "",
            md5sum=definition.md5sum if definition else "",
            definition=definition.text if definition else "",
            format=self.format,
            bucket_ns=defaultBucket(definition),
            ttl=self.ttl,
            nodeID=self.nodeID,
            comment=self.comment,
            key_format=self.key_format or "time",
            key_part=self.key_part,
            user=self.user,
        )
