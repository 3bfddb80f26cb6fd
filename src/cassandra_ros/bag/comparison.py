# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Compare a bag with the store: the messages of both, side by side in their order."""

from __future__ import annotations

import hashlib
import os
from collections import deque
from dataclasses import dataclass, field
from itertools import groupby, islice
from typing import AbstractSet, Iterable, Iterator, Mapping, NamedTuple

from cassandra_ros.bag.file_formats import open_file
from cassandra_ros.bag.identity import read_content
from cassandra_ros.bag.message_file import (
    MessageFile,
    MessageProgress,
    chosen_connections,
    read_in_order,
)
from cassandra_ros.bag.publish_times import count_differing
from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.errors import CorruptMessage, InvalidKey
from cassandra_ros.keys import split_seq
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.messages.stamps import Stamp, Time, iso_time, to_ns
from cassandra_ros.tables.registry import Run
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.run_finder import RunName, Writers
from cassandra_ros.topics.stored_row import StoredRow

SHOWN = 10
"""Differences that are kept in words; all are counted."""
WINDOW = 50
"""Messages ahead, on either side, among which a counterpart is looked for."""

_SIZE_BYTES = 8
_FOREIGN = 1 << 32
"""Rank of stored messages whose connection is none of the bag's."""

# How much of an entry's time, rank and place must agree before two messages are compared.
_NO_ORDER = 0
_BY_CONNECTION = 2
_BY_POSITION = 3


@dataclass
class VerifyReport:
    """Outcome of a comparison."""

    path: str
    scope: str
    """Which stored messages were compared, in words."""
    equal_messages: int = 0
    differences: int = 0
    """Messages that are missing, superfluous or different."""
    missing: int = 0
    """Those of them that the store lacks; the others are rows that are not of this bag."""
    left_out: int = 0
    """Messages of the bag that are not compared: they were latched before the window of which it
    is an export, see export_bag."""
    first: list[str] = field(default_factory=list)
    """The first differences, a line each."""

    @property
    def equal(self) -> bool:
        """Whether bag and store hold the same."""
        return not self.differences

    def add(self, text: str, messages: int = 1) -> None:
        """Note a difference: a line that says which message, and in what it differs."""
        self.differences += messages
        if len(self.first) < SHOWN:
            self.first.append(text)


def verify_bag(
    ros_cas: RosCassandra,
    path: str | os.PathLike[str],
    topics: Iterable[str] | None = None,
    nodeID: str | None = None,
    progress: MessageProgress | None = None,
    reading: MessageProgress | None = None,
    run: RunName = None,
    salvage: bool = False,
    large_chunks: bool = False,
) -> VerifyReport:
    """Compare a bag with the store, message by message, in the order in which rosbag reads.

    Equal means: the same messages with the same topic, time, type, md5sum, bytes and connection
    (header byte for byte), in the same order. Where the store holds rows of an import of this
    very bag only those are compared, so that a keyspace may hold other bags and recordings on
    the same topics; else all rows of the bag's topics are. Then messages that an export marked as
    latched before its window are left out: the store holds them at another time. Of the import of
    an MCAP also publish_time and sequence are compared.

    Args:
        topics: Only these; None = all of the bag.
        nodeID: Compare what is stored for this node; None = whichever node it is.
        progress: Told which messages of the bag were compared.
        reading: Told how far the pass over the bag is that finds its import.
        run: Compare what this recording or import stored, by its name or writer id.
        salvage: Compare what can be read of a damaged bag, as import_bag stores it.
        large_chunks: As import_bag takes it.

    Raises:
        BagError: The bag cannot be read to its end.
        TopicNotFound: The bag has no such topic.
        RunNotFound: The store has no such run.
        InvalidKey: The bag was imported for several nodes, and nodeID does not choose.
    """
    with open_file(path, salvage, large_chunks) as reader:
        numbers = chosen_connections(reader, topics)
        chosen = {n: reader.connections[n].topic for n in numbers}
        catalog = ros_cas.catalog
        stored = _stored_topics(catalog, chosen.values())
        writers = catalog.keyspace.runs.writers(run)
        found = _find_import(catalog, reader, stored, nodeID, reading, writers)
        whose = "" if nodeID is None else f" of node {nodeID}"
        whose += "" if run is None else f" of run {run}"
        scope = f"all stored messages{whose} on its topics"
        if found is not None:
            scope = "the import of this bag" + (f" for node {found.node}" if found.node else "")
        report = VerifyReport(reader.path, scope)
        if found is None:
            numbers -= _leave_out(reader, numbers, report)
            chosen = {n: chosen[n] for n in numbers}
        for topic in sorted(set(chosen.values()) - stored):
            gone = {n for n in chosen if chosen[n] == topic}
            count = sum(reader.counts[n] for n in gone)
            report.add(f"{topic} is not stored: its {count} messages are missing", count)
            numbers -= gone
        comparison = _by_place(catalog, reader, stored, found, nodeID, report, writers)
        _compare(reader, numbers, dict.fromkeys(stored, comparison), progress)
        late = (
            count_differing(catalog.keyspace.side_tables, reader, found) if found is not None else 0
        )
        if late:
            report.add(f"publish_time or sequence of {late} messages are stored otherwise", late)
    return report


def verify_content(
    ros_cas: RosCassandra,
    path: str | os.PathLike[str],
    topics: Iterable[str] | None = None,
    nodeID: str | None = None,
    mapping: Mapping[str, str] | None = None,
    start: Time | None = None,
    end: Time | None = None,
    progress: MessageProgress | None = None,
    run: RunName = None,
    salvage: bool = False,
    large_chunks: bool = False,
) -> VerifyReport:
    """Compare each topic's messages in their order by type, md5sum and bytes alone.

    Times and connections are not compared: they differ when a bag was played and recorded live.
    Of a stretch that begins no later than the bag, messages that an export marked as latched
    before its window are left out; where the bag was played they are among what was recorded.
    Memory: two pages of rows for each topic, and what read_in_order needs; of a topic whose key is
    a time in the message, all keys.

    Args:
        topics: Only these topics of the bag; None = all.
        nodeID: Only what this node recorded; None = all nodes.
        mapping: Topic of the bag -> topic under which it was recorded.
        start: First time of reception (genpy.Time, int ns, float s, text); None = open.
        end: Last time, included; None = open.
        progress: Told which messages of the bag were compared.
        run: Only what this recording or import stored, by its name or writer id.
        salvage, large_chunks: As verify_bag takes them.

    Raises:
        BagError, TopicNotFound, RunNotFound: As of verify_bag.
    """
    renamed = dict(mapping or {})
    catalog = ros_cas.catalog
    writers = catalog.keyspace.runs.writers(run)
    with open_file(path, salvage, large_chunks) as reader:
        numbers = chosen_connections(reader, topics)
        report = VerifyReport(reader.path, "all stored messages on its topics, by content")
        if start is not None and to_ns(start) <= reader.start_ns:
            numbers -= _leave_out(reader, numbers, report)
        ranks = _Ranks((), positions=False)
        wanted = {reader.connections[n].topic for n in numbers}
        stored = _stored_topics(catalog, {renamed.get(topic, topic) for topic in wanted})
        comparisons: dict[str, Comparison] = {}
        for topic in wanted:
            names = stored & {renamed.get(topic, topic)}
            # In the order of the bag, whatever the topic's key is.
            rows = catalog.read(names, start, end, node=nodeID, received=True, run=writers)
            comparisons[topic] = Comparison(map(ranks.see, rows), report, _NO_ORDER)
        _compare(reader, numbers, comparisons, progress)
    return report


def _leave_out(reader: MessageFile, numbers: AbstractSet[int], report: VerifyReport) -> set[int]:
    """Return the connections of messages from before the window of a bag, and count these."""
    early = {n for n in numbers if reader.connections[n].from_before}
    report.left_out = sum(reader.counts[n] for n in early)
    return early


def _stored_topics(catalog: Catalog, names: Iterable[str]) -> AbstractSet[str]:
    return {topic.name for topic in catalog.all(None)}.intersection(names)


def _find_import(
    catalog: Catalog,
    reader: MessageFile,
    topics: AbstractSet[str],
    node: str | None,
    reading: MessageProgress | None,
    among: Writers,
) -> Run | None:
    """Find the import of this bag whose rows are to be compared, by the directory's writer ids.

    Those of tables whose keys are not the times of the bag are looked for at all times.
    """
    keyspace = catalog.keyspace
    nodes = None if node is None else (node,)
    writers: set[tuple[str, int]] = set()
    for table in (table for topic in topics for table in keyspace.tables.of_topic(topic)):
        first, last = table.bucket_of(reader.start_ns), table.bucket_of(reader.end_ns)
        if table.metadata.own_time:
            first, last = -(2**63), 2**63 - 1
        rows = keyspace.directory.buckets(table.name, first, last, nodes)
        writers.update((row.node, row.writer) for row in rows)
    imports = (run for run in keyspace.registry.runs() if run.kind == "import")
    runs = [run for run in imports if (run.node, run.writer) in writers]
    runs = [run for run in runs if among is None or run.writer in among]
    if not runs:
        return None
    content = read_content(reader, reading)
    found = {run.node: run for run in runs if content.is_of(run)}
    if len(found) > 1:
        names = ", ".join(map(repr, sorted(found)))
        raise InvalidKey(
            f"{reader.path} was imported for the nodes {names}; choose one with --node-id"
        )
    return next(iter(found.values()), None)


def _by_place(
    catalog: Catalog,
    reader: MessageFile,
    topics: AbstractSet[str],
    found: Run | None,
    node: str | None,
    report: VerifyReport,
    writers: Writers = None,
) -> Comparison:
    """Compare the rows of an import, or all rows of the topics, by time and connection."""
    ranks = _Ranks(reader.connections.values(), positions=found is not None)
    if found is None:
        rows = catalog.read(topics, node=node, received=True, run=writers)
        return Comparison(_in_order(rows, ranks), report, _BY_CONNECTION)
    # As stamps: an int near 0, a simulation's time, might be refused as seconds.
    ends = map(Stamp.from_ns, (reader.start_ns, reader.end_ns))
    own = frozenset([found.writer])
    rows = catalog.read(topics, *ends, node=found.node, received=True, run=own)
    # These rows know their positions, so that one which is missing shifts no others.
    return Comparison(_in_order(rows, ranks), report, _BY_POSITION)


class Entry(NamedTuple):
    """A message of the bag, or a stored one; entries sort in the order in which rosbag reads."""

    t_ns: int
    rank: int
    """Place of its connection in the bag's index, or _FOREIGN."""
    place: int
    """Its position in the bag, or its seq where that is not known."""
    type: str
    md5sum: str
    value: bytes
    """Its fingerprint."""
    topic: str

    @property
    def content(self) -> tuple[str, str, bytes]:
        """What must be equal, wherever the messages stand."""
        return self[3:6]

    def __str__(self) -> str:
        return f"{self.topic} at {iso_time(self.t_ns)}"


def fingerprint(wire: bytes) -> bytes:
    """Shorten a message to 24 bytes that differ when the messages differ."""
    digest = hashlib.blake2b(wire, digest_size=16).digest()
    return len(wire).to_bytes(_SIZE_BYTES, "little") + digest


class _Ranks:
    """Finds the connections of rows among those of the bag, and shortens the rows to entries."""

    def __init__(self, connections: Iterable[Connection], positions: bool) -> None:
        self._positions = positions
        self._exact: dict[tuple[str, bytes, int], int] = {}
        # The number is lost where the messages did not come from this very bag.
        self._alike: dict[tuple[str, bytes], int] = {}
        for rank, c in enumerate(connections):
            self._exact[c.topic, c.header, c.number] = rank
            self._alike.setdefault((c.topic, c.header), rank)
        self._known: dict[tuple[str, int], tuple[int, str]] = {}

    def see(self, row: StoredRow) -> Entry:
        """Shorten a row to what is compared; one that cannot be read back equals no message."""
        key = (row.table.name, row.conn)
        if key not in self._known:
            c = row.connection
            alike = self._alike.get((c.topic, c.header), _FOREIGN)
            self._known[key] = (self._exact.get((c.topic, c.header, c.number), alike), c.type)
        rank, msg_type = self._known[key]
        place = split_seq(row.seq)[1] if self._positions else row.seq
        try:
            value = fingerprint(row.wire)
        except CorruptMessage:
            value = b""
        return Entry(row.received, rank, place, msg_type, row.md5sum, value, row.topic)


def _in_order(rows: Iterable[StoredRow], ranks: _Ranks) -> Iterator[Entry]:
    """Put rows of equal time in the order of their connections."""
    for _, group in groupby(rows, lambda row: row.received):
        yield from sorted(map(ranks.see, group))


def _compare(
    reader: MessageFile,
    numbers: AbstractSet[int],
    comparisons: Mapping[str, Comparison],
    progress: MessageProgress | None,
) -> None:
    """Walk through a bag in the order of rosbag, each topic against its stored messages."""
    connections = list(reader.connections.values())
    messages = read_in_order(reader, lambda message: fingerprint(message.data), numbers)
    for t_ns, rank, position, value in messages:
        c = connections[rank]
        comparisons[c.topic].add(Entry(t_ns, rank, position, c.type, c.md5sum, value, c.topic))
        if progress is not None:
            progress(1, int.from_bytes(value[:_SIZE_BYTES], "little"))
    for comparison in comparisons.values():
        comparison.finish()


class Comparison:
    """Compares messages of a bag with stored ones so that a lost one does not make others differ.

    Messages at different places are missing on one side; at one place, the next equal one decides.
    ``order`` is how many of (time, rank, place) say where a message stands; 0 = only its turn does.
    """

    def __init__(self, store: Iterator[Entry], report: VerifyReport, order: int) -> None:
        self._store = store
        self._report = report
        self._order = order
        self._bag: deque[Entry] = deque()
        self._seen: deque[Entry] = deque()

    def add(self, message: Entry) -> None:
        """Take the next message of the bag."""
        self._bag.append(message)
        self._advance(WINDOW)

    def finish(self) -> None:
        """Compare what is left; there are no more messages in the bag."""
        self._advance(1)
        while self._seen or self._fill():
            self._superfluous(1)

    def _fill(self) -> bool:
        self._seen.extend(islice(self._store, WINDOW - len(self._seen)))
        return bool(self._seen)

    def _advance(self, wanted: int) -> None:
        """Compare while at least so many messages of the bag wait, or the next two are equal."""
        bag, seen, order = self._bag, self._seen, self._order
        while bag:
            if not (seen or self._fill()) or bag[0][:order] < seen[0][:order]:
                self._missing(1)
            elif seen[0][:order] < bag[0][:order]:
                self._superfluous(1)
            elif bag[0].content == seen[0].content:
                self._report.equal_messages += 1
                bag.popleft()
                seen.popleft()
            elif len(bag) < wanted:
                return
            else:
                self._resolve()

    def _resolve(self) -> None:
        """Decide what the first difference at one place is, and step behind it."""
        self._fill()
        further = self._ahead(self._bag[0], self._seen)
        missing = self._ahead(self._seen[0], self._bag)
        if further and (not missing or further <= missing):
            self._superfluous(further)
        elif missing:
            self._missing(missing)
        else:
            self._different(self._bag.popleft(), self._seen.popleft())

    def _ahead(self, message: Entry, others: Iterable[Entry]) -> int:
        """Return how many messages at its place come before an equal one; 0 = there is none."""
        for count, other in enumerate(others):
            if other[: self._order] != message[: self._order]:
                return 0
            if other.content == message.content:
                return count
        return 0

    def _missing(self, count: int) -> None:
        known = self._order or self._seen
        why = "is not in the store" if known else "has no counterpart: the store has fewer messages"
        self._report.missing += count
        for _ in range(count):
            wanted = self._bag.popleft()
            self._report.add(f"{wanted}: message {wanted.place} of the bag {why}")

    def _superfluous(self, count: int) -> None:
        for _ in range(count):
            seen, why = self._seen.popleft(), "" if self._order else " here"
            if self._order and seen.rank == _FOREIGN:
                why = " over this connection"
            self._report.add(f"{seen}: the bag has no such message{why}")

    def _different(self, wanted: Entry, seen: Entry) -> None:
        reasons = []
        types = [f"{entry.type} [{entry.md5sum}]" for entry in (wanted, seen)]
        if types[0] != types[1]:
            reasons.append(f"type {types[0]} in the bag, {types[1]} in the store")
        if not seen.value:
            reasons.append("the stored message is damaged")
        elif wanted.value != seen.value:
            sizes = [int.from_bytes(e.value[:_SIZE_BYTES], "little") for e in (wanted, seen)]
            text = f"{sizes[0]} bytes in the bag, {sizes[1]} in the store"
            reasons.append(text if sizes[0] != sizes[1] else f"its {sizes[0]} bytes differ")
        stored = "" if str(wanted) == str(seen) else f" (stored as {seen})"
        where = f"{wanted}: message {wanted.place} of the bag"
        self._report.add(f"{where}: {'; '.join(reasons)}{stored}")
