# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The bounded buffer of messages that wait for the store, and the connections they came over."""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import Mapping, NamedTuple, Sequence

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.recording.filters import TopicFilter
from cassandra_ros.recording.place_keeper import tells_places
from cassandra_ros.store.tables.lengths import UNKNOWN_SPAN_NS, Lengths, bucket_for, span_for
from cassandra_ros.store.tables.row_table import LARGE_MESSAGE_CHUNK_BYTES
from cassandra_ros.topics.message_writer import Handle

ITEM_BYTES = 300
"""Memory of a buffered message in addition to its bytes, bytes.

Without it many small messages would take much more memory than the maximum.
"""

UNBOUNDED_BYTES = 512 * 1024 * 1024
"""Memory of which half is used before the spool, where the buffer has no maximum, bytes."""
FIRST_SEC = 1.0
"""How long a topic is observed before its table is made, s: its rate fixes the bucket length."""
FIRST_MESSAGES = 5_000
"""Number of messages after which the table is made earlier."""
FIRST_BYTES = 8_000_000
"""Size of messages after which the table is made earlier, bytes."""
LONGEST_STEP_NS = 60 * SECOND_NS
"""Maximum time counted between two messages, ns: a longer one may be a change of the clock."""
LONGEST_BUCKET_NS = 600 * SECOND_NS
"""Maximum length of a bucket of a live topic, ns: its rate may grow later."""

_HEADERS = ("Header", "std_msgs/Header", "roslib/Header")


class BufferedMessage(NamedTuple):
    """A message that waits for the store."""

    source: MessageSource
    t: int
    """Time of reception, ns."""
    counter: int
    """Position in the order of reception over all topics, from 0; it does not overflow."""
    wire: bytes

    @property
    def nbytes(self) -> int:
        """Memory that it takes in the buffer, bytes."""
        return len(self.wire) + ITEM_BYTES


class MessageSource:
    """The messages of one topic with the same connection header.

    The writing thread calls ``hold`` and ``is_ripe``, and sets ``submitted``. From then on the
    thread of the TableMaker calls ``lengths``, and sets ``handle``, ``error``, ``told`` and
    ``conflicts``.
    """

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self.topic = connection.topic
        self.handle: Handle | None = None  # for writing, once the table exists
        self.error = ""  # reason why its messages cannot be stored; '' = none
        self.waiting: deque[BufferedMessage] = deque()  # messages received before the table existed
        self.submitted = False  # whether the table is, or was, being made
        self.told = False  # whether an attempt to make the table failed and was logged
        self.conflicts = 0  # number of attempts that ended with a schema conflict
        self.has_header = starts_with_header(connection.definition_text)
        self.tells_places = tells_places(connection)  # whether it has poses of the robot
        self._since = 0.0  # when the first message was held, monotonic clock, s
        self._seen = 0  # number of messages that were held
        self._seen_bytes = 0
        self._last_ns = 0  # time of reception of the last message
        self._span_ns = 0  # time from the first to the last message, without changes of the clock

    def hold(self, item: BufferedMessage) -> None:
        """Keep a message until the table exists."""
        if not self._seen:
            self._since, self._last_ns = time.monotonic(), item.t
        self._span_ns += min(max(item.t - self._last_ns, 0), LONGEST_STEP_NS)
        self._last_ns = item.t
        self._seen += 1
        self._seen_bytes += len(item.wire)
        self.waiting.append(item)

    def is_ripe(self) -> bool:
        """Return whether the rate is known well enough to fix the bucket length."""
        enough = self._seen >= FIRST_MESSAGES or self._seen_bytes >= FIRST_BYTES
        return enough or self._watched_sec() >= FIRST_SEC

    def lengths(self) -> Lengths:
        """Return the lengths of buckets and blocks for the observed rate."""
        return lengths_for(self._seen, self._seen_bytes, self._watched_sec())

    def _watched_sec(self) -> float:
        """Return the time over which the held messages were received, s."""
        # Messages that waited for the store or come from a snapshot are handed on in a moment: for
        # them only the times of reception show the rate.
        held_sec = time.monotonic() - self._since if self._seen else 0.0
        return max(held_sec, self._span_ns / SECOND_NS)


class Feed(NamedTuple):
    """One connection of rospy."""

    header: Mapping[str, str]
    """rospy's object; it is referenced here because its id identifies the connection."""
    source: MessageSource
    filter: TopicFilter | None = None
    """Filter of the topic's messages; None = all messages are recorded."""


class Buffer:
    """A queue that drops the oldest message when it is full, as in rosbag. Thread-safe.

    A message counts until it is released, so that a message that was taken and still waits for its
    table is within the maximum, too (0 = no maximum). One message is always accepted, of any size.
    """

    def __init__(self, bound_bytes: int) -> None:
        self._bound = bound_bytes or 2**63
        self._half = (bound_bytes or UNBOUNDED_BYTES) // 2
        self._items: deque[BufferedMessage] = deque()
        self.held_bytes = 0
        """Memory of the queued messages and of those that were taken and not released, bytes."""
        self._closed = False
        self._changed = threading.Condition()

    def put(self, item: BufferedMessage) -> list[BufferedMessage]:
        """Append a message; return the messages that were dropped for it."""
        dropped: list[BufferedMessage] = []
        with self._changed:
            self._items.append(item)
            self.held_bytes += item.nbytes
            while self.held_bytes > self._bound and len(self._items) > 1:
                dropped.append(self._items.popleft())
                self.held_bytes -= dropped[-1].nbytes
            if len(self._items) == 1:
                self._changed.notify()
        return dropped

    def wait_for_room(self, nbytes: int) -> None:
        """Wait until a message of this size fits into an eighth of the buffer, or it is empty.

        So most of it stays free for live messages, while those of a snapshot are put.
        """
        with self._changed:
            while self.held_bytes and self.held_bytes + nbytes + ITEM_BYTES > self._bound // 8:
                self._changed.wait(0.05)

    def next_messages(
        self, most: int, most_bytes: int, timeout_sec: float
    ) -> list[BufferedMessage]:
        """Remove and return the oldest messages, at least one; [] after the timeout or a ``wake``.

        Args:
            most: Maximum number of messages.
            most_bytes: Size from which no further message is taken, bytes.
        """
        taken: list[BufferedMessage] = []
        nbytes = 0
        with self._changed:
            if not self._items:
                self._changed.wait(timeout_sec)
            while self._items and len(taken) < most and nbytes < most_bytes:
                item = self._items.popleft()
                nbytes += item.nbytes
                taken.append(item)
        return taken

    def hold(self, items: Sequence[BufferedMessage]) -> None:
        """Count messages that are in memory again after they were released; they are not queued."""
        with self._changed:
            self.held_bytes += sum(item.nbytes for item in items)

    def put_back(self, items: Sequence[BufferedMessage]) -> None:
        """Put messages back that were taken last and not released, before all others."""
        with self._changed:
            self._items.extendleft(reversed(items))
            self._changed.notify()

    def release(self, item: BufferedMessage) -> None:
        """Subtract a taken message, which is no longer held in memory."""
        with self._changed:
            self.held_bytes -= item.nbytes

    def release_all(self, items: Sequence[BufferedMessage]) -> None:
        """Subtract taken messages, see ``release``."""
        with self._changed:
            self.held_bytes -= sum(item.nbytes for item in items)

    def wake(self) -> None:
        """Let a waiting ``next_messages`` return at once."""
        with self._changed:
            self._changed.notify_all()

    def close(self) -> None:
        """Declare that no further message will be put."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    @property
    def is_half_full(self) -> bool:
        """Whether messages wait to be taken, and half of the memory is in use."""
        return self.held_bytes > self._half and bool(self._items)

    @property
    def waits(self) -> bool:
        """Whether messages wait to be taken."""
        return bool(self._items)

    @property
    def closed(self) -> bool:
        """Whether no further message will be put."""
        return self._closed

    @property
    def ended(self) -> bool:
        """Whether it is closed and all messages were taken."""
        with self._changed:
            return self._closed and not self._items


def lengths_for(messages: int, nbytes: int, seconds: float) -> Lengths:
    """Return the lengths of buckets and blocks for so many messages in a time, s."""
    # Several messages give a rate from 0.1 s on; one message counts as one per second.
    seconds = max(seconds, 0.1 if messages > 1 else 1.0)
    rate_hz, bytes_per_sec = messages / seconds, nbytes / seconds
    # Live blocks are closed by their age: a longer block would only make readers search more.
    bucket_ns = bucket_for(rate_hz, bytes_per_sec, LONGEST_BUCKET_NS)
    span_ns = min(span_for(rate_hz, bytes_per_sec), UNKNOWN_SPAN_NS)
    return Lengths(bucket_ns, span_ns, nbytes > LARGE_MESSAGE_CHUNK_BYTES * messages)


def starts_with_header(definition_text: str) -> bool:
    """Return whether the first field of a message is a std_msgs/Header.

    Only the text is searched: a definition that cannot be parsed may still begin with a Header.
    """
    for line in definition_text.split("\n"):
        code = line.split("#")[0].strip()
        if code.startswith("="):
            return False
        if code and "=" not in code:
            return code.split()[0] in _HEADERS
    return False
