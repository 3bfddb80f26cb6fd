# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a file of the spool says of its run: where the messages belong, and how the run ended."""

from __future__ import annotations

import json
import zlib
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Dict, Mapping, Sequence, TypeVar

from cassandra_ros.errors import SpoolError

VERSION = 1
"""Version of the files that this release writes, and the only one that it reads."""
LABEL, END, TOTALS = "cassandra_ros.files.spool", "cassandra_ros.end", "cassandra_ros.totals"
"""Names of the metadata records with a SpoolLabel, a RunEnd and RunTotals. They are in the files;
by their beginning ``mcap_records.is_plausible`` knows our records."""
_T = TypeVar("_T", "SpoolLabel", "RunEnd", "RunTotals")


@dataclass(frozen=True)
class SpoolLabel:
    """The run of the messages in a file, as far as a drain must know it."""

    writer: int
    """Writer id of the messages in this file."""
    run: int
    """Writer id of the run. The messages have another one only after the first 2**32 of the run."""
    keyspace: str
    address: str
    """Hosts and port of the store, 'HOST[,HOST]:PORT'; '' = not known."""
    begun_ns: int
    """Time at which the run began, wall clock, ns."""
    node: str = ""
    """nodeID of the recorded robot."""
    name: str = ""
    """Name of the run."""
    labels: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Settings of the topics, see recording/topic_settings.py."""
    journal: bool = False
    """Whether all messages of the run go through the spool."""
    version: int = VERSION


@dataclass(frozen=True)
class RunEnd:
    """The end of a run whose messages are not all stored."""

    ended_ns: int
    """Time of the end, wall clock, ns."""
    stored: Mapping[str, int]
    """Number of messages by topic that are stored when the spool is drained."""
    lost: Mapping[str, int]
    """Number of lost messages by topic."""
    losses: Sequence[tuple[str, str, int, int, int]] = ()
    """Losses that are not stored yet: topic, kind, first and last time, ns, number of messages."""
    version: int = VERSION


@dataclass
class TopicTotal:
    """The messages of a topic in one or more files."""

    count: int = 0
    first_ns: int = 2**63
    """Time of reception of the first of them, ns; 2**63 = no message yet."""
    last_ns: int = 0
    """Time of reception of the last of them, ns; 0 = no message yet."""

    def add(self, count: int, first_ns: int, last_ns: int) -> None:
        """Count further messages."""
        self.count += count
        self.first_ns = min(self.first_ns, first_ns)
        self.last_ns = max(self.last_ns, last_ns)


Totals = Dict[str, TopicTotal]
"""Topic → its messages in the files of a run, from the first file to some place in one of them."""


def copy_totals(totals: Totals) -> Totals:
    """Return a copy of totals, with objects of its own: the original may be counted on."""
    return {topic: replace(total) for topic, total in totals.items()}


@dataclass(frozen=True)
class RunTotals:
    """The messages that were written to the files of a run up to the place of this record.

    By them a reader sees how many messages the damaged and missing parts before it had.
    """

    topics: Mapping[str, Sequence[int]]
    """Topic → the fields of TopicTotal in their order."""
    version: int = VERSION

    @classmethod
    def of(cls, totals: Mapping[str, TopicTotal]) -> RunTotals:
        """Return totals as a record."""
        return cls({t: (n.count, n.first_ns, n.last_ns) for t, n in totals.items()})

    def totals(self) -> Totals:
        """Return the totals as new objects, which the caller may change."""
        return {topic: TopicTotal(*numbers) for topic, numbers in self.topics.items()}


def as_metadata(record: SpoolLabel | RunEnd | RunTotals) -> Mapping[str, str]:
    """Return a label, an end or totals as the fields of a metadata record."""
    text = json.dumps(asdict(record), sort_keys=True)
    return {"text": text, "crc": f"{zlib.crc32(text.encode()):08x}"}


def is_whole(metadata: Mapping[str, str]) -> bool:
    """Return whether the checksum of a label, an end or totals is right."""
    return metadata.get("crc") == f"{zlib.crc32(metadata.get('text', '').encode()):08x}"


def from_metadata(kind: type[_T], metadata: Mapping[str, str], where: str) -> _T:
    """Return the label, the end or the totals in a metadata record.

    Args:
        kind: SpoolLabel, RunEnd or RunTotals, by the name of the record.
        metadata: Fields of the record. The caller has checked them with is_whole.
        where: Name of the file in the error text.

    Raises:
        SpoolError: It is of another version.
    """
    values = json.loads(metadata["text"])
    version = values.get("version")
    if version != VERSION:
        raise SpoolError(
            f"{where} has version {version}, and this release of cassandra_ros reads only version "
            f"{VERSION}: store its messages with the release that wrote it"
        )
    return kind(**{member.name: values[member.name] for member in fields(kind)})
