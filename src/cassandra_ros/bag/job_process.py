# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A process that stores a part of a bag for ``import --jobs``.

It reads its task as one line of JSON from standard input. It writes lines of JSON: regularly the
numbers of messages and bytes handled since the last line, at its end the result.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from dataclasses import asdict, dataclass
from types import FrameType
from typing import Callable, Dict, Iterator, List, Optional, Tuple

from cassandra_ros.arguments import check_new_node
from cassandra_ros.bag.bag_read_ahead import ReadAhead
from cassandra_ros.bag.file_formats import open_file
from cassandra_ros.bag.message_file import MessageBatch, MessageFile
from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.errors import BagError, CassandraRosError
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.tables.block_limits import limits_for
from cassandra_ros.tables.directory import Lengths
from cassandra_ros.tables.registry import Run
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.message_writer import Handle, MessageWriter

TELL_SEC = 0.1
"""Minimum interval between two lines of progress, s."""

Span = Tuple[int, int]
"""A time range, ns; its end is not included."""


@dataclass
class ImportTask:
    """The part of a bag that one process stores: some connections, each in a time range."""

    opening: Tuple[str, bool, bool]
    """Arguments of open_file."""
    formats: Dict[int, str]
    """Storage format by connection number."""
    lengths: Dict[int, Lengths]
    """Lengths of buckets and blocks by connection number. They are needed if another client drops
    the table during the import, so that it must be made again."""
    writer_id: int
    node: str
    store: Dict[str, object]
    """Arguments of RosCassandra."""
    spans: Dict[int, Span]
    """Time range to store by connection number; other connections are not stored."""

    def to_line(self) -> str:
        """Return the task as a line of JSON."""
        return json.dumps(asdict(self)) + "\n"

    @staticmethod
    def from_line(line: str) -> ImportTask:
        """Return the task that to_line wrote."""
        values = json.loads(line)
        for name in ("spans", "formats", "lengths"):  # JSON has only texts as keys
            values[name] = {int(number): value for number, value in values[name].items()}
        values["lengths"] = {number: Lengths(*each) for number, each in values["lengths"].items()}
        return ImportTask(**values)


@dataclass
class TaskResult:
    """The result of a task."""

    counts: Dict[int, List[int]]
    """Number and size (bytes) of the acknowledged messages by connection number."""
    error: str = ""
    """Class name of the error that ended the process; '' = no error."""
    text: str = ""
    """Text of that error."""

    def to_line(self) -> str:
        """Return the result as a line of JSON."""
        return json.dumps(asdict(self)) + "\n"

    @staticmethod
    def from_line(line: str) -> TaskResult:
        """Return the result that to_line wrote."""
        values = json.loads(line)
        counts = {int(number): count for number, count in values.pop("counts").items()}
        return TaskResult(counts, **values)


def read_batches(reader: MessageFile, spans: Dict[int, Span]) -> Iterator[MessageBatch]:
    """Read the messages of some connections and time ranges, chunk by chunk.

    Chunks that hold none of them according to the index are not unpacked. If the index is wrong,
    messages are missed.

    Args:
        spans: Time range by connection number.
    """
    for chunk in range(reader.chunk_count):
        info = reader.chunk_info(chunk)
        here = {
            number: span
            for number, span in spans.items()
            if number in info.counts and span[0] <= info.end_ns and info.start_ns < span[1]
        }
        if here:
            yield from reader.batches(chunk, here)


def bag_writer(
    keyspace: Keyspace,
    reader: MessageFile,
    writer_id: int,
    node: str,
    *,
    format: Optional[str] = None,
    run: Optional[Run] = None,
) -> MessageWriter:
    """Return the writer for a bag, or for a part of it."""
    # The limits of blocks depend neither on the current time nor on the topics that are imported.
    limits, node = limits_for(len(reader.connections)), check_new_node(node)
    return MessageWriter(keyspace, writer_id, format=format, node=node, run=run, limits=limits)


def connect(
    writer: MessageWriter, connection: Connection, lengths: Lengths, format_name: str
) -> Handle:
    """Return the handle with which the writer writes messages of a connection of the bag."""
    bucket_ns, span_ns, large = lengths
    return writer.connect(connection, bucket_ns, span_ns=span_ns, large=large, format=format_name)


class _ProgressReporter:
    """Counts messages, reports progress on standard output, and handles the signal to stop."""

    def __init__(self) -> None:
        self.counts: Dict[int, List[int]] = {}
        self._messages = self._bytes = 0
        self._told = time.monotonic()
        self.ended = False
        self.hurry: Callable[[], None] = lambda: None
        """Function that ends all waits for the store; replaced when there is a connection."""

    def end(self, _number: int, _frame: Optional[FrameType]) -> None:
        """Handle a signal: stop before the next message."""
        self.ended = True
        self.hurry()

    def add(self, number: int, messages: int, nbytes: int) -> None:
        """Count messages that were given to the writer."""
        count = self.counts.setdefault(number, [0, 0])
        count[0] += messages
        count[1] += nbytes
        self._messages += messages
        self._bytes += nbytes
        if time.monotonic() - self._told > TELL_SEC:
            self.tell()

    def tell(self) -> None:
        """Report the messages and bytes counted since the last report."""
        _say(json.dumps([self._messages, self._bytes]) + "\n")
        self._messages = self._bytes = 0
        self._told = time.monotonic()


def _say(line: str) -> None:
    sys.stdout.write(line)
    sys.stdout.flush()


def _write(task: ImportTask, reporter: _ProgressReporter) -> None:
    """Store the messages of a task. On return the store has acknowledged all counted messages."""
    reader = open_file(*task.opening)
    with RosCassandra(**task.store) as ros_cas, reader:  # type: ignore[arg-type]
        reporter.hurry = ros_cas.cassandra.outage.hurry
        # The process that started us keeps the run and its heartbeat, and has made the tables.
        with bag_writer(ros_cas.catalog.keyspace, reader, task.writer_id, task.node) as writer:
            handles = {
                n: connect(writer, reader.connections[n], task.lengths[n], task.formats[n])
                for n in task.spans
            }
            with ReadAhead(read_batches(reader, task.spans)) as ahead:
                for (number, positions, times, wires), size in ahead:
                    if reporter.ended:
                        break
                    writer.write_run(handles[number], times, positions, wires)
                    reporter.add(number, len(wires), size)
            reporter.tell()


def main() -> int:
    """Execute the task that is read from standard input; return the exit status."""
    reporter = _ProgressReporter()
    # Ctrl-C reaches all processes of the terminal; the process that started this one ends it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, reporter.end)
    task = ImportTask.from_line(sys.stdin.readline())
    try:
        _write(task, reporter)
        result = TaskResult(reporter.counts)
    except CassandraRosError as exc:
        # The messages before the damage are acknowledged. After a failed write it is not known
        # which messages are.
        counts = reporter.counts if isinstance(exc, BagError) else {}
        result = TaskResult(counts, type(exc).__name__, str(exc))
    _say(result.to_line())
    if reporter.ended:  # do not wait for threads that connect to a silent store
        os._exit(1)
    return 1 if result.error else 0
