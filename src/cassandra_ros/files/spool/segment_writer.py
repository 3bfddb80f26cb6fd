# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""One file of the spool: an MCAP to which chunks are appended.

MCAP and not a bag: a chunk of MCAP has a checksum and a message has a sequence number, the counter
of our rows, while for a bag both would be fields of our own. A message of 60 bytes takes 1.2 us of
processor time here, 5.5 us with the library's writer of MCAP, and 2 to 3 us with our writer of
bags; an image of 2 MB takes 0.9 ms, beside 5 to 6 ms and 6 to 8 ms. Both keep an index in memory.

Each file stands alone: it begins with the label of the run, and its chunks hold the schemas and
channels of their messages. A channel is written into the first chunk with a message of it, again
into the next chunk, and into later ones at distances that double, so that damage costs only the
messages of the chunks that it hits. The message indexes after a chunk tell which messages were in
it when it is damaged. At its beginning and after chunks a file tells how many messages the run has
written by then, by topic, so that what a damaged or missing file had is counted.
"""

from __future__ import annotations

import os
from collections import defaultdict
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Iterable, Sequence, Tuple

from cassandra_ros.files.bag import mcap_records
from cassandra_ros.files.spool.spool_folder import open_private
from cassandra_ros.files.spool.spool_label import (
    END,
    LABEL,
    TOTALS,
    RunEnd,
    RunTotals,
    SpoolLabel,
    TopicTotal,
    Totals,
    as_metadata,
    copy_totals,
)
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.store.tables.checksum import crc32

REPEAT_BYTES = 2 * 4096
"""Minimum distance between the second and the third copy of a channel, bytes: a damaged page of a
disk does not hit both."""
TOTALS_SHARE = 8
"""Minimum size of what is written between two records of totals, as a multiple of such a record's
size: totals take at most about an eighth of the file."""
UNCOPIED_PART_BYTES = 1 << 18
"""Size above which a part of a write is not joined with the other parts, bytes: that would copy it.
"""
SpooledMessage = Tuple[Connection, int, int, bytes]
"""Connection, time of reception (ns), lower 32 bits of the counter in its run, serialised message.
"""


@dataclass
class _Definitions:
    """Schemas and channels that were first written into the same chunk."""

    records: list[bytes]
    due: int = 0
    """Size of the file from which the next chunk repeats them, bytes; 0 = the next one does."""
    distance: int = 0
    """Distance from the last copy to the next one, bytes; 0 = they are in fewer than two chunks."""
    copies: int = 0
    """Number of chunks that have them."""

    def repeated(self, size: int, least: int) -> None:
        """Note a further copy, and from the second one on when the next one is due.

        Args:
            size: Size of the file after this copy, bytes.
            least: Minimum distance to the next copy, bytes.
        """
        self.copies += 1
        if self.copies > 1:
            self.distance = max(2 * self.distance, least)
            self.due = size + self.distance


class SegmentWriter:
    """One file that is being written. Not thread-safe; ``sync`` may run beside ``append``.

    Args:
        path: The file, which must not exist.
        label: The run of its messages.
        totals: The messages in the files of the run before this one. This object adds those that it
            writes; the caller gives the same object to the next file. None = it is the only file.

    Raises:
        OSError: The disk is full or fails, or the file exists. A new file is deleted.
    """

    def __init__(self, path: Path, label: SpoolLabel, totals: Totals | None = None) -> None:
        self.path = path
        self._totals = {} if totals is None else totals
        self._totals_due = 0
        """Size of the file from which the next totals are written, bytes."""
        self.size = 0
        """Size of the file up to its last complete record, bytes."""
        self._numbers: dict[int, tuple[int, Connection]] = {}
        """id() of a connection → channel id, and the connection: while it is here, no other object
        gets its id()."""
        self._topics: list[str] = []
        """Topic of each channel, in the order of their ids, which begin with 1."""
        self._definitions: list[_Definitions] = []
        """One for each chunk with the first message of a connection."""
        self._definition_bytes = 0
        """Size of all schemas and channels of the file, bytes."""
        self._file = open(path, "xb", buffering=0, opener=open_private)  # noqa: SIM115
        try:
            head = mcap_records.metadata(LABEL, as_metadata(label))
            self._write([mcap_records.begin_file(), head, _record_of(self._totals)])
        except OSError:
            self._file.close()
            path.unlink()
            raise

    def append(self, messages: Iterable[SpooledMessage]) -> None:
        """Append messages, at least one, as one chunk.

        Raises:
            OSError: The disk is full, or fails. The file is as it was before, and the messages may
                be appended again.
        """
        due = [definitions for definitions in self._definitions if definitions.due <= self.size]
        parts = [record for definitions in due for record in definitions.records]
        new_definitions: list[bytes] = []
        at = sum(map(len, parts))  # offset of the next record in the chunk
        first, last = 2**63, 0
        # Channel id → time of reception and offset of each message in turn, as an index has them.
        entries: defaultdict[int, list[int]] = defaultdict(list)
        added: Totals = {}
        for connection, t_ns, counter, wire in messages:
            numbered = self._numbers.get(id(connection))
            if numbered is None:
                numbered = self._numbers[id(connection)] = len(self._numbers) + 1, connection
                new_definitions.append(mcap_records.channel(*numbered))
                self._topics.append(connection.topic)
            number = numbered[0]
            entries[number] += t_ns, at
            parts.append(mcap_records.message_head(number, counter, t_ns, len(wire)))
            parts.append(wire)
            at += len(parts[-2]) + len(wire)
            first, last = min(first, t_ns), max(last, t_ns)
        for number, times_and_offsets in entries.items():
            times = times_and_offsets[::2]
            total = added.setdefault(self._topics[number - 1], TopicTotal())
            total.add(len(times), min(times), max(times))
        if new_definitions:
            # In front: a reader takes the channels at the beginning of a chunk only.
            shift = sum(map(len, new_definitions))
            parts[:0] = new_definitions
            at += shift
            for times_and_offsets in entries.values():
                times_and_offsets[1::2] = [offset + shift for offset in times_and_offsets[1::2]]
            # Before the write: if that fails, the next chunk has them.
            self._definitions.append(_Definitions(new_definitions))
            self._definition_bytes += shift
            due.append(self._definitions[-1])
        content = b"".join(parts)
        chunk = mcap_records.chunk(content, (first, last), crc32(content))
        indexes = [
            mcap_records.index(number, times_and_offsets)
            for number, times_and_offsets in entries.items()
        ]
        totals_records = []
        if self.size + at >= self._totals_due:
            totals_records.append(_record_of(_sum(self._totals, added)))
        self._write([*chunk, *indexes, *totals_records])
        _add(self._totals, added)
        if totals_records:
            self._totals_due = self.size + TOTALS_SHARE * len(totals_records[0])
        for definitions in due:
            definitions.repeated(self.size, max(REPEAT_BYTES, 2 * self._definition_bytes))

    @property
    def connections(self) -> int:
        """Number of connections in the file. A channel id has 16 bits, so the caller limits it."""
        return len(self._numbers)

    def finish(self, end: RunEnd) -> None:
        """Append the end of the run; raises OSError as append. The caller closes the file then."""
        self._write([_record_of(self._totals), mcap_records.metadata(END, as_metadata(end))])

    def _write(self, parts: Sequence[bytes]) -> None:
        """Write records to the end of the file, all or (after an OSError) none of them."""
        written = 0
        # Joined, small parts are one request to the system; a large one would be copied.
        pieces = parts if max(map(len, parts)) > UNCOPIED_PART_BYTES else [b"".join(parts)]
        try:
            for piece in pieces:
                rest = memoryview(piece)
                while rest:
                    done = self._file.write(rest)
                    rest = rest[done:]
                    written += done
        except OSError:
            self._file.truncate(self.size)
            self._file.seek(self.size)
            raise
        self.size += written

    def sync(self) -> None:
        """Write what was appended to the disk, and set the file's time.

        By this time a drain knows how long a recorder that was killed was alive.
        """
        os.utime(self._file.fileno())
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """End the file, so that every reader of MCAP takes it as complete, sync and close it.

        Raises:
            OSError: The disk fails. The file is closed all the same.
        """
        try:
            with suppress(OSError):  # without room for its end it is read just as well
                self._write([mcap_records.end_file()])
            self.sync()
        finally:
            self._file.close()


def _add(totals: Totals, added: Totals) -> None:
    """Add the messages of ``added`` to ``totals``."""
    for topic, total in added.items():
        sums = totals.setdefault(topic, TopicTotal())
        sums.add(total.count, total.first_ns, total.last_ns)


def _sum(totals: Totals, added: Totals) -> Totals:
    sums = copy_totals(totals)
    _add(sums, added)
    return sums


def _record_of(totals: Totals) -> bytes:
    """Return the metadata record of totals."""
    return mcap_records.metadata(TOTALS, as_metadata(RunTotals.of(totals)))
