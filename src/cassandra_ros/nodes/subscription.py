# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Subscriptions that lose no message: those of rospy, repaired where rospy drops messages.

``rospy.Subscriber`` loses or doubles messages in these cases (rospy 1.15, seen in tests):

* It registers with the master before it has its callback and buffer size, and drops messages that
  are received in between. Here the callback is set first.
* Publishers that start at the same time cause updates that each list all of them, and so two
  connections to one publisher: messages come twice, or are lost with the connection that is
  dropped. Here one connection attempt waits for the other.
* A publisher that is restarted with the same URI while its old connection is still being read is
  taken for connected and never heard again. Here a connection whose other end is closed does not
  count, and the publisher is tried again when the old connection ends.
* A connection that breaks while its publisher goes on, as by a network that was away, is never
  made again. Here the publisher is asked again, and the gap is noted.
* rosgraph refuses a connection header that is not UTF-8 (a degree sign in an old .msg file), and
  its publisher is never heard. Here the bytes are kept as surrogates.

The bytes that were read are counted, so that the end of a recording can wait until all messages
were handled.
"""

from __future__ import annotations

import fcntl
import io
import logging
import select
import socket
import struct
import termios
import threading
import time
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

_log = logging.getLogger(__name__)

BUFF_SIZE = 16 * 1024 * 1024
"""Maximum number of bytes read at once. With the 64 KiB of rospy large messages are delayed."""

# Not POLLHUP, which is also set before a socket is connected.
_HUNG_UP = select.POLLRDHUP | select.POLLERR
_CLOSING = "#closing"
"""Suffix of the endpoint id of an old connection that is still being read."""

MAX_HEADER_BYTES = 16 * 1024 * 1024
"""Maximum size of a connection header, bytes."""

_length = struct.Struct("<I").unpack_from
_received: WeakKeyDictionary[socket.socket, int] = WeakKeyDictionary()
"""Number of bytes received after the header by socket; -1 while the header is being read."""

RECONNECT_SEC = 1.0
"""Time after which a publisher is asked again whose connection has ended, s."""
TOLD_SEC = 2.0
"""Time before the end of a connection in which the master may have named its publisher because
another process publishes there now, s."""
_POLL_SEC = 0.05
"""Interval at which it is checked whether a publisher has sent its header, s."""

OnGap = Callable[[str, float], None]
"""Function called with a topic and the time, s, up to now in which a publisher was not heard,
although it went on, because its connection was broken."""
Callback = Callable[[str, Mapping[str, str], bytes], None]
"""Function called with topic, connection header and serialised message."""


def subscribe(
    topic: str, callback: Callback, tcp_nodelay: bool = False, on_gap: OnGap | None = None
) -> rospy.Subscriber:
    """Subscribe to a topic of any type, by its resolved name.

    The callback is called on the threads of the publishers' connections. ``on_gap`` is called on
    another thread, also after the subscriber has left if others of this process stay.
    """
    # From now on rospy reads with the functions below, in this whole process.
    tcpros_base.read_ros_handshake_header = read_header
    tcpros_base.recv_buff = receive

    def pass_on(msg: rospy.AnyMsg) -> None:
        # rospy itself may have subscribed with a class: to /clock for simulated time.
        wire = msg._buff if isinstance(msg, rospy.AnyMsg) else serialize(msg)
        callback(topic, msg._connection_header, wire)

    manager = get_topic_manager()
    with manager.lock:
        impl = manager.get_subscriber_impl(topic)
        if impl is None:
            impl = _Subscription(topic, pass_on, tcp_nodelay)
            manager._add(impl, manager.subs, Registration.SUB)
            subscriber = rospy.Subscriber(topic, rospy.AnyMsg)
            subscriber.callback = pass_on  # so that ``unregister`` removes it
        else:
            subscriber = rospy.Subscriber(topic, rospy.AnyMsg, pass_on)
    if on_gap is not None and isinstance(impl, _Subscription):
        impl.on_gaps.append(on_gap)
    return subscriber


def is_drained(subscriber: rospy.Subscriber) -> bool:
    """Return whether all bytes that have reached this machine were handed to the callback."""
    impl = subscriber.impl
    if not isinstance(impl, _Subscription):
        return True
    return all(_is_read(connection) for connection in list(impl.connections or ()))


def connected_uris(subscriber: rospy.Subscriber) -> set[str]:
    """Return the URIs of the connected publishers."""
    impl = subscriber.impl
    connections = list(impl.connections or ()) if impl is not None else []
    return {c.endpoint_id for c in connections if c.header is not None}


def was_heard(subscriber: rospy.Subscriber) -> bool:
    """Return whether a publisher was ever connected."""
    impl = subscriber.impl
    return not isinstance(impl, _Subscription) or impl.was_heard


class _Subscription(_SubscriberImpl):
    """The implementation of a subscription in rospy, with the repairs described above.

    rospy calls its methods on the threads of the connections, and has one thread for each attempt
    to connect. A connection gets two further attributes here: ``heard_at``, the monotonic time of
    its last message, s, and ``handled``, the number of its bytes that were handed to the callbacks.
    """

    def __init__(
        self, name: str, pass_on: Callable[[rospy.AnyMsg], None], tcp_nodelay: bool
    ) -> None:
        super().__init__(name, rospy.AnyMsg)
        self.set_buff_size(BUFF_SIZE)
        self.set_tcp_nodelay(tcp_nodelay)
        self._connecting: dict[str, threading.Thread] = {}
        """URI of a publisher -> thread that connects to it."""
        self._named: dict[str, float] = {}
        """URI of a connected publisher -> time at which the master last named it, monotonic, s."""
        self.on_gaps: list[OnGap] = []
        self.was_heard = False
        """Whether a publisher was ever connected."""
        self.add_callback(pass_on, None)

    def has_connection(self, endpoint_id: str) -> bool:
        """Return whether a publisher is connected; wait for another thread that connects to it.

        rospy calls it before it connects to a publisher, and does not connect if it is True.
        """
        me = threading.current_thread()
        while not rospy.is_shutdown():
            with self.c_lock:
                connections = [c for c in self.connections if c.endpoint_id == endpoint_id]
                if any(not c.done and not _has_hung_up(c) for c in connections):
                    self._named[endpoint_id] = time.monotonic()
                    return True
                other = self._connecting.get(endpoint_id)
                if other is None or other is me or not other.is_alive():
                    alive = {u: t for u, t in self._connecting.items() if t.is_alive()}
                    self._connecting = {**alive, endpoint_id: me}
                    return False
            other.join(1.0)
        return True

    def add_connection(self, c: Transport) -> bool:
        """Add a connection; an old one of the same publisher may still be read."""
        with self.c_lock:
            for old in self.connections:
                if old.endpoint_id == c.endpoint_id:
                    if not old.done and not _has_hung_up(old):
                        return False  # two threads have asked the publisher
                    old.endpoint_id += _CLOSING
            self.was_heard = True
            return bool(super().add_connection(c))

    def remove_connection(self, c: Transport) -> None:
        """Remove a connection that has ended; try to connect to its publisher again."""
        super().remove_connection(c)
        with self.c_lock:
            again = c.endpoint_id.replace(_CLOSING, "")
            was_named = self._named.pop(again, -TOLD_SEC) > time.monotonic() - TOLD_SEC
            if not (was_named or _is_greeted(c)) or self.closed or rospy.is_shutdown():
                return
        heard_at = None if was_named else getattr(c, "heard_at", time.monotonic())
        threading.Thread(target=self._reconnect, args=(again, heard_at), daemon=True).start()

    def _reconnect(self, uri: str, heard_at: float | None) -> None:
        """Connect to a publisher again; one that has ended or left the topic refuses.

        Args:
            heard_at: Monotonic time at which it was last heard, s; None = the master has named it
                since: it is another process, of which nothing was missed.
        """
        if heard_at is not None:
            time.sleep(RECONNECT_SEC)  # a publisher that closes at once is not asked all the time
        for listener in list(get_registration_listeners().listeners):
            connect = getattr(listener, "_connect_topic_thread", None)
            if connect is not None and not (self.closed or rospy.is_shutdown()):
                if self._connections_to(uri):
                    heard_at = None  # the master has named it meanwhile
                connect(self.name, uri)
        if heard_at is not None and self._await_greeting(uri):
            lasted = time.monotonic() - heard_at
            for on_gap in list(self.on_gaps):
                on_gap(self.name, lasted)
            _log.warning(
                "a connection of %s was broken, while its publisher went on: what it sent in the "
                "last %.1f s may be lost",
                self.name,
                lasted,
            )

    def _connections_to(self, uri: str) -> list[Transport]:
        """Return the connections to a publisher that have not ended."""
        return [c for c in list(self.connections or ()) if c.endpoint_id == uri and not c.done]

    def _await_greeting(self, uri: str) -> bool:
        """Wait until a publisher has sent its header; return False if it does not."""
        while not (self.closed or rospy.is_shutdown()):
            connections = self._connections_to(uri)
            if not connections or any(map(_is_greeted, connections)):
                return bool(connections)
            time.sleep(_POLL_SEC)
        return False

    def receive_callback(self, msgs: list[rospy.AnyMsg], connection: Transport) -> None:
        """Hand on messages and count the bytes of the connection that were handled."""
        super().receive_callback(msgs, connection)
        connection.heard_at = time.monotonic()
        nbytes = sum(len(msg._buff) + 4 for msg in msgs)
        connection.handled = getattr(connection, "handled", 0) + nbytes


def _is_greeted(connection: Transport) -> bool:
    """Return whether the publisher has sent its header, and no refusal."""
    return bool(connection.header) and "error" not in connection.header


def _has_hung_up(connection: Transport) -> bool:
    """Return whether the publisher has closed its end."""
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
    """Return whether all bytes that have come over a connection were handed to the callbacks."""
    sock = connection.socket
    if sock is None or connection.done:
        return True
    try:
        # The socket first: its bytes are counted as received before they leave it.
        unread = unread_bytes(sock)
    except (OSError, ValueError):
        return True
    return not unread and getattr(connection, "handled", 0) == _received.get(sock, 0)


def unread_bytes(sock: socket.socket) -> int:
    """Return the number of unread bytes in a socket."""
    return int(_length(fcntl.ioctl(sock, termios.FIONREAD, bytes(4)))[0])


def receive(sock: socket.socket, b: io.BytesIO, buff_size: int) -> int:
    """Wait for bytes and append them to ``b``, as recv_buff of rospy does; return their number.

    They are counted before they leave the socket.

    Raises:
        TransportTerminated: The connection broke, or the publisher has closed it.
    """
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
    """Read a connection header as rosgraph does, but keep bytes that are not UTF-8.

    Afterwards ``b`` has the bytes that were received after the header.

    Raises:
        TransportInitError: The publisher has closed the connection, or the header is too large or
            broken.
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
