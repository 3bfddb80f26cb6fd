# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a late subscriber of a latched topic gets first; without a master and without a node."""

from __future__ import annotations

import contextlib
import socket
import struct

import pytest
from nodes.raw_publisher import message
from rospy.impl.tcpros_base import TCPROSTransport, TCPROSTransportProtocol
from std_msgs.msg import String

from cassandra_ros.nodes.publication import MessageKind, Publication

KIND = MessageKind.of("std_msgs/String", String._md5sum, String._full_text)


@pytest.fixture
def publication():
    made = Publication("/fixed", KIND, True, 10)
    yield made
    made.close()


@contextlib.contextmanager
def subscriber(publication, name):
    """Return a function that gives the texts that a new subscriber has got, a number of them."""
    with contextlib.ExitStack() as stack:
        listener = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        mine = stack.enter_context(socket.create_connection(listener.getsockname(), 180))
        theirs, _ = listener.accept()
        transport = TCPROSTransport(TCPROSTransportProtocol("/fixed", String), name)
        transport.set_socket(theirs, name)
        stack.callback(transport.close)
        stream = stack.enter_context(mine.makefile("rb"))
        assert publication.add_connection(transport)

        def texts(count):
            wires = [stream.read(*struct.unpack("<I", stream.read(4))) for _ in range(count)]
            return [String().deserialize(wire).data for wire in wires]

        yield texts


def publish(publication, *messages):
    for source, text in messages:
        publication.publish_wire(message(String(text)), source)


def test_the_last_message_of_each_source_comes_in_the_order_of_publication(publication):
    """A source that latches again comes last, so that no older message undoes its change."""
    publish(publication, ("one", "a"), ("two", "b"), ("three", "c"))
    with subscriber(publication, "first") as texts:
        assert texts(3) == ["a", "b", "c"]
        publish(publication, ("one", "d"), (None, "not latched"), ("two", "e"))
        assert texts(3) == ["d", "not latched", "e"]
        with subscriber(publication, "late") as late:
            assert late(3) == ["c", "d", "e"]
            publish(publication, ("three", "f"))
            assert texts(1) == late(1) == ["f"]


def test_what_was_forgotten_is_not_sent_to_late_subscribers(publication):
    publish(publication, ("one", "a"), ("two", "b"))
    publication.forget_latched()
    publish(publication, ("two", "c"))
    with subscriber(publication, "late") as texts:
        assert texts(1) == ["c"]
        publish(publication, (None, "next"))
        assert texts(1) == ["next"]
