# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Numbered messages of topic /a: written, and counted in the store and in its directory."""

from __future__ import annotations

from std_msgs.msg import String

from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of

SEC = 10**9
T0 = 1_500_000_000 * SEC


def connect(writer, topic="/a", cls=String, caller="/x", **options):
    return writer.connect(api_connection(topic, definition_of(cls), caller), **options)


def wire_of(number):
    return serialize(String(data=f"text {number}"))


def write(writer, numbers, **options):
    """Write the messages with these numbers to /a; return the handle."""
    handle = connect(writer, **options)
    for number in numbers:
        writer.write(handle, T0 + number, number, wire_of(number))
    return handle


def write_in_two_parts(writer):
    """Write messages 0 to 4 and flush, then write messages 5 to 9 and close the writer."""
    write(writer, range(5))
    writer.flush()
    write(writer, range(5, 10))
    writer.close()


def directory_of(rosCas, node=""):
    """Return the directory's rows of the one bucket of /a, by writer id."""
    (table,) = rosCas.getTopic("/a").tables
    rows = rosCas.catalog.keyspace.directory.find(table.name, node, table.bucket_of(T0))
    return {row.writer: row for row in rows}


def told(rosCas):
    """Return the number of messages of /a: read as rows, counted, and as info says."""
    topic = rosCas.getTopic("/a")
    return len(list(topic.rows())), topic.countTopicData(), rosCas.info(["/a"])[0].count
