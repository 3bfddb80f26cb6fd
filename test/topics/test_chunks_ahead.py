# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Large messages are asked for ahead: in order, within bounds, and only for who reads them."""

from __future__ import annotations

import os

import pytest
from hypothesis import given
from hypothesis import strategies as st
from std_msgs.msg import UInt8MultiArray

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.topics.stored_row import AHEAD_ROWS, LARGE_AHEAD_BYTES, chunks_ahead

MB = 10**6


class Row:
    """What chunks_ahead knows of a row."""

    def __init__(self, size):
        self.size, self.chunked = size, size > MB // 2
        self.asked = self.was_read = False

    def ask(self):
        assert self.chunked and not self.asked
        self.asked = True


ROWS = st.lists(st.sampled_from([100, MB, 3 * MB, 20 * MB]), max_size=100)


@given(ROWS, st.sampled_from(["all", "none", "some"]), st.randoms())
def test_order_and_bounds(sizes, reads, rand):
    rows = [Row(size) for size in sizes]
    taken = []

    def source():
        for row in rows:
            taken.append(row)
            yield row

    for number, row in enumerate(chunks_ahead(source())):
        assert row is rows[number]
        ahead = taken[number + 1 :]
        assert len(ahead) <= AHEAD_ROWS
        # Within the budget, but for the one that reaches it.
        assert sum(r.size for r in ahead[:-1] if r.asked) <= LARGE_AHEAD_BYTES
        row.was_read = reads == "all" or (reads == "some" and rand.random() < 0.8)
    assert len(taken) == len(rows)
    if reads == "none":
        assert not any(row.asked for row in rows)
    if reads == "all":
        assert all(row.asked for row in [row for row in rows if row.chunked][1:])


def test_scan_of_large_messages(rosCas, cql):
    sizes = [MB, 100, 6 * MB, MB, MB, 100, 2 * MB, MB]
    messages = [UInt8MultiArray(data=os.urandom(size)) for size in sizes]
    rosCas.addTopic("/big", format="binary", msg_type="std_msgs/UInt8MultiArray")
    topic = rosCas.getTopic("/big")
    keys = [topic.addData(message) for message in messages]
    assert [message for _, message in topic.items()] == messages
    assert [message for _, message in topic.items(reverse=True)] == messages[::-1]
    topic.removeData(keys[3])
    (table,) = topic.tables
    cql.execute(
        f'DELETE FROM {rosCas.keyspace}."{table.name}_c" WHERE "_node" = \'\' '
        f'AND "_bucket" = {table.bucket_of(keys[4].ns)} AND "_t" = {keys[4].ns} '
        f'AND "_seq" = {keys[4].seq} AND "_chunk" = 1'
    )
    found = []
    with pytest.raises(CorruptMessage, match="1 of 2 chunks"):
        found.extend(row.message() for row in topic.rows())
    rows = list(topic.rows())
    assert len(rows) == 7
    assert [row.message() for row in rows[4:]] == messages[5:]
