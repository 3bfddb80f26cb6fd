# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Publishers of serialised messages, of types that need not be installed.

What differs from ``rospy.Publisher``:

* Type, md5 and definition are texts; no class of messages is made, no definition run.
* Of a latched topic the last message of each source goes to a late subscriber, not only the last:
  two nodes may have latched their part of /tf_static.
* A message is sent from the thread that publishes as far as that does not block, so that it is on
  time, and never copied where it is large. What waits for a slow subscriber is bounded; what it
  misses is counted.
* What waits at the end can be waited for.
"""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections import deque
from dataclasses import dataclass
from typing import Callable, Hashable, Optional, Sequence, Union

import rospy
from rospy.impl.registration import Registration, get_topic_manager
from rospy.impl.transport import Transport
from rospy.topics import _PublisherImpl, _TopicImpl

from cassandra_ros.errors import TypeMismatch

BATCH_BYTES = 256 * 1024
"""Small messages that wait are sent together up to this size."""
PIECE_BYTES = 8 * 1024 * 1024
"""Large messages are sent in pieces of this size, so that it is seen that they move."""

ANY = "*"
"""Type or md5 of what is stored without: anybody may take it."""

_length = struct.Struct("<I").pack


@dataclass(frozen=True)
class MessageKind:
    """What a publisher says of its messages, as the class of messages that rospy asks."""

    _type: str
    _md5sum: str
    _full_text: bytes
    """The definition, as it was stored: rosgraph sends bytes as they are."""

    @classmethod
    def of(cls, type_: str, md5sum: str, definition: str) -> MessageKind:
        """Make the kind of a type, its md5 and its definition; bytes may be surrogates."""
        text = definition.encode("utf-8", "surrogateescape")
        return cls(type_ or ANY, md5sum or ANY, text)


class _Link:
    """One subscriber: what waits for it, and the thread that sends it.

    Has what rospy asks of a transport. At most ``bound`` messages wait (0 = any number); when one
    more comes the oldest is dropped.
    """

    def __init__(self, transport: Transport, bound: int) -> None:
        self.transport = transport
        self.missed = 0
        self.moved = time.monotonic()
        """When bytes last went out, or something came that waits for it."""
        self._bound = bound or 2**62
        self._queue: deque[bytes] = deque()
        self._rest: Optional[memoryview] = None  # of a message that is half sent
        self._busy = False
        self._changed = threading.Condition()
        transport.set_cleanup_callback(self._closed)
        threading.Thread(target=self._run, daemon=True, name="publisher").start()

    def __getattr__(self, name: str) -> object:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.transport, name)

    def _closed(self, transport: Transport) -> None:
        with self._changed:
            self._changed.notify_all()

    @property
    def is_idle(self) -> bool:
        """Whether everything was handed to the system, or nobody is there to take it."""
        with self._changed:
            waits = self._queue or self._rest is not None or self._busy
            return bool(self.transport.done or not waits)

    @property
    def is_full(self) -> bool:
        """Whether the next message would drop one."""
        with self._changed:
            return not self.transport.done and len(self._queue) >= self._bound

    def latched(self, wires: Sequence[bytes]) -> None:
        """Send what is latched, whatever the bound is."""
        with self._changed:
            self._bound += len(wires)
            self.moved = time.monotonic()
            self._queue.extend(wires)
            self._changed.notify_all()

    def abandon(self) -> None:
        """Send nothing more; what waits is missed, where there still is a subscriber."""
        with self._changed:
            if not self.transport.done:
                begun = self._rest is not None or self._busy
                self.missed += len(self._queue) + begun
            self._queue.clear()

    def offer(self, wire: bytes) -> None:
        """Send a message now, or as soon as the subscriber takes it."""
        try:
            with self._changed:
                if self.transport.done:
                    return
                waits = self._queue or self._rest is not None or self._busy
                if not waits:
                    self.moved = time.monotonic()
                    self._send_now(wire)
                    return
                while len(self._queue) >= self._bound:
                    self._queue.popleft()
                    self.missed += 1
                self._queue.append(wire)
                self._changed.notify_all()
        except OSError:
            self.transport.close()  # not under our lock: it calls back

    def _send_now(self, wire: bytes) -> None:
        parts = (_length(len(wire)), wire)
        try:
            sent = self.transport.socket.sendmsg(parts, (), socket.MSG_DONTWAIT)
        except BlockingIOError:
            sent = 0
        except AttributeError:
            return  # closed meanwhile: there is no socket any more
        self._count(sent, 1)
        if sent < len(wire) + 4:
            # A large message is never copied; of one that is not begun nothing is lost.
            whole = memoryview(wire if sent >= 4 else b"".join(parts))
            self._rest = whole[sent - 4 if sent >= 4 else sent :]
            self._changed.notify_all()

    def _run(self) -> None:
        while True:
            with self._changed:
                while not (self._queue or self._rest is not None or self.transport.done):
                    self._changed.wait()
                if self.transport.done:
                    return
                parts, messages = self._take()
                self._busy = True
            try:
                for part in parts:
                    self._send(part)
            except (OSError, AttributeError):
                self.transport.close()
            with self._changed:
                self._busy = False
                self._count(0, messages)

    def _take(self) -> tuple[list[Union[bytes, memoryview]], int]:
        """Return what is to be sent next, and how many messages begin in it."""
        if self._rest is not None:
            rest, self._rest = self._rest, None
            return [rest], 0
        if len(self._queue[0]) > BATCH_BYTES:
            wire = self._queue.popleft()
            # Length and first piece together: a packet of four bytes alone would be waited for.
            return [_length(len(wire)) + wire[:1024], memoryview(wire)[1024:]], 1
        taken: list[bytes] = []
        nbytes = 0
        while self._queue and nbytes + len(self._queue[0]) <= BATCH_BYTES:
            wire = self._queue.popleft()
            taken += [_length(len(wire)), wire]
            nbytes += len(wire)
        return [b"".join(taken)], len(taken) // 2

    def _send(self, data: Union[bytes, memoryview]) -> None:
        view = memoryview(data)
        while view:
            sent = self.transport.socket.send(view[:PIECE_BYTES])
            view = view[sent:]
            self._count(sent, 0)

    def _count(self, nbytes: int, messages: int) -> None:
        if nbytes:
            self.moved = time.monotonic()
        self.transport.stat_bytes += nbytes
        self.transport.stat_num_msg += messages


class Publication(_PublisherImpl):
    """A topic that is published by bytes. Made by ``advertise``."""

    def __init__(self, topic: str, kind: MessageKind, latched: bool, queue_size: int) -> None:
        super().__init__(topic, kind)
        self.is_latch = latched  # rospy says so in the connection header
        self.ref_count = 1
        self._kind = kind
        self.published = 0
        self._queue_size = queue_size
        self._missed = 0  # by subscribers that are gone
        self._latched: dict[Hashable, bytes] = {}
        self._sending = threading.RLock()  # rospy's own is gone when it closes the topic

    @property
    def topic(self) -> str:
        """Its name, resolved."""
        return str(self.resolved_name)

    @property
    def kind(self) -> MessageKind:
        """What it says of its messages."""
        return self._kind

    def publish_wire(self, wire: bytes, source: Optional[Hashable] = None) -> None:
        """Send a serialised message to every subscriber.

        Args:
            wire: The message.
            source: Where the message is latched, who latches it: late subscribers get the last
                message of each source, in the order in which these were published.
        """
        with self._sending:
            if source is not None:
                self._latched.pop(source, None)
                self._latched[source] = wire
            self.published += 1
            self.message_data_sent += len(wire)
            for link in self.connections:
                link.offer(wire)

    def forget_latched(self) -> None:
        """Let late subscribers get nothing of what was latched before."""
        with self._sending:
            self._latched.clear()

    def add_connection(self, c: Transport) -> bool:
        """Take a subscriber; it gets what is latched."""
        # What waits is joined by us; the kernel would hold a small message back for an answer.
        c.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        link = _Link(c, self._queue_size)
        with self._sending:
            link.latched(list(self._latched.values()))
            return bool(_TopicImpl.add_connection(self, link))

    def remove_connection(self, c: Union[_Link, Transport]) -> None:
        """Forget a subscriber, also while the topic is left: rospy's listeners are gone then."""
        _TopicImpl.remove_connection(self, c)
        for listener in list(self.subscriber_listeners or ()):
            listener.peer_unsubscribe(self.resolved_name, self.get_num_connections())

    def _remove_connection(self, connections: list[_Link], c: Union[_Link, Transport]) -> None:
        """Forget a subscriber; rospy would take it by its file descriptor, which is used again."""
        link = next((one for one in connections if c in (one, one.transport)), None)
        if link is None:
            return
        connections.remove(link)
        self._missed += link.missed
        try:
            self.connection_poll.remove_fd(link.transport.fileno())
        except (OSError, KeyError, ValueError):
            pass  # it is closed, and was never or is no longer looked at
        link.transport.close()

    @property
    def subscribers(self) -> int:
        """How many connections stand."""
        return int(self.get_num_connections())

    @property
    def missed(self) -> int:
        """How many messages slow subscribers missed, in all."""
        return self._missed + sum(int(link.missed) for link in list(self.connections))

    def await_room(self, stop: Callable[[], bool], stalled_sec: float) -> None:
        """Wait until no subscriber's queue is full; not for one that takes nothing for a while."""
        self._await(lambda link: link.is_full, stop, stalled_sec)

    def drain(self, stop: Callable[[], bool], stalled_sec: float) -> None:
        """Wait until everything is sent; not to one that takes nothing for a while."""
        self._await(lambda link: not link.is_idle, stop, stalled_sec)

    def _await(
        self, waits: Callable[[_Link], bool], stop: Callable[[], bool], stalled_sec: float
    ) -> None:
        while not stop():
            since = time.monotonic() - stalled_sec
            if not any(waits(link) and link.moved > since for link in self.connections):
                return
            time.sleep(0.001)

    def unregister(self) -> None:
        """Do not publish the topic any more; what was not drained is missed."""
        for link in list(self.connections):
            link.abandon()
        manager = get_topic_manager()
        with manager.lock:
            if manager.pubs.get(self.resolved_name) is self:
                manager._remove(self, manager.pubs, Registration.PUB)
        self.close()


class SharedPublication:
    """A topic that this process publishes already with a class, as every node does /rosout."""

    def __init__(self, impl: _PublisherImpl) -> None:
        self._impl = impl
        self.topic = str(impl.resolved_name)
        self.kind = MessageKind.of(
            impl.data_class._type, impl.data_class._md5sum, impl.data_class._full_text
        )
        self.published = 0
        self.missed = 0
        self.is_latch = bool(impl.is_latch)

    def publish_wire(self, wire: bytes, source: Optional[Hashable] = None) -> None:
        """Send a serialised message to every subscriber."""
        msg = rospy.AnyMsg()
        msg._buff = wire
        self._impl.acquire()
        try:
            self._impl.publish(msg)
        finally:
            self._impl.release()
        self.published += 1

    def forget_latched(self) -> None:
        """Do nothing: what is latched is not ours."""

    @property
    def subscribers(self) -> int:
        """How many connections stand."""
        return int(self._impl.get_num_connections())

    def await_room(self, stop: Callable[[], bool], stalled_sec: float) -> None:
        """Do nothing: rospy has no way to tell."""

    def drain(self, stop: Callable[[], bool], stalled_sec: float) -> None:
        """Do nothing: rospy has no way to tell."""

    def unregister(self) -> None:
        """Do nothing: the topic is not ours."""


AnyPublication = Union[Publication, SharedPublication]


def advertise(topic: str, kind: MessageKind, latched: bool, queue_size: int) -> AnyPublication:
    """Publish a topic, by its name before remapping.

    Args:
        topic: Its name.
        kind: What is said of its messages.
        latched: Whether the connection header says so.
        queue_size: How many messages may wait for each subscriber; 0 = any number.

    Raises:
        TypeMismatch: This process publishes it already with another type.
    """
    manager = get_topic_manager()
    name = rospy.resolve_name(topic)
    with manager.lock:
        impl = manager.get_publisher_impl(name)
        if impl is None:
            publication = Publication(topic, kind, latched, queue_size)
            manager._add(publication, manager.pubs, Registration.PUB)
            return publication
    other = impl.data_class
    if isinstance(impl, Publication) or other._md5sum != kind._md5sum:
        raise TypeMismatch(
            f"topic {name} cannot be published as {kind._type}: this node publishes it already "
            f"as {other._type}; map it to another name, as {name}:={name}_played"
        )
    return SharedPublication(impl)
