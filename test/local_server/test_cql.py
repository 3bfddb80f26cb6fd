# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
from __future__ import annotations

import socket
import threading

from cassandra_ros.local_server import free_port
from cassandra_ros.local_server.cql import answers_cql, schema_versions


def listener():
    server = socket.socket()
    server.bind(("127.0.0.1", 0))
    server.listen()
    return server, server.getsockname()[1]


def test_who_does_not_speak_cql():
    server, port = listener()

    def answer():
        connection, _ = server.accept()
        with connection:
            connection.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")

    with server:
        thread = threading.Thread(target=answer)
        thread.start()
        assert not answers_cql("127.0.0.1", port, timeout_sec=60)
        thread.join()
    assert not answers_cql("127.0.0.1", port)


def test_a_listener_that_says_nothing_is_given_up():
    server, port = listener()
    with server:
        assert not answers_cql("127.0.0.1", port, timeout_sec=0.1)


def test_cassandra_speaks_cql(cassandra):
    assert answers_cql(cassandra.host, cassandra.port, timeout_sec=60)


def test_a_node_tells_its_version_of_the_schema(cassandra, cql):
    def asked():
        [row] = cql.execute("SELECT schema_version FROM system.local")
        return {"here": str(row[0])}

    # Other tests change the schema meanwhile: it counts when it is the same before and after.
    before, told, after = None, None, asked()
    while before != after:
        before = after
        told, after = schema_versions(cassandra.host, cassandra.port, timeout_sec=60), asked()
    assert told == after


def test_a_closed_port_gives_no_versions():
    assert schema_versions("127.0.0.1", free_port()) == {}
