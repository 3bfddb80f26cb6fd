# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Messages that wait for the store: over which connection each came, and a bound for all."""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import Mapping, NamedTuple, Optional

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.recording.place_keeper import tells_places
from cassandra_ros.tables.directory import UNKNOWN_SPAN_NS, Lengths, bucket_for, span_for
from cassandra_ros.tables.row_table import CHUNK_BYTES
from cassandra_ros.topics.message_writer import Handle

ITEM_BYTES = 300
"""What an item takes besides its message: small messages would else fill the memory unseen."""

FIRST_SEC = 1.0
"""How long a topic is watched before its table is made: its rate fixes the bucket length."""
FIRST_MESSAGES = 5_000
FIRST_BYTES = 8_000_000
LONGEST_STEP_NS = 60 * SECOND_NS
"""A longer time between two messages counts as this: a clock may have been set."""
LONGEST_BUCKET_NS = 600 * SECOND_NS
"""Live rates may grow: never longer, whatever the first second says."""

_HEADERS = ("Header", "std_msgs/Header", "roslib/Header")


class Item(NamedTuple):
    """One message on its way into the store."""

    source: Source
    """Over which it came."""
    t: int
    """Time of arrival, ns."""
    counter: int
    """Arrival order over all topics."""
    wire: bytes

    @property
    def nbytes(self) -> int:
        """What it counts for in the buffer."""
        return len(self.wire) + ITEM_BYTES


class Source:
    """Messages of one topic with one connection header."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self.topic = connection.topic
        self.handle: Optional[Handle] = None  # where the messages go, when the table stands
        self.error = ""  # why they cannot be stored
        self.waiting: deque[Item] = deque()  # what came before the table stood
        self.submitted = False  # whether the table is being made
        self.told = False  # whether its table was tried in vain, and people know that it waits
        self.conflicts = 0  # how often another one's schema change came between
        self.has_header = starts_with_header(connection.definition_text)
        self.tells_places = tells_places(connection)  # where the robot is
        self._since = 0.0
        self._seen = 0
        self._seen_bytes = 0
        self._last_ns = 0  # when the last of them came
        self._span_ns = 0  # time from the first to the last

    def hold(self, item: Item) -> None:
        """Keep a message until the table stands."""
        if not self._seen:
            self._since, self._last_ns = time.monotonic(), item.t
        self._span_ns += min(max(item.t - self._last_ns, 0), LONGEST_STEP_NS)
        self._last_ns = item.t
        self._seen += 1
        self._seen_bytes += len(item.wire)
        self.waiting.append(item)

    def submit(self) -> None:
        """Note that the table is being made."""
        self.submitted = True

    def stand(self, handle: Handle) -> None:
        """Note where the messages go: the table stands."""
        self.handle = handle

    def fail(self, error: str) -> None:
        """Note why the messages cannot be stored."""
        self.error = error

    def note_conflict(self) -> None:
        """Note that another client's schema change came between."""
        self.conflicts += 1

    def tell(self) -> bool:
        """Note that people know that it waits for its table; say whether they did not before."""
        first = not self.told
        self.told = True
        return first

    def is_ripe(self) -> bool:
        """Whether enough was seen to fix the bucket length."""
        enough = self._seen >= FIRST_MESSAGES or self._seen_bytes >= FIRST_BYTES
        return enough or self._watched() >= FIRST_SEC

    def lengths(self) -> Lengths:
        """Choose how much time buckets and blocks cover, by the rate that was seen."""
        # What came in a burst is no rate; what came within a second is one.
        seconds = max(self._watched(), 0.1 if self._seen > 1 else 1.0)
        rate_hz, bytes_per_sec = self._seen / seconds, self._seen_bytes / seconds
        # Live blocks are sealed by their age: a longer span would only make readers look further.
        bucket_ns = bucket_for(rate_hz, bytes_per_sec, LONGEST_BUCKET_NS)
        span_ns = min(span_for(rate_hz, bytes_per_sec), UNKNOWN_SPAN_NS)
        return Lengths(bucket_ns, span_ns, self._seen_bytes > CHUNK_BYTES * self._seen)

    def _watched(self) -> float:
        # What waited for the store, or was kept for a snapshot, is handed on in a moment: of that
        # only the times of arrival tell the rate.
        here = time.monotonic() - self._since if self._seen else 0.0
        return max(here, self._span_ns / SECOND_NS)


class Feed(NamedTuple):
    """One connection of rospy."""

    header: Mapping[str, str]
    """rospy's object, kept alive, for its id names the connection."""
    source: Source


class Buffer:
    """First in, first out; when full the oldest is dropped, as in rosbag. Thread-safe.

    An item counts until it is released, so that also what was taken and still waits for its table
    is within the bound (0 = none). One message is always accepted, whatever its size.
    """

    def __init__(self, bound_bytes: int) -> None:
        self._bound = bound_bytes or 2**63
        self._items: deque[Item] = deque()
        self.held_bytes = 0
        self._closed = False
        self._changed = threading.Condition()

    def put(self, item: Item) -> list[Item]:
        """Append an item; return what had to be dropped for it."""
        dropped: list[Item] = []
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
        """Return when a message of this size fits and much room is left for what arrives."""
        with self._changed:
            while self.held_bytes and self.held_bytes + nbytes + ITEM_BYTES > self._bound // 8:
                self._changed.wait(0.05)

    def take(self, most: int, most_bytes: int, timeout_sec: float) -> list[Item]:
        """Take the oldest, at least one, until a bound is met; [] after the timeout or a wake."""
        taken: list[Item] = []
        nbytes = 0
        with self._changed:
            if not self._items:
                self._changed.wait(timeout_sec)
            while self._items and len(taken) < most and nbytes < most_bytes:
                item = self._items.popleft()
                nbytes += item.nbytes
                taken.append(item)
        return taken

    def release(self, item: Item) -> None:
        """Note that an item that was taken is no longer held in memory."""
        with self._changed:
            self.held_bytes -= item.nbytes

    def wake(self) -> None:
        """Let a waiting ``take`` return at once."""
        with self._changed:
            self._changed.notify_all()

    def close(self) -> None:
        """Note that nothing will be put any more."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    @property
    def closed(self) -> bool:
        """Whether nothing will be put any more."""
        return self._closed

    @property
    def ended(self) -> bool:
        """Whether it is closed and everything was taken."""
        with self._changed:
            return self._closed and not self._items


def starts_with_header(definition_text: str) -> bool:
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
