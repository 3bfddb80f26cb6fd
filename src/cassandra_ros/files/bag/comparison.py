# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Compare the messages of a bag with those of the store, one by one in their order."""

from __future__ import annotations

import hashlib
import os
from bisect import bisect_right
from collections import Counter, deque
from dataclasses import dataclass, field
from itertools import groupby, islice
from typing import AbstractSet, Iterable, Iterator, Mapping, NamedTuple, Sequence

from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.errors import CorruptMessage, InvalidKey, MessageNotFound
from cassandra_ros.files.bag.file_formats import open_file
from cassandra_ros.files.bag.identity import read_content
from cassandra_ros.files.bag.message_file import (
    MessageFile,
    MessageProgress,
    connections_of_topics,
    read_in_order,
    topics_of,
)
from cassandra_ros.files.bag.publish_times import count_other_publish_times
from cassandra_ros.keys import split_seq
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.messages.stamps import Time, iso_time, to_ns
from cassandra_ros.read import Read, TimeRange, Whose, Writers
from cassandra_ros.store.tables.registry import Run
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.event_finder import AroundRule, EventRule
from cassandra_ros.topics.event_times import Reads
from cassandra_ros.topics.run_finder import RunName
from cassandra_ros.topics.stored_row import StoredRow

SHOWN = 10
"""Maximum number of differences that a report describes. All differences are counted."""
WINDOW = 50
"""Number of following messages, in bag and store, that are searched for an equal message."""

_SIZE_BYTES = 8
"""Number of bytes of a fingerprint that hold the size of the message."""
_FOREIGN = 1 << 32
"""Rank of stored messages whose connection is not in the bag: higher than all ranks in a bag."""

_NO_ORDER = 0
_BY_CONNECTION = 2
_BY_POSITION = 3
"""How many of the first fields of Entry (time, rank, position) must be equal before the content of
two messages is compared."""


@dataclass
class VerifyReport:
    """The result of a comparison."""

    path: str
    scope: str
    """Description of the stored messages that were compared."""
    equal_messages: int = 0
    differences: int = 0
    """Number of messages that are missing, superfluous or different."""
    missing: int = 0
    """Number of messages of the bag that the store does not have; part of ``differences``."""
    left_out: int = 0
    """Number of messages of the bag that were not compared, because an export added them as latched
    before its time range, see export_bag."""
    mixed_robots: list[str] = field(default_factory=list)
    """The robots of the compared messages, '' = one without name, if there are several and the file
    does not tell which message is whose; see verify_bag."""
    extras: dict[str, int] = field(default_factory=dict)
    """Kind of records that are never stored → their number in the file, see MessageFile. With a
    time range also the messages that cannot be stored, whose times are not known, by topic."""
    first: list[str] = field(default_factory=list)
    """The first differences, one line each; at most SHOWN."""

    @property
    def equal(self) -> bool:
        """Whether bag and store hold the same messages."""
        return not self.differences

    def add(self, text: str, messages: int = 1) -> None:
        """Count a difference of some messages, and keep its description: one line of text."""
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
    start: Time | None = None,
    end: Time | None = None,
    event: EventRule = None,
    around: AroundRule = None,
) -> VerifyReport:
    """Compare a bag with the store, message by message, in the order in which rosbag reads.

    Bag and store are equal if they have the same messages in the same order, with equal topic,
    time, type, md5sum, bytes and connection (header byte for byte). If the store holds an import of
    this bag, only the rows of that import are compared, so the keyspace may hold other bags and
    recordings of the same topics. Otherwise all rows of the bag's topics are compared, and messages
    that an export added as latched before its time range are left out, because the store holds them
    at another time. For the import of an MCAP publish_time and sequence are compared, too.

    What export_bag changes is not a difference: topics have the names that they have now, and the
    numbers of connections do not count, only their headers. Messages of several robots are told
    apart if the headers in the file name the robots, as export_bag writes them. If they do not, the
    messages of all robots are compared together, and ``mixed_robots`` lists the robots.

    Args:
        topics: Topics to compare; None = all topics of the bag.
        nodeID: Robot whose stored messages are compared; None = all robots.
        progress: Callback for the messages that were compared, see MessageProgress.
        reading: Callback for the first pass over the bag, which finds its import.
        run: Name or writer id of the recording or import to compare with; None = all.
        salvage: Compare what can be read of a damaged bag, as import_bag stores it.
        large_chunks: As in import_bag.
        start: First receive time, included (genpy.Time, int ns, float s, text): earlier messages of
            the bag and of the store are not compared; None = open.
        end: Last receive time, included; None = open.
        event, around: As in export_bag: compare with the stored messages of these times only. Of a
            bag that was imported only its own messages of these times are compared, of another one
            all of them, because an export has no others.

    Raises:
        EventNotFound, InvalidOption, InvalidQuery: As in export_bag.
        BagError: The bag cannot be read to its end.
        TopicNotFound: The bag has no such topic.
        RunNotFound: The store has no such run.
        InvalidKey: The bag was imported for several robots, and nodeID does not choose one.
        MessageNotFound: Neither bag nor store has a message of these times.
    """
    with open_file(path, salvage, large_chunks) as reader:
        numbers = connections_of_topics(reader, topics)
        topic_of = {n: reader.connections[n].topic for n in numbers}
        catalog = ros_cas.catalog
        catalog.keyspace.runs.check_robot(nodeID)
        stored = _stored_topics(catalog, topic_of.values())
        writers = catalog.keyspace.runs.writers(run)
        own_import = _find_import(catalog, reader, stored, nodeID, reading, writers)
        whose = "" if nodeID is None else f" of node {nodeID}"
        whose += "" if run is None else f" of run {run}"
        scope = f"all stored messages{whose} on its topics"
        if own_import is not None:
            scope = "the import of this bag" + (
                f" for node {own_import.node}" if own_import.node else ""
            )
        report = VerifyReport(reader.path, scope, extras=dict(reader.extras))
        times = limits = catalog.time_range(stored, start, end)
        for topic in sorted(topics_of(reader, topics) & reader.left_out.keys()):
            count, why = reader.left_out[topic]
            if times != TimeRange():  # the times of these messages are not known
                report.extras[f"messages of {topic} in the whole file ({why})"] = count
                continue
            report.add(f"{count} messages of {topic} are not stored: {why}", count)
            report.missing += count
        if own_import is None:
            numbers -= _leave_out(reader, numbers, report, times)
            topic_of = {n: topic_of[n] for n in numbers}
        counts = _counts(reader, {n for n in topic_of if topic_of[n] not in stored}, times)
        for topic in sorted(set(topic_of.values()) - stored):
            absent = {n for n in topic_of if topic_of[n] == topic}
            count = sum(counts[n] for n in absent)
            if count:
                report.add(f"{topic} is not stored: its {count} messages are missing", count)
            report.missing += count
            numbers -= absent
        ranks = _Ranks(reader.connections.values(), positions=own_import is not None)
        origin = Whose.of(nodeID, writers)
        if own_import is not None:
            origin = Whose.of(own_import.node, frozenset([own_import.writer]))
            times = TimeRange(max(times.low, reader.start_ns), min(times.high, reader.end_ns))
        windows, has_windows = [times], event is not None or around is not None
        reads = Reads(Read(times, origin), [Read(times, origin)])
        if has_windows:
            reads = catalog.reads_of(sorted(stored), start, end, origin, event, around)
            if own_import is not None:
                windows = [read.time_range for read in reads.parts]
        rows = catalog.read_parts(stored, reads, received=True)
        # The rows of an import hold their positions in the bag, so a missing row shifts no other.
        order = _BY_CONNECTION if own_import is None else _BY_POSITION
        comparison = Comparison(_in_order(rows, ranks), report, order)
        _compare(reader, numbers, dict.fromkeys(stored, comparison), progress, ranks, windows)
        report.mixed_robots = ranks.mixed_robots  # known only when all rows were read
        others = 0
        if own_import is not None:
            others = count_other_publish_times(catalog.keyspace.side_tables, reader, own_import)
        if others:
            report.add(
                f"publish_time or sequence of {others} messages are stored otherwise", others
            )
        is_limited = has_windows or limits != TimeRange()
        if is_limited and report.equal and not report.equal_messages:
            first, last = iso_time(reader.start_ns), iso_time(reader.end_ns)
            what = "of these times" if has_windows else "between start and end"
            raise MessageNotFound(
                f"nothing was compared: {reader.path} and the store have no message {what}; the "
                f"file has messages from {first} to {last}"
            )
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
    event: EventRule = None,
    around: AroundRule = None,
) -> VerifyReport:
    """Compare the messages of each topic in their order, by type, md5sum and bytes only.

    Times and connections are not compared: they differ when the bag was played and recorded again.
    If ``start`` is not after the first message of the bag, or there is an ``event``, messages that
    an export added as latched before its time ranges are left out. Otherwise they are compared,
    because a player publishes them, so a recording of it has them. Messages of one topic and time
    by several publishers differ if they are stored in another order than rosbag reads them.

    Memory: two pages of rows for each topic and the memory of read_in_order. For a topic whose key
    is a time in the message, also the keys of all its messages.

    Args:
        topics: Topics of the bag to compare; None = all.
        nodeID: Robot whose stored messages are compared; None = all robots.
        mapping: Topic of the bag -> topic under which it was recorded.
        start: First receive time, included (genpy.Time, int ns, float s, text); None = open.
        end: Last receive time, included; None = open.
        progress: Callback for the messages that were compared, see MessageProgress.
        run: Name or writer id of the recording or import to compare with; None = all.
        salvage, large_chunks: As in verify_bag.
        event: Only stored messages of a robot during its events, as in readMessages.
        around: Only stored messages around others, as in export_bag.

    Raises:
        EventNotFound: There is no such event.
        BagError, TopicNotFound, RunNotFound: As in verify_bag.
    """
    renamed = dict(mapping or {})
    catalog = ros_cas.catalog
    writers = catalog.keyspace.runs.writers(run)
    with open_file(path, salvage, large_chunks) as reader:
        numbers = connections_of_topics(reader, topics)
        report = VerifyReport(reader.path, "all stored messages on its topics, by content")
        from_start = start is not None and to_ns(start) <= reader.start_ns
        if from_start or event is not None or around is not None:
            numbers -= _leave_out(reader, numbers, report, TimeRange())
        ranks = _Ranks((), positions=False)
        bag_topics = {reader.connections[n].topic for n in numbers}
        stored = _stored_topics(catalog, {renamed.get(topic, topic) for topic in bag_topics})
        comparisons: dict[str, Comparison] = {}
        for topic in bag_topics:
            names = stored & {renamed.get(topic, topic)}
            # In the order of the bag, whatever the topic's key is.
            origin = catalog.whose(nodeID, writers)
            reads = catalog.reads_of(names, start, end, origin, event, around)
            rows = catalog.read_parts(names, reads, received=True)
            comparisons[topic] = Comparison(map(ranks.entry_of, rows), report, _NO_ORDER)
        _compare(reader, numbers, comparisons, progress)
    return report


def _leave_out(
    reader: MessageFile, numbers: AbstractSet[int], report: VerifyReport, times: TimeRange
) -> set[int]:
    """Return the connections whose messages an export added as latched before its time range.

    The report gets the number of these messages in ``times``.
    """
    early = {n for n in numbers if reader.connections[n].from_before}
    counts = _counts(reader, early, times)
    report.left_out = sum(counts[n] for n in early)
    return early


def _counts(reader: MessageFile, numbers: AbstractSet[int], times: TimeRange) -> Counter[int]:
    """Return the number of messages in a time range of some connections, by connection number.

    The result may also have numbers of other connections.
    """
    if times == TimeRange() or not numbers:
        return reader.counts
    messages = reader.messages(numbers)
    return Counter(
        message.number for message in messages if times.low <= message.t_ns <= times.high
    )


def _stored_topics(catalog: Catalog, names: Iterable[str]) -> AbstractSet[str]:
    """Return those of the names that are topics of the keyspace."""
    return {topic.name for topic in catalog.all(None)}.intersection(names)


def _find_import(
    catalog: Catalog,
    reader: MessageFile,
    topics: AbstractSet[str],
    node: str | None,
    reading: MessageProgress | None,
    among: Writers,
) -> Run | None:
    """Return the import of this bag whose rows are to be compared; None = there is no import.

    Only runs whose writer id is in the directory, for the bag's time range, are considered; for
    tables whose keys are not the times of the bag the time range is unlimited. If there is such a
    run, the bag is read to its end.

    Args:
        topics: Stored topics of the bag.
        node: Robot of the import; None = any.
        reading: Callback for the messages that are read.
        among: Writer ids of the runs that are considered; None = all.

    Raises:
        InvalidKey: There are imports for several robots.
    """
    keyspace = catalog.keyspace
    nodes = None if node is None else (node,)
    writers: set[tuple[str, int]] = set()
    for table in (table for topic in topics for table in keyspace.tables.of_topic(topic)):
        first, last = table.bucket_of(reader.start_ns), table.bucket_of(reader.end_ns)
        if table.metadata.own_time:
            first, last = -(2**63), 2**63 - 1
        rows = keyspace.directory.buckets(table.name, table.metadata, first, last, nodes)
        writers.update((row.node, row.writer) for row in rows)
    imports = (run for run in keyspace.registry.runs() if run.kind == "import")
    runs = [run for run in imports if (run.node, run.writer) in writers]
    runs = [run for run in runs if among is None or run.writer in among]
    if not runs:
        return None
    content = read_content(reader, reading)
    imports_of_bag = {run.node: run for run in runs if content.is_of(run)}
    if len(imports_of_bag) > 1:
        names = ", ".join(map(repr, sorted(imports_of_bag)))
        raise InvalidKey(
            f"{reader.path} was imported for the nodes {names}; choose one with --node-id"
        )
    return next(iter(imports_of_bag.values()), None)


class Entry(NamedTuple):
    """A message of the bag or of the store. Entries sort in the order in which rosbag reads."""

    t_ns: int
    rank: int
    """Position of the message's connection in the bag's index, or _FOREIGN."""
    position: int
    """Position of the message in the bag, or its ``_seq`` if the position is unknown."""
    type: str
    md5sum: str
    value: bytes
    """Fingerprint of the serialised message; b'' = the stored message cannot be read."""
    topic: str

    @property
    def content(self) -> tuple[str, str, bytes]:
        """Type, md5sum and fingerprint: the fields that are equal in equal messages."""
        return self[3:6]

    def __str__(self) -> str:
        return f"{self.topic} at {iso_time(self.t_ns)}"


def fingerprint(wire: bytes) -> bytes:
    """Return 24 bytes that identify a serialised message: its size and a hash."""
    digest = hashlib.blake2b(wire, digest_size=16).digest()
    return len(wire).to_bytes(_SIZE_BYTES, "little") + digest


class _Ranks:
    """Converts stored rows to entries; finds the rank of each row's connection in the bag.

    Connections of a bag with equal topics and headers have one rank, that of the first, unless the
    rows are those of its import: an export changes their numbers.

    Args:
        connections: Connections of the bag, in the order of its index.
        positions: Whether the rows are those of the bag's import: the counter in ``_seq`` is the
            message's position in the bag, and connections have the numbers of the bag.
    """

    def __init__(self, connections: Iterable[Connection], positions: bool) -> None:
        self._positions = positions
        self._exact: dict[tuple[str, bytes, int], int] = {}
        """Topic, header and number of a connection of the bag -> its rank."""
        self._alike: dict[tuple[str, bytes], int] = {}
        """Topic and header -> rank of the first connection of the bag that has them."""
        self.of_bag: list[int] = []
        """Rank of each connection of the bag."""
        for rank, c in enumerate(connections):
            self._exact[c.topic, c.header, c.number] = rank
            shared = self._alike.setdefault((c.topic, c.header), rank)
            self.of_bag.append(rank if positions else shared)
        self._connections: dict[tuple[str, int, str], tuple[int, str, str]] = {}
        """Table, ``_conn`` and robot of rows -> rank, type and md5 of their connection."""
        self._robots: set[str] = set()
        """Robots of the rows so far; not noted where a row's connection is found with its number.
        """
        self._named: set[str] = set()
        """Those of them that a header in the bag names."""

    @property
    def mixed_robots(self) -> list[str]:
        """The robots of the rows so far if there are several, not all of them named by the bag."""
        mixed = len(self._robots) > 1 and self._named != self._robots
        return sorted(self._robots) if mixed else []

    def entry_of(self, row: StoredRow) -> Entry:
        """Return the entry of a row. A row that cannot be read is unequal to every message."""
        key = (row.table.name, row.conn, row.node)
        if key not in self._connections:
            c = row.connection
            self._connections[key] = (self._rank(row.topic, c, row.node), c.type, c.md5sum)
        rank, msg_type, md5sum = self._connections[key]
        position = split_seq(row.seq)[1] if self._positions else row.seq
        try:
            value = fingerprint(row.wire)
        except CorruptMessage:
            value = b""
        return Entry(row.received, rank, position, msg_type, md5sum, value, row.topic)

    def _rank(self, topic: str, connection: Connection, node: str) -> int:
        """Return the rank of a connection, under the current name of its topic; note its robot."""
        header = connection.header
        exact = self._exact.get((topic, header, connection.number)) if self._positions else None
        if exact is not None:
            return exact
        self._robots.add(node)
        named = self._alike.get((topic, connection.of_robot(node).header))
        if named is not None:
            self._named.add(node)
            return named
        return self._alike.get((topic, header), _FOREIGN)


def _in_order(rows: Iterable[StoredRow], ranks: _Ranks) -> Iterator[Entry]:
    """Yield the entries of rows, which come by receive time; those of equal time by rank."""
    for _, group in groupby(rows, lambda row: row.received):
        # Equal ranks keep their order: it is that of an export, by robot and _seq.
        yield from sorted(map(ranks.entry_of, group), key=lambda entry: entry.rank)


def _compare(
    reader: MessageFile,
    numbers: AbstractSet[int],
    comparisons: Mapping[str, Comparison],
    progress: MessageProgress | None,
    ranks: _Ranks | None = None,
    windows: Sequence[TimeRange] = (TimeRange(),),
) -> None:
    """Read a bag in the order of rosbag and compare each topic with its stored messages.

    Args:
        numbers: Connections that are compared.
        comparisons: Topic of the bag -> its comparison; several topics may share one.
        ranks: Ranks of the connections; None = each has its own.
        windows: Receive times of the messages that are compared, in their order, disjoint.
    """
    starts = [window.low for window in windows]
    for entry in _entries_of_bag(reader, numbers, ranks):
        number = bisect_right(starts, entry.t_ns) - 1
        if number < 0 or entry.t_ns > windows[number].high:
            continue
        comparisons[entry.topic].add(entry)
        if progress is not None:
            progress(1, int.from_bytes(entry.value[:_SIZE_BYTES], "little"))
    for comparison in comparisons.values():
        comparison.finish()


def _entries_of_bag(
    reader: MessageFile, numbers: AbstractSet[int], ranks: _Ranks | None
) -> Iterator[Entry]:
    """Yield the entries of a bag in the order of rosbag, equal ranks in the order of the bag."""
    connections = list(reader.connections.values())
    rank_of = range(len(connections)) if ranks is None else ranks.of_bag
    messages = read_in_order(reader, lambda message: fingerprint(message.data), numbers)
    for _, group in groupby(messages, lambda message: message.t_ns):
        entries = []
        for t_ns, place, position, value in group:
            c = connections[place]
            rank = rank_of[place]
            entries.append(Entry(t_ns, rank, position, c.type, c.md5sum, value, c.topic))
        yield from sorted(entries, key=lambda entry: (entry.rank, entry.position))


class Comparison:
    """Compares two sequences of messages. A missing message does not make the next ones different.

    Two messages that differ in time, rank or position are reported as missing from one side each.
    Messages that agree in these but not in content are matched with the next equal message.

    Args:
        store: The stored messages, in their order.
        report: Report to which the differences are added.
        order: Number of fields of (time, rank, position) that place a message; 0 = only its order.
    """

    def __init__(self, store: Iterator[Entry], report: VerifyReport, order: int) -> None:
        self._store = store
        self._report = report
        self._order = order
        self._bag: deque[Entry] = deque()
        """Messages of the bag that are still to be compared."""
        self._seen: deque[Entry] = deque()
        """Stored messages that were read and are still to be compared, at most WINDOW."""

    def add(self, message: Entry) -> None:
        """Take the next message of the bag."""
        self._bag.append(message)
        self._advance(WINDOW)

    def finish(self) -> None:
        """Compare the remaining messages, after the last message of the bag.

        A second call does nothing: several topics may share this object.
        """
        self._advance(1)
        while self._seen or self._fill():
            self._superfluous(1)

    def _fill(self) -> bool:
        """Read stored messages until WINDOW of them wait; return whether any waits."""
        self._seen.extend(islice(self._store, WINDOW - len(self._seen)))
        return bool(self._seen)

    def _advance(self, minimum: int) -> None:
        """Compare while the bag has ``minimum`` messages waiting, or the next two are equal."""
        bag = self._bag
        seen = self._seen
        order = self._order
        while bag:
            if not (seen or self._fill()) or bag[0][:order] < seen[0][:order]:
                self._missing(1)
            elif seen[0][:order] < bag[0][:order]:
                self._superfluous(1)
            elif bag[0].content == seen[0].content:
                self._report.equal_messages += 1
                bag.popleft()
                seen.popleft()
            elif len(bag) < minimum:
                return
            else:
                self._resolve()

    def _resolve(self) -> None:
        """Report the next difference as missing, superfluous or different messages, and skip it."""
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
        """Return how many of ``others`` precede one that is equal to a message.

        Return 0 if none of those with the same place is equal. The caller knows that the first one
        is not.
        """
        for count, other in enumerate(others):
            if other[: self._order] != message[: self._order]:
                return 0
            if other.content == message.content:
                return count
        return 0

    def _missing(self, count: int) -> None:
        """Report the next messages of the bag as missing in the store."""
        is_certain = self._order or self._seen
        why = (
            "is not in the store"
            if is_certain
            else "has no counterpart: the store has fewer messages"
        )
        self._report.missing += count
        for _ in range(count):
            entry = self._bag.popleft()
            self._report.add(f"{entry}: message {entry.position} of the bag {why}")

    def _superfluous(self, count: int) -> None:
        """Report the next stored messages as missing in the bag."""
        for _ in range(count):
            seen = self._seen.popleft()
            why = "" if self._order else " here"
            if self._order and seen.rank == _FOREIGN:
                why = " over this connection"
            self._report.add(f"{seen}: the bag has no such message{why}")

    def _different(self, expected: Entry, seen: Entry) -> None:
        """Report a message of the bag and the stored one that is in its place."""
        reasons = []
        types = [f"{entry.type} [{entry.md5sum}]" for entry in (expected, seen)]
        if types[0] != types[1]:
            reasons.append(f"type {types[0]} in the bag, {types[1]} in the store")
        if not seen.value:
            reasons.append("the stored message is damaged")
        elif expected.value != seen.value:
            sizes = [int.from_bytes(e.value[:_SIZE_BYTES], "little") for e in (expected, seen)]
            text = f"{sizes[0]} bytes in the bag, {sizes[1]} in the store"
            reasons.append(text if sizes[0] != sizes[1] else f"its {sizes[0]} bytes differ")
        stored = "" if str(expected) == str(seen) else f" (stored as {seen})"
        where = f"{expected}: message {expected.position} of the bag"
        self._report.add(f"{where}: {'; '.join(reasons)}{stored}")
