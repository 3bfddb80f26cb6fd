# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Read MCAP files with messages of ROS 1, chunk by chunk, without message classes."""

from __future__ import annotations

import os
from collections import Counter
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import BinaryIO, Mapping, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Metadata, Schema, Statistics
from mcap.well_known import MessageEncoding, Profile

from cassandra_ros.errors import BagError, BagTooLarge, BagUnindexed
from cassandra_ros.files.bag import mcap_events
from cassandra_ros.files.bag import mcap_format as mcapformat
from cassandra_ros.files.bag.format import ChunkMessages, Longs, uncounted
from cassandra_ros.files.bag.mcap_channel import to_connection, why_foreign
from cassandra_ros.files.bag.mcap_format import ChunkHead, McapRecord, Messages
from cassandra_ros.files.bag.message_file import (
    Allowance,
    ChunkInfo,
    MessageFile,
    PublishTimes,
    SalvageReport,
)
from cassandra_ros.keys import MAX_NS
from cassandra_ros.messages.connection_header import Connection

_LOOSE_BYTES = 1 << 20
"""Maximum size of consecutive messages outside of chunks that are read at once, bytes."""
_LATE = "their log_time lies after the year 2106, in which the time of ROS 1 ends"
_KINDS = frozenset(map(int, Opcode))
_EXTRAS = {
    int(Opcode.ATTACHMENT): "attachments",
    int(Opcode.METADATA): "records of metadata",
}
"""Kinds of records that cannot be stored -> their name in warnings."""
ROSBAG2_METADATA = "metadata.yaml"
"""Name of the file that each folder of rosbag2 has."""
SQLITE_MAGIC = b"SQLite format 3\x00"
"""First bytes of the files of rosbag2 that are not MCAP files."""


@dataclass
class _Chunk:
    """A chunk, or consecutive messages outside of chunks."""

    record: McapRecord
    """Position of the compressed records."""
    head: ChunkHead
    """Where the messages are counted one by one, its times are replaced by theirs."""
    counts: Counter[int] = field(default_factory=Counter)
    """Number of messages by channel id, without late ones; empty until they are counted."""
    index: McapRecord | None = None
    """Position of the message indexes of the chunk."""
    salvaged: bytes | None = None
    """Unpacked beginning of the chunk, if the file ends inside it or the chunk is damaged."""
    records_counted: bool = False
    """Whether the Allowance has counted its records."""
    damaged: bool = False
    """Whether the messages that ``counts`` counts cannot be read."""

    @property
    def loose(self) -> bool:
        """Whether these are messages outside of chunks."""
        return self.record.kind == Opcode.MESSAGE

    @property
    def readable(self) -> Counter[int]:
        """Number of messages that can be read, by channel id."""
        return Counter() if self.damaged else self.counts

    @property
    def counted(self) -> bool:
        """Whether ``counts`` is final: from the message indexes, and no message is late."""
        return bool(self.counts) and self.salvaged is None and self.head.end_ns <= MAX_NS


class _ChunkContent(NamedTuple):
    """The unpacked content and the messages of the chunk that was read last."""

    chunk: int
    content: bytes
    messages: Messages


class McapReader(MessageFile):
    """An MCAP that is open for reading; also a context manager.

    Each ROS 1 channel of the file is a connection. All records are visited once when the file is
    opened. A chunk without message index is unpacked then, so files without chunks, indexes or
    summary can be read, too. Memory: about 500 bytes for each chunk; while a chunk is read, as
    much as BagReader.

    Args:
        salvage: If the file is cut short, damaged or was not closed, read the messages before the
            damage and in chunks after it. All chunks are read to find it. An undamaged file is read
            as usual.
        large_chunks: Also read chunks and files that an Allowance refuses by default. A file that
            was made to do harm can then fill the memory.

    Attributes:
        salvaged: The damage that was found when the file was opened with ``salvage``, if any.
        left_out: Messages of channels with other encodings or damaged headers, and messages with
            a later time than ROS 1 has, see MessageFile.
        extras: Number of attachments and metadata records that are not events, see MessageFile.

    Raises:
        BagUnindexed: The file was not closed properly, or is cut short.
        BagTooLarge: The file would unpack to more bytes or records than the Allowance permits.
        BagError: The file cannot be opened, is damaged, or holds no ROS 1 messages; with salvage:
            no message can be read.
    """

    def __init__(
        self, path: str | os.PathLike[str], salvage: bool = False, large_chunks: bool = False
    ) -> None:
        self.path, self.salvaged = os.fspath(path), SalvageReport()
        self._profile = ""
        self._salvages = salvage
        self._stated: int | None = None
        """Number of messages that the file states at its end; None = it states no number."""
        self._unknown_bytes = 0
        """Size of the records of kinds that the format does not have, bytes."""
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        """Schemas and channels of the file by their ids, also of other encodings."""
        self._chunks: list[_Chunk] = []
        """Chunks in the order of the file, from ``_number_connections`` on without empty ones."""
        self._numbers: dict[int, int] = {}
        """Channel id -> connection number, of the channels whose messages are read."""
        self._first: list[int] = [0]
        """Number of messages in the chunks before each chunk, and in all chunks."""
        self._late: Counter[int] = Counter()
        """Number of messages that are too late for ROS 1, by channel id."""
        self._last: _ChunkContent | None = None
        try:
            with ExitStack() as opened:
                self._file: BinaryIO = opened.enter_context(open(self.path, "rb"))
                file_bytes = os.fstat(self._file.fileno()).st_size
                self._allowance = Allowance(file_bytes, large_chunks)
                self._read_index(salvage)
                self._number_connections()
                if self.salvaged.why and not self.message_count:
                    raise BagError(
                        f"{self.path} {self.salvaged.why}: there is no message that can be salvaged"
                    )
                self.salvaged.messages = self.message_count
                opened.pop_all()
        except OSError as exc:
            raise BagError(f"{self.path} cannot be read: {exc.strerror}") from exc

    def close(self) -> None:
        """Close the file. A second call does nothing."""
        self._file.close()

    def chunk_info(self, chunk: int) -> ChunkInfo:
        """Return the index entry of a chunk, see MessageFile."""
        entry = self._chunks[chunk]
        counts = {self._numbers[c]: n for c, n in entry.readable.items() if c in self._numbers}
        return ChunkInfo(entry.record.start, *self.chunk_times(chunk), counts, self._first[chunk])

    def chunk_times(self, chunk: int) -> tuple[int, int]:
        """Return the first and the last time in a chunk that the file states, ns."""
        head = self._chunks[chunk].head
        return head.start_ns, head.end_ns

    def chunk_content(self, chunk: int) -> tuple[bytes, ChunkMessages]:
        """Return the content and the ROS 1 messages of a chunk, see MessageFile."""
        content, messages = self._messages(chunk)
        ids = np.array([self._numbers[c] for c in messages.channels.tolist()], np.int64)
        return content, ChunkMessages(ids, messages.times, messages.starts, messages.stops)

    def chunk_publish_times(self, chunk: int) -> PublishTimes | None:
        """Return the publish times and sequence numbers of a chunk, see MessageFile."""
        _, messages = self._messages(chunk)
        if not (messages.delays.any() or messages.sequences.any()):
            return None
        self.has_publish_times = True
        return PublishTimes(self._first[chunk], messages.delays, messages.sequences)

    def _messages(self, chunk: int) -> tuple[bytes, Messages]:
        """Return the content and the messages of a chunk, without those that are left out.

        The last chunk is kept, because the callers ask for its messages and their publish times.

        Raises:
            BagError: The chunk is damaged, or contradicts its message index.
        """
        if self._last is None or self._last.chunk != chunk:
            self._last = None  # free the last chunk first, so that only one is in memory
            content, index, offsets = self._content(chunk), self._chunks[chunk].index, None
            # A valid index is shorter than twice the content. A longer one would waste memory.
            if index is not None and index.stop - index.start <= 2 * len(content):
                offsets = mcapformat.offsets_of_indexes(self._bytes(index))
            messages = self._find(chunk, content, offsets).in_time()
            if Counter(messages.channels.tolist()) != self._chunks[chunk].readable:
                raise BagError(
                    f"{self._where(chunk)} is damaged: its {len(messages.times)} messages are not "
                    "those that its message index lists; write the file anew with: "
                    f"mcap recover {self.path} -o RECOVERED.mcap"
                )
            is_connected = np.isin(messages.channels, list(self._numbers))
            self._last = _ChunkContent(
                chunk, content, Messages(*(column[is_connected] for column in messages))
            )
        return self._last.content, self._last.messages

    def _find(self, chunk: int, content: bytes, offsets: Longs | None = None) -> Messages:
        """Find the messages in the content of a chunk, whose records are counted once.

        Raises:
            BagTooLarge: The file has too many records.
            BagError: The chunk is damaged.
        """
        entry, where = self._chunks[chunk], self._where(chunk)
        count = (
            uncounted if entry.records_counted else partial(self._allowance.count_records, where)
        )
        messages = mcapformat.find_messages(content, where, offsets, count)
        entry.records_counted = True
        return messages

    def _content(self, chunk: int) -> bytes:
        """Return the unpacked records of a chunk; raises BagError if it is damaged."""
        entry, where = self._chunks[chunk], self._where(chunk)
        if entry.salvaged is not None:
            return entry.salvaged
        try:
            data = self._bytes(entry.record)
        except OSError as exc:
            raise BagError(f"{where} cannot be read: {exc.strerror}") from exc
        return data if entry.loose else mcapformat.decompress(entry.head, data, where)

    def _bytes(self, record: McapRecord) -> bytes:
        self._file.seek(record.start)
        return self._file.read(record.stop - record.start)

    def _where(self, chunk: int) -> str:
        return f"{self.path}: chunk {chunk + 1} of {len(self._chunks)}"

    def _read_index(self, salvage: bool) -> None:
        """List schemas, channels and chunks of the file; with salvage up to the damage."""
        before = self._schemas, self._channels
        try:
            for record in mcapformat.walk(self._file):
                # The summary repeats schemas and channels. What a damaged one says does not count.
                if record.kind == Opcode.DATA_END:
                    before = dict(self._schemas), dict(self._channels)
                self._note(record)
        except BagError as exc:
            if not salvage:
                raise
            self._schemas, self._channels = before
            self._stop(record, exc)
        if salvage:
            self._check_chunks()
        self._count_the_rest()

    def _stop(self, damaged: McapRecord, error: BagError) -> None:
        """Report the damage. If the file ends inside a chunk, keep its complete records.

        Args:
            damaged: The record that could not be read, or that of kind CUT.
            error: The error that it raised.
        """
        position, file_bytes = damaged.start, os.fstat(self._file.fileno()).st_size
        self._stated = None
        if damaged.kind in (Opcode.STATISTICS, Opcode.FOOTER):
            self.salvaged.end("has a damaged summary")
            return
        why = f"is cut short or damaged at byte {position} of {file_bytes}"
        if isinstance(error, BagTooLarge):
            why = f"is read up to byte {position} of {file_bytes} only ({error})"
        self.salvaged.end(why, file_bytes - position)
        chunk = McapRecord(damaged.kind, position + mcapformat.RECORD.size, file_bytes)
        self._file.seek(position)
        if damaged.kind == mcapformat.CUT and self._file.read(1) == bytes([Opcode.CHUNK]):
            with suppress(BagError):
                head, place = mcapformat.read_chunk_head(self._file, chunk, self.path, cut=True)
                self._count_size(head, place, position)
                where = f"in the chunk at byte {position} of {file_bytes}"
                count = partial(self._allowance.count_records, f"{self.path} {where}")
                records = mcapformat.unpack_part(head, self._bytes(place), count)
                entry = _Chunk(place, head, salvaged=records, records_counted=True)
                self._chunks.append(entry)
                # A compressed chunk counts with all its bytes, see SalvageReport.
                read = place.start + len(records) if head.compression == "none" else position
                self.salvaged.end(f"is cut short or damaged {where}", file_bytes - read)

    def _check_chunks(self) -> None:
        """Read all chunks; count the messages of those with an index, note those that are damaged.

        Messages after a damaged chunk keep their positions if the chunk has a message index, so
        that they are the same rows as those of an import without salvage.
        """
        file_bytes = os.fstat(self._file.fileno()).st_size
        for place, chunk in enumerate(self._chunks):
            try:
                messages = self._find(place, self._content(place)).in_time()
            except BagError as exc:
                begin, end = chunk.record.start, chunk.record.stop
                why = f"is damaged in the chunk at byte {begin} of {file_bytes}"
                why += f" ({exc})" if isinstance(exc, BagTooLarge) else ""
                self.salvaged.add(why, end - begin)
                self.salvaged.behind |= place + 1 < len(self._chunks)
                chunk.damaged, chunk.salvaged = True, b""
                self._stated = None
                continue
            if chunk.counts:  # without an index _count_the_rest counts them
                chunk.counts = Counter(messages.channels.tolist())

    def _note(self, record: McapRecord) -> None:
        """Take a record outside of chunks into the index.

        Raises:
            BagUnindexed: The file is cut short.
            BagError: The record is damaged.
        """
        kind = record.kind
        if kind == mcapformat.CUT:
            raise BagUnindexed(
                f"{self.path} is cut short at byte {record.stop}, or still being written; with "
                "--salvage (salvage=True) what it holds is read; or keep that with: "
                f"mcap recover {self.path} -o RECOVERED.mcap"
            )
        if kind == Opcode.CHUNK:
            head, place = mcapformat.read_chunk_head(self._file, record, self.path)
            self._count_size(head, place, record.start)
            self._chunks.append(_Chunk(place, head))
        elif kind == Opcode.MESSAGE_INDEX and self._chunks:
            channel, count = mcapformat.count_of_index(self._file, record, self.path)
            chunk, start = self._chunks[-1], record.start - mcapformat.RECORD.size
            if count:
                chunk.counts[channel] += count
            # All indexes that follow one another are read together later.
            if chunk.index is not None and chunk.index.stop == start:
                start = chunk.index.start
            chunk.index = record._replace(start=start)
        elif kind == Opcode.MESSAGE:
            self._note_loose(record)
        elif kind == Opcode.STATISTICS:
            raw = self._description(record)
            self._stated = mcapformat.parse(Statistics, raw, self.path).message_count
        elif kind == Opcode.FOOTER:
            mcapformat.check_summary(self._file, record, self.path)
        elif kind in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.HEADER):
            self._note_description(kind, self._description(record), self.path)
        elif kind == Opcode.METADATA and self._note_event(record):
            pass
        elif kind in _EXTRAS:
            self.extras[_EXTRAS[kind]] = self.extras.get(_EXTRAS[kind], 0) + 1
        elif kind not in _KINDS:
            self._unknown_bytes += record.stop - record.start

    def _note_event(self, record: McapRecord) -> bool:
        """Take a record of metadata if it is an event; return whether it is."""
        size, full = record.stop - record.start, len(self.events) >= mcap_events.MAX_EVENTS
        if size > mcap_events.MAX_EVENT_BYTES or full:
            return False
        try:
            metadata = mcapformat.parse(Metadata, self._bytes(record), self.path)
        except BagError:
            return False  # it is counted with the records that are not stored
        if metadata.name != mcap_events.NAME:
            return False
        self.events.append(metadata.metadata)
        return True

    def _count_size(self, head: ChunkHead, place: McapRecord, position: int) -> None:
        """Count the unpacked size of a chunk, before it is unpacked.

        Args:
            place: Position of its compressed records.
            position: Offset of the chunk, for the error text.

        Raises:
            BagTooLarge: The Allowance does not permit it.
        """
        where, packed = f"{self.path}: the chunk at byte {position}", place.stop - place.start
        self._allowance.count_chunk(head.compression, head.size, packed, where)

    def _description(self, record: McapRecord) -> bytes:
        """Read a record that describes the file; raises BagError if it is too large."""
        if record.stop - record.start > mcapformat.MAX_DESCRIPTION_BYTES:
            raise BagError(
                f"{self.path} is damaged: the record of kind {record.kind} at byte {record.start} "
                f"has {record.stop - record.start} bytes; over {mcapformat.MAX_DESCRIPTION_BYTES} "
                "bytes are not believed"
            )
        return self._bytes(record)

    def _note_loose(self, record: McapRecord) -> None:
        """Add a message outside of chunks to the messages directly before it."""
        start, size = record.start - mcapformat.RECORD.size, record.stop - record.start
        self._allowance.count_chunk("none", size, size, f"{self.path}: the message at byte {start}")
        last = self._chunks[-1].record if self._chunks else None
        if (
            last is not None
            and self._chunks[-1].loose
            and last.stop == start
            and last.stop - last.start + size < _LOOSE_BYTES
        ):
            self._chunks[-1].record = last._replace(stop=record.stop)
        else:
            head = ChunkHead(0, 0, size, 0, "none")
            self._chunks.append(_Chunk(record._replace(start=start), head))

    def _note_description(self, kind: int, raw: bytes, where: str) -> None:
        """Take a header, a schema or a channel, outside of chunks or inside; raises BagError.

        A schema or a channel may be repeated, but not with other fields.
        """
        if kind == Opcode.HEADER:
            self._profile = mcapformat.parse(Header, raw, where).profile
        elif kind == Opcode.SCHEMA:
            schema = mcapformat.parse(Schema, raw, where)
            if self._schemas.setdefault(schema.id, schema) != schema:
                raise BagError(f"{where} is damaged: it has two different schemas {schema.id}")
        elif kind == Opcode.CHANNEL:
            channel = mcapformat.parse(Channel, raw, where)
            if self._channels.setdefault(channel.id, channel) != channel:
                raise BagError(f"{where} is damaged: it has two different channels {channel.id}")

    def _count_the_rest(self) -> None:
        """Unpack the chunks that have no final counts, or whose channels are only inside them."""
        for place, chunk in enumerate(self._chunks):
            if chunk.damaged or chunk.counted and all(map(self._is_known, chunk.counts)):
                continue
            content, where = self._content(place), self._where(place)
            messages = self._find(place, content)
            for record in mcapformat.records_of(content, where):
                if record.kind in (Opcode.SCHEMA, Opcode.CHANNEL):
                    raw = content[record.start : record.stop]
                    self._note_description(record.kind, raw, where)
            if not chunk.counted:
                self._late.update(messages.channels[messages.times == mcapformat.TOO_LATE].tolist())
                messages = messages.in_time()
                chunk.counts = Counter(messages.channels.tolist())
                if len(messages.times):
                    ends = int(messages.times.min()), int(messages.times.max())
                    chunk.head = chunk.head._replace(start_ns=ends[0], end_ns=ends[1])
            missing = [c for c in (*chunk.counts, *self._late) if c not in self._channels]
            if missing:
                raise BagError(
                    f"{where} is damaged: it has messages of channel {missing[0]}, which is missing"
                )

    def _is_known(self, channel_id: int) -> bool:
        """Return whether a channel and its schema were read; schema 0 = it has none."""
        channel = self._channels.get(channel_id)
        return channel is not None and channel.schema_id in (0, *self._schemas)

    def _number_connections(self) -> None:
        """Make a connection of each channel that has ROS 1 messages; note what is left out.

        Raises:
            BagError: The number of messages is not the one that the file states; or no message is
                one of ROS 1.
        """
        for chunk in self._chunks:
            if chunk.damaged:  # it may have been the only one that describes some channels
                chunk.counts = Counter({c: n for c, n in chunk.counts.items() if self._is_known(c)})
        self._chunks = [chunk for chunk in self._chunks if chunk.counts]
        self.salvaged.damaged = {n for n, chunk in enumerate(self._chunks) if chunk.damaged}
        totals: Counter[int] = Counter()
        for chunk in self._chunks:
            totals.update(chunk.counts)
        message_count = sum(totals.values()) + sum(self._late.values())
        if self._stated not in (None, message_count):
            why = (
                f"is damaged: of the {self._stated} messages that it should hold {message_count} "
                "are found"
            )
            if not self._salvages:
                raise BagError(f"{self.path} {why}")
            self.salvaged.end(why, self._unknown_bytes)
        connections: list[tuple[Connection, int]] = []
        """Connections and their channel ids."""
        foreign: dict[str, str] = {}
        """Topics whose messages are not those of ROS 1 -> the reason."""
        for channel_id, count in sorted(totals.items()):
            channel = self._channels[channel_id]
            schema = self._schemas.get(channel.schema_id)
            why = why_foreign(channel, schema)
            if why:
                foreign[channel.topic] = why
            else:
                try:
                    connections.append((to_connection(channel, schema), channel_id))
                except BagError as exc:
                    why = str(exc)
            if why:
                self.leave_out(channel.topic, why, count)
        for channel_id, count in sorted(self._late.items()):
            self.leave_out(self._channels[channel_id].topic, _LATE, count)
        if foreign and not connections:
            self._refuse(totals, foreign)
        self._set_attributes(connections, totals)

    def _set_attributes(
        self, connections: list[tuple[Connection, int]], totals: Counter[int]
    ) -> None:
        """Set the attributes of MessageFile.

        Args:
            connections: The connections and their channel ids.
            totals: Number of messages by channel id, also of those that are left out or damaged.
        """
        if len({connection.number for connection, _ in connections}) < len(connections):
            # Each of several exports that were merged has its own numbers; channel ids are unique.
            connections = [
                (replace(connection, number=channel_id), channel_id)
                for connection, channel_id in connections
            ]
        connections.sort(key=lambda pair: pair[0].number)
        self._numbers = {channel_id: connection.number for connection, channel_id in connections}
        self.connections = {connection.number: connection for connection, _ in connections}
        lost: Counter[int] = Counter()
        for chunk in self._chunks:
            if chunk.damaged:
                lost.update(chunk.counts)
        self.counts = Counter({n: totals[c] - lost[c] for c, n in self._numbers.items()})
        self.salvaged.missing = sum(lost[c] for c in self._numbers)
        self.chunk_count, self.message_count = len(self._chunks), sum(self.counts.values())
        # Damaged messages count, too: those after them keep their positions.
        chunk_counts = [
            sum(count for channel_id, count in chunk.counts.items() if channel_id in self._numbers)
            for chunk in self._chunks
        ]
        self._first = [0, *np.cumsum(chunk_counts).tolist()]
        self.start_ns = min((chunk.head.start_ns for chunk in self._chunks), default=0)
        self.end_ns = max((chunk.head.end_ns for chunk in self._chunks), default=0)

    def _refuse(self, totals: Counter[int], foreign: Mapping[str, str]) -> None:
        """Raise the BagError for a file without messages of ROS 1.

        Args:
            totals: Number of messages by channel id.
            foreign: Topic -> why its messages are not those of ROS 1.
        """
        encodings = {self._channels[channel_id].message_encoding for channel_id in totals}
        if self._profile == Profile.ROS2 or MessageEncoding.CDR in encodings:
            raise refusal(self.path)
        topic, why = next(iter(foreign.items()))
        raise BagError(
            f"{self.path} holds no messages of ROS 1: of topic {topic} {why}; only MCAP files of "
            "ROS 1 can be stored, as 'mcap convert IN.bag OUT.mcap' makes them of bags"
        )


def refusal(path: str) -> BagError:
    """Return the error for a file or folder of rosbag2; it says how to convert it to ROS 1."""
    folder = path if os.path.isdir(path) else os.path.dirname(path) or "."
    whole = folder if os.path.exists(os.path.join(folder, ROSBAG2_METADATA)) else path
    return BagError(
        f"{path} is a bag of ROS 2 (rosbag2); its messages are not those of ROS 1, which are kept "
        "here: convert it with 'pip install rosbags' and 'rosbags-convert --src "
        f"{whole} --dst OUT.bag', and import OUT.bag"
    )
