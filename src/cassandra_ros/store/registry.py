# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""cr_connection, cr_definition and cr_run: what the rows refer to, written before them."""

from __future__ import annotations

import hashlib
import platform
from dataclasses import dataclass, field, fields
from datetime import datetime
from typing import Mapping, NamedTuple

from cassandra_ros.store.connection import Cassandra, CqlRow
from cassandra_ros.store.names import quote_name
from cassandra_ros.store.side_tables import SideTables


class StoredHeader(NamedTuple):
    """A connection header as it is kept: the definition cut out, its place noted."""

    topic: str
    number: int
    """-1, or of a bag: 0 to 2**32 - 1."""
    header: bytes
    def_offset: int
    """Where the definition was cut out; -1 = the header has none."""
    md5sum: str
    definition: bytes


@dataclass(frozen=True)
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


_RUN = tuple(each.name for each in fields(Run))


class Registry:
    """Reads and writes connections, definitions and runs of one keyspace."""

    def __init__(self, cassandra: Cassandra, side_tables: SideTables) -> None:
        self._cassandra = cassandra
        self._side_tables = side_tables
        self._space = quote_name(side_tables.keyspace)

    def put_header(self, table: str, conn: int, row: StoredHeader) -> None:
        """Store a connection header and its definition; the same values at each repeat."""
        def_hash = hashlib.sha256(row.definition).digest()
        definition = {"md5sum": row.md5sum, "hash": def_hash, "text": row.definition}
        header = {
            "tbl": table,
            "conn": conn,
            "topic": row.topic,
            "number": _signed(row.number),
            "header": row.header,
            "def_offset": row.def_offset,
            "md5sum": row.md5sum,
            "def_hash": def_hash,
        }
        self._insert("cr_definition", definition, f"storing the definition of topic {row.topic}")
        self._insert("cr_connection", header, f"storing the connection header of topic {row.topic}")

    def _insert(self, table: str, columns: Mapping[str, object], what: str) -> None:
        marks = ", ".join("?" * len(columns))
        cql = f"INSERT INTO {self._space}.{table} ({', '.join(columns)}) VALUES ({marks})"
        self._cassandra.execute(cql, list(columns.values()), what=what)

    def get_header(self, table: str, conn: int) -> StoredHeader | None:
        """Read a connection header back; None when there is none with this number."""
        if not self._side_tables.has("cr_connection", "cr_definition"):
            return None
        rows = self._cassandra.execute(
            f"SELECT topic, number, header, def_offset, md5sum, def_hash "
            f"FROM {self._space}.cr_connection WHERE tbl = ? AND conn = ?",
            (table, conn),
            what="reading a connection header",
        )
        if not rows:
            return None
        topic, number, header, offset, md5sum, def_hash = rows[0]
        texts = self._cassandra.execute(
            f"SELECT text FROM {self._space}.cr_definition WHERE md5sum = ? AND hash = ?",
            (md5sum, def_hash),
            what="reading a message definition",
        )
        if not texts:
            return None
        return StoredHeader(topic, _unsigned(number), header, offset, md5sum, texts[0][0])

    def forget(self, table: str) -> None:
        """Remove the connections of a table that was dropped (a scan: connections are few)."""
        rows = self._cassandra.execute(
            f"SELECT tbl, conn FROM {self._space}.cr_connection", what="listing the connections"
        )
        self._cassandra.execute_many(
            f"DELETE FROM {self._space}.cr_connection WHERE tbl = ? AND conn = ?",
            [(tbl, conn) for tbl, conn in rows if tbl == table],
            what="removing connection headers",
        )

    def put_run(self, run: Run, *, started: bool = False, ended: bool = False) -> None:
        """Store a run; the server notes the time when it starts and ends."""
        columns = {name: getattr(run, name) for name in _RUN if name not in ("started", "ended")}
        self._insert("cr_run", columns, "storing the run")
        for column in ["started"] * started + ["ended"] * ended:
            self._cassandra.execute(
                f"INSERT INTO {self._space}.cr_run (node, writer, {column}) "
                "VALUES (?, ?, toTimestamp(now()))",
                (run.node, run.writer),
                what="storing the run",
            )

    def runs(self) -> list[Run]:
        """List all runs of the keyspace (a scan: runs are few)."""
        if not self._side_tables.has("cr_run"):
            return []
        cql = f"SELECT {', '.join(_RUN)} FROM {self._space}.cr_run"
        return [_run(row) for row in self._cassandra.execute(cql, what="listing the runs")]


# The column is an int of CQL, the numbers of bags go to 2**32 - 1: those from 2**31 on are kept as
# the negative int of the same 32 bits. The last one would be -1, which is live; it is null.


def _signed(number: int) -> int | None:
    if number < 2**31:
        return number
    return number - 2**32 if number < 2**32 - 1 else None


def _unsigned(column: int | None) -> int:
    if column is None:
        return 2**32 - 1
    return column if column >= -1 else column + 2**32


def _run(row: CqlRow) -> Run:
    node, writer, kind, name, source, format_name, host, started, ended, *maps = row
    labels, stored, lost = (dict(m or {}) for m in maps)
    texts = (kind or "", name or "", source or "", format_name or "", host or "")
    return Run(node, writer, *texts, started, ended, labels, stored, lost)
