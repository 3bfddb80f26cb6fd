# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Stored rows as messages of services."""

from __future__ import annotations

from typing import Any

import rospy

from cassandra_ros.errors import CorruptMessage, DefinitionError
from cassandra_ros.messages.classes import toYaml
from cassandra_ros.messages.stamps import isoTime
from cassandra_ros.msg import StoredMessage

YAML_BYTES = 1024 * 1024
"""Larger messages are not written as YAML: it takes seconds, and ten times the bytes."""


def pack(row: Any, omit_data: bool, omit_yaml: bool) -> Any:
    """Make a StoredMessage of a stored row."""
    return StoredMessage(
        key=rospy.Time(*divmod(row.t, 10**9)),
        key_text=clean(row.name) or (isoTime(row.t) if row.table.valued else str(row.t)),
        node_id=clean(row.node),
        topic=clean(row.topic),
        type=clean(row.type),
        md5sum=clean(row.md5sum),
        data=b"" if omit_data else row.wire,
        yaml="" if omit_yaml else clean(_yaml(row)),
    )


def sizeOf(message: Any) -> int:
    """Return about how many bytes a StoredMessage takes in a reply."""
    return len(message.data) + len(message.yaml) + 200


def clean(text: str) -> str:
    """Return text that is valid UTF-8, for what came from outside may hold anything."""
    return text.encode("utf-8", "surrogateescape").decode("utf-8", "replace")


def _yaml(row: Any) -> str:
    if row.size > YAML_BYTES:
        return f"# {row.size} bytes of {row.type}, too many to be shown here: read data"
    try:
        return toYaml(row.message())
    except (CorruptMessage, DefinitionError) as exc:
        return "# " + " ".join(str(exc).split())
