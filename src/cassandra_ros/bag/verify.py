# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Compare a bag with the store exactly: what, when, over which connection, in which order."""

from __future__ import annotations

from itertools import groupby
from typing import Any, Dict, Iterable, Iterator, List, NamedTuple, Set, Tuple

from cassandra_ros.bag.differences import (
    Progress,
    VerifyReport,
    describeBytes,
    describePlace,
    fingerprint,
    rowFingerprint,
)
from cassandra_ros.bag.identity import Reading, earlierWriterId, isEarlier, readContent
from cassandra_ros.bag.order import Ordered, readInOrder
from cassandra_ros.bag.reader import BagReader
from cassandra_ros.bag.topics import chosenConnections
from cassandra_ros.errors import InvalidKey
from cassandra_ros.keys import splitSeq
from cassandra_ros.messages.connection import Connection
from cassandra_ros.topics.ros_cassandra import RosCassandra
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_table import TopicTable

_FOREIGN = 1 << 32
"""Rank of rows whose connection is none of the bag's."""


class _Seen(NamedTuple):
    """A stored message, comparable in the order in which rosbag reads."""

    t_ns: int
    rank: int
    """Place of its connection in the bag, or _FOREIGN."""
    order: int
    """Decides between equal ones: its position in the bag, or its seq where that is not known."""
    value: bytes
    topic: str
    type: str
    md5sum: str


class Import(NamedTuple):
    """The rows of one import."""

    node: str
    writer_id: int


def verifyBag(
    rosCas: RosCassandra,
    path: Any,
    topics: Iterable[str] | None = None,
    nodeID: str | None = None,
    progress: Progress | None = None,
    reading: Reading | None = None,
) -> VerifyReport:
    """Compare a bag with the store, message by message, in the order in which rosbag reads.

    Equal means: the same messages with the same topic, time, type, md5sum, bytes and connection
    (header byte for byte), in the same order. Where the store holds rows of an import of this
    very bag only those are compared, so that a keyspace may hold other bags and recordings on
    the same topics; else all rows of the bag's topics are.

    Args:
        rosCas: Connected to a keyspace.
        path: The bag.
        topics: Only these; None = all of the bag.
        nodeID: Compare what is stored for this node; None = whichever node it is.
        progress: Told how far it is.
        reading: Told how far the pass over the bag is that finds its import.

    Raises:
        BagError: The bag cannot be read to its end.
        TopicNotFound: The bag has no such topic.
        InvalidKey: The bag was imported for several nodes, and nodeID does not choose.
    """
    with BagReader(path) as reader:
        numbers = chosenConnections(reader, topics)
        chosen = {n: c for n, c in reader.connections.items() if n in numbers}
        names = {c.topic for c in chosen.values()}
        stored = names & {topic.name for topic in rosCas.getAllTopics()}
        scope = _findImport(rosCas, reader, stored, nodeID, reading)
        report = VerifyReport(reader.path, _describe(scope, nodeID))
        for topic in sorted(names - stored):
            gone = [n for n, c in chosen.items() if c.topic == topic]
            count = sum(reader.totals[n].count for n in gone)
            report.add(f"{topic} is not stored: its {count} messages are missing", count)
            numbers.difference_update(gone)
        rows = _storedRows(rosCas, reader, stored, scope, nodeID)
        _compare(reader, numbers, rows, scope, report, progress)
    return report


def holdsNothingElse(rosCas: RosCassandra, reader: BagReader, found: Import) -> bool:
    """Say whether an import has rows, and each of them is a message of this bag.

    Raises:
        BagError: The bag cannot be read to its end.
    """
    names = {c.topic for c in reader.connections.values()}
    stored = names & {topic.name for topic in rosCas.getAllTopics()}
    report = VerifyReport(reader.path, "")
    rows = _storedRows(rosCas, reader, stored, found, None)
    _compare(reader, set(reader.connections), rows, found, report, None)
    return report.equal_messages > 0 and report.differences == report.missing


def _findImport(
    rosCas: RosCassandra,
    reader: BagReader,
    topics: Set[str],
    nodeID: str | None,
    reading: Reading | None,
) -> Import | None:
    """Find the rows of an import of this bag, by the writer ids in the directory."""
    parts = rosCas.parts
    writers = {
        Import(row.node, row.writer)
        for topic in topics
        for table in parts.tables.ofTopic(topic)
        for row in parts.directory.buckets(
            *(table.name, *_bucketsOf(table, reader)),
            None if nodeID is None else (nodeID,),
        )
    }
    runs = [run for run in rosCas.runs() if Import(run.node, run.writer) in writers]
    runs = [run for run in runs if run.kind == "import"]
    if not runs:
        return None
    content = readContent(reader, reading)
    found = {run.node: run.writer for run in runs if content.isOf(run)}
    for run in filter(isEarlier, runs):
        if run.node not in found and run.writer == earlierWriterId(reader, run.node):
            found[run.node] = run.writer
    if len(found) > 1:
        nodes = ", ".join(map(repr, sorted(found)))
        raise InvalidKey(
            f"{reader.path} was imported for the nodes {nodes}; choose one with --node-id"
        )
    return next((Import(node, writer) for node, writer in found.items()), None)


def _bucketsOf(table: TopicTable, reader: BagReader) -> Tuple[int, int]:
    if table.metadata.own_time:
        return -(2**63), 2**63 - 1  # the times of the bag are not those of the keys
    return table.bucketOf(reader.start_ns), table.bucketOf(reader.end_ns)


def _describe(scope: Import | None, nodeID: str | None) -> str:
    if scope is not None:
        return "the import of this bag" + (f" for node {scope.node}" if scope.node else "")
    whose = "" if nodeID is None else f" of node {nodeID}"
    return f"all stored messages{whose} on its topics"


def _storedRows(
    rosCas: RosCassandra,
    reader: BagReader,
    topics: Set[str],
    scope: Import | None,
    nodeID: str | None,
) -> Iterator[StoredRow]:
    if scope is None:
        yield from rosCas.readMessages(topics, nodeID=nodeID, received=True)
        return
    ends = (reader.start_ns, reader.end_ns)
    for row in rosCas.readMessages(topics, *ends, nodeID=scope.node, received=True):
        if splitSeq(row.seq)[0] == scope.writer_id:
            yield row


def _inOrder(
    rows: Iterator[StoredRow], connections: List[Connection], scope: Import | None
) -> Iterator[_Seen]:
    """Put rows of equal time in the order of their connections."""
    ranks = _Ranks(connections, scope is not None)
    for _, group in groupby(rows, lambda row: row.received):
        yield from sorted(map(ranks.see, group))


class _Ranks:
    """Finds the connections of rows among those of the bag."""

    def __init__(self, connections: List[Connection], positions: bool) -> None:
        self._positions = positions
        self._exact = {(c.topic, c.header, c.number): i for i, c in enumerate(connections)}
        # The number is lost where the messages did not come from this very bag.
        self._alike: Dict[Tuple[str, bytes], int] = {}
        for place, c in enumerate(connections):
            self._alike.setdefault((c.topic, c.header), place)
        self._known: Dict[Tuple[str, int], Tuple[int, str]] = {}

    def see(self, row: StoredRow) -> _Seen:
        """Shorten a row to what is compared."""
        key = (row.table.name, row.conn)
        if key not in self._known:
            c = row.connection
            alike = self._alike.get((c.topic, c.header), _FOREIGN)
            rank = self._exact.get((c.topic, c.header, c.number), alike)
            self._known[key] = (rank, c.type)
        rank, msg_type = self._known[key]
        order = splitSeq(row.seq)[1] if self._positions else row.seq
        value = rowFingerprint(row)
        return _Seen(row.received, rank, order, value, row.topic, msg_type, row.md5sum)


def _reporting(bag: Iterator[Ordered], progress: Progress | None) -> Iterator[Ordered]:
    for entry in bag:
        if progress is not None:
            progress(1)
        yield entry


def _compare(
    reader: BagReader,
    numbers: Set[int],
    rows: Iterator[StoredRow],
    scope: Import | None,
    report: VerifyReport,
    progress: Progress | None,
) -> None:
    connections = list(reader.connections.values())
    read = readInOrder(reader, lambda message: fingerprint(message.data), numbers)
    bag, store = _reporting(read, progress), _inOrder(rows, connections, scope)
    # The rows of an import know their positions, so that one which is missing shifts no others.
    width = 2 if scope is None else 3
    wanted, seen = next(bag, None), next(store, None)
    while wanted is not None and seen is not None:
        if wanted[:width] < seen[:width]:
            _missing(wanted, connections, report)
            wanted = next(bag, None)
        elif seen[:width] < wanted[:width]:
            _superfluous(seen, report)
            seen = next(store, None)
        else:
            _compareMessages(wanted, seen, connections[wanted.rank], report)
            wanted, seen = next(bag, None), next(store, None)
    while wanted is not None:
        _missing(wanted, connections, report)
        wanted = next(bag, None)
    while seen is not None:
        _superfluous(seen, report)
        seen = next(store, None)


def _missing(wanted: Ordered, connections: List[Connection], report: VerifyReport) -> None:
    place = describePlace(connections[wanted.rank].topic, wanted.t_ns)
    report.add(f"{place}: message {wanted.position} of the bag is not in the store")
    report.missing += 1


def _superfluous(seen: _Seen, report: VerifyReport) -> None:
    why = " over this connection" if seen.rank == _FOREIGN else ""
    report.add(f"{describePlace(seen.topic, seen.t_ns)}: the bag has no such message{why}")


def _compareMessages(
    wanted: Ordered, seen: _Seen, connection: Connection, report: VerifyReport
) -> None:
    reasons = []
    if (connection.type, connection.md5sum) != (seen.type, seen.md5sum):
        reasons.append(
            f"type {connection.type} [{connection.md5sum}] in the bag, "
            f"{seen.type} [{seen.md5sum}] in the store"
        )
    if wanted.value != seen.value:
        reasons.append(describeBytes(wanted.value, seen.value))
    if reasons:
        place = describePlace(connection.topic, wanted.t_ns)
        report.add(f"{place}: message {wanted.position} of the bag: {'; '.join(reasons)}")
    else:
        report.equal_messages += 1
