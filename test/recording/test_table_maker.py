# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The thread that makes tables: many at once, but not so many that the first topics wait long."""

from __future__ import annotations

import threading

from nodes.children import await_true
from nodes.raw_publisher import header_of
from std_msgs.msg import String

from cassandra_ros.errors import StoreUnavailable, WriteFailed
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.recording import table_maker
from cassandra_ros.recording.message_buffer import MessageSource
from cassandra_ros.recording.table_maker import TOGETHER, TableMaker


def source(n):
    return MessageSource(live_connection(f"/topic{n}", header_of(String)))


def test_many_tables_are_made_in_groups():
    groups, decided, begin = [], [], threading.Event()

    def connect(each):
        begin.wait()
        decided.append(each.topic)
        return object()

    maker = TableMaker(lambda sources: groups.append(len(sources)), connect, lambda: None)
    for n in range(3 * TOGETHER):
        maker.make(source(n))
    begin.set()
    await_true(lambda: len(maker.decided) == 3 * TOGETHER)
    maker.close()
    assert decided == [f"/topic{n}" for n in range(3 * TOGETHER)]
    assert len(groups) >= 3
    assert max(groups) <= TOGETHER


def test_a_table_that_the_next_recorder_makes_is_no_error(caplog):
    """The messages are left in the spool when the connection is closed."""
    begin = threading.Event()

    def connect(each):
        begin.wait()
        raise StoreUnavailable("the connection is closed")

    maker = TableMaker(lambda sources: None, connect, lambda: None)
    waiting = source(0)
    maker.make(waiting)
    maker.close(wait=False)
    begin.set()
    await_true(lambda: waiting.error)
    # Threads of earlier tests may log that their server went away.
    assert waiting.topic not in caplog.text


def test_a_topic_that_is_removed_while_its_table_is_made_is_recorded_all_the_same(monkeypatch):
    monkeypatch.setattr(table_maker, "PAUSE_SEC", 0.01)
    answers = [WriteFailed("the table was dropped as soon as it was made"), object()]

    def connect(each):
        answer = answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    maker = TableMaker(lambda sources: None, connect, lambda: None)
    waiting = source(0)
    maker.make(waiting)
    await_true(lambda: maker.decided)
    maker.close()
    assert waiting.handle is not None, waiting.error
