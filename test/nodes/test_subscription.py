# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a subscription knows of the connections that it has."""

from __future__ import annotations

import io
import itertools
import socket
import struct
import time
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import pytest

from cassandra_ros.nodes import subscriptions
from cassandra_ros.nodes.subscription import _has_hung_up, _is_read, _received, read_header


@pytest.fixture
def pair():
    with socket.create_server(("127.0.0.1", 0)) as server:
        ours = socket.create_connection(server.getsockname())
        theirs, _ = server.accept()
    with ours, theirs:
        yield ours, theirs


def hung_up(sock):
    return _has_hung_up(SimpleNamespace(socket=sock))


def test_one_that_is_being_connected_has_not_hung_up():
    assert not hung_up(None)
    with socket.socket() as sock:
        assert not hung_up(sock)


def test_one_that_stands_has_not_hung_up(pair):
    ours, theirs = pair
    assert not hung_up(ours)
    theirs.sendall(b"data")
    assert not hung_up(ours)


@pytest.mark.parametrize("linger", [False, True])
def test_one_whose_other_end_is_closed_has_hung_up(pair, linger):
    ours, theirs = pair
    if linger:  # it is reset
        theirs.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    theirs.sendall(b"data")
    theirs.close()
    assert hung_up(ours)


def test_one_that_is_refused_or_closed_has_hung_up():
    with socket.socket() as free, socket.socket() as sock:
        free.bind(("127.0.0.1", 0))
        with pytest.raises(ConnectionRefusedError):
            sock.connect(free.getsockname())
        # The error was told; what is left looks as it did before.
        sock.close()
        assert hung_up(sock)


def test_messages_that_come_with_the_header_are_not_handed_on_yet(pair):
    """A recording that ends just then must wait for them."""
    ours, theirs = pair
    connection = SimpleNamespace(socket=ours, done=False, handled=0)
    assert _is_read(connection)
    field = b"callerid=/x"
    header = struct.pack("<II", len(field) + 4, len(field)) + field
    with ThreadPoolExecutor(1) as other:
        behind = io.BytesIO()
        reading = other.submit(read_header, ours, behind, 4096)
        theirs.sendall(header[:9])
        while _received.get(ours, 0) == 0:
            time.sleep(0.001)
        assert not _is_read(connection)
        theirs.sendall(header[9:] + b"12345")
        assert reading.result() == {"callerid": "/x"}
    assert behind.getvalue() == b"12345"
    assert not _is_read(connection)
    connection.handled = 5
    assert _is_read(connection)


def test_a_topic_that_is_read_to_its_end_does_not_prolong_the_wait_for_others(monkeypatch):
    """By a clock of its own, which each look at it moves by a second."""
    seconds = itertools.count()
    drained = {"/a": iter([False, False, False, True]), "/b": itertools.repeat(False)}
    clock = SimpleNamespace(monotonic=lambda: float(next(seconds)), sleep=lambda sec: None)
    monkeypatch.setattr(subscriptions, "time", clock)
    monkeypatch.setattr(subscriptions, "is_drained", lambda topic: next(drained[topic]))
    monkeypatch.setattr(subscriptions.rospy, "is_shutdown", lambda: False)
    subscribed = subscriptions.Subscriptions(lambda topic, header, wire: None)
    subscribed._subscribers = {"/a": "/a", "/b": "/b"}
    assert subscribed.drain(["/a", "/b"], lambda topic: 7, lambda: False) == ["/b"]
    # Looks at 0 s before the loop, at 1 s when the counts are new, then until DRAIN_SEC is over.
    assert next(seconds) - 1 == 1 + subscriptions.DRAIN_SEC + 1
