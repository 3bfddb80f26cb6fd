# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The version of what is stored: another one whenever the messages are others."""

from __future__ import annotations

import pytest
from std_msgs.msg import UInt32

from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.read import Read, TimeRange
from cassandra_ros.topics.overview.content_version import content_version

SEC = 10**9
T0 = 1_500_000_000 * SEC


def write(rosCas, numbers, ttl=0):
    with rosCas.messageWriter(ttl=ttl, format="binary") as writer:
        handle = writer.connect(api_connection("/a", definition_of(UInt32), "/x"), bucket_ns=SEC)
        for number in numbers:
            writer.write(handle, T0 + number * SEC // 2, number, serialize(UInt32(number)))


def version(rosCas, read):
    directory = rosCas.catalog.keyspace.directory
    return content_version(directory, rosCas.getTopic("/a").tables, read)


def test_messages_of_the_time_range_count_alone(rosCas):
    write(rosCas, range(4))
    first_second = Read(TimeRange(T0, T0 + SEC - 1))
    before, whole = version(rosCas, first_second), version(rosCas, Read())
    write(rosCas, [4])  # in the third bucket
    assert version(rosCas, first_second) == before
    assert version(rosCas, Read()) != whole


@pytest.mark.parametrize("number", [0, 2])
def test_a_message_that_has_expired_changes_it(rosCas, cql, number):
    """The directory is not told when a row expires, and so the rows of its table are counted."""
    write(rosCas, range(3), ttl=86400)
    before = version(rosCas, Read())
    assert version(rosCas, Read()) == before
    (table,) = rosCas.getTopic("/a").tables
    t = T0 + number * SEC // 2
    cql.execute(
        f'DELETE FROM {table.qualified} WHERE "_node" = %s AND "_bucket" = %s AND "_t" = %s',
        ("", table.bucket_of(t), t),
    )
    assert version(rosCas, Read()) != before
