# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A subscriber that takes any type, and as slowly as it likes: TCPROS by hand, without rospy."""

from __future__ import annotations

import socket
import struct
import time
import xmlrpc.client


class RawSubscriber:
    """One connection to the publisher of a topic; ``header`` is what that says, as bytes."""

    def __init__(self, uri, topic, timeout_sec=180, publisher=None, **fields):
        address = find(uri, topic, timeout_sec, publisher)
        self._sock = socket.create_connection(address, timeout_sec)
        wanted = {"topic": topic, "callerid": f"/raw_{id(self)}", "md5sum": "*", "type": "*"}
        data = b""
        for name, value in {**wanted, **fields}.items():
            field = f"{name}={value}".encode()
            data += struct.pack("<I", len(field)) + field
        self._sock.sendall(struct.pack("<I", len(data)) + data)
        self.header = {}
        rest = self.read()
        while rest:
            (size,) = struct.unpack_from("<I", rest)
            name, _, value = rest[4 : 4 + size].partition(b"=")
            self.header[name.decode()] = value
            rest = rest[4 + size :]

    def read(self):
        """Return the next message, None at the end."""
        size = self._read(4)
        return None if size is None else self._read(struct.unpack("<I", size)[0])

    def _read(self, size):
        data = b""
        while len(data) < size:
            found = self._sock.recv(size - len(data))
            if not found:
                return None
            data += found
        return data

    def rest(self):
        """Return all messages until the publisher goes."""
        return list(iter(self.read, None))

    def close(self):
        self._sock.close()

    def __enter__(self):
        return self

    def __exit__(self, *exc_info):
        self.close()


def find(uri, topic, timeout_sec, publisher=None):
    """Wait for a publisher of a topic, or for this one; return its address for TCPROS."""
    master = xmlrpc.client.ServerProxy(uri)
    deadline = time.monotonic() + timeout_sec
    while time.monotonic() < deadline:
        _, _, (publishers, _, _) = master.getSystemState("/raw")
        names = [n for n in dict(publishers).get(topic, ()) if publisher in (None, n)]
        if names:
            _, _, node = master.lookupNode("/raw", names[0])
            _, _, (_, host, port) = xmlrpc.client.ServerProxy(node).requestTopic(
                "/raw", topic, [["TCPROS"]]
            )
            return host, port
        time.sleep(0.02)
    raise AssertionError(f"topic {topic} has no publisher")
