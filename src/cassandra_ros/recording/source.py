# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A publisher's connection as the recorder sees it, and the wait for its table."""

from __future__ import annotations

import time
from collections import deque
from typing import Any, Mapping, Optional

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.connection import Connection
from cassandra_ros.recording.buffer import Item
from cassandra_ros.store.buckets import bucketFor

FIRST_SEC = 1.0
"""How long a topic is watched before its table is made: its rate fixes the bucket length."""
FIRST_MESSAGES = 5_000
FIRST_BYTES = 8_000_000
LONGEST_BUCKET_NS = 600 * SECOND_NS
"""Live rates may grow: never longer, whatever the first second says."""

_HEADERS = ("Header", "std_msgs/Header", "roslib/Header")


class Source:
    """Messages of one topic with one connection header.

    Attributes:
        connection: Topic and header.
        handle: Where the messages go; None until the table stands.
        error: Why they cannot be stored, or ''.
        waiting: Messages that came before the table stood.
    """

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self.topic = connection.topic
        self.handle: Any = None
        self.error = ""
        self.waiting: deque[Item] = deque()
        self.submitted = False
        self.has_header = startsWithHeader(connection.definition_text)
        self._since: Optional[float] = None
        self._seen = 0
        self._seen_bytes = 0

    def hold(self, item: Item) -> None:
        """Keep a message until the table stands."""
        if self._since is None:
            self._since = time.monotonic()
        self._seen += 1
        self._seen_bytes += len(item.wire)
        self.waiting.append(item)

    def isRipe(self) -> bool:
        """Whether enough was seen to fix the bucket length."""
        watched = 0.0 if self._since is None else time.monotonic() - self._since
        return (
            watched >= FIRST_SEC or self._seen >= FIRST_MESSAGES or self._seen_bytes >= FIRST_BYTES
        )

    def bucketLength(self) -> int:
        """Return the bucket length for the rate that was seen, ns."""
        watched = 0.0 if self._since is None else time.monotonic() - self._since
        # What came in a burst is no rate; what came within a second is one.
        seconds = max(watched, 0.1 if self._seen > 1 else 1.0)
        return bucketFor(self._seen / seconds, self._seen_bytes / seconds, LONGEST_BUCKET_NS)


class Feed:
    """One connection of rospy: its header object, and what comes over it."""

    __slots__ = ("header", "source")

    def __init__(self, header: Mapping[str, Any], source: Source) -> None:
        self.header = header  # kept alive, for its id names the connection
        self.source = source


def startsWithHeader(definition_text: str) -> bool:
    """Say whether the first field of a message is a std_msgs/Header.

    Only the text is looked at, for it may be hostile or broken and still have a sequence number.
    """
    for line in definition_text.split("\n"):
        code = line.split("#")[0].strip()
        if code.startswith("="):
            return False
        if code and "=" not in code:
            return code.split()[0] in _HEADERS
    return False
