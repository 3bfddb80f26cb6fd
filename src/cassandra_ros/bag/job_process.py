# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""One part of an import, in a process of its own: what cuts it, and the process itself.

It is told its task in a line of JSON, and answers with one for what it has handed over since the
last, and at its end one for what the store has acknowledged.
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
"""How often a process says how far it is."""

Span = Tuple[int, int]
"""From this time on and before that one, ns."""


@dataclass
class ImportTask:
    """What one process stores of a bag: of some connections the messages of a batch of time."""

    opening: Tuple[str, bool, bool]
    """Arguments of open_file."""
    formats: Dict[int, str]
    """By number of the connection, as all of these."""
    lengths: Dict[int, Lengths]
    """Of buckets and blocks, where a table must be made anew: another client dropped it."""
    writer_id: int
    node: str
    store: Dict[str, object]
    """Arguments of RosCassandra."""
    spans: Dict[int, Span]
    """Which connections, and of which times."""

    def to_line(self) -> str:
        """Return it as a line of JSON."""
        return json.dumps(asdict(self)) + "\n"

    @staticmethod
    def from_line(line: str) -> ImportTask:
        """Read back what to_line wrote."""
        values = json.loads(line)
        for name in ("spans", "formats", "lengths"):  # JSON has only texts as keys
            values[name] = {int(number): value for number, value in values[name].items()}
        values["lengths"] = {number: Lengths(*each) for number, each in values["lengths"].items()}
        return ImportTask(**values)


@dataclass
class Stored:
    """What became of a part: by connection, messages and bytes that are acknowledged."""

    counts: Dict[int, List[int]]
    error: str = ""
    """Name of the error that ended it."""
    text: str = ""

    def to_line(self) -> str:
        """Return it as a line of JSON."""
        return json.dumps(asdict(self)) + "\n"

    @staticmethod
    def from_line(line: str) -> Stored:
        """Read back what to_line wrote."""
        values = json.loads(line)
        counts = {int(number): count for number, count in values.pop("counts").items()}
        return Stored(counts, **values)


def read_batches(reader: MessageFile, spans: Dict[int, Span]) -> Iterator[MessageBatch]:
    """Read the messages of some connections and times; chunks without any are not unpacked.

    Which they are is told by the index: where it is wrong messages are missed.
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
    """Make the writer for a bag or for a part of it."""
    # Blocks are not sealed by time, nor do they depend on the topics that are chosen.
    limits, node = limits_for(len(reader.connections)), check_new_node(node)
    return MessageWriter(keyspace, writer_id, format=format, node=node, run=run, limits=limits)


def connect(
    writer: MessageWriter, connection: Connection, lengths: Lengths, format_name: str
) -> Handle:
    """Make ready for the messages of a connection of the bag."""
    bucket_ns, span_ns, large = lengths
    return writer.connect(connection, bucket_ns, span_ns=span_ns, large=large, format=format_name)


class _Teller:
    """Says on standard output how far the process is, and whether it is to end early."""

    def __init__(self) -> None:
        self.counts: Dict[int, List[int]] = {}
        self._messages = self._bytes = 0
        self._told = time.monotonic()
        self.ended = False
        self.hurry: Callable[[], None] = lambda: None
        """Lets waits for the store end."""

    def end(self, _number: int, _frame: Optional[FrameType]) -> None:
        """Handle a signal: stop before the next message."""
        self.ended = True
        self.hurry()

    def add(self, number: int, messages: int, nbytes: int) -> None:
        """Count messages of a connection that were handed over."""
        count = self.counts.setdefault(number, [0, 0])
        count[0] += messages
        count[1] += nbytes
        self._messages += messages
        self._bytes += nbytes
        if time.monotonic() - self._told > TELL_SEC:
            self.tell()

    def tell(self) -> None:
        """Say what came since the last time."""
        _say(json.dumps([self._messages, self._bytes]) + "\n")
        self._messages = self._bytes = 0
        self._told = time.monotonic()


def _say(line: str) -> None:
    sys.stdout.write(line)
    sys.stdout.flush()


def _write(part: ImportTask, teller: _Teller) -> None:
    """Store the messages of a part; those that the teller has counted are acknowledged then."""
    reader = open_file(*part.opening)
    with RosCassandra(**part.store) as ros_cas, reader:  # type: ignore[arg-type]
        teller.hurry = ros_cas.cassandra.outage.hurry
        # The import's run, its heartbeat and its tables are those of the process that started us.
        with bag_writer(ros_cas.catalog.keyspace, reader, part.writer_id, part.node) as writer:
            handles = {
                n: connect(writer, reader.connections[n], part.lengths[n], part.formats[n])
                for n in part.spans
            }
            with ReadAhead(read_batches(reader, part.spans)) as ahead:
                for (number, positions, times, wires), size in ahead:
                    if teller.ended:
                        break
                    writer.write_run(handles[number], times, positions, wires)
                    teller.add(number, len(wires), size)
            teller.tell()


def main() -> int:
    """Do what the line on standard input asks for; return the exit status."""
    teller = _Teller()
    # A Ctrl-C reaches all processes of the terminal; ours are told by the one that started them.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, teller.end)
    part = ImportTask.from_line(sys.stdin.readline())
    try:
        _write(part, teller)
        stored = Stored(teller.counts)
    except CassandraRosError as exc:
        # What came before the damage is acknowledged; of a failed write nobody can say how much.
        counts = teller.counts if isinstance(exc, BagError) else {}
        stored = Stored(counts, type(exc).__name__, str(exc))
    _say(stored.to_line())
    if teller.ended:  # threads that connect to a silent store are not waited for
        os._exit(1)
    return 1 if stored.error else 0
