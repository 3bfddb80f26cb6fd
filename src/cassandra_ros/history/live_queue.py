# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Live messages that wait while the past is read: bounded, and never lost silently.

When there is no room left and a recorder writes the topic, all that waits is forgotten: it is in
the store, and read from there. Where nobody writes it, and once the past is done, the publisher's
thread waits for room, as it waits for a callback of rospy; the publisher's own queue then decides.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from typing import Callable, Deque, Dict, List, Mapping, NamedTuple, Optional

from cassandra_ros.errors import ClockNotSet
from cassandra_ros.history.alignment import Mark, digest_of

_log = logging.getLogger(__name__)

OVERHEAD_BYTES = 300
"""What a message that waits takes beside its bytes, about."""

MAX_CONNECTIONS = 4096
"""Connections remembered by their header object; publishers come and go for days."""

TOO_OFTEN = 5
"""After it was full so often a person is told."""


class Publisher(NamedTuple):
    """Who published a message, as its connection header says; the same in store and live."""

    callerid: str
    type: str
    md5sum: str


class LiveMessage:
    """A message as it came over a connection."""

    __slots__ = ("_digest", "header", "publisher", "repeated", "t", "wanted", "wire")

    def __init__(
        self, t: int, publisher: Publisher, header: Mapping[str, str], wire: bytes, repeated: bool
    ) -> None:
        self.t, self.publisher, self.header, self.wire = t, publisher, header, wire
        self.repeated = repeated
        """The first of a latching publisher's connection: it may have been sent long before."""
        self.wanted = True
        self._digest: Optional[bytes] = None

    @property
    def mark(self) -> Mark:
        """What it is compared by."""
        if self._digest is None:
            self._digest = digest_of(self.wire)
        return Mark(self.t, self._digest)


class Owed(NamedTuple):
    """Messages of a publisher that were forgotten: the first one, and how many."""

    first: Mark
    number: int


class Waiting(NamedTuple):
    """The messages of a publisher that wait, and since when (monotonic seconds)."""

    messages: List[LiveMessage]
    since: float


class LiveQueue:
    """Takes messages from the threads of publishers; one thread takes them out.

    Args:
        bound: Of the bytes that wait.
        clock: Tells the time of reception, ns; raises ClockNotSet while nobody knows it.
    """

    def __init__(self, bound: int, clock: Callable[[], int]) -> None:
        self._bound, self._clock = bound, clock
        self._changed = threading.Condition()
        self._messages: Deque[LiveMessage] = deque()
        self._bytes = 0
        self._closed = self._joined = False
        self._connections: Dict[int, Mapping[str, str]] = {}
        self._since: Dict[Publisher, float] = {}
        self.recorded = False
        """Whether the store gets what comes: then it may be forgotten here."""
        self.epoch = 0
        """How often it was forgotten."""
        self.began_ns = self.now_ns()
        """From then on nothing is missing that came."""
        self.owed: Dict[Publisher, Owed] = {}
        """What was forgotten."""

    def now_ns(self) -> int:
        """Tell the time; 0 while nobody knows it."""
        try:
            return self._clock()
        except ClockNotSet:
            return 0

    def note_recorded(self, recorded: bool) -> None:
        """Note whether the store gets what comes."""
        self.recorded = recorded

    def begin(self) -> bool:
        """Say whether the time is known; from then on what came before it has it, too."""
        with self._changed:
            if not self.began_ns:
                self.began_ns = self.now_ns()
                for message in self._messages:
                    message.t = message.t or self.began_ns
            return self.began_ns > 0

    def put(self, header: Mapping[str, str], wire: bytes) -> None:
        """Take a message; its header is the same object for all of a connection."""
        with self._changed:
            nbytes = len(wire) + OVERHEAD_BYTES
            if self._messages and self._bytes + nbytes > self._bound:
                self._make_room(nbytes)
            if self._closed:
                return
            first = id(header) not in self._connections
            if first:  # kept, lest another header comes to lie there
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
        if self.recorded and not self._joined:
            self._forget()
            return
        if not self._joined:
            _log.warning(
                "the live messages that wait for the past to be read fill the buffer, and nobody "
                "records them: their publishers must wait"
            )
        self._changed.wait_for(lambda: self._closed or not self._over(nbytes))

    def _over(self, nbytes: int) -> bool:
        if self.recorded and not self._joined:  # meanwhile somebody does
            self._forget()
        return bool(self._messages) and self._bytes + nbytes > self._bound

    def _forget(self) -> None:
        for message in self._messages:
            if not message.repeated:
                owed = self.owed.get(message.publisher) or Owed(message.mark, 0)
                self.owed[message.publisher] = owed._replace(number=owed.number + 1)
        self.epoch += 1
        _log.log(
            logging.INFO if self.epoch == 1 else logging.DEBUG,
            "%d live messages that waited while the past is read are read from the store",
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

    def waiting(self) -> Dict[Publisher, Waiting]:
        """Return what waits, by publisher, in order."""
        found: Dict[Publisher, Waiting] = {}
        with self._changed:
            for message in self._messages:
                who = message.publisher
                if who not in found:
                    found[who] = Waiting([], self._since[who])
                found[who].messages.append(message)
        return found

    def join(self, epoch: int) -> bool:
        """Forget nothing from now on; False where something was since that epoch."""
        with self._changed:
            self._joined = self.epoch == epoch
            return self._joined

    def first(self) -> Optional[LiveMessage]:
        """Return the oldest, which stays."""
        with self._changed:
            return self._messages[0] if self._messages else None

    def take(self, timeout_sec: float) -> Optional[LiveMessage]:
        """Take the oldest; None where none comes in time, or it is closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._messages or self._closed, timeout_sec)
            if self._closed or not self._messages:
                return None
            message = self._messages.popleft()
            self._bytes -= len(message.wire) + OVERHEAD_BYTES
            self._changed.notify_all()
            return message

    def wait(self, seconds: float) -> None:
        """Return after so long, or when it is closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed, seconds)

    def close(self) -> None:
        """Drop what waits, and take nothing any more."""
        with self._changed:
            self._closed = True
            self._messages.clear()
            self._changed.notify_all()

    @property
    def closed(self) -> bool:
        """Whether it was closed."""
        return self._closed
