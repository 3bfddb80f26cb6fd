# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""How rospy reads from publishers, mended in two places.

A connection header that is not UTF-8 (a degree sign in an old .msg file) is refused by rosgraph,
and its publisher never heard; here the bytes are kept as surrogates. And what was read is counted,
so that the end of a recording can wait until all of it was handled.
"""

from __future__ import annotations

import fcntl
import select
import socket
import struct
import termios
from typing import Any
from weakref import WeakKeyDictionary

import rospy
from rospy.impl import tcpros_base

_length = struct.Struct("<I").unpack_from
_received: WeakKeyDictionary[Any, int] = WeakKeyDictionary()
"""Socket of a connection → bytes that came behind its header."""


def mendReading() -> None:
    """Let rospy read with the functions below, in this process."""
    tcpros_base.read_ros_handshake_header = readHeader
    tcpros_base.recv_buff = receive


def receivedBytes(sock: Any) -> int:
    """Return how many bytes have left a socket behind the header; -1 while that is read."""
    return _received.get(sock, 0)


def unreadBytes(sock: Any) -> int:
    """Return how many bytes lie in a socket."""
    return int(_length(fcntl.ioctl(sock, termios.FIONREAD, bytes(4)))[0])


def receive(sock: Any, b: Any, buff_size: int) -> int:
    """Read what is there, as rospy's recv_buff; count it before it leaves the socket.

    Args:
        sock: Blocking socket.
        b: BytesIO to append to.
        buff_size: At most so many bytes.

    Returns:
        The number of bytes.
    """
    try:
        poller = select.poll()
        poller.register(sock, select.POLLIN)
        poller.poll()
        size = min(unreadBytes(sock), buff_size)
        _received[sock] = _received.get(sock, 0) + size
        data = sock.recv(max(size, 1))
    except (OSError, ValueError) as exc:
        raise rospy.exceptions.TransportTerminated(f"the connection broke: {exc}") from exc
    if not data:
        raise rospy.exceptions.TransportTerminated("the publisher has closed the connection")
    b.write(data)
    return len(data)


MAX_HEADER_BYTES = 16 * 1024 * 1024


def readHeader(sock: Any, b: Any, buff_size: int) -> dict[str, str]:
    """Read a connection header as rosgraph does, keeping bytes that are not UTF-8.

    Args:
        sock: Blocking socket.
        b: BytesIO; afterwards holds what came behind the header.
        buff_size: Bytes to read at once.
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
    return _fields(received[4:end])


def _fields(header: bytes) -> dict[str, str]:
    fields: dict[str, str] = {}
    at = 0
    while at + 4 <= len(header):
        (size,) = _length(header, at)
        name, equals, value = header[at + 4 : at + 4 + size].partition(b"=")
        at += 4 + size
        if not equals or at > len(header):
            raise rospy.exceptions.TransportInitError("a connection header is malformed")
        text = name.decode("utf-8", "surrogateescape").strip()
        fields[text] = value.decode("utf-8", "surrogateescape")
    return fields
