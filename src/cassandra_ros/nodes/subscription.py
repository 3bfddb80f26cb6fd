# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Subscriptions that lose nothing: rospy's own, mended where it drops messages.

What plain ``rospy.Subscriber`` loses or doubles (rospy 1.15, seen with publishers made for it):

* It registers with the master before it knows its callback and buffer size; what arrives in
  between is dropped. Here the callback stands first.
* Publishers that start together cause updates that each list all of them, and two connections to
  one publisher: messages come twice, or are lost with the connection that is dropped. Here one
  attempt waits for the other.
* A publisher that comes again under its URI while its old connection is still being read is taken
  for connected, and not heard any more. Here a connection whose other end is closed does not
  count, and a publisher that was taken for connected is tried again when its connection ends.
* A connection header that is not UTF-8 (a degree sign in an old .msg file) is refused by rosgraph,
  and its publisher never heard. Here the bytes are kept as surrogates.

What was read is counted, so that the end of a recording can wait until all of it was handled.
"""

from __future__ import annotations

import fcntl
import io
import select
import socket
import struct
import termios
import threading
from typing import Callable, Mapping
from weakref import WeakKeyDictionary

import rospy
from rospy.impl import tcpros_base
from rospy.impl.registration import Registration, get_registration_listeners, get_topic_manager
from rospy.impl.transport import Transport
from rospy.topics import _SubscriberImpl

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import Connection

BUFF_SIZE = 16 * 1024 * 1024
"""Most bytes that are read at once; with rospy's 64 KiB large messages lag."""

# Not POLLHUP, which a socket has also before it is connected.
_HUNG_UP = select.POLLRDHUP | select.POLLERR
_CLOSING = "#closing"

MAX_HEADER_BYTES = 16 * 1024 * 1024

_length = struct.Struct("<I").unpack_from
_received: WeakKeyDictionary[socket.socket, int] = WeakKeyDictionary()
"""Socket of a connection → bytes that came behind its header; -1 while that is read."""

Callback = Callable[[str, Mapping[str, str], bytes], None]
"""Called with topic, connection header and serialised message."""


def subscribe(topic: str, callback: Callback, tcp_nodelay: bool = False) -> rospy.Subscriber:
    """Subscribe to a topic of any type, by its resolved name.

    The callback is called on the thread of each publisher.
    """
    # Let rospy read with the functions below, in this process.
    tcpros_base.read_ros_handshake_header = read_header
    tcpros_base.recv_buff = receive

    def take(msg: rospy.AnyMsg) -> None:
        # rospy itself may be subscribed with a class: /clock under simulated time.
        wire = msg._buff if isinstance(msg, rospy.AnyMsg) else serialize(msg)
        callback(topic, msg._connection_header, wire)

    manager = get_topic_manager()
    with manager.lock:
        if manager.get_subscriber_impl(topic) is None:
            manager._add(_Subscription(topic, take, tcp_nodelay), manager.subs, Registration.SUB)
            return rospy.Subscriber(topic, rospy.AnyMsg)
    return rospy.Subscriber(topic, rospy.AnyMsg, take)


def is_drained(subscriber: rospy.Subscriber) -> bool:
    """Say whether everything that has reached this machine was handed to the callback."""
    impl = subscriber.impl
    if not isinstance(impl, _Subscription):
        return True
    return all(_is_read(connection) for connection in list(impl.connections or ()))


def connected_uris(subscriber: rospy.Subscriber) -> set[str]:
    """Return the URIs of the publishers whose connection stands."""
    impl = subscriber.impl
    found = list(impl.connections or ()) if impl is not None else []
    return {c.endpoint_id for c in found if c.header is not None}


def was_heard(subscriber: rospy.Subscriber) -> bool:
    """Say whether a publisher was ever connected."""
    impl = subscriber.impl
    return not isinstance(impl, _Subscription) or impl.heard


class _Subscription(_SubscriberImpl):
    """rospy's side of a subscription, with the faults above mended."""

    def __init__(self, name: str, take: Callable[[rospy.AnyMsg], None], tcp_nodelay: bool) -> None:
        super().__init__(name, rospy.AnyMsg)
        self.set_buff_size(BUFF_SIZE)
        self.set_tcp_nodelay(tcp_nodelay)
        self._connecting: dict[str, threading.Thread] = {}
        self._asked_again: set[str] = set()
        self.heard = False
        """A publisher was connected at some time."""
        self.add_callback(take, None)

    def has_connection(self, endpoint_id: str) -> bool:
        """Say whether a publisher is connected; waits for another thread that connects to it."""
        me = threading.current_thread()
        while not rospy.is_shutdown():
            with self.c_lock:
                connections = [c for c in self.connections if c.endpoint_id == endpoint_id]
                if any(not c.done and not _has_hung_up(c) for c in connections):
                    self._asked_again.add(endpoint_id)
                    return True
                other = self._connecting.get(endpoint_id)
                if other is None or other is me or not other.is_alive():
                    self._connecting[endpoint_id] = me
                    return False
            other.join(1.0)
        return True

    def add_connection(self, c: Transport) -> bool:
        """Add a connection beside an old one of the same publisher that is still being read."""
        with self.c_lock:
            for old in self.connections:
                if old.endpoint_id == c.endpoint_id:
                    old.endpoint_id += _CLOSING
            self.heard = True
            return bool(super().add_connection(c))

    def remove_connection(self, c: Transport) -> None:
        """Forget a connection that has ended; look whether its publisher is there again."""
        super().remove_connection(c)
        with self.c_lock:
            again = c.endpoint_id.replace(_CLOSING, "")
            if again not in self._asked_again or self.closed or rospy.is_shutdown():
                return
            self._asked_again.discard(again)
        for listener in list(get_registration_listeners().listeners):
            # One that is gone, or does not publish any more, refuses.
            connect = getattr(listener, "_connect_topic_thread", None)
            if connect is not None:
                threading.Thread(target=connect, args=(self.name, again), daemon=True).start()

    def receive_callback(self, msgs: list[rospy.AnyMsg], connection: Transport) -> None:
        """Hand on messages and note how many of the connection's bytes they were."""
        super().receive_callback(msgs, connection)
        nbytes = sum(len(msg._buff) + 4 for msg in msgs)
        connection.handled = getattr(connection, "handled", 0) + nbytes


def _has_hung_up(connection: Transport) -> bool:
    """Say whether the publisher has closed its end."""
    sock = connection.socket
    if sock is None:
        return False  # being connected
    try:
        poller = select.poll()
        poller.register(sock, _HUNG_UP)
        return any(flags & _HUNG_UP for _, flags in poller.poll(0))
    except (OSError, ValueError):
        return True


def _is_read(connection: Transport) -> bool:
    sock = connection.socket
    if sock is None or connection.done:
        return True
    try:
        # In this order: what has left the socket was counted before it did.
        unread = unread_bytes(sock)
    except (OSError, ValueError):
        return True
    return not unread and getattr(connection, "handled", 0) == _received.get(sock, 0)


def unread_bytes(sock: socket.socket) -> int:
    """Return how many bytes lie in a socket."""
    return int(_length(fcntl.ioctl(sock, termios.FIONREAD, bytes(4)))[0])


def receive(sock: socket.socket, b: io.BytesIO, buff_size: int) -> int:
    """Append what is there to ``b``, as rospy's recv_buff; count it before it leaves the socket."""
    try:
        poller = select.poll()
        poller.register(sock, select.POLLIN)
        poller.poll()
        size = min(unread_bytes(sock), buff_size)
        _received[sock] = _received.get(sock, 0) + size
        data = sock.recv(max(size, 1))
    except (OSError, ValueError) as exc:
        raise rospy.exceptions.TransportTerminated(f"the connection broke: {exc}") from exc
    if not data:
        raise rospy.exceptions.TransportTerminated("the publisher has closed the connection")
    b.write(data)
    return len(data)


def read_header(sock: socket.socket, b: io.BytesIO, buff_size: int) -> dict[str, str]:
    """Read a connection header as rosgraph does, keeping bytes that are not UTF-8.

    What came behind the header is in ``b`` afterwards.
    """
    while b.tell() < 4 or b.tell() - 4 < _length(b.getvalue())[0]:
        if sock.recv(1, socket.MSG_PEEK):
            _received[sock] = -1  # before it leaves the socket: messages may come with it
        data = sock.recv(buff_size)
        if not data:
            raise rospy.exceptions.TransportInitError("the publisher closed before its header")
        b.write(data)
        if b.tell() >= 4 and _length(b.getvalue()[:4])[0] > MAX_HEADER_BYTES:
            raise rospy.exceptions.TransportInitError(
                f"the publisher announces a header of over {MAX_HEADER_BYTES} bytes"
            )
    received = b.getvalue()
    end = 4 + _length(received)[0]
    b.seek(0)
    b.truncate(0)
    b.write(received[end:])
    _received[sock] = len(received) - end
    try:
        fields = Connection("", received[4:end]).fields
    except CorruptMessage as exc:
        raise rospy.exceptions.TransportInitError(str(exc)) from exc
    return {
        name.strip(): value.decode("utf-8", "surrogateescape") for name, value in fields.items()
    }
