# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Export stored messages into a bag or an MCAP, as they were recorded."""

from __future__ import annotations

import os
from bisect import bisect_right
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from typing import Iterable, Iterator, Sequence, Union

from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.errors import BagError, MessageNotFound
from cassandra_ros.files.bag.file_formats import make_file
from cassandra_ros.files.bag.file_writer import FileWriter
from cassandra_ros.files.bag.message_file import MessageProgress
from cassandra_ros.files.bag.publish_times import PublishTimeFinder
from cassandra_ros.keys import split_seq
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.messages.stamps import Time, iso_time
from cassandra_ros.read import LAST_NS, Nodes, TimeRange, Whose
from cassandra_ros.store.tables.event_table import Event
from cassandra_ros.stores.fleet.fleet_row import FleetRow
from cassandra_ros.topics.catalog import Catalog, Conditions
from cassandra_ros.topics.event_finder import AroundRule, EventRule
from cassandra_ros.topics.event_times import Reads
from cassandra_ros.topics.overview.latched_messages import LatchedFinder, LatchedRecord, tests_of
from cassandra_ros.topics.run_finder import RunName
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_table import TopicTable

ExportedRow = Union[StoredRow, FleetRow]
"""A message of one store, or of several."""
_RUN_NUMBERS = 1 << 16
"""Number of connection numbers that are reserved for each recording or import."""


@dataclass
class ExportReport:
    """The result of an export: what was written."""

    path: str
    messages: dict[str, int] = field(default_factory=dict)
    """Number of messages by topic."""
    bytes: int = 0
    """Size of the serialised messages, bytes."""
    events: int = 0
    """Number of events; only an MCAP can hold them."""
    latched: dict[str, int] = field(default_factory=dict)
    """Number of messages by topic that were latched before the start; part of ``messages``."""

    def add(self, topic: str, size: int, early: bool) -> None:
        """Count a message of ``size`` bytes; ``early`` = it was latched before the start."""
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
    run: RunName = None,
    latched: bool = True,
    event: EventRule = None,
    event_nodes: Nodes = None,
    around: AroundRule = None,
) -> ExportReport:
    """Write stored messages into a bag of format 2.0, or into an MCAP.

    The messages are written in the order of their receive times. Connections keep topic, header
    and number, so rosbag reads the messages of an imported bag in their original order: by time,
    connection, position. In an MCAP each connection is a channel. publish_time and sequence are
    those of the MCAP from which a message was imported; for other messages they are log_time and 0.
    The events of these robots that meet the time of the messages are metadata of an MCAP. If the
    chosen topics have messages of several robots, the header of each connection gets the field
    ``cassandra_ros.node`` with its robot.

    Args:
        path: The file to write: an MCAP if it ends with .mcap, else a bag. Its name is PATH.active
            until it is complete.
        topics: Topics to export; None = all.
        start: First receive time, included (genpy.Time, int ns, float s or text); None = open.
        end: Last receive time, included; None = open.
        nodeID: Robot whose messages are exported; None = all robots.
        compression: 'none' or 'lz4', for a bag also 'bz2', for an MCAP also 'zstd'; None = 'none'
            for a bag, 'zstd' for an MCAP.
        force: Replace an existing file.
        progress: Callback for the messages that were written, see MessageProgress.
        where: Topic -> condition, as in readMessages. For these topics only messages that satisfy
            the condition are exported; for all other topics, all messages.
        run: Name or writer id of the recordings or imports to export; None = all.
        latched: If there is a start, begin the file with the messages that were latched before it:
            the last message of each latching publisher (of /tf_static, say) in the runs that the
            file shows. Their time in the file is the start. Each has a connection of its own, in
            whose header the field ``latched_from`` is the time at which it was received, ns. With
            ``event`` each of its time ranges begins so, as far as they have changed since.
        event: Only messages of a robot during its events, as in readMessages.
        event_nodes: Robots whose events are written, where ``where`` selects several; None = those
            of nodeID. Events of no robot are written, too.
        around: Only messages around those of a topic that satisfy a condition: ('TOPIC: condition',
            before, after), the times in seconds or as Durations. Not together with ``event``.

    Raises:
        MessageNotFound: There are no messages to export. No file is created or replaced.
        BagError: The file exists, or cannot be written.
        TopicNotFound, RunNotFound: One of the topics is not stored, or there is no such run.
        EventNotFound: There is no such event of that time, robot and run.
        InvalidOption, InvalidQuery: A condition in ``where`` cannot be parsed or evaluated.
        StoreUnavailable: The store stopped answering; the incomplete file is deleted.
    """
    if os.path.exists(path) and not force:
        raise BagError(f"{os.fspath(path)} exists; choose another name, or replace it with --force")
    # The caller may have named one topic in two spellings.
    catalog = ros_cas.catalog
    names = None if topics is None else sorted({catalog.get(name).name for name in topics})
    reads = catalog.reads_of(names, start, end, catalog.whose(nodeID, run), event, around)
    has_start = start is not None or event is not None or around is not None
    rows = _find_rows(catalog, names, reads, where, latched and has_start)
    report = ExportReport(os.fspath(path))
    first = list(islice(rows, 1))
    if not first:
        why = why_empty(catalog, names, nodeID, run)
        raise MessageNotFound(f"{report.path} is not written, for there is no such message: {why}")
    with make_file(path, compression) as writer:
        robots = robots_of(catalog, catalog.tables(names), reads.whole.whose)
        numbers = ConnectionNumbers(writer, several_robots=len(robots) > 1)
        publish_times = PublishTimeFinder(
            catalog.keyspace.side_tables, enabled=writer.keeps_publish_times
        )
        times = TimeRange(LAST_NS, 0)  # of no message
        for t_ns, row in chain(first, rows):
            wire, is_early = row.wire, t_ns != row.received
            number = numbers.latched(row) if is_early else numbers.of(row)
            writer.write(number, t_ns, wire, *publish_times.of(row, t_ns))
            report.add(row.topic, len(wire), is_early)
            if progress is not None:
                progress(1, len(wire))
            times = TimeRange(min(times.low, t_ns), max(times.high, t_ns))
        whose = reads.whole.whose.both(Whose(event_nodes))
        for exported in _events(catalog, reads, times, whose):
            report.events += writer.add_event(exported)
    return report


def _find_rows(
    catalog: Catalog,
    topics: Sequence[str] | None,
    reads: Reads,
    where: Conditions,
    latched: bool,
) -> Iterator[tuple[int, StoredRow]]:
    """Yield (time in the file, row) of each message of the parts of a read, in their order.

    The time is the receive time. With ``latched`` each part begins with the messages that were
    latched before it and were not given yet; their time is the start of the part.
    """
    tables, whose = catalog.tables(topics), reads.whole.whose
    filters = catalog.filters(where, topics, whose)
    finder = LatchedFinder(catalog.keyspace, tables, whose, tests_of(catalog, where, whose))
    given = LatchedRecord()
    # A later part needs to know which latched messages this one had.
    records = latched and len(reads.parts) > 1 and finder.latches
    for read in reads.parts:
        low, high = read.time_range
        earlier = given.changes(finder.of(read.whose), low, high) if latched else []
        for row in earlier:
            yield low, row
        for row in catalog.merged(tables, filters, read, received=True):
            if records and finder.is_latched(row):
                given.note(row)
            yield row.received, row


def _events(catalog: Catalog, reads: Reads, times: TimeRange, whose: Whose) -> Iterator[Event]:
    """Yield the events of robots that meet the time range of the messages, and one of the parts.

    Args:
        times: First and last time in the file.
    """
    starts = [read.time_range.low for read in reads.parts]
    for event in catalog.keyspace.events.find(within=times, whose=whose):
        # The last part that begins before the event ends; the parts do not overlap.
        last = bisect_right(starts, event.time_range.high) - 1
        if last >= 0 and reads.parts[last].time_range.high >= event.start_ns:
            yield event


def robots_of(catalog: Catalog, tables: Sequence[TopicTable], whose: Whose) -> set[str]:
    """Return the robots of a selection that may have messages in some tables.

    Robots that are named in the selection count even if they have none.
    """
    if whose.nodes is not None:
        return set(whose.nodes)
    robots = set(catalog.keyspace.nodes(tables))
    if whose.writers is None:
        return robots
    of_runs = catalog.keyspace.runs.nodes(whose.writers)
    return robots if of_runs is None else robots & of_runs


def why_empty(
    catalog: Catalog,
    topics: Sequence[str] | None,
    node: str | None = None,
    run: RunName = None,
) -> str:
    """Return the reason why a selection has no messages, in words.

    Args:
        topics: Topics of the selection; None = all.
        node: Robot of the selection; None = all.
        run: Run of the selection; None = all.
    """
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
    """Assigns numbers to the connections of stored rows in a bag that is being written.

    rosbag reads messages of equal time in the order of their connection numbers. So the connections
    of an imported bag keep their order: the first import keeps its numbers, all numbers of each
    further import are shifted by a constant. Connections that never were in a bag get the next free
    number. A connection is added to the writer with its first row.

    Args:
        several_robots: Name the robot of each connection in its header.
    """

    def __init__(self, writer: FileWriter, several_robots: bool) -> None:
        self._writer = writer
        self._several_robots = several_robots
        self._numbers: dict[tuple[int, str, str, int, str], int] = {}
        """(writer id, topic, md5, ``_conn``, robot) -> number; the writer id is 0 for connections
        that never were in a bag, which all runs share; the robot is '' if there is only one."""
        self._bases: dict[int, int] = {}
        """Writer id of an import -> what is added to the numbers of its connections."""
        self._free = 0
        """Lowest number that is higher than all that were assigned."""

    def of(self, row: ExportedRow) -> int:
        """Return the number of a row's connection, the same in all tables and stores that have it.

        Raises MessageNotFound if no store with the row answers any more.
        """
        run = split_seq(row.seq)[0]
        key = (run, row.topic, row.md5sum, row.conn, self._robot(row))
        number = self._numbers.get(key)
        if number is None:
            number = self._numbers[key] = self._add(row, run)
        return number

    def latched(self, row: StoredRow) -> int:
        """Return the number of a new connection that holds only this message, latched before.

        It is lower than the numbers that are assigned later, but for connections of an import that
        has numbers already. So rosbag reads it before a message that was received at the start.
        """
        return self._next(self._connection(row).latched_from(row.received))

    def _robot(self, row: ExportedRow) -> str:
        """Return the robot for the keys of _numbers."""
        return row.node if self._several_robots else ""

    def _connection(self, row: ExportedRow) -> Connection:
        """Return the connection of a row as the file has it: with the current name of its topic."""
        connection = replace(row.connection, topic=row.topic)
        return connection.of_robot(row.node) if self._several_robots else connection

    def _add(self, row: ExportedRow, run: int) -> int:
        """Add the connection of a row of a run to the writer; return its number."""
        connection = self._connection(row)
        if connection.number < 0:
            # 0 is not the id of any writer.
            shared = (0, row.topic, row.md5sum, row.conn, self._robot(row))
            if shared not in self._numbers:
                self._numbers[shared] = self._next(connection)
            return self._numbers[shared]
        if run not in self._bases:
            self._bases[run] = -(-self._free // _RUN_NUMBERS) * _RUN_NUMBERS
        return self._next(connection, self._bases[run] + connection.number)

    def _next(self, connection: Connection, preferred: int | None = None) -> int:
        """Add a connection to the writer; return its number: the preferred one, else the next."""
        try:
            number = self._writer.connection(connection, preferred)
        except BagError:
            # Another bag has over 65,535 connections.
            number = self._writer.connection(connection)
        self._free = max(self._free, number + 1)
        return number
