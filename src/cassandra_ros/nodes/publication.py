# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Publishers of serialised messages, of types that need not be installed.

They differ from ``rospy.Publisher``:

* Type, md5 and definition are texts; no message class is made, and no definition is executed.
* A late subscriber of a latched topic gets the last message of each source, not only the very last
  one: two nodes may each have latched their part of /tf_static.
* The publishing thread sends a message itself as far as that does not block, so that it is on time,
  and never copies a large one. The queue of a slow subscriber is bounded, and the messages that it
  misses are counted.
* The end can wait until the queued messages are sent.
"""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections import deque
from dataclasses import dataclass
from typing import Callable, Hashable, Sequence, Union

import rospy
from rospy.impl.registration import Registration, get_topic_manager
from rospy.impl.transport import Transport
from rospy.topics import _PublisherImpl, _TopicImpl

from cassandra_ros.errors import TypeMismatch

SEND_BATCH_BYTES = 256 * 1024
"""Maximum size of small queued messages that are sent together, bytes."""
PIECE_BYTES = 8 * 1024 * 1024
"""Size of the pieces in which large messages are sent, bytes; each piece shows progress."""

ANY = "*"
"""Type or md5 of messages that were stored without one: it matches every subscriber."""

_length = struct.Struct("<I").pack


@dataclass(frozen=True)
class MessageKind:
    """The type of a publisher's messages, in the form of a message class for rospy."""

    _type: str
    _md5sum: str
    _full_text: bytes
    """The definition, as it was stored: rosgraph sends bytes as they are."""

    @classmethod
    def of(cls, type_: str, md5sum: str, definition: str) -> MessageKind:
        """Return the kind for a type, its md5 and its definition, which may have surrogates."""
        text = definition.encode("utf-8", "surrogateescape")
        return cls(type_ or ANY, md5sum or ANY, text)


class _Link:
    """The connection to one subscriber: its queue, and the thread that sends.

    It has the attributes of a transport of rospy. At most ``bound`` messages are queued (0 = no
    maximum); then the oldest is dropped for a new one.
    """

    def __init__(self, transport: Transport, bound: int) -> None:
        self.transport = transport
        self.missed = 0
        """Number of messages that were dropped because the queue was full, or was abandoned."""
        self.moved = time.monotonic()
        """Last time at which bytes were sent or sending began, monotonic clock, s."""
        self._bound = bound or 2**62
        self._queue: deque[bytes] = deque()
        self._unsent: memoryview | None = None  # unsent end of a message, sent before the queue
        self._busy = False  # whether the thread is sending
        # Its lock guards what stands above. The thread sends without it; meanwhile ``_busy`` keeps
        # ``offer`` from sending, so that messages keep their order.
        self._changed = threading.Condition()
        transport.set_cleanup_callback(self._on_close)
        threading.Thread(target=self._run, daemon=True, name="publisher").start()

    def __getattr__(self, name: str) -> object:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.transport, name)

    def _on_close(self, transport: Transport) -> None:
        """Let the thread end; called by the transport on the thread that closes it."""
        with self._changed:
            self._changed.notify_all()

    @property
    def is_idle(self) -> bool:
        """Whether all messages were handed to the system, or the subscriber is gone."""
        with self._changed:
            waits = self._queue or self._unsent is not None or self._busy
            return bool(self.transport.done or not waits)

    @property
    def is_full(self) -> bool:
        """Whether the queue is full, so that the next message would drop the oldest."""
        with self._changed:
            return not self.transport.done and len(self._queue) >= self._bound

    def latched(self, wires: Sequence[bytes]) -> None:
        """Queue the latched messages in addition to the maximum."""
        with self._changed:
            self._bound += len(wires)
            self.moved = time.monotonic()
            self._queue.extend(wires)
            self._changed.notify_all()

    def abandon(self) -> None:
        """Drop the queue; its messages count as missed if the subscriber is still connected."""
        with self._changed:
            if not self.transport.done:
                half_sent = self._unsent is not None or self._busy
                self.missed += len(self._queue) + half_sent
            self._queue.clear()

    def offer(self, wire: bytes) -> None:
        """Send a message now, or queue it if the subscriber is slow."""
        try:
            with self._changed:
                if self.transport.done:
                    return
                waits = self._queue or self._unsent is not None or self._busy
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
            self.transport.close()  # not under our lock: it calls _on_close

    def _send_now(self, wire: bytes) -> None:
        """Send as much of a message as does not block; leave the rest to the thread."""
        buffers = (_length(len(wire)), wire)
        try:
            sent = self.transport.socket.sendmsg(buffers, (), socket.MSG_DONTWAIT)
        except BlockingIOError:
            sent = 0
        except AttributeError:
            return  # closed meanwhile: the transport has no socket any more
        self._note_sent(sent, 1)
        if sent < len(wire) + 4:
            # A large message is never copied unless none of it was sent.
            whole = memoryview(wire if sent >= 4 else b"".join(buffers))
            self._unsent = whole[sent - 4 if sent >= 4 else sent :]
            self._changed.notify_all()

    def _run(self) -> None:
        """Send what ``offer`` has not sent, until the connection is closed."""
        while True:
            with self._changed:
                while not (self._queue or self._unsent is not None or self.transport.done):
                    self._changed.wait()
                if self.transport.done:
                    return
                buffers, messages = self._take()
                self._busy = True
            try:
                for data in buffers:
                    self._send(data)
            except (OSError, AttributeError):
                self.transport.close()
            with self._changed:
                self._busy = False
                self._note_sent(0, messages)

    def _take(self) -> tuple[list[bytes | memoryview], int]:
        """Return the buffers to be sent next, and the number of messages that begin in them.

        They are the rest of a message, one large message, or small ones together.
        """
        if self._unsent is not None:
            rest, self._unsent = self._unsent, None
            return [rest], 0
        if len(self._queue[0]) > SEND_BATCH_BYTES:
            wire = self._queue.popleft()
            # Length and first piece together: the four bytes alone would be a packet of their own.
            return [_length(len(wire)) + wire[:1024], memoryview(wire)[1024:]], 1
        taken: list[bytes] = []
        nbytes = 0
        while self._queue and nbytes + len(self._queue[0]) <= SEND_BATCH_BYTES:
            wire = self._queue.popleft()
            taken += [_length(len(wire)), wire]
            nbytes += len(wire)
        return [b"".join(taken)], len(taken) // 2

    def _send(self, data: bytes | memoryview) -> None:
        """Send all of a buffer; this may block for as long as the subscriber does not read."""
        view = memoryview(data)
        while view:
            sent = self.transport.socket.send(view[:PIECE_BYTES])
            view = view[sent:]
            self._note_sent(sent, 0)

    def _note_sent(self, nbytes: int, messages: int) -> None:
        """Note that bytes were sent, and that messages were begun, in rospy's statistics too."""
        if nbytes:
            self.moved = time.monotonic()
        self.transport.stat_bytes += nbytes
        self.transport.stat_num_msg += messages


class Publication(_PublisherImpl):
    """A topic on which serialised messages are published. Made by ``advertise``."""

    def __init__(self, topic: str, kind: MessageKind, latched: bool, queue_size: int) -> None:
        super().__init__(topic, kind)
        self.is_latch = latched  # rospy writes it to the connection header
        self.ref_count = 1
        self._kind = kind
        self.published = 0
        """Number of messages that were published."""
        self._queue_size = queue_size
        self._missed = 0  # number of messages that former subscribers missed
        self._latched: dict[Hashable, bytes] = {}
        """Last latched message by source, in the order of publication."""
        # Guards ``_latched``: a new subscriber gets a message as latched or as published, not both.
        # rospy deletes its own lock when it closes the topic.
        self._sending = threading.RLock()

    @property
    def topic(self) -> str:
        """Resolved name of the topic."""
        return str(self.resolved_name)

    @property
    def kind(self) -> MessageKind:
        """Type of its messages."""
        return self._kind

    def publish_wire(self, wire: bytes, source: Hashable | None = None) -> None:
        """Send a serialised message to every subscriber.

        Args:
            wire: The message.
            source: For a latched message, the key of its source; late subscribers get the last
                message of each source, in the order of publication. None = not latched.
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
        """Forget the latched messages, so that late subscribers do not get them."""
        with self._sending:
            self._latched.clear()

    def add_connection(self, c: Transport) -> bool:
        """Add a subscriber and send it the latched messages."""
        # Small messages are joined here; the kernel would delay them until an acknowledgement.
        c.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        link = _Link(c, self._queue_size)
        with self._sending:
            link.latched(list(self._latched.values()))
            return bool(_TopicImpl.add_connection(self, link))

    def remove_connection(self, c: _Link | Transport) -> None:
        """Remove a subscriber, also while the topic is closed and rospy's listeners are gone."""
        _TopicImpl.remove_connection(self, c)
        for listener in list(self.subscriber_listeners or ()):
            listener.peer_unsubscribe(self.resolved_name, self.get_num_connections())

    def _remove_connection(self, connections: list[_Link], c: _Link | Transport) -> None:
        """Remove a subscriber; rospy would find it by its file descriptor, which may be reused."""
        link = next((one for one in connections if c in (one, one.transport)), None)
        if link is None:
            return
        connections.remove(link)
        self._missed += link.missed
        try:
            self.connection_poll.remove_fd(link.transport.fileno())
        except (OSError, KeyError, ValueError):
            pass  # it is closed and not polled
        link.transport.close()

    @property
    def subscribers(self) -> int:
        """Number of connected subscribers."""
        return int(self.get_num_connections())

    @property
    def missed(self) -> int:
        """Number of messages that slow subscribers missed, summed over all of them."""
        return self._missed + sum(int(link.missed) for link in list(self.connections))

    def await_room(self, stop: Callable[[], bool], stalled_sec: float) -> bool:
        """Wait until no subscriber's queue is full; return whether that is so, or ``stop``.

        Args:
            stop: Returns whether to stop waiting.
            stalled_sec: Time without progress after which a subscriber is not waited for, s.
        """
        self._await(lambda link: link.is_full, stop, stalled_sec)
        return stop() or not any(link.is_full for link in list(self.connections))

    def drain(self, stop: Callable[[], bool], stalled_sec: float) -> None:
        """Wait until all queued messages are sent; arguments as for ``await_room``."""
        self._await(lambda link: not link.is_idle, stop, stalled_sec)

    def _await(
        self, waits: Callable[[_Link], bool], stop: Callable[[], bool], stalled_sec: float
    ) -> None:
        """Wait while ``waits`` is true of a connection that has moved within ``stalled_sec``."""
        while not stop():
            since = time.monotonic() - stalled_sec
            if not any(waits(link) and link.moved > since for link in self.connections):
                return
            time.sleep(0.001)

    def unregister(self) -> None:
        """Unregister the topic; messages that are still queued count as missed."""
        for link in list(self.connections):
            link.abandon()
        manager = get_topic_manager()
        with manager.lock:
            if manager.pubs.get(self.resolved_name) is self:
                manager._remove(self, manager.pubs, Registration.PUB)
        self.close()


class SharedPublication:
    """A topic that this process publishes already with a message class, for example /rosout."""

    def __init__(self, impl: _PublisherImpl) -> None:
        self._impl = impl
        self.topic = str(impl.resolved_name)
        self.kind = MessageKind.of(
            impl.data_class._type, impl.data_class._md5sum, impl.data_class._full_text
        )
        self.published = 0
        self.missed = 0
        self.is_latch = bool(impl.is_latch)

    def publish_wire(self, wire: bytes, source: Hashable | None = None) -> None:
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
        """Do nothing: another publisher of this process latched the messages."""

    @property
    def subscribers(self) -> int:
        """Number of connected subscribers."""
        return int(self._impl.get_num_connections())

    def await_room(self, stop: Callable[[], bool], stalled_sec: float) -> bool:
        """Return True: rospy does not show the queues of its subscribers."""
        return True

    def drain(self, stop: Callable[[], bool], stalled_sec: float) -> None:
        """Do nothing: rospy does not show the queues of its subscribers."""

    def unregister(self) -> None:
        """Do nothing: another publisher of this process uses the topic."""


AnyPublication = Union[Publication, SharedPublication]


def advertise(topic: str, kind: MessageKind, latched: bool, queue_size: int) -> AnyPublication:
    """Publish a topic.

    Args:
        topic: Name of the topic before remapping.
        kind: Type of its messages.
        latched: Whether the connection header has latching=1.
        queue_size: Maximum number of messages queued for each subscriber; 0 = no maximum.

    Raises:
        TypeMismatch: This process publishes the topic already with another type.
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
