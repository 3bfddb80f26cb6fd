# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Read a file of the spool chunk by chunk; what is damaged is told, and the rest is read.

A file may end anywhere (the process was killed, the power was cut) and may be damaged anywhere.
Each chunk has a checksum. After a damaged one reading goes on with the next record that is
complete, and the message indexes say which messages are missing. A connection is written more than
once; if the first ones are damaged, a later one is taken.
"""

from __future__ import annotations

import re
from collections import defaultdict
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Iterator, NamedTuple, Sequence

from cassandra_ros.errors import BagError, SpoolError
from cassandra_ros.files.bag import mcap_records
from cassandra_ros.files.bag.mcap_format import MAGIC, RECORD, McapRecord, find_messages
from cassandra_ros.files.spool.segment_writer import SpooledMessage
from cassandra_ros.files.spool.spool_label import (
    END,
    LABEL,
    TOTALS,
    RunEnd,
    RunTotals,
    SpoolLabel,
    TopicTotal,
    Totals,
    from_metadata,
    is_whole,
)
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.store.tables.checksum import crc32

_LOOK_BYTES = 64
"""Number of bytes of a record by which is_plausible checks it."""
_RECORD = re.compile(rb"[\x06\x07\x0c\x0f].{4}\x00{4}", re.DOTALL)
"""Kind and length of a record that may follow damage: a chunk, a message index, metadata or the end
of the data, of less than 4 GB."""


class Missing(NamedTuple):
    """Messages of one topic that cannot be read."""

    topic: str
    """'' = not known."""
    messages: int
    """Number of messages; 0 = some, their number is not known."""
    first_ns: int
    """Time of reception of the first of them, ns; 0 = not known."""
    last_ns: int
    """Time of reception of the last of them, ns; 0 = not known."""


@dataclass
class SegmentPart:
    """The messages of one chunk and what is missing of them, damage, or totals."""

    messages: Sequence[SpooledMessage] = ()
    damage: str = ""
    """What is damaged, in words; '' = nothing."""
    missing: Sequence[Missing] = ()
    """What is missing by the message indexes; as these may be damaged too, there may be more."""
    totals: Totals | None = None
    """The messages that the run had written to its files up to here; None = not told here."""


@dataclass
class _SegmentDamage:
    """Damage of which no part was yielded yet: more damage may follow directly."""

    at: int
    """Offset of the first damaged byte."""
    indexes: list[mcap_records.IndexedMessages] = field(default_factory=list)
    """Message indexes after it, of the chunks in it."""
    to: int = 0
    """Offset of the first byte after it."""


class SegmentReader:
    """A file of the spool, read into memory: backlog.py ends a file at 16 MB.

    Args:
        path: The file. It may still be written: what is complete when it is opened is read.

    Raises:
        SpoolError: The file cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.connections: dict[int, Connection] = {}
        """Connections that were read so far, by channel id. A file names a connection in several
        chunks; the first object stays, because callers keep what they know of it by its id()."""
        self._searched = False
        """Whether all chunks were searched for connections."""
        try:
            # Not mapped: a mapped file ends the process when its disk is removed.
            self._data = path.read_bytes()
        except OSError as exc:
            raise SpoolError(f"{path} cannot be read: {exc.strerror}") from exc
        self.nbytes = len(self._data)

    def label(self) -> SpoolLabel | None:
        """Return the label of the run; None = it is not before the first chunk, or damaged.

        Raises:
            SpoolError: It is of another version.
        """
        for record in self._records():
            if record.kind == mcap_records.METADATA_KIND:
                name, values = self._metadata(record)
                if name == LABEL and is_whole(values):
                    return from_metadata(SpoolLabel, values, str(self.path))
            elif record.kind == mcap_records.CHUNK_KIND:
                break
        return None

    def end(self) -> RunEnd | None:
        """Return the end of the run; None = it is not in this file, or damaged.

        Raises:
            SpoolError: It is of another version.
        """
        for record in self._records():
            if record.kind == mcap_records.METADATA_KIND:
                name, values = self._metadata(record)
                if name == END and is_whole(values):
                    return from_metadata(RunEnd, values, str(self.path))
        return None

    def totals(self) -> dict[int, TopicTotal]:
        """Count the messages by channel id. Only the message indexes are read, no chunk."""
        totals: defaultdict[int, TopicTotal] = defaultdict(TopicTotal)
        for record in self._records():
            if record.kind == mcap_records.INDEX_KIND:
                listed = mcap_records.read_index(self._bytes(record))
                if listed.times:
                    times = listed.times
                    totals[listed.channel].add(len(times), min(times), max(times))
        return dict(totals)

    def parts(self) -> Iterator[SegmentPart]:
        """Yield the messages chunk by chunk, and what is missing where the file is damaged.

        Raises:
            SpoolError: Totals are of another version.
        """
        # ``whole`` is the last chunk if it could be read. Of the indexes after it some may be
        # damaged; those that follow this damage list no missing messages.
        damage: _SegmentDamage | None = None
        whole: SegmentPart | None = None
        at = len(MAGIC)
        for record in self._records():
            if record.start - RECORD.size > at:
                damage = damage or _SegmentDamage(at)
                damage.to = record.start - RECORD.size
            at = record.stop
            if record.kind == mcap_records.INDEX_KIND and damage is not None:
                listed = mcap_records.read_index(self._bytes(record))
                if whole is None or not self._is_of(listed, whole):
                    damage.indexes.append(listed)
            elif record.kind == mcap_records.METADATA_KIND:
                totals = self._totals(record)
                if totals is not None:
                    if damage is not None:
                        yield self._damage_part(damage)
                    damage = None
                    yield SegmentPart(totals=totals)
            elif record.kind == mcap_records.CHUNK_KIND:
                if damage is not None:
                    yield self._damage_part(damage)
                damage, whole = None, self._messages(record)
                if whole is None:
                    damage = _SegmentDamage(record.start - RECORD.size, to=record.stop)
                else:
                    yield whole
            elif record.kind == mcap_records.END_KIND:
                at = self.nbytes  # is_plausible has checked how many bytes follow it
        if damage is not None:
            yield self._damage_part(damage)
        if at < self.nbytes:
            why = f"{self.path} is cut short at byte {at} of {self.nbytes}"
            yield SegmentPart(damage=why, missing=[Missing("", 0, 0, 0)])

    def _is_of(self, listed: mcap_records.IndexedMessages, whole: SegmentPart) -> bool:
        """Return whether an index lists messages of a chunk that was read."""
        connection = self._connection(listed.channel)
        return [t for other, t, _, _ in whole.messages if other is connection] == list(listed.times)

    def _damage_part(self, damage: _SegmentDamage) -> SegmentPart:
        """Return the part for damage, with what its indexes list; else with unknown messages."""
        totals: defaultdict[str, TopicTotal] = defaultdict(TopicTotal)
        for listed in damage.indexes:
            connection = self._connection(listed.channel)
            if listed.times:
                topic = "" if connection is None else connection.topic
                totals[topic].add(len(listed.times), min(listed.times), max(listed.times))
        missing = [Missing(t, n.count, n.first_ns, n.last_ns) for t, n in totals.items()]
        why = f"{self.path} is damaged from byte {damage.at} to {damage.to}"
        return SegmentPart(damage=why, missing=missing or [Missing("", 0, 0, 0)])

    def _messages(self, record: McapRecord) -> SegmentPart | None:
        """Return the messages of a chunk, in the order in which they were written.

        Return None if its checksum is wrong, or we did not write it. A message whose connection is
        damaged wherever the file names it is missing.
        """
        where = f"{self.path}: the chunk at byte {record.start}"
        content = self._content(record)
        if content is None:
            return None
        try:
            self._take_connections(content, where)
            columns = [column.tolist() for column in find_messages(content, where)]
        except BagError:  # right checksum, but not written by us
            return None
        lost: defaultdict[int, TopicTotal] = defaultdict(TopicTotal)
        messages: list[SpooledMessage] = []
        for channel, counter, t_ns, _, start, stop in zip(*columns):
            connection = self._connection(channel)
            if connection is None:
                lost[channel].add(1, t_ns, t_ns)
            else:
                messages.append((connection, t_ns, counter, content[start:stop]))
        if not lost:
            return SegmentPart(messages)
        why = f"{where} has messages whose definitions are damaged"
        missing = [Missing("", n.count, n.first_ns, n.last_ns) for n in lost.values()]
        return SegmentPart(messages, why, missing)

    def _content(self, record: McapRecord) -> bytes | None:
        """Return the records of a chunk; None = its checksum is wrong."""
        content, crc = mcap_records.chunk_content(self._bytes(record))
        return content if crc32(content) == crc else None

    def _take_connections(self, content: bytes, where: str) -> None:
        """Add the connections of a chunk that are not known yet; raises BagError."""
        for number, connection in mcap_records.read_channels(content, where).items():
            self.connections.setdefault(number, connection)

    def _connection(self, channel: int) -> Connection | None:
        """Return the connection of a channel; None = it is damaged wherever the file names it."""
        connection = self.connections.get(channel)
        if connection is None and not self._searched:
            self._searched = True
            for record in self._records():
                if record.kind == mcap_records.CHUNK_KIND:
                    content = self._content(record)
                    with suppress(BagError):
                        self._take_connections(content or b"", str(self.path))
            connection = self.connections.get(channel)
        return connection

    def _totals(self, record: McapRecord) -> Totals | None:
        """Return the totals in a metadata record; None = it holds something else, or is damaged."""
        name, values = self._metadata(record)
        if name != TOTALS or not is_whole(values):
            return None
        return from_metadata(RunTotals, values, str(self.path)).totals()

    def _metadata(self, record: McapRecord) -> tuple[str, dict[str, str]]:
        """Return name and fields of a metadata record; '' and no fields if it is damaged."""
        try:
            name, values = mcap_records.read_metadata(self._bytes(record), str(self.path))
            return name, dict(values)
        except BagError:
            return "", {}

    def _bytes(self, record: McapRecord) -> bytes:
        return self._data[record.start : record.stop]

    def _records(self) -> Iterator[McapRecord]:
        """Yield the complete records outside of chunks up to the end of the data.

        Damaged bytes, and a record that the file cuts short, are passed over without a word: the
        positions of the records tell that.
        """
        at, data = len(MAGIC), self._data
        while at + RECORD.size <= self.nbytes:
            kind, length = RECORD.unpack(data[at : at + RECORD.size])
            start = at + RECORD.size
            stop = start + length
            head = data[start : start + _LOOK_BYTES]
            after = self.nbytes - stop
            if after < 0 or not mcap_records.is_plausible(kind, length, head, after):
                following = _RECORD.search(data, at + 1)
                if following is None:
                    return
                at = following.start()
                continue
            yield McapRecord(kind, start, stop)
            if kind == mcap_records.END_KIND:
                return
            at = stop
