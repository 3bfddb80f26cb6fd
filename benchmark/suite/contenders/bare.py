# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The bare driver on the store's own tables: what the store can reach at best.

Prepared INSERTs of whole rows of format binary in unlogged batches of one partition, a fixed number
of them on their way; messages over 512 KiB in chunks, each an INSERT. Nothing is noted in the
directory, no byte is looked at. The driver's buffers are 1 MiB.
"""

from __future__ import annotations

import socket
from collections import deque
from pathlib import Path
from typing import Any, Iterator

from cassandra.cluster import EXEC_PROFILE_DEFAULT, Cluster, ExecutionProfile, Session
from cassandra.policies import WhiteListRoundRobinPolicy
from cassandra.query import BatchStatement, BatchType, tuple_factory

from cassandra_ros.store.tables.lengths import bucket_for
from suite.contenders.contender import Contender
from suite.messages import Batch
from suite.server import Server

BATCH_BYTES = 32 * 1024
ON_THE_WAY = 16
LARGE_ON_THE_WAY = 8
CHUNK = 512 * 1024
PAGE = 5000


class _Connection(Cluster.connection_class):  # type: ignore[misc]
    in_buffer_size = out_buffer_size = 1 << 20


def bare_cluster(server: Server) -> Cluster:
    """Connect with the driver alone."""
    profile = ExecutionProfile(
        load_balancing_policy=WhiteListRoundRobinPolicy([server.host]),
        request_timeout=60,
        row_factory=tuple_factory,
    )
    cluster = Cluster(
        [server.host],
        port=server.port,
        protocol_version=4,  # without checksums that Python would compute
        compression=False,
        execution_profiles={EXEC_PROFILE_DEFAULT: profile},
        sockopts=[(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)],
        schema_metadata_enabled=False,
        token_metadata_enabled=False,
    )
    cluster.connection_class = _Connection
    return cluster


class Bare(Contender):
    """The driver alone, on a table that the store has made."""

    name = "bare driver"

    def __init__(self, batch: Batch, folder: Path, server: Server) -> None:
        super().__init__(batch, folder)
        self.server, self.keyspace = server, server.keyspace
        self._cluster: Cluster | None = None
        self.large = max(map(len, batch.wires)) > CHUNK

    @property
    def session(self) -> Session:
        """The driver's session."""
        if self._cluster is None:
            self._cluster = bare_cluster(self.server)
            self._session = self._cluster.connect()
            self._session.use_client_timestamp = False
        return self._session

    def open(self) -> None:
        self.bucket_ns = bucket_for(*self.batch.rate)
        with self.server.store.messageWriter(format="binary") as writer:
            self.table = writer.connect(self.batch.connection, self.bucket_ns).table.name
        self._on_way: deque[Any] = deque()
        name = f'"{self.keyspace}"."{self.table}"'
        self._all = f'SELECT "_t", "_data" FROM {name} WHERE "_node" = ? AND "_bucket" = ?'
        row = '"_node", "_bucket", "_t", "_seq", "_conn", "_size", "_data"'
        if self.large:
            name = f'"{self.keyspace}"."bare_blobs"'
            self.session.execute(f"DROP TABLE IF EXISTS {name}")
            self.session.execute(
                f'CREATE TABLE {name} ("_node" text, "_bucket" bigint, "_t" bigint, "_seq" bigint, '
                '"_chunk" int, "_data" blob, PRIMARY KEY (("_node", "_bucket", "_t", "_seq"), '
                "\"_chunk\")) WITH compression = {'enabled': 'false'}"
            )
            row = '"_node", "_bucket", "_t", "_seq", "_chunk", "_data"'
            self._all = (
                f'SELECT "_data" FROM {name} WHERE "_node" = ? AND "_bucket" = ? AND "_t" = ? '
                'AND "_seq" = ?'
            )
        marks = ", ".join("?" for _ in row.split(","))
        self._insert = self.session.prepare(f"INSERT INTO {name} ({row}) VALUES ({marks})")

    def extend(self, first: int, last: int) -> None:
        if self.large:
            self._extend_large(first, last)
            return
        batch, bucket_ns, insert = self.batch, self.bucket_ns, self._insert
        rows: list[tuple[Any, ...]] = []
        size, at = 0, batch.times[first] // bucket_ns
        for i in range(first, last):
            t_ns, wire = batch.times[i], batch.wires[i]
            bucket = t_ns // bucket_ns
            if rows and (size + len(wire) > BATCH_BYTES or bucket != at):
                self._send(insert, rows)
                rows, size, at = [], 0, bucket
            rows.append(("", bucket, t_ns, i, 0, len(wire), wire))
            size += len(wire)
        self._send(insert, rows)

    def _send(self, insert: Any, rows: list[tuple[Any, ...]]) -> None:
        together = BatchStatement(BatchType.UNLOGGED)
        for row in rows:
            together.add(insert, row)
        self._submit(together, None, ON_THE_WAY)

    def _submit(self, statement: Any, row: Any, most: int) -> None:
        self._on_way.append(self.session.execute_async(statement, row))
        while len(self._on_way) >= most:
            self._on_way.popleft().result()

    def _extend_large(self, first: int, last: int) -> None:
        for i in range(first, last):
            t_ns, wire = self.batch.times[i], self.batch.wires[i]
            for chunk, at in enumerate(range(0, len(wire), CHUNK)):
                row = ("", t_ns // self.bucket_ns, t_ns, i, chunk, wire[at : at + CHUNK])
                self._submit(self._insert, row, LARGE_ON_THE_WAY)

    def finish(self) -> None:
        while self._on_way:
            self._on_way.popleft().result()

    def open_reading(self) -> None:
        name = f'"{self.keyspace}"."{self.table}"'
        self._select = self.session.prepare(
            f'SELECT "_t", "_seq", "_conn", "_size", "_data" FROM {name} '
            'WHERE "_node" = ? AND "_bucket" = ? AND "_t" = ?'
        )

    def lookup(self, t_ns: int) -> Any:
        return self.session.execute(self._select, ("", t_ns // self.bucket_ns, t_ns)).one()

    def objects(self) -> Iterator[Any]:
        cls = self.batch.cls
        for _, wire in self.raw():
            yield cls().deserialize(wire)

    def raw(self) -> Iterator[tuple[int, bytes]]:
        statement = self.session.prepare(self._all)
        statement.fetch_size = PAGE
        if self.large:
            yield from self._raw_large(statement)
            return
        last = self.batch.times[-1] // self.bucket_ns
        for bucket in range(self.batch.times[0] // self.bucket_ns, last + 1):
            yield from self.session.execute(statement, ("", bucket))

    def _raw_large(self, statement: Any) -> Iterator[tuple[int, bytes]]:
        waiting: deque[tuple[int, Any]] = deque()
        for i, t_ns in enumerate([*self.batch.times, *[None] * LARGE_ON_THE_WAY]):
            if t_ns is not None:
                row = ("", t_ns // self.bucket_ns, t_ns, i)
                waiting.append((t_ns, self.session.execute_async(statement, row)))
            if waiting and (t_ns is None or len(waiting) >= LARGE_ON_THE_WAY):
                t, asked = waiting.popleft()
                yield t, b"".join(chunk for (chunk,) in asked.result())

    def size(self) -> int | None:
        return self.server.table_bytes(self.table)

    def close(self) -> None:
        if self._cluster is not None:
            self._cluster.shutdown()
            self._cluster = None

    def discard(self) -> None:
        self.close()
        if self.server.store.existTopic(self.batch.topic):
            self.server.store.removeTopic(self.batch.topic)
