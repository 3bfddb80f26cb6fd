# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""From the store into a bag or an MCAP, which holds the messages as they were recorded."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from typing import Iterable, Iterator, Sequence

from cassandra_ros.bag.file_formats import make_file
from cassandra_ros.bag.file_writer import FileWriter
from cassandra_ros.bag.message_file import MessageProgress
from cassandra_ros.bag.publish_times import SentFinder
from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.errors import BagError, MessageNotFound
from cassandra_ros.keys import split_seq
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.messages.stamps import Time, iso_time
from cassandra_ros.overview.latched_messages import latched_before
from cassandra_ros.topics.catalog import Catalog, Conditions
from cassandra_ros.topics.key_selection import TimeRange
from cassandra_ros.topics.run_finder import RunName
from cassandra_ros.topics.stored_row import StoredRow

_RUN_NUMBERS = 1 << 16
"""Connection numbers that are set aside for each recording or import."""


@dataclass
class ExportReport:
    """What an export wrote."""

    path: str
    messages: dict[str, int] = field(default_factory=dict)
    """Number of messages by topic."""
    bytes: int = 0
    """Serialised bytes."""
    latched: dict[str, int] = field(default_factory=dict)
    """How many messages by topic were latched before the start; they are counted above, too."""

    def add(self, topic: str, size: int, early: bool) -> None:
        """Count a message of so many bytes; early: it was latched before the start."""
        self.bytes += size
        for counts in (self.messages, self.latched) if early else (self.messages,):
            counts[topic] = counts.get(topic, 0) + 1


def export_bag(
    ros_cas: RosCassandra,
    path: str | os.PathLike[str],
    topics: Iterable[str] | None = None,
    start: Time | None = None,
    end: Time | None = None,
    nodeID: str | None = None,
    compression: str | None = None,
    force: bool = False,
    progress: MessageProgress | None = None,
    where: Conditions = None,
    empty: bool = False,
    run: RunName = None,
    latched: bool = True,
) -> ExportReport:
    """Write stored messages into a bag of format 2.0, or into an MCAP.

    The messages are written in the order in which they were received. Connections keep topic,
    header and number, so rosbag gives back the messages of an imported bag in their order: by
    time, connection, position. In an MCAP they are the channels; publish_time and sequence are
    those of the MCAP from which a message came, else log_time and 0.

    Args:
        path: The file to make, an MCAP where it ends with .mcap, else a bag; it has the name
            PATH.active until it is complete.
        topics: Only these; None = all.
        start: First time of reception (genpy.Time, int ns, float s or text); None = open.
        end: Last time, included; None = open.
        nodeID: Only what this node recorded; None = all nodes.
        compression: 'none', 'lz4', of a bag also 'bz2', of an MCAP 'zstd'; None = 'none' in a
            bag, 'zstd' in an MCAP.
        force: Replace a file that exists.
        progress: Told what was written.
        where: Topic -> condition, as readMessages takes it: of these topics only the messages
            that satisfy it; the others are written whole.
        empty: Write a bag also where there is no message for it.
        run: Only what the recordings or imports of this name, or of a writer id, stored.
        latched: Where there is a start, begin with what was latched before it: for each publisher
            of the runs that the bag shows its last message (of /tf_static, say). These stand at
            the time of the start, each with a connection of its own, in whose header the field
            ``latched_from`` says when it was received, ns.

    Raises:
        MessageNotFound: There is no message for it; a file that was there before stays, and none
            is begun, of which somebody who follows it would get a part.
        BagError: The file exists, or cannot be written.
        TopicNotFound, RunNotFound: One of the topics is not stored, or there is no such run.
        InvalidOption, InvalidQuery: where is none.
        StoreUnavailable: The store stopped answering; no bag is left behind.
    """
    if os.path.exists(path) and not force:
        raise BagError(f"{os.fspath(path)} exists; choose another name, or replace it with --force")
    # One topic may have been asked for in two spellings.
    catalog = ros_cas.catalog
    names = None if topics is None else sorted({catalog.get(name).name for name in topics})
    rows = catalog.read(names, start, end, node=nodeID, received=True, where=where, run=run)
    low, high = TimeRange.between(start, end)
    before = []
    if latched and start is not None:
        before = latched_before(catalog, low, names, to=high, nodeID=nodeID, run=run, where=where)
    report = ExportReport(os.fspath(path))
    first = list(islice(rows, 1))
    if not (before or first or empty):
        raise _not_written(report.path, why_empty(catalog, names, nodeID, run))
    with make_file(path, compression) as writer:
        numbers = ConnectionNumbers(writer)
        sent = SentFinder(catalog.keyspace.side_tables, writer.keeps_sent)
        for number, t_ns, row in _numbered(numbers, low, before, chain(first, rows)):
            wire = row.wire
            writer.write(number, t_ns, wire, *sent.of(row, t_ns))
            report.add(row.topic, len(wire), early=t_ns != row.received)
            if progress is not None:
                progress(1, len(wire))
    return report


def _numbered(
    numbers: ConnectionNumbers, low: int, before: Iterable[StoredRow], rows: Iterable[StoredRow]
) -> Iterator[tuple[int, int, StoredRow]]:
    """Yield rows with their connection's number and their time; what was latched before first."""
    for row in before:
        yield numbers.latched(row), low, row
    for row in rows:
        yield numbers.of(row), row.received, row


def _not_written(path: str, reason: str) -> MessageNotFound:
    return MessageNotFound(f"{path} is not written, for there is no such message: {reason}")


def why_empty(
    catalog: Catalog,
    topics: Sequence[str] | None,
    node: str | None = None,
    run: RunName = None,
) -> str:
    """Say why some topics, None = all, have no message of a node and run in some window."""
    infos = catalog.infos(topics)
    if not infos:
        return f"keyspace {catalog.keyspace.name} holds none of these topics"
    nodes = sorted({info.node for info in infos})
    if node is not None and node not in nodes:
        return f"none is of node {node!r}, but of {', '.join(map(repr, nodes))}"
    if run is not None:
        infos = catalog.infos(topics, run=run)
        if not infos:
            which = f"run {run!r}" if isinstance(run, (str, int)) else "the run"
            return f"{which} stored none in these topics"
    times = [ns for info in infos for ns in (info.first_ns, info.last_ns) if ns is not None]
    if not times:
        return "these topics are empty"
    return f"these topics reach from {iso_time(min(times))} to {iso_time(max(times))}"


class ConnectionNumbers:
    """Gives the connections of stored rows their numbers in a bag that is written.

    Between equal times rosbag reads the connection of the lower number first, so those of an
    imported bag keep their numbers among each other: the first import its own, each further one
    shifted as a whole. What was never in a bag is numbered as it appears. The writer gets each
    connection when it appears.
    """

    def __init__(self, writer: FileWriter) -> None:
        self._writer = writer
        self._numbers: dict[tuple[int, str, int], int] = {}
        self._bases: dict[int, int] = {}
        self._free = 0

    def of(self, row: StoredRow) -> int:
        """Return the number of a row's connection."""
        run = split_seq(row.seq)[0]
        key = (run, row.table.name, row.conn)
        number = self._numbers.get(key)
        if number is None:
            number = self._numbers[key] = self._add(row, run)
        return number

    def latched(self, row: StoredRow) -> int:
        """Return the number of a connection for a row from before the bag alone.

        Between equal times it is read before all that ask for theirs later.
        """
        return self._next(_connection(row).latched_from(row.received))

    def _add(self, row: StoredRow, run: int) -> int:
        connection = _connection(row)
        if connection.number < 0:
            shared = (0, row.table.name, row.conn)  # 0 is nobody's writer id
            if shared not in self._numbers:
                self._numbers[shared] = self._next(connection)
            return self._numbers[shared]
        if run not in self._bases:
            self._bases[run] = -(-self._free // _RUN_NUMBERS) * _RUN_NUMBERS
        return self._next(connection, self._bases[run] + connection.number)

    def _next(self, connection: Connection, wanted: int | None = None) -> int:
        try:
            number = self._writer.connection(connection, wanted)
        except BagError:
            # A connection kept in two formats, or a bag with over 65,535 of them beside another.
            number = self._writer.connection(connection)
        self._free = max(self._free, number + 1)
        return number


def _connection(row: StoredRow) -> Connection:
    """Return the connection of a row, of the topic as it is called now."""
    connection = row.connection
    return connection if connection.topic == row.topic else replace(connection, topic=row.topic)
