# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A bounded queue of the live messages that wait while stored messages are read.

When the queue is full and a recorder writes the topic, all waiting messages are dropped: they are
read from the store instead. When no recorder writes the topic, and after the stored messages have
all been read, the publisher's thread waits for room, as it waits for a callback of rospy. Then the
publisher's own queue decides which messages are dropped.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from typing import Callable, Mapping, NamedTuple

from cassandra_ros.errors import ClockNotSet
from cassandra_ros.playing.history.alignment import MessageFingerprint, digest_of

_log = logging.getLogger(__name__)

OVERHEAD_BYTES = 300
"""Approximate memory of a waiting message in addition to its bytes, bytes."""

MAX_CONNECTIONS = 4096
"""Maximum number of connections whose header is remembered: publishers come and go for days."""

TOO_OFTEN = 5
"""Number of times that the queue has been emptied for lack of room when a warning is logged."""


class Publisher(NamedTuple):
    """The publisher of a message according to its connection header, live or stored."""

    callerid: str
    type: str
    md5sum: str


class LiveMessage:
    """A message as it was received over a connection."""

    __slots__ = ("_digest", "header", "publisher", "repeated", "t", "wanted", "wire")

    def __init__(
        self, t: int, publisher: Publisher, header: Mapping[str, str], wire: bytes, repeated: bool
    ) -> None:
        self.t, self.publisher, self.header, self.wire = t, publisher, header, wire
        self.repeated = repeated
        """Whether it is the first message of a connection to a latching publisher.

        Such a message may have been published long before.
        """
        self.wanted = True
        """Whether it is handed out; False where the same message was handed out from the store."""
        self._digest: bytes | None = None

    @property
    def mark(self) -> MessageFingerprint:
        """Time and digest by which it is compared with stored messages."""
        if self._digest is None:
            self._digest = digest_of(self.wire)
        return MessageFingerprint(self.t, self._digest)


class DroppedMessages(NamedTuple):
    """The messages of one publisher that were dropped for lack of room."""

    first: MessageFingerprint
    """The message that was dropped first."""
    number: int
    """Number of dropped messages."""


class WaitingMessages(NamedTuple):
    """The waiting messages of one publisher."""

    messages: list[LiveMessage]
    since: float
    """Time at which the first message of the publisher arrived, monotonic clock, s."""


class LiveQueue:
    """A queue that is filled by the publishers' threads and emptied by one thread.

    Args:
        bound: Maximum size of the waiting messages, bytes.
        clock: Returns the time of reception, ns; raises ClockNotSet before the first /clock
            message.
    """

    def __init__(self, bound: int, clock: Callable[[], int]) -> None:
        self._bound, self._clock = bound, clock
        self._changed = threading.Condition()
        self._messages: deque[LiveMessage] = deque()
        self._bytes = 0
        """Memory of the waiting messages, bytes."""
        self._closed = False
        self._joined = False
        """Whether the stored messages were read up to the waiting ones: then none is dropped."""
        self._connections: dict[int, Mapping[str, str]] = {}
        """Headers by their id, of the connections from which a message came."""
        self._since: dict[Publisher, float] = {}
        """Monotonic time at which the first waiting message of a publisher arrived, s."""
        self.recorded = False
        """Whether a recorder stores the topic, so that waiting messages may be dropped here."""
        self.epoch = 0
        """Number of times that the waiting messages were dropped. If it is the same as before a
        comparison with stored messages, none was dropped meanwhile."""
        self.began_ns = self.now_ns()
        """Time from which on the queue has every received message, ns; 0 = time not known yet."""
        self.dropped: dict[Publisher, DroppedMessages] = {}
        """Dropped messages by publisher."""

    def now_ns(self) -> int:
        """Return the time, ns; 0 while simulated time is not known."""
        try:
            return self._clock()
        except ClockNotSet:
            return 0

    def begin(self) -> bool:
        """Return whether the time is known.

        Once it is, messages that were received earlier get it as their time of reception.
        """
        with self._changed:
            if not self.began_ns:
                self.began_ns = self.now_ns()
                for message in self._messages:
                    message.t = message.t or self.began_ns
            return self.began_ns > 0

    def put(self, header: Mapping[str, str], wire: bytes) -> None:
        """Append a message; wait for room if none may be dropped. After ``close`` do nothing.

        Args:
            header: Connection header; the same object for all messages of a connection.
        """
        with self._changed:
            nbytes = len(wire) + OVERHEAD_BYTES
            if self._messages and self._bytes + nbytes > self._bound:
                self._make_room(nbytes)
            if self._closed:
                return
            first = id(header) not in self._connections
            if first:  # held here so that no other header can get the same id
                if len(self._connections) >= MAX_CONNECTIONS:
                    self._connections.pop(next(iter(self._connections)))
                self._connections[id(header)] = header
            who = Publisher(*(header.get(name, "") for name in ("callerid", "type", "md5sum")))
            repeated = first and header.get("latching") == "1"
            self._messages.append(LiveMessage(self.now_ns(), who, header, wire, repeated))
            self._since.setdefault(who, time.monotonic())
            self._bytes += nbytes
            self._changed.notify_all()

    def _make_room(self, nbytes: int) -> None:
        """Drop the waiting messages if a recorder stores them, else wait for room, or the end."""
        if self.recorded and not self._joined:
            self._drop_waiting()
            return
        if not self._joined:
            _log.warning(
                "live messages fill the buffer while stored messages are read, and no recorder "
                "stores them: their publishers must wait"
            )
        self._changed.wait_for(lambda: self._closed or not self._is_still_full(nbytes))

    def _is_still_full(self, nbytes: int) -> bool:
        """Return whether there is no room yet; first drop the waiting messages if they may be."""
        if self.recorded and not self._joined:  # a recorder may have started since the last check
            self._drop_waiting()
        return bool(self._messages) and self._bytes + nbytes > self._bound

    def _drop_waiting(self) -> None:
        """Drop all waiting messages: they will be read from the store."""
        for message in self._messages:
            if not message.repeated:  # it may have been sent, and stored, long before
                dropped = self.dropped.get(message.publisher) or DroppedMessages(message.mark, 0)
                self.dropped[message.publisher] = dropped._replace(number=dropped.number + 1)
        self.epoch += 1
        _log.log(
            logging.INFO if self.epoch == 1 else logging.DEBUG,
            "%d waiting live messages are dropped here and will be read from the store",
            len(self._messages),
        )
        if self.epoch == TOO_OFTEN:
            _log.warning(
                "messages come from the store alone, some seconds late: the callback is slower "
                "than they come, or the buffer (%d bytes) holds less than 5 s of them; give more "
                "with buff_size",
                self._bound,
            )
        self._messages.clear()
        self._since.clear()
        self._bytes = 0
        self.began_ns = self.now_ns()

    def waiting(self) -> dict[Publisher, WaitingMessages]:
        """Return the waiting messages by publisher, in order of reception."""
        waiting: dict[Publisher, WaitingMessages] = {}
        with self._changed:
            for message in self._messages:
                who = message.publisher
                if who not in waiting:
                    waiting[who] = WaitingMessages([], self._since[who])
                waiting[who].messages.append(message)
        return waiting

    def join(self, epoch: int) -> bool:
        """Drop nothing from now on; return False if messages were dropped since ``epoch``.

        With False they may still be dropped.
        """
        with self._changed:
            self._joined = self.epoch == epoch
            return self._joined

    def first(self) -> LiveMessage | None:
        """Return the oldest message without taking it; None if the queue is empty."""
        with self._changed:
            return self._messages[0] if self._messages else None

    def next_message(self, timeout_sec: float) -> LiveMessage | None:
        """Remove and return the oldest message; None after the timeout or once it is closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._messages or self._closed, timeout_sec)
            if self._closed or not self._messages:
                return None
            message = self._messages.popleft()
            self._bytes -= len(message.wire) + OVERHEAD_BYTES
            self._changed.notify_all()
            return message

    def wait(self, seconds: float) -> None:
        """Wait for ``seconds``, or until the queue is closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed, seconds)

    def close(self) -> None:
        """Drop the waiting messages and accept no more."""
        with self._changed:
            self._closed = True
            self._messages.clear()
            self._changed.notify_all()

    @property
    def closed(self) -> bool:
        """Whether the queue was closed."""
        return self._closed
