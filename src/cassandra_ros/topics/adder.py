# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""addData: message objects into the store, one at a time."""

from __future__ import annotations

import itertools
import sys
import threading
from typing import Any, Optional

from cassandra_ros.errors import WriteFailed
from cassandra_ros.keys import newWriterId
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection import apiConnection
from cassandra_ros.messages.definition import definitionOf
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.store.writer import RowWriter
from cassandra_ros.topics.clock import Clock, nowNs
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.message_writer import MessageWriter
from cassandra_ros.topics.topic_table import TopicTable


class Adder:
    """Stores single messages under one writer id. Thread-safe.

    Args:
        keyspace: Where to.
        clock: Tells the time for messages without a key; None = rospy's or the wall's.
    """

    def __init__(self, keyspace: Keyspace, clock: Optional[Clock]) -> None:
        self._keyspace = keyspace
        self._clock = clock
        self._counter = itertools.count()
        self._writer: Optional[MessageWriter] = None
        self._mutex = threading.Lock()

    def now(self) -> int:
        """Tell the time, ns."""
        return nowNs(self._clock)

    def add(self, table: TopicTable, msg: Any, t: int, node: str) -> Stamp:
        """Store a message of the table's type; return when it is acknowledged."""
        wire = serialize(msg)
        connection = apiConnection(table.metadata.topic, definitionOf(type(msg)), _callerid())
        # One at a time: a failure is raised to whoever flushes, and must be that message's.
        with self._mutex:
            writer = self._open()
            handle = writer.connect(connection, format=table.metadata.format, nodeID=node)
            counter = next(self._counter)
            seq = writer.write(handle, t, counter, wire)
            try:
                writer.flush()
            except WriteFailed:
                if writer.current(handle) is handle:
                    raise
                # Another client removed the topic while this was on its way.
                writer.write(handle, t, counter, wire)
                writer.flush()
            name = writer.current(handle).table.name
        return Stamp.fromNs(t, node=node, seq=seq, table=name)

    def _open(self) -> MessageWriter:
        if self._writer is None:
            space, writer_id = self._keyspace, newWriterId()
            rows = RowWriter(
                *(space.cassandra, space.schema, space.directory, writer_id), linger_sec=0.0
            )
            self._writer = MessageWriter(space, rows, writer_id, ttl=None)
            self._counter = itertools.count()
        return self._writer

    def close(self) -> None:
        """Close the writer; the next add opens another."""
        with self._mutex:
            writer, self._writer = self._writer, None
            if writer is not None:
                writer.close()


def _callerid() -> str:
    # Not imported: a program without a node must not need rospy.
    rospy = sys.modules.get("rospy")
    return str(rospy.get_name()) if rospy and rospy.core.is_initialized() else ""
