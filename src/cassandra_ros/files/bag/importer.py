# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Import a bag or an MCAP into the store. Repeating an import, or a part of it, changes nothing."""

from __future__ import annotations

import logging
import os
import threading
import time
from collections import Counter, deque
from dataclasses import dataclass, field, replace
from functools import partial
from types import TracebackType
from typing import AbstractSet, Iterable, Iterator, Mapping, Sequence

from cassandra_ros.arguments import check_new_node, check_new_topic
from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.errors import (
    BagError,
    EventNotFound,
    InvalidKey,
    InvalidName,
    InvalidOption,
    TopicExists,
)
from cassandra_ros.files.bag import identity
from cassandra_ros.files.bag.file_formats import open_file
from cassandra_ros.files.bag.format_choice import (
    CHOICE_MESSAGES,
    STORED_BEFORE,
    UNUSABLE,
    FormatChoice,
    choose_format,
    too_few,
)
from cassandra_ros.files.bag.identity import BagContent, source_of
from cassandra_ros.files.bag.mcap_events import event_of
from cassandra_ros.files.bag.message_file import (
    MessageBatch,
    MessageFile,
    MessageProgress,
    SalvageReport,
    connections_of_topics,
    topics_of,
)
from cassandra_ros.files.bag.publish_times import store_publish_times
from cassandra_ros.files.bag.size_estimate import TopicSample, new_samples, sample_chunk
from cassandra_ros.keys import MAX_NS, MAX_WRITER, SECOND_NS
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.messages.formats.table import FALLBACK_FORMAT
from cassandra_ros.metadata import Kind
from cassandra_ros.read import Read, TimeRange, Whose
from cassandra_ros.store.blocks.block_builder import limits_for
from cassandra_ros.store.rows.writer import WriteStats
from cassandra_ros.store.tables.directory import CLOCKS_SEC
from cassandra_ros.store.tables.event_table import Event
from cassandra_ros.store.tables.lengths import Lengths, bucket_for, span_for
from cassandra_ros.store.tables.registry import Run
from cassandra_ros.store.tables.row_table import LARGE_MESSAGE_CHUNK_BYTES
from cassandra_ros.topics.event_finder import Events
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.message_writer import (
    Asked,
    Handle,
    MessageWriter,
    connection_kind,
    usable_definition,
)
from cassandra_ros.topics.removal import delete_time_range
from cassandra_ros.topics.run_finder import describe_runs
from cassandra_ros.topics.stored_totals import holds_any

BATCHES_AHEAD_BYTES = 8 * 1024 * 1024
"""Maximum size of the messages that wait for the caller, bytes. One batch may always wait."""


class BatchReadAhead:
    """An iterator over batches that a separate thread reads; a context manager that stops it.

    An error of the reading thread is raised after the last batch that was read before it.

    Args:
        batches: The batches to read. No other code may use their file until the context is left.
    """

    def __init__(self, batches: Iterator[MessageBatch]) -> None:
        self._batches = batches
        self._read: deque[tuple[MessageBatch, int]] = deque()
        self._held = 0
        self._ended = self._stopped = False
        self._error: BaseException | None = None
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, daemon=True, name="cassandra_ros-bag")

    def __enter__(self) -> BatchReadAhead:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        exc: BaseException | None,
        where: TracebackType | None,
    ) -> None:
        with self._changed:
            self._stopped = True
            self._changed.notify_all()
        self._thread.join()

    def __iter__(self) -> Iterator[tuple[MessageBatch, int]]:
        """Yield each batch and the size of its serialised messages, bytes."""
        while True:
            with self._changed:
                while not (self._read or self._ended):
                    self._changed.wait()
                if not self._read:
                    break
                batch, size = self._read.popleft()
                self._held -= size
                self._changed.notify_all()
            yield batch, size
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        error: BaseException | None = None
        try:
            for batch in self._batches:
                if not self._put(batch):
                    break
        except BaseException as exc:  # noqa: BLE001 - __iter__ raises it again
            error = exc
        with self._changed:
            self._error, self._ended = error, True
            self._changed.notify_all()

    def _put(self, batch: MessageBatch) -> bool:
        """Wait for room, then add a batch. Return False when the caller has left the context."""
        size = sum(map(len, batch.wires))
        with self._changed:
            while self._read and self._held + size > BATCHES_AHEAD_BYTES and not self._stopped:
                self._changed.wait()
            self._read.append((batch, size))
            self._held += size
            self._changed.notify_all()
            return not self._stopped


_log = logging.getLogger(__name__)

_WINDOW_NS = 10 * SECOND_NS
"""Minimum length of the windows over which the rate of a topic is measured, ns."""
_SALVAGE = (
    "The same import with --salvage (salvage=True) adds what can be read after the damage to them. "
    "A repaired copy counts as another bag: delete this run before you import one"
)


@dataclass
class ImportedTopic:
    """The result of an import for one topic."""

    format: str
    """Storage format of the topic's table; 'binary' if the message definition cannot be used."""
    why: str = ""
    """Reason for the format in a few words; '' = the caller named it."""
    messages: int = 0
    bytes: int = 0
    """Size of the serialised messages, bytes."""


@dataclass
class ImportReport:
    """The result of an import. The store has acknowledged all messages that it counts."""

    path: str
    writer_id: int
    """Writer id of all rows of the import: the upper half of ``_seq``."""
    nodeID: str
    topics: dict[str, ImportedTopic] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    """Facts about the run in words: that its content was stored before, under which name, or for
    another robot, and which other runs have its name."""
    lost: dict[str, int] = field(default_factory=dict)
    """Number of messages that cannot be stored, by topic. A warning gives the reason."""
    events: int = 0
    """Number of events in the file that are stored."""
    salvaged: SalvageReport = field(default_factory=SalvageReport)
    """The damage that was found with ``salvage``, if any."""

    @property
    def messages(self) -> int:
        """Number of messages of all topics."""
        return sum(topic.messages for topic in self.topics.values())


def import_bag(
    ros_cas: RosCassandra,
    path: str | os.PathLike[str],
    format: str | None = None,
    topics: Iterable[str] | None = None,
    nodeID: str = "",
    progress: MessageProgress | None = None,
    reading: MessageProgress | None = None,
    salvage: bool = False,
    large_chunks: bool = False,
) -> ImportReport:
    """Store the messages of a bag of format 2.0, or of an MCAP with messages of ROS 1.

    The bag is read twice, because the key of each row depends on the content of the whole bag. So
    an import that is repeated, or was interrupted and is started again, writes the same rows. If a
    topic was converted to packed or removed after an earlier import, the rows of that import are
    deleted before the messages are stored again.

    A run is known by its content and robot; its name is a label. A copy of the bag under another
    name is the same run, which keeps its name; its source becomes the copy. The same bag for
    another robot is another run. Different bags of one name are two runs of one name. The notes of
    the report say which of this is so.

    For an MCAP publish_time and sequence of each message are stored, too, and its events, which
    become events of nodeID and of this run; an export into an MCAP writes them back. Memory does
    not depend on the size of the bag, except for BagReader's index.

    Args:
        format: Storage format of all topics, as in addTopic; None = a stored topic keeps its
            format, and that of a new one is chosen by choose_format.
        topics: Topics to import, with or without leading slash; None = all.
        nodeID: Robot that recorded the bag; '' = unknown.
        progress: Callback for the messages that were stored, see MessageProgress.
        reading: Callback for the first pass over the bag, see MessageProgress.
        salvage: If the bag is cut short, damaged or was not closed, store the messages before the
            damage and of the chunks after it; a warning describes the damage. This continues an
            import that ended at the damage. An undamaged bag is imported as usual.
        large_chunks: Also read chunks of more than 256 MiB of content, and files that unpack to
            more than 1000 times their size. Only for files that you trust: a file that was made
            to do harm can fill the memory and the disk.

    Returns:
        What was stored. A topic whose message definition is empty, broken or hostile is stored as
        binary, with a warning. Messages that cannot be stored are left out, with a warning, and
        counted as lost: those of a topic whose name cannot be stored, of a connection without valid
        topic, type or md5sum, and of a time after the year 2106. All other messages are stored.

    Raises:
        BagError: The bag cannot be read to its end. The messages before the damage are stored; the
            text gives their number and the position of the damage.
        BagTooLarge: The bag would unpack to more bytes than is permitted; nothing of it is stored.
        TopicExists: The bag is stored already, in another format than ``format``.
        TopicNotFound: The bag has no such topic.
        WriteFailed, StoreUnavailable: The store did not acknowledge all messages.
    """
    keyspace = ros_cas.catalog.keyspace
    with open_file(path, salvage, large_chunks) as reader:
        numbers = connections_of_topics(reader, topics)
        samples = {} if format else new_samples(reader, reader.connections.keys())
        sampled = {n: sample for n, sample in samples.items() if not too_few(sample)}
        seen = partial(sample_chunk, sampled, CHOICE_MESSAGES)
        content = identity.read_content(reader, reading, seen)
        # The limits of blocks depend neither on the current time nor on the imported topics.
        limits = limits_for(len(reader.connections))
        lengths = table_lengths(reader, content.sizes)
        writer_id, earlier = _writer_id(keyspace, nodeID, content)
        is_repeated = earlier is not None
        report = ImportReport(reader.path, writer_id, nodeID, salvaged=reader.salvaged)
        _tell_damage(report)
        numbers = _refuse_names(reader, numbers, report)
        _tell_left_out(reader, topics, report)
        _tell_robots(reader, numbers, report)
        run = _run(reader, nodeID, writer_id, format, content)
        if earlier is not None:
            run = replace(run, name=earlier.name, stored=earlier.stored, lost=earlier.lost)
        report.notes += _notes(reader.path, keyspace.registry.runs(), run, earlier, content)
        choices = _choices(keyspace, reader, numbers, run, is_repeated, samples)
        node = check_new_node(nodeID)
        wanted = {
            n: Asked(connection, *lengths[n], choices[n].format)
            for n, connection in reader.connections.items()
            if n in numbers
        }
        if reader.has_publish_times:
            store_publish_times(keyspace.side_tables, reader, run)
        # The bag is read while its tables are made.
        with BatchReadAhead(_batches(reader, wanted.keys())) as ahead, MessageWriter(
            keyspace,
            writer_id,
            format=format,
            node=node,
            run=run,
            limits=limits,
            connections=[*wanted.values()],
        ) as writer:
            handles = {n: _connect(writer, wish) for n, wish in wanted.items()}
            _name_topics(handles, choices, report)
            if is_repeated:
                _remove_other_blocks(keyspace, handles, run)
            _write_messages(ahead, writer, handles, report, progress)
            chosen = topics_of(reader, topics)
            others = {topic: n for topic, n in run.lost.items() if topic not in chosen}
            writer.close(lost={**others, **report.lost})
            if _tell_hidden(writer.stats(), report):
                stored = {
                    topic: topic_report.messages for topic, topic_report in report.topics.items()
                }
                lost = {**others, **report.lost}
                keyspace.registry.put_run(replace(run, stored={**run.stored, **stored}, lost=lost))
        _store_events(keyspace.events, reader, run, report)
    return report


def _tell_hidden(stats: Mapping[str, WriteStats], report: ImportReport) -> bool:
    """Count as lost what was stored and cannot be read; return whether there is anything of it."""
    hidden = {
        topic: topic_stats.hidden for topic, topic_stats in stats.items() if topic_stats.hidden
    }
    for topic, count in hidden.items():
        report.topics[topic].messages -= count
        report.lost[topic] = report.lost.get(topic, 0) + count
        _warn(
            report,
            f"{report.path}: {count} messages of topic {topic} were stored, but cannot be read: "
            "they were deleted meanwhile, or before by a server whose clock is ahead, so that this "
            "deletion has the later time. Set the clocks of the servers (NTP, chrony), and import "
            "it once more when that time has passed",
        )
    return bool(hidden)


def _store_events(events: Events, reader: MessageFile, run: Run, report: ImportReport) -> None:
    """Store the events of an MCAP for the robot and the run of the import, each once."""
    for fields in reader.events:
        try:
            event = replace(event_of(fields, reader.path), node=run.node, writer=run.writer)
            if not _is_stored(events, event):
                events.put(event)
            report.events += 1
        except (BagError, InvalidKey, InvalidName, InvalidOption) as exc:
            _warn(report, f"an event is not stored: {exc}")


def _is_stored(events: Events, event: Event) -> bool:
    """Return whether an earlier import has stored an event, which may have been ended since."""
    try:
        return events.get(event).node == event.node
    except EventNotFound:
        return False


def _connect(writer: MessageWriter, wish: Asked) -> Handle:
    """Return the handle with which the writer writes messages of a connection of the bag."""
    return writer.connect(
        wish.connection,
        wish.bucket_ns,
        span_ns=wish.span_ns,
        large=wish.large,
        format=wish.format,
    )


def _name_topics(
    handles: Mapping[int, Handle], choices: Mapping[int, FormatChoice], report: ImportReport
) -> None:
    """Add the stored topics, their formats and warnings to the report."""
    for number, handle in handles.items():
        report.topics.setdefault(handle.topic, ImportedTopic(handle.format, choices[number].why))
        if handle.warning and handle.warning not in report.warnings:
            report.warnings.append(handle.warning)


def _run(
    reader: MessageFile, node: str, writer_id: int, format: str | None, content: BagContent
) -> Run:
    """Return the entry of the import in the list of runs."""
    path = source_of(reader.path)
    labels = {identity.CONTENT: content.digest}
    name = os.path.basename(path)
    return Run(node, writer_id, "import", name, path, format or "", labels=labels)


def _notes(
    path: str, runs: Sequence[Run], run: Run, earlier: Run | None, content: BagContent
) -> list[str]:
    """Say in words what the runs of a keyspace have to do with an import."""
    notes: list[str] = []
    robot = f" of robot {run.node}" if run.node else ""
    if earlier is not None:
        text = f"{path} has the content of run {run.name} ({run.writer}){robot}"
        if run.name != os.path.basename(path):
            text += ", which keeps its name"
        notes.append(f"{text}: each message is stored once")
    others = [other for other in runs if other.writer != run.writer]
    notes += [
        f"the same messages are also stored as run {other.writer} of "
        f"{f'robot {other.node}' if other.node else 'no robot'}, so each is there once for each "
        f"robot; 'cassandra_bag delete --run {other.writer}' deletes those"
        for other in others
        if content.is_of(other)
    ]
    namesakes = [run, *(other for other in others if other.name == run.name)]
    if len(namesakes) > 1:
        notes.append(f"{describe_runs(namesakes)}; --run {run.writer} means this one alone")
    return notes


def _warn(report: ImportReport, text: str) -> None:
    """Log a warning and add it to the report."""
    report.warnings.append(text)
    _log.warning("%s", text)


def _tell_damage(report: ImportReport) -> None:
    if report.salvaged.why:
        _warn(report, report.salvaged.told(report.path))


def _refuse_names(reader: MessageFile, numbers: AbstractSet[int], report: ImportReport) -> set[int]:
    """Return the numbers of connections whose topics can be stored; report each other topic once.

    Args:
        numbers: Numbers of the connections to choose from.
    """
    usable: set[int] = set()
    refused: Counter[str] = Counter()
    reasons: dict[str, InvalidName] = {}
    for number in sorted(numbers):
        topic = reader.connections[number].topic
        try:
            check_new_topic(topic)
            usable.add(number)
        except InvalidName as exc:
            refused[topic] += reader.counts[number]
            reasons[topic] = exc
    for topic, count in refused.items():
        report.lost[topic] = report.lost.get(topic, 0) + count
        _warn(
            report,
            f"{reader.path}: {count} messages are not stored: {reasons[topic]}; to store them too, "
            "import a copy of the bag in which their topic has another name",
        )
    return usable


def _tell_left_out(reader: MessageFile, topics: Iterable[str] | None, report: ImportReport) -> None:
    """Report what else a file holds: of the chosen topics the messages that cannot be stored."""
    for topic in sorted(topics_of(reader, topics) & reader.left_out.keys()):
        count, why = reader.left_out[topic]
        report.lost[topic] = report.lost.get(topic, 0) + count
        _warn(
            report,
            f"{reader.path}: {count} messages of topic {topic} are not stored: {why}; choose "
            "others with --topics to leave them out on purpose",
        )
    for what, count in reader.extras.items() if topics is None else ():
        _warn(report, f"{reader.path}: its {count} {what} are not stored")


def _tell_robots(reader: MessageFile, numbers: AbstractSet[int], report: ImportReport) -> None:
    """Report that messages of several robots, which an export named, become those of one."""
    robots = {reader.connections[number].robot for number in numbers} - {None}
    if len(robots) > 1:
        names = ", ".join(
            sorted(robot or "one without name" for robot in robots if robot is not None)
        )
        whose = f"robot {report.nodeID!r}" if report.nodeID else "one robot without name"
        _warn(
            report,
            f"{reader.path} was exported of several robots ({names}); all of its messages are "
            f"stored as those of {whose}: 'cassandra_bag copy' keeps robots, runs and events",
        )


def _writer_id(keyspace: Keyspace, node: str, content: BagContent) -> tuple[int, Run | None]:
    """Return the writer id of this bag's import, and the run of an earlier import of this bag.

    The robot counts, the name of the file does not. A run is noted before its first row is written,
    and forgotten after its last row was deleted: the rows of a bag that was not imported before
    need not be looked for.
    """
    runs = keyspace.registry.runs()
    mine = (run for run in runs if run.node == node)
    earlier = next(filter(content.is_of, mine), None)
    if earlier is not None:
        return earlier.writer, earlier
    writer_id, taken = content.writer_id(node), {run.writer for run in runs}
    # 31 bits may agree with those of another bag by chance, or its run has another robot now.
    while writer_id in taken:
        writer_id = writer_id % MAX_WRITER + 1
    return writer_id, None


def _choices(
    keyspace: Keyspace,
    reader: MessageFile,
    numbers: AbstractSet[int],
    run: Run,
    is_repeated: bool,
    samples: Mapping[int, TopicSample],
) -> dict[int, FormatChoice]:
    """Return the storage format of each connection, by number.

    A repeated import writes to the tables that hold its rows, even if the topic has changed since.

    Args:
        samples: By connection; not used if the caller gave the format.

    Raises:
        TopicExists: The rows are stored in another format than the one that the caller gave; every
            message would be stored twice.
    """
    choices: dict[int, FormatChoice] = {}
    chosen: dict[TopicSample, FormatChoice] = {}
    for number in sorted(numbers):
        connection = reader.connections[number]
        stored = _stored_formats(keyspace, connection, run) if is_repeated else set()
        md5sum = connection_kind(connection).md5sum
        new, why = run.format or keyspace.new_tables.stored_format(connection.topic, md5sum), ""
        if not new:
            sample = samples[number]
            chosen[sample] = new, why = chosen.get(sample) or choose_format(sample)
        elif not run.format:
            why = STORED_BEFORE
        usable, _ = usable_definition(connection, new)
        if run.format and stored - {new if usable is not None else FALLBACK_FORMAT}:
            raise TopicExists(
                f"{reader.path} is stored in keyspace {keyspace.name} already, topic "
                f"{connection.topic} in format {', '.join(sorted(stored))}; in format {new} "
                f"every message would be there twice: 'cassandra_bag convert {connection.topic} "
                f"--format {new}' changes the format of what is stored; or import it into "
                "another keyspace"
            )
        if stored:
            new, why = min(stored), "" if run.format else STORED_BEFORE
        choices[number] = FormatChoice(new, UNUSABLE if why and usable is None else why)
    return choices


def _stored_formats(keyspace: Keyspace, connection: Connection, run: Run) -> set[str]:
    """Return the formats of the tables that hold rows of a run from a connection."""
    whose = Whose((run.node,), frozenset((run.writer,)))
    tables = keyspace.tables.of_topic(connection.topic)
    kind = connection_kind(connection)
    return {
        table.metadata.format
        for table in tables
        if table.kind == kind
        and keyspace.connections.has(table.name, connection)
        and holds_any(keyspace.directory, [table], whose)
    }


def _remove_other_blocks(keyspace: Keyspace, handles: Mapping[int, Handle], run: Run) -> None:
    """Delete what an earlier import of the bag stored that ours will not overwrite.

    These are blocks that begin at other messages, after a conversion or if the topic was removed
    during the import. Their messages would be stored twice.
    """
    whose = Whose((run.node,), frozenset((run.writer,)))
    tables = {handle.table.name: handle.table for handle in handles.values()}
    placed = keyspace.side_tables.has("cr_placed")
    for table in tables.values():
        # Messages that were deleted since are stored again, but the index does not cover them.
        if placed:
            keyspace.place_index.withdraw(table.name, run=(run.node, run.writer))
    other = [table for table in tables.values() if table.metadata.may_be_cut_otherwise]
    read = Read(TimeRange(0, MAX_NS), whose)
    held = [table for table in other if holds_any(keyspace.directory, [table], whose)]
    if delete_time_range(keyspace, held, read):
        # What a server stores whose clock is behind would lie under the deletion.
        time.sleep(CLOCKS_SEC)


def _batches(reader: MessageFile, numbers: AbstractSet[int]) -> Iterator[MessageBatch]:
    """Read the messages of some connections, chunk by chunk.

    Chunks that hold none of them according to the index are not unpacked. If the index is wrong,
    messages are missed.
    """
    for chunk in range(reader.chunk_count):
        yield from reader.batches(chunk, numbers)


def _write_messages(
    ahead: BatchReadAhead,
    writer: MessageWriter,
    handles: dict[int, Handle],
    report: ImportReport,
    progress: MessageProgress | None,
) -> None:
    try:
        for (number, positions, times, wires), size in ahead:
            handle = handles[number]
            writer.write_run(handle, times, positions, wires)
            topic = report.topics[handle.topic]
            topic.messages += len(wires)
            topic.bytes += size
            if progress is not None:
                progress(len(wires), size)
    except BagError as exc:
        writer.flush()
        raise type(exc)(
            f"{exc}; the {report.messages} messages before it are stored. {_SALVAGE}"
        ) from exc
    writer.flush()


@dataclass
class _Rate:
    start_ns: int
    end_ns: int
    count: int = 0
    bytes: float = 0.0
    peak_hz: float = 0.0
    peak_bytes: float = 0.0
    connections: int = 0

    def lengths(self) -> Lengths:
        """Choose the lengths of buckets and blocks."""
        per = max(self.connections, 1)
        bucket_ns = bucket_for(self.peak_hz, self.peak_bytes)
        span_ns = span_for(self.peak_hz / per, self.peak_bytes / per)
        return Lengths(
            bucket_ns, span_ns, self.peak_bytes > LARGE_MESSAGE_CHUNK_BYTES * self.peak_hz
        )

    def finish(self, start_ns: int, last: bool = False) -> None:
        """End a window. The last window, which may be short, counts only if it is the only one."""
        if not last or not self.peak_hz:
            seconds = max(1.0, (self.end_ns - self.start_ns) / SECOND_NS)
            self.peak_hz = max(self.peak_hz, self.count / seconds)
            self.peak_bytes = max(self.peak_bytes, self.bytes / seconds)
        self.start_ns = start_ns
        self.count = 0
        self.bytes = 0.0


def table_lengths(reader: MessageFile, sizes: Mapping[int, int]) -> dict[int, Lengths]:
    """Choose the lengths of buckets and blocks in each connection's table, by connection number.

    They follow from the highest rate over windows of at least 10 s, which is computed from the
    message counts of the chunks and the mean message size of each connection. Windows are used
    because a single wrong stamp can make the whole bag, but not every window of it, too long.

    Args:
        sizes: Size of the serialised messages by connection number, bytes.
    """
    # Connections of equal topic and kind share a table.
    rates: dict[tuple[str, Kind], _Rate] = {}
    means = {number: sizes[number] / max(count, 1) for number, count in reader.counts.items()}
    keys = {n: (c.topic, connection_kind(c)) for n, c in reader.connections.items()}
    for chunk in range(reader.chunk_count):
        info = reader.chunk_info(chunk)
        seen = set()
        for number, count in info.counts.items():
            rate = rates.setdefault(keys[number], _Rate(info.start_ns, info.end_ns))
            if keys[number] not in seen and rate.end_ns - rate.start_ns >= _WINDOW_NS:
                rate.finish(info.start_ns)
            seen.add(keys[number])
            rate.end_ns = max(rate.start_ns, info.end_ns)
            rate.count += count
            rate.bytes += count * means[number]
    for rate in rates.values():
        rate.finish(rate.end_ns, last=True)
    for key in keys.values():
        rates[key].connections += 1
    return {n: rates[key].lengths() for n, key in keys.items()}
