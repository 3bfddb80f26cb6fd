# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""How addData stores message objects: one at a time, each acknowledged before it returns."""

from __future__ import annotations

import itertools
import sys
import threading
import time
from types import ModuleType

from cassandra_ros.errors import ClockNotSet
from cassandra_ros.keys import COUNTER_BITS, Position, RowName, new_writer_id
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.messages.stamps import Stamp, Time, to_ns
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.message_writer import MessageWriter
from cassandra_ros.topics.row_finder import Clock
from cassandra_ros.topics.stored_row import Key
from cassandra_ros.topics.topic_table import TopicTable


class MessageAdder:
    """Stores single messages under one writer id. Thread-safe."""

    def __init__(self, keyspace: Keyspace, clock: Clock | None) -> None:
        self._keyspace = keyspace
        self._clock = clock
        # Both stay when the writer is closed, so messages with equal stamps keep their order.
        self._writer_id = new_writer_id()
        self._counter = itertools.count()
        self._writer: MessageWriter | None = None
        self._mutex = threading.Lock()

    def add(self, table: TopicTable, msg: object, t: Time | None, node: str, name: str = "") -> Key:
        """Store a message of the table's type (t None = now); return its key when acknowledged.

        Raises:
            InvalidKey, ClockNotSet: The time is not valid, or not known yet.
            WriteFailed, SchemaConflict, StoreUnavailable: The message could not be stored.
        """
        t = clock_ns(self._clock) if t is None else to_ns(t)
        wire = serialize(msg)
        connection = api_connection(table.metadata.topic, definition_of(type(msg)), _caller_id())
        # One at a time: flush raises a failure, which must belong to the message of this call.
        with self._mutex:
            writer = self._writer
            if writer is None:
                writer = MessageWriter(self._keyspace, self._writer_id, linger_sec=0.0, ttl=None)
                self._writer = writer
            # A table that is about to be replaced takes no new messages.
            format_name = self._keyspace.schema.format_after(table.name, table.metadata.format)
            handle = writer.connect(connection, format=format_name, node=node)
            counter = next(self._counter)
            row = writer.write(handle, t, counter, wire, name)
            writer.flush()
            # Another client may have removed the topic, so that the message is in another table.
            present = writer.current(handle)
        seq, table = writer.writer_id << COUNTER_BITS | counter, present.table
        if row is None or present is not handle:  # the message is in a block, or moved
            row = table.make_row(t, seq, present.conn, wire, name)
        if table.named:
            # Not row.seq: in a row that equal messages share it is 0.
            return RowName.of(Position(t, node, seq, table.name, row.name))
        return Stamp.from_ns(row.t, node=node, seq=row.seq, table=table.name)

    def close(self) -> None:
        """Close the writer; the next add opens another one with the same id."""
        with self._mutex:
            writer, self._writer = self._writer, None
            if writer is not None:
                writer.close()


def _rospy() -> ModuleType | None:
    """Return rospy if a node runs in this process, otherwise None."""
    # Not imported here: a program without a node must not need rospy.
    rospy = sys.modules.get("rospy")
    return rospy if rospy is not None and rospy.core.is_initialized() else None


def _caller_id() -> str:
    rospy = _rospy()
    return "" if rospy is None else str(rospy.get_name())


def clock_ns(clock: Clock | None) -> int:
    """Return the time, ns: the given clock's, else rospy's if a node runs here, else wall time.

    Wall time is not asked of rospy, which rounds it to a float.

    Raises:
        ClockNotSet: The node uses simulated time and no /clock message has come.
    """
    if clock is not None:
        return to_ns(clock())
    rospy = _rospy()
    if rospy is None or rospy.rostime.is_wallclock():
        return time.time_ns()
    now = int(rospy.rostime.get_rostime().to_nsec())
    if not now:
        raise ClockNotSet(
            "simulated time is in use (/use_sim_time) and no /clock message has come yet: start "
            "the simulator or player, or give a key"
        )
    return now
