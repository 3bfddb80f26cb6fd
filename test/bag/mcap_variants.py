# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Small MCAP files in every variant that MCAP's conformance suite has, but with messages of ROS 1.

Six cases of data, each with every sensible combination of ten features of the format.
"""

from __future__ import annotations

import zlib
from itertools import combinations
from typing import NamedTuple

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from cassandra_ros.files.bag.mcap_format import MAGIC, RECORD

CHUNKS, MESSAGE_INDEX, STATISTICS, SCHEMAS, CHANNELS = "ch", "mx", "st", "rsh", "rch"
ATTACHMENT_INDEX, METADATA_INDEX, CHUNK_INDEX, OFFSETS, PADDING = "ax", "mdx", "chx", "sum", "pad"
FEATURES = (
    CHUNKS,
    MESSAGE_INDEX,
    STATISTICS,
    SCHEMAS,
    CHANNELS,
    ATTACHMENT_INDEX,
    METADATA_INDEX,
    CHUNK_INDEX,
    OFFSETS,
    PADDING,
)
"""Features: records in a chunk, what follows a chunk, parts of the summary, and bytes of later
versions of the format after the last field of each record."""
_NEEDS = {
    ATTACHMENT_INDEX: Attachment,
    METADATA_INDEX: Metadata,
    SCHEMAS: Schema,
    CHANNELS: Channel,
    CHUNKS: (Schema, Channel, Message),
}
"""Kinds of records of which the data must have one, by feature."""
_SUMMARY = {CHUNK_INDEX, SCHEMAS, CHANNELS, METADATA_INDEX, ATTACHMENT_INDEX, STATISTICS}


def _wire(text: str) -> bytes:
    return len(text).to_bytes(4, "little") + text.encode()


_TYPED = [
    Schema(1, b"string data\n", "ros1msg", "std_msgs/String"),
    Channel(1, "/example", "ros1", {"callerid": "/robot"}, 1),
]
CASES = {
    "NoData": [],
    "OneMessage": [*_TYPED, Message(1, 2, _wire("one"), 1, 10)],
    "TenMessages": [
        *_TYPED,
        *(
            Message(1, t_ns, _wire(f"{n} of ten"), t_ns, n)
            for n, t_ns in enumerate([0, 2, 1, 3, 3, 5, 4, 7, 8, 9])
        ),
    ],
    "OneSchemalessMessage": [
        Channel(1, "/example", "ros1", {}, 0),
        Message(1, 2, _wire("one"), 1, 10),
    ],
    "OneAttachment": [Attachment(1, 2, "photo", "image/png", b"\1\2\3")],
    "OneMetadata": [Metadata("about", {"driver": "Ada"})],
}


class Variant(NamedTuple):
    """A file of the suite."""

    case: str
    features: frozenset[str]

    @property
    def name(self) -> str:
        """Case and features, as the suite joins them."""
        return "-".join((self.case, *sorted(self.features)))


def variants():
    """List all that make sense: 416."""
    every = (chosen for n in range(len(FEATURES) + 1) for chosen in combinations(FEATURES, n))
    sets = list(map(frozenset, every))
    return [Variant(case, chosen) for case in CASES for chosen in sets if _fits(case, chosen)]


def _fits(case: str, features: frozenset[str]) -> bool:
    kinds = tuple(map(type, CASES[case]))
    if any(
        f in _NEEDS and not any(issubclass(kind, _NEEDS[f]) for kind in kinds) for f in features
    ):
        return False
    if {CHUNK_INDEX, MESSAGE_INDEX} & features and CHUNKS not in features:
        return False
    return OFFSETS not in features or bool(_SUMMARY & features)


def make(variant: Variant, inside: bool = False) -> bytes:
    """Build the file of a variant.

    Args:
        inside: Pad also the records inside of chunks, which the suite does not.
    """
    return _Maker(variant, inside).file()


class _Maker:
    """One file that grows."""

    def __init__(self, variant: Variant, inside: bool) -> None:
        self.inside = inside
        self.features = variant.features
        self.records = CASES[variant.case]
        self.out = bytearray(MAGIC)
        self.indexes: dict[str, list[object]] = {}

    def file(self) -> bytes:
        self._add(Header("", ""))
        self._data()
        self._add(DataEnd(zlib.crc32(self.out)))
        start, groups = len(self.out), self._summary()
        has_summary, offsets = len(self.out) > start, 0
        if OFFSETS in self.features:
            offsets = len(self.out)
            for group in groups:
                self._add(group)
        footer = self._packed(Footer(start if has_summary else 0, offsets, 0), padded=False)[:-4]
        crc = zlib.crc32(footer, zlib.crc32(self.out[start:]))
        return bytes(self.out + footer + crc.to_bytes(4, "little") + MAGIC)

    def _packed(self, record, padded=True) -> bytes:
        builder = RecordBuilder()
        record.write(builder)
        data = builder.end()
        # A message ends with its bytes, the footer lies at a fixed distance from the end.
        if PADDING not in self.features or not padded or isinstance(record, Message):
            return data
        kind, length = RECORD.unpack_from(data)
        return RECORD.pack(kind, length + 3) + data[RECORD.size :] + b"\x01\xff\xff"

    def _add(self, record) -> tuple[int, int]:
        """Append a record; return its place and length."""
        start = len(self.out)
        self.out += self._packed(record)
        return start, len(self.out) - start

    def _data(self) -> None:
        content = []
        for record in self.records:
            if isinstance(record, Attachment):
                index = AttachmentIndex(
                    *self._add(record),
                    record.log_time,
                    record.create_time,
                    len(record.data),
                    record.name,
                    record.media_type,
                )
                self.indexes.setdefault(ATTACHMENT_INDEX, []).append(index)
            elif isinstance(record, Metadata):
                index = MetadataIndex(*self._add(record), record.name)
                self.indexes.setdefault(METADATA_INDEX, []).append(index)
            elif CHUNKS in self.features:
                content.append(record)
            else:
                self._add(record)
        if CHUNKS in self.features:
            self._chunk(content)

    def _chunk(self, content) -> None:
        data, entries = bytearray(), []
        for record in content:
            if isinstance(record, Message):
                entries.append((record.log_time, len(data)))
            data += self._packed(record, self.inside)
        begin, end = min(entries)[0], max(entries)[0]
        place, size = self._add(Chunk("", bytes(data), end, begin, zlib.crc32(data), len(data)))
        offsets, indexed = {}, len(self.out)
        if MESSAGE_INDEX in self.features:
            offsets[1], _ = self._add(MessageIndex(1, entries))
        indexed = len(self.out) - indexed
        self.indexes[CHUNK_INDEX] = [
            ChunkIndex(size, place, "", len(data), end, indexed, offsets, begin, len(data))
        ]

    def _summary(self) -> list[SummaryOffset]:
        """Write the summary; return where its groups lie."""
        groups = {
            SCHEMAS: (Opcode.SCHEMA, self._of(Schema)),
            CHANNELS: (Opcode.CHANNEL, self._of(Channel)),
            STATISTICS: (Opcode.STATISTICS, [self._statistics()]),
            METADATA_INDEX: (Opcode.METADATA_INDEX, self.indexes.get(METADATA_INDEX, [])),
            ATTACHMENT_INDEX: (Opcode.ATTACHMENT_INDEX, self.indexes.get(ATTACHMENT_INDEX, [])),
            CHUNK_INDEX: (Opcode.CHUNK_INDEX, self.indexes.get(CHUNK_INDEX, [])),
        }
        found = []
        for feature, (kind, records) in groups.items():
            start = len(self.out)
            for record in records if feature in self.features else ():
                self._add(record)
            if len(self.out) > start:
                found.append(SummaryOffset(kind, start, len(self.out) - start))
        return found

    def _of(self, kind) -> list[object]:
        return [record for record in self.records if isinstance(record, kind)]

    def _statistics(self) -> Statistics:
        times = [message.log_time for message in self._of(Message)]
        return Statistics(
            attachment_count=len(self._of(Attachment)),
            channel_count=len(self._of(Channel)),
            channel_message_counts={1: len(times)} if times else {},
            chunk_count=int(CHUNKS in self.features),
            message_count=len(times),
            message_end_time=max(times, default=0),
            message_start_time=min(times, default=0),
            metadata_count=len(self._of(Metadata)),
            schema_count=len(self._of(Schema)),
        )
