# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""SQLite as rosbag2's storage plugin lays it out and sets it up by default."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Any, Iterator

from suite.contenders.contender import Contender

SCHEMA = """
PRAGMA journal_mode=MEMORY;
PRAGMA synchronous=OFF;
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
  serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
  data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
"""
INSERT = "INSERT INTO messages (timestamp, topic_id, data) VALUES (?, ?, ?)"
SELECT = "SELECT data FROM messages WHERE timestamp = ? AND topic_id = 1 ORDER BY timestamp, id"
ALL = "SELECT timestamp, data FROM messages WHERE topic_id = 1 ORDER BY timestamp, id"
CACHE_BYTES = 100 * 1024 * 1024
"""rosbag2 collects so many bytes for a transaction."""


class Sqlite(Contender):
    """Serialised messages; the layout and pragmas of rosbag2 (preset 'none': written fast)."""

    name = "sqlite"
    _db: sqlite3.Connection | None = None

    @property
    def path(self) -> str:
        """The database."""
        return str(self.folder / "messages.db3")

    def open(self) -> None:
        self._db = sqlite3.connect(self.path, isolation_level=None)
        self._db.executescript(SCHEMA)
        cls = self.batch.cls
        self._db.execute(
            "INSERT INTO topics VALUES (1, ?, ?, 'ros1', '')", (self.batch.topic, cls._type)
        )
        self._waiting = 0
        self._db.execute("BEGIN TRANSACTION")

    def extend(self, first: int, last: int) -> None:
        batch, execute = self.batch, self._db.execute
        for t_ns, wire in zip(batch.times[first:last], batch.wires[first:last]):
            execute(INSERT, (t_ns, 1, wire))
            self._waiting += len(wire)
            if self._waiting >= CACHE_BYTES:
                execute("COMMIT")
                execute("BEGIN TRANSACTION")
                self._waiting = 0

    def finish(self) -> None:
        self._db.execute("COMMIT")

    def open_reading(self) -> None:
        if self._db is None:
            self._db = sqlite3.connect(self.path, isolation_level=None)

    def objects(self) -> Iterator[Any]:
        cls = self.batch.cls
        for _, wire in self.raw():
            yield cls().deserialize(wire)

    def raw(self) -> Iterator[tuple[int, bytes]]:
        self.open_reading()
        yield from self._db.execute(ALL)

    def lookup(self, t_ns: int) -> Any:
        (wire,) = self._db.execute(SELECT, (t_ns,)).fetchone()
        return self.batch.cls().deserialize(wire)

    def size(self) -> int:
        return Path(self.path).stat().st_size

    def close(self) -> None:
        if self._db is not None:
            self._db.close()
            self._db = None
