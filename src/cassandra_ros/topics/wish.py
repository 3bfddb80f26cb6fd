# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What addTopic asked for."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Mapping, Optional

from cassandra_ros.errors import TopicExists
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
    index: tuple[str, ...] = ()
    """Fields that are to have an index."""
    asked: bool = True
    """addTopic named the format; else it is the one that is stored."""
    pending: bool = True
    """Added in this process, perhaps without a table yet."""

    def check(self, metadata: TopicMetadata, definition: Optional[Definition]) -> None:
        """Compare with what is stored.

        Raises:
            TopicExists: The topic is stored in another way than asked for.
        """
        wrong = []
        if definition is not None and definition.md5sum != metadata.md5sum:
            wrong.append(f"type {metadata.msg_type} [{metadata.md5sum}]")
        key = (self.key_format, self.key_part)
        if self.key_format and key != (metadata.key_format, metadata.key_part):
            wrong.append(f"key_format {metadata.key_format} {metadata.key_part}".rstrip())
        if self.ttl and self.ttl != metadata.ttl:
            wrong.append(f"ttl {metadata.ttl} s")
        if wrong:
            raise TopicExists(
                f"topic {metadata.topic} is stored already with {', '.join(wrong)}; give the "
                "same, or remove the topic first"
            )

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
            indexes=dict.fromkeys(self.index, ""),
        )
