# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Latched messages before a time, of topics whose key is not the time of reception."""

from __future__ import annotations

from std_msgs.msg import Header

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.topics.overview.latched_messages import latched_before
from cassandra_ros.topics.overview.latest_messages import Latest

T0 = 1_500_000_000 * SECOND_NS


def test_what_was_received_at_the_time_itself_is_not_before_it(rosCas):
    rosCas.addTopic("/h", key_format="msg_part", key_part="stamp", msg_type="std_msgs/Header")
    header = {"type": Header._type, "md5sum": Header._md5sum, "latching": "1"}
    header["message_definition"] = Header._full_text
    with rosCas.messageWriter(writer_id=5) as writer:
        handle = writer.connect(live_connection("/h", header))
        for n in range(3):
            stamp = Stamp.from_ns(T0 - (n + 1) * SECOND_NS)
            writer.write(handle, T0 + n, n, serialize(Header(seq=n, stamp=stamp)))
        other = writer.connect(live_connection("/other", header))
        writer.write(other, T0 + 1, 9, serialize(Header()))
    found = {
        t: [row.received for row in latched_before(rosCas.catalog, t, ["/h"])] for t in (T0, T0 + 1)
    }
    assert found == {T0: [], T0 + 1: [T0]}


def test_messages_latched_at_the_time_of_a_view_are_shown(rosCas):
    """Two publishers have latched a message at the same time, and a view of this time has both."""
    header = {"type": Header._type, "md5sum": Header._md5sum, "latching": "1"}
    header["message_definition"] = Header._full_text
    with rosCas.messageWriter(writer_id=5) as writer:
        for n in range(2):
            handle = writer.connect(live_connection("/h", {**header, "callerid": f"/talker{n}"}))
            writer.write(handle, T0, n, serialize(Header(seq=n)))
    latest = Latest(rosCas.catalog.keyspace, rosCas.getTopic("/h").tables)
    assert [row.message().seq for row in latest.before(T0)] == [0, 1]
    assert latest.before(T0 - 1) == []
