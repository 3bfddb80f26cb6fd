# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A publisher that says what it likes: TCPROS by hand, without rospy."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
import xmlrpc.client
from socketserver import ThreadingMixIn
from xmlrpc.server import SimpleXMLRPCServer


class _Server(ThreadingMixIn, SimpleXMLRPCServer):
    daemon_threads = True


def message(msg):
    """Serialise a message object."""
    from io import BytesIO

    buffer = BytesIO()
    msg.serialize(buffer)
    return buffer.getvalue()


def header_of(msg_class, name="/raw", **other):
    """The header fields that an honest publisher sends; None leaves one out."""
    fields = {
        "callerid": name,
        "latching": "0",
        "md5sum": msg_class._md5sum,
        "message_definition": msg_class._full_text,
        "topic": "",
        "type": msg_class._type,
    }
    fields.update(other)
    return {name: value for name, value in fields.items() if value is not None}


class RawPublisher:
    """One publisher of one topic, registered with the master."""

    def __init__(self, uri, topic, header, name="/raw"):
        self.topic, self.header, self.name = topic, header, name
        self._sockets = []
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._rpc = _Server(("127.0.0.1", 0), logRequests=False, allow_none=True)
        self._rpc.register_function(self._request_topic, "requestTopic")
        self._rpc.register_function(lambda caller: [1, "", 1], "getPid")
        self._rpc.register_function(lambda *args: [1, "", 0], "publisherUpdate")
        self.uri = f"http://127.0.0.1:{self._rpc.server_address[1]}/"
        for work in (self._rpc.serve_forever, self._accept):
            threading.Thread(target=work, daemon=True).start()
        self._master = xmlrpc.client.ServerProxy(uri)
        kind = header.get("type", "std_msgs/String")
        self._master.registerPublisher(name, topic, kind, self.uri)

    def _request_topic(self, caller, topic, protocols):
        # A node that was killed stays listed at the master, and our port may have been its own.
        if topic != self.topic:
            return [0, f"{topic} is not published here", []]
        return [1, "", ["TCPROS", "127.0.0.1", self._listener.getsockname()[1]]]

    def _accept(self):
        while True:
            try:
                sock, _ = self._listener.accept()
            except OSError:
                return
            try:
                self._greet(sock)
            except (OSError, struct.error):
                sock.close()  # it went before it had said who it is

    def _greet(self, sock):
        (size,) = struct.unpack("<I", sock.recv(4, socket.MSG_WAITALL))
        sock.recv(size, socket.MSG_WAITALL)
        fields = b""
        for name, value in self.header.items():
            raw = value if isinstance(value, bytes) else value.encode()
            field = name.encode() + b"=" + raw
            fields += struct.pack("<I", len(field)) + field
        sock.sendall(struct.pack("<I", len(fields)) + fields)
        # What is sent goes at once: else up to 40 ms of it wait for an acknowledgement and come
        # together, which overruns the 100 messages that rosbag record queues.
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._sockets.append(sock)

    def await_subscribers(self, count=1, timeout_sec=120):
        """Wait until a number of connections is open."""
        deadline = time.monotonic() + timeout_sec
        while len(self._sockets) < count:
            assert time.monotonic() < deadline, f"nobody subscribes to {self.topic}"
            time.sleep(0.01)
        return self

    def publish(self, *wires):
        """Send serialised messages to all subscribers, as fast as they take them."""
        data = b"".join(struct.pack("<I", len(wire)) + wire for wire in wires)
        for sock in list(self._sockets):
            try:
                sock.sendall(data)
            except OSError:  # a subscriber that was killed, or another thread has hung up
                with contextlib.suppress(ValueError):
                    self._sockets.remove(sock)

    @contextlib.contextmanager
    def only_last(self):
        """Publish to the subscriber that came last alone."""
        every, self._sockets = self._sockets, self._sockets[-1:]
        yield self
        self._sockets = every

    def close(self):
        """Unregister and hang up; who comes again meanwhile is refused."""
        self._master.unregisterPublisher(self.name, self.topic, self.uri)
        with contextlib.suppress(OSError):  # it is shut down already
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self.hang_up()
        self._rpc.shutdown()
        self._rpc.server_close()

    def hang_up(self):
        """Close the connections; what was sent is still delivered."""
        for sock in self._sockets:
            sock.close()
        self._sockets = []

    def __enter__(self):
        return self

    def __exit__(self, *exc_info):
        self.close()
