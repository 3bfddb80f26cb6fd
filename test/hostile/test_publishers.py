# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A publisher that sends changed headers and messages, to a writer and to a recorder."""

from __future__ import annotations

import socket
import struct

import psutil
import pytest
from hostile.mutate import changed_bytes, changed_text
from hostile.test_definitions import WORDS
from messages.random_wire import WireMaker
from nav_msgs.msg import Odometry
from nodes.children import await_true, start_recorder
from nodes.raw_publisher import RawPublisher, header_of, message
from sensor_msgs.msg import Imu, LaserScan
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from cassandra_ros.messages.classes import installed_definition
from cassandra_ros.messages.connection_header import Connection, live_connection
from cassandra_ros.metadata import FORMAT_NAMES

KINDS = (String, Imu, LaserScan, TFMessage, Odometry)
DEFINITIONS = {kind: installed_definition(kind._type) for kind in KINDS}
HONEST = 20
T0 = 1_400_000_000 * 10**9


def fields_of(chance, kind):
    """Return the fields of a publisher's header, of which some are changed."""
    fields = header_of(kind)
    name = chance.choice(list(fields))
    if chance.random() < 0.7:
        fields[name] = changed_text(chance, fields[name], WORDS)
    elif chance.random() < 0.5:
        del fields[name]
    return fields


def wires_of(chance, kind):
    """Return messages, of which one is changed."""
    maker = WireMaker(DEFINITIONS[kind], chance.getrandbits(32), odd=chance.random() < 0.3)
    wires = [maker.make() for _ in range(chance.choice((1, 3)))]
    return [*wires, changed_bytes(chance, wires[0], range(0, len(wires[0]), 4), wires)]


@pytest.mark.suite("all", "a search over changed inputs")
def test_messages_that_are_written(give, rosCas):
    """Right headers and changed messages go into tables that stand; a changed header rarely does
    not make another table, which takes as long as a hundred messages."""
    counts = {}
    with rosCas.messageWriter() as writer:

        def attempt(chance):
            kind, name = chance.choice(KINDS), chance.choice(list(FORMAT_NAMES))
            topic, header = f"/{name}/{kind.__name__}", header_of(kind)
            if chance.random() < 0.03:
                topic, header = f"/{name}/changed", fields_of(chance, kind)
            connection = live_connection(topic, header)
            if chance.random() < 0.02:
                topic = f"/{name}/changed"
                connection = Connection(topic, changed_bytes(chance, connection.header))
            handle = writer.connect(connection, format=name)
            for wire in wires_of(chance, kind):
                counts[topic] = counts.get(topic, 0) + 1
                number = sum(counts.values())
                writer.write(handle, T0 + number * 10**6, number, wire)

        give("messages of a hostile publisher, written", 400, attempt)
    stored = {topic.name: topic.countTopicData() for topic in rosCas.getAllTopics()}
    assert stored == counts


class HostilePublisher(RawPublisher):
    """A publisher whose header is any bytes, of any stated length."""

    def __init__(self, *words, raw):
        self.raw = raw
        super().__init__(*words)

    def _greet(self, sock):
        (size,) = struct.unpack("<I", sock.recv(4, socket.MSG_WAITALL))
        sock.recv(size, socket.MSG_WAITALL)
        sock.sendall(self.raw)
        self._sockets.append(sock)

    def close(self):
        """End the thread that waits for subscribers, too."""
        self._listener.shutdown(socket.SHUT_RDWR)
        super().close()


def raw_header(fields):
    parts = [f"{name}={value}".encode("utf-8", "replace") for name, value in fields.items()]
    body = b"".join(struct.pack("<I", len(part)) + part for part in parts)
    return struct.pack("<I", len(body)) + body


@pytest.fixture
def recorder(roscore, cassandra, keyspace, rosCas):
    """A recorder of hostile topics and of an honest one."""
    words = ("-e", "/hostile/.*", "/honest")
    with start_recorder(roscore, cassandra, keyspace, *words) as child:
        child.await_line("recording ")
        yield child
        assert child.end() == 0, child.output


@pytest.mark.suite("all", "hundreds of publishers")
def test_publishers_that_are_recorded(give, roscore, recorder, rosCas):
    process = psutil.Process(recorder.process.pid)
    numbers = iter(range(10**9))

    def attempt(chance):
        kind = chance.choice(KINDS)
        raw = raw_header(fields_of(chance, kind))
        if chance.random() < 0.6:
            raw = changed_bytes(chance, raw, range(0, min(len(raw), 60), 4))
        topic = f"/hostile/t{next(numbers)}"
        words = (roscore.uri, topic, header_of(kind), "/raw")
        with HostilePublisher(*words, raw=raw) as publisher:
            publisher.await_subscribers()
            frames = [struct.pack("<I", len(wire)) + wire for wire in wires_of(chance, kind)]
            data = b"".join(frames)
            if chance.random() < 0.4:
                data = changed_bytes(chance, data, [0, 4])
            for sock in list(publisher._sockets):
                try:
                    sock.sendall(data)
                except OSError:
                    pass  # it has hung up
        assert recorder.process.poll() is None, recorder.output

    give("publishers of a recorder", 8, attempt, watched=[process])
    with RawPublisher(roscore.uri, "/honest", header_of(String), "/fair") as publisher:
        publisher.await_subscribers()
        publisher.publish(*(message(String(f"{n}")) for n in range(HONEST)))
        await_true(lambda: rosCas.existTopic("/honest"))
        await_true(lambda: rosCas.getTopic("/honest").countTopicData() == HONEST)
