# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""addData: message objects into the store, one at a time."""

from __future__ import annotations

import itertools
import sys
import threading
import time
from typing import Any, Callable, Optional

from cassandra_ros.errors import ClockNotSet, WriteFailed
from cassandra_ros.keys import Position, RowName, joinSeq, newWriterId
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection import apiConnection
from cassandra_ros.messages.definition import definitionOf
from cassandra_ros.messages.stamps import Stamp, toNs
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.message_writer import MessageWriter
from cassandra_ros.topics.selection import Time
from cassandra_ros.topics.stored_row import Key
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

    def add(self, table: TopicTable, msg: Any, t: int, node: str, name: str = "") -> Key:
        """Store a message of the table's type; return its key when it is acknowledged."""
        wire = serialize(msg)
        connection = apiConnection(table.metadata.topic, definitionOf(type(msg)), _callerid())
        # One at a time: a failure is raised to whoever flushes, and must be that message's.
        with self._mutex:
            writer = self._open()
            handle = writer.connect(connection, format=table.metadata.format, nodeID=node)
            counter = next(self._counter)
            seq = joinSeq(writer.writer_id, counter)
            row = writer.write(handle, t, counter, wire, name)
            try:
                writer.flush()
            except WriteFailed:
                if writer.current(handle) is handle:
                    raise
                # Another client removed the topic while this was on its way.
                row = writer.write(handle, t, counter, wire, name)
                writer.flush()
            stored = writer.current(handle).table
        if row is None:
            raise AssertionError("a writer without on_loss raises what it refuses")
        if stored.named:
            return RowName.of(Position(t, node, seq, stored.name, row.name))
        return Stamp.fromNs(row.t, node=node, seq=row.seq, table=stored.name)

    def _open(self) -> MessageWriter:
        if self._writer is None:
            self._writer = MessageWriter(self._keyspace, newWriterId(), linger_sec=0.0, ttl=None)
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


Clock = Callable[[], Time]


def nowNs(clock: Optional[Clock]) -> int:
    """Tell the time: the given clock's, else rospy's where a node runs here, else wall time.

    Args:
        clock: Returns a time of any kind that toNs takes, or None.

    Returns:
        Nanoseconds since 1970.

    Raises:
        ClockNotSet: The node uses simulated time and no /clock message has come.
    """
    if clock is not None:
        return toNs(clock())
    # Not imported: a program without a node must not need rospy.
    rospy = sys.modules.get("rospy")
    if rospy is None or not rospy.core.is_initialized():
        return time.time_ns()
    now = int(rospy.rostime.get_rostime().to_nsec())
    if not now:
        raise ClockNotSet(
            "simulated time is in use (/use_sim_time) and no /clock message has come yet: start "
            "the simulator or player, or give a key"
        )
    return now
