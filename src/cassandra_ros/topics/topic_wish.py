# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The request of addTopic, kept until its first message tells the type."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Mapping, Optional, Sequence

from cassandra_ros.arguments import (
    check_fields,
    check_key_format,
    check_new_node,
    check_new_topic,
    check_text,
    check_ttl,
    check_user_keys,
)
from cassandra_ros.errors import TopicExists
from cassandra_ros.messages.definition import Definition
from cassandra_ros.metadata import TopicMetadata


def wished_topic(
    topic: str,
    format: Optional[str],
    node: str,
    ttl: int,
    comment: str,
    user: Optional[Mapping[str, Any]],
    index: Sequence[str],
) -> TopicMetadata:
    """Check the arguments of addTopic, and return them as metadata without a type."""
    return TopicMetadata(
        topic=check_new_topic(topic),
        msg_type="",
        md5sum="",
        format="" if format is None else format,
        bucket_ns=0,
        nodeID=check_new_node(node),
        ttl=check_ttl(ttl),
        comment=check_text("comment", comment),
        user=check_user_keys({} if user is None else user),
        indexes=dict.fromkeys(check_fields("index", index), ""),
    )


def with_key(wanted: TopicMetadata, key_format: Optional[str], key_part: str) -> TopicMetadata:
    """Return metadata with the requested key; '' = as the topic is stored."""
    return wanted.with_(key_format=check_key_format(key_format, key_part), key_part=key_part)


@dataclass(frozen=True)
class Wish:
    """The request of addTopic; kept until the first message tells the type."""

    metadata: TopicMetadata
    """Metadata without a type; key_format '' = as stored, else 'time'; indexes are to be made."""
    asked: bool
    """Whether addTopic named the format; otherwise it is the stored one."""
    pending: bool
    """Whether it was added in this process and may have no table yet."""

    def check(self, stored: TopicMetadata, definition: Optional[Definition]) -> None:
        """Raise TopicExists if the topic is stored with other values than requested."""
        wrong, wanted = [], self.metadata
        if definition is not None and definition.md5sum != stored.md5sum:
            wrong.append(f"type {stored.msg_type} [{stored.md5sum}]")
        key = (wanted.key_format, wanted.key_part)
        if wanted.key_format and key != (stored.key_format, stored.key_part):
            wrong.append(f"key_format {stored.key_format} {stored.key_part}".rstrip())
        if wanted.ttl and wanted.ttl != stored.ttl:
            wrong.append(f"ttl {stored.ttl} s")
        if wrong:
            raise TopicExists(
                f"topic {stored.topic} is stored already with {', '.join(wrong)}; give the "
                "same, or remove the topic first"
            )
