# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""cr_connection, cr_definition and cr_run: written before the rows that refer to them.

Also cr_loss (messages that could not be stored) and cr_context (parameters and node graph of runs).
"""

from __future__ import annotations

import hashlib
import math
import platform
from dataclasses import dataclass, field, fields, replace
from datetime import datetime
from enum import Enum
from typing import Container, Iterable, Iterator, Mapping, NamedTuple, Sequence

from cassandra_ros.printable import shown
from cassandra_ros.store.connection.cassandra import CqlRow
from cassandra_ros.store.tables.context_blob import RunContext, decode_context, encode_context
from cassandra_ros.store.tables.side_tables import SideTables

OWN_LABELS = ("content",)
"""Names of the labels by which an import finds its run again."""


class StoredHeader(NamedTuple):
    """A connection header as stored: without the definition, which is stored once."""

    topic: str
    number: int
    """Number of the connection in its bag, 0 to 2**32 - 1; -1 = not from a bag."""
    header: bytes
    def_offset: int
    """Offset at which the definition was cut out, bytes; -1 = the header has none."""
    md5sum: str
    definition: bytes


@dataclass(frozen=True, repr=False)
class Run:
    """One recording or import."""

    node: str
    writer: int
    kind: str
    """'import', 'recording' or 'api'."""
    name: str = ""
    source: str = ""
    format: str = ""
    host: str = field(default_factory=platform.node)
    started: datetime | None = None
    ended: datetime | None = None
    labels: Mapping[str, str] = field(default_factory=dict)
    stored: Mapping[str, int] = field(default_factory=dict)
    lost: Mapping[str, int] = field(default_factory=dict)
    """Numbers of stored and of lost messages by topic, written when the run ends."""

    state: str = "ended"
    """'recording' (imports too), 'ended', or 'interrupted': the run was killed or failed."""
    first_ns: int | None = None
    last_ns: int | None = None
    """Key times of its first and last message, ns; None = it has none with a time, or they were not
    asked for."""

    @property
    def public_labels(self) -> dict[str, str]:
        """Labels that users gave, without those by which an import finds its run again."""
        return {name: text for name, text in self.labels.items() if name not in OWN_LABELS}

    def __repr__(self) -> str:
        start, end = (f"{t:%Y-%m-%dT%H:%M:%SZ}" if t else "?" for t in (self.started, self.ended))
        parts = [self.kind, f"of {shown(self.node)}" if self.node else "", self.state]
        parts += [f"{start} to {end}", f"messages: {sum(self.stored.values())}"]
        parts += [f"lost: {sum(self.lost.values())}"] if any(self.lost.values()) else []
        parts += [shown(f"{name}={text}") for name, text in self.labels.items()]
        return f"<Run {self.name!r} {self.writer}: {', '.join(filter(None, parts))}>"


_RUN = tuple(f.name for f in fields(Run) if f.name not in ("state", "first_ns", "last_ns"))
"""Columns of cr_run: the fields that are stored, in their order."""


class SignOfLife(NamedTuple):
    """Last sign of life of a run that has not ended."""

    age_sec: float
    """Time since it began or since its last heartbeat, by the server's clock, s."""
    interrupted: bool
    """Whether the run ended with an error."""


class LossKind(str, Enum):
    """Reason for which messages are missing."""

    BUFFER_FULL = "buffer full"
    TABLE_LATE = "buffer full before its table stood"
    NO_TABLE = "no table"
    NO_CLOCK = "no clock"
    REFUSED = "refused by the store"
    NOT_READ = "not read from the socket"
    UNHEARD = "publisher not heard"
    AT_END = "not stored at the end"
    SPOOL_FULL = "spool full"
    SPOOL_DAMAGED = "spool damaged"
    KILLED = "recorder killed"
    NO_ROOM = "deleted for room before it was copied"
    MISTAKE = "internal error"


@dataclass(frozen=True)
class Loss:
    """Messages of a topic that a run should have stored and has not."""

    topic: str
    node: str
    writer: int
    kind: LossKind
    first_ns: int
    """Time of the first lost message, or of the beginning of the time range with losses, ns."""
    last_ns: int
    """Time of the last lost message, or of the end of the time range, ns."""
    count: int
    """Number of lost messages; 0 = the number is unknown."""


_HEADER = ("tbl", "conn", "def_hash", "topic", "number", "header", "def_offset", "md5sum")
_OF_RUN = {"cr_context": ("heartbeat", "interrupted", "context"), "cr_sent": ("stripe", "sent")}
"""Tables with further rows of a run, and their columns beside writer and node."""
_LOSS = "topic, node, writer, kind, first, last, n"


class Registry:
    """Reads and writes connections, definitions, runs, losses and contexts of one keyspace."""

    def __init__(self, side_tables: SideTables) -> None:
        self._tables = side_tables

    def put_headers(self, rows: Sequence[tuple[str, int, StoredHeader]]) -> None:
        """Write connection headers and their definitions; a repetition writes the same rows.

        Args:
            rows: Table, number of the connection in it, header; at least one.
        """
        definitions: dict[tuple[str, bytes], bytes] = {}
        headers: list[CqlRow] = []
        for table, conn, row in rows:
            def_hash = hashlib.sha256(row.definition).digest()
            definitions[row.md5sum, def_hash] = row.definition
            number = _to_int(row.number)
            headers.append(
                (table, conn, def_hash, row.topic, number, row.header, row.def_offset, row.md5sum)
            )
        topics = {row.topic for _, _, row in rows}
        of = f"of {len(topics)} topics" if len(topics) > 1 else f"of topic {rows[0][2].topic}"
        names = ("md5sum", "hash", "text")
        texts = [(*key, text) for key, text in definitions.items()]
        self._tables.insert_many("cr_definition", names, texts, f"storing the definition {of}")
        what = f"storing the connection header {of}"
        self._tables.insert_many("cr_connection", _HEADER, headers, what)

    def get_header(self, table: str, conn: int) -> StoredHeader | None:
        """Return a connection header; None if no header has this number."""
        names, where = "topic, number, header, def_offset, md5sum, def_hash", "tbl = ? AND conn = ?"
        what = "reading a connection header"
        rows = self._tables.select("cr_connection", names, where, (table, conn), what=what)
        if not rows:
            return None
        topic, number, header, offset, *key = rows[0]
        text = self._definition(key)
        if text is None:
            return None
        return StoredHeader(topic, _from_int(number), header, offset, key[0], text)

    def headers(self, tables: Container[str]) -> Iterator[tuple[str, int, StoredHeader]]:
        """Yield the connection headers of some tables (a full scan: connections are few).

        Yields (table, number of the connection in it, header). Each definition is read once,
        however many connections have it.
        """
        names = "tbl, conn, topic, number, header, def_offset, md5sum, def_hash"
        rows = self._tables.select("cr_connection", names, what="listing the connections")
        texts: dict[tuple[str, bytes], bytes] = {}
        for table, conn, topic, number, header, offset, md5sum, def_hash in rows:
            if table not in tables:
                continue
            key = (md5sum, def_hash)
            if key not in texts:
                text = self._definition(key)
                if text is None:
                    continue  # changed by hand; get_header returns None for it
                texts[key] = text
            yield (
                table,
                conn,
                StoredHeader(topic, _from_int(number), header, offset, md5sum, texts[key]),
            )

    def _definition(self, key: Sequence[object]) -> bytes | None:
        what, where = "reading a message definition", "md5sum = ? AND hash = ?"
        texts = self._tables.select("cr_definition", "text", where, key, what=what)
        return bytes(texts[0][0]) if texts else None

    def damaged_definitions(self) -> list[str]:
        """Return the md5sums of definitions whose text is no longer the one that was stored."""
        rows = self._tables.select(
            "cr_definition", "md5sum, hash, text", what="reading the message definitions"
        )
        return sorted(
            md5sum
            for md5sum, digest, text in rows
            if hashlib.sha256(bytes(text or b"")).digest() != bytes(digest)
        )

    def tables(self) -> set[str]:
        """Return the names of the tables that have connection headers (a full scan)."""
        rows = self._tables.select("cr_connection", "tbl", what="listing the connections")
        return {table for (table,) in rows}

    def delete_entries(self, table: str) -> None:
        """Delete the connection headers of a dropped table (a full scan: connections are few)."""
        rows = self._tables.select("cr_connection", "tbl, conn", what="listing the connections")
        keys = [row for row in rows if row[0] == table]
        self._tables.delete("cr_connection", ("tbl", "conn"), keys, "removing connection headers")

    def put_run(self, run: Run, *, started: bool = False, ended: bool = False) -> None:
        """Write a run; the server adds the time at which it started or ended.

        A time that the run itself has, because the store was away then, is written as it is. What
        is None in the run stays as it is stored.
        """
        columns = {name: getattr(run, name) for name in _RUN}
        columns = {name: value for name, value in columns.items() if value is not None}
        now = ["started"] * (started and run.started is None)
        now += ["ended"] * (ended and run.ended is None)
        self._tables.insert("cr_run", columns, "storing the run", now=now)

    def runs(self) -> list[Run]:
        """Return all runs of the keyspace (a full scan: runs are few)."""
        rows = self._tables.select("cr_run", ", ".join(_RUN), what="listing the runs")
        return [_run(row) for row in rows]

    def signs(self) -> dict[tuple[int, str], SignOfLife]:
        """Return the last sign of life of each run, by writer and node (two full scans)."""
        now, what = "toTimestamp(now())", "reading the state of the runs"
        starts = self._tables.select("cr_run", f"writer, node, started, {now}", what=what)
        names = f"writer, node, heartbeat, interrupted, {now}"
        contexts = self._tables.select("cr_context", names, what=what)
        beats = {(writer, node): (beat, broken) for writer, node, beat, broken, _ in contexts}
        signs: dict[tuple[int, str], SignOfLife] = {}
        for writer, node, started, server_time in starts:
            beat, broken = beats.get((writer, node), (None, None))
            last = max(filter(None, (started, beat)), default=None)
            age_sec = math.inf if last is None else (server_time - last).total_seconds()
            # An import that is repeated has started again after its interruption.
            is_interrupted = broken is not None and (started is None or broken >= started)
            signs[writer, node] = SignOfLife(age_sec, is_interrupted)
        return signs

    def put_heartbeat(self, writer: int, node: str, *, interrupted: bool = False) -> None:
        """Note that a run is alive, or that it ends with an error."""
        self._tables.make("cr_context")
        now = ["heartbeat"] + ["interrupted"] * interrupted
        columns = {"writer": writer, "node": node}
        self._tables.insert("cr_context", columns, "noting that the run goes on", now=now)

    def move_run(self, run: Run, node: str) -> None:
        """Give the context, send times and losses of a run to its entry of another robot.

        The caller has written that entry. At last the entry of its own robot is deleted, so this
        can be repeated after an error.
        """
        key, what = (run.writer, run.node), "giving a run another robot"
        for table, names in _OF_RUN.items():
            columns = ", ".join(names)
            where = "writer = ? AND node = ?"
            for row in self._tables.select(table, columns, where, key, what=what):
                values = {n: value for n, value in zip(names, row) if value is not None}
                self._tables.insert(table, {"writer": run.writer, "node": node, **values}, what)
        losses = [x for x in self.losses() if (x.writer, x.node) == key]
        for loss in losses:
            self.put_loss(replace(loss, node=node))
        self.forget_run(*key, {loss.topic for loss in losses})

    def forget_run(self, writer: int, node: str, topics: Iterable[str]) -> None:
        """Delete a run whose messages were deleted, its context, and its losses of some topics.

        Its row of cr_run goes last, so that the run is still found after an error.
        """
        what, keys = "removing a run", [(writer, node)]
        if self._tables.has("cr_loss"):
            losses = [(topic, node, writer) for topic in topics]
            self._tables.delete("cr_loss", ("topic", "node", "writer"), losses, what)
        for table in ("cr_context", "cr_sent", "cr_run"):
            if self._tables.has(table):
                self._tables.delete(table, ("writer", "node"), keys, what)

    def put_loss(self, loss: Loss) -> None:
        """Write a loss; it replaces one with the same topic, node, writer, kind and first_ns."""
        self._tables.make("cr_loss")
        columns = {"topic": loss.topic, "node": loss.node, "writer": loss.writer}
        columns.update(kind=loss.kind.value, first=loss.first_ns, last=loss.last_ns, n=loss.count)
        self._tables.insert("cr_loss", columns, f"storing a loss of topic {loss.topic}")

    def losses(self, topics: Sequence[str] | None = None) -> list[Loss]:
        """Return the losses of some topics by time; None = of all (a full scan: losses are few)."""
        what, select = "listing the losses", self._tables.select
        if topics is None:
            rows = select("cr_loss", _LOSS, what=what)
        else:
            answers = (select("cr_loss", _LOSS, "topic = ?", (t,), what=what) for t in set(topics))
            rows = [row for answer in answers for row in answer]
        return sorted(map(_loss, rows), key=lambda loss: (loss.first_ns, loss.topic, loss.writer))

    def forget_losses(self, topic: str) -> None:
        """Delete the losses of a topic whose messages were deleted."""
        if self._tables.has("cr_loss"):
            self._tables.delete("cr_loss", ("topic",), [(topic,)], "removing losses")

    def rename_losses(self, topic: str, new_name: str) -> None:
        """Move the losses of a topic to its new name."""
        losses = self.losses([topic])
        for loss in losses:
            self.put_loss(replace(loss, topic=new_name))
        if losses:
            self.forget_losses(topic)

    def rename_counts(self, topic: str, new_name: str) -> None:
        """Move a topic's numbers of messages to its new name, in the runs that have ended.

        A run that goes on writes its numbers, under the names of its topics, when it ends.
        """
        for run in self.runs():
            counts = [
                {new_name if name == topic else name: n for name, n in numbers.items()}
                for numbers in (run.stored, run.lost)
            ]
            if run.ended is not None and counts != [run.stored, run.lost]:
                self.put_run(replace(run, stored=counts[0], lost=counts[1]))

    def put_context(self, writer: int, node: str, context: RunContext) -> None:
        """Write parameters and node graph of a run.

        Raises:
            InvalidOption: They cannot be encoded.
        """
        blob = encode_context(context)
        self._tables.make("cr_context")
        columns = {"writer": writer, "node": node, "context": blob}
        what = "storing the parameters of the run"
        self._tables.insert("cr_context", columns, what, now=["heartbeat"])

    def get_context(self, writer: int, node: str) -> RunContext | None:
        """Return parameters and node graph of a run; None if they were not stored.

        Raises:
            CorruptMessage: The stored bytes are damaged.
        """
        where, what = "writer = ? AND node = ?", "reading the parameters of a run"
        rows = self._tables.select("cr_context", "context", where, (writer, node), what=what)
        return None if not rows or rows[0][0] is None else decode_context(rows[0][0])


# The column is a signed 32-bit int, and connection numbers of bags go to 2**32 - 1. Numbers from
# 2**31 on are stored as the negative int of the same 32 bits. The last would be -1, which means
# "not from a bag", so it is stored as null.


def _to_int(number: int) -> int | None:
    """Return the column of a connection number; see above."""
    if number < 2**31:
        return number
    return number - 2**32 if number < 2**32 - 1 else None


def _from_int(column: int | None) -> int:
    """Return the connection number of a column."""
    if column is None:
        return 2**32 - 1
    return column if column >= -1 else column + 2**32


def _loss(row: CqlRow) -> Loss:
    topic, node, writer, kind, first, last, count = row
    try:
        loss_kind = LossKind(kind)
    except ValueError:  # a kind that only newer releases know
        loss_kind = LossKind.MISTAKE
    return Loss(topic, node, writer, loss_kind, first, last or first, count or 0)


def _run(row: CqlRow) -> Run:
    node, writer, kind, name, source, format_name, host, started, ended, *maps = row
    labels, stored, lost = (dict(m or {}) for m in maps)
    texts = (kind or "", name or "", source or "", format_name or "", host or "")
    return Run(node, writer, *texts, started, ended, labels, stored, lost)
