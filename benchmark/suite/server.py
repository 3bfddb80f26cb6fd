# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The Cassandra that is measured: its start, its processor time, its files."""

from __future__ import annotations

import uuid
from pathlib import Path
from typing import Sequence

import psutil

from cassandra_ros import RosCassandra
from cassandra_ros.local_server import LocalCluster, free_port


class Server:
    """A local Cassandra of the benchmark, or one that runs already.

    Args:
        folder: Where it keeps its files.
        address: host:port of a running one: it is neither stopped nor looked into.
        nodes: 1 to 3.
    """

    def __init__(self, folder: Path, address: str | None = None, nodes: int = 1) -> None:
        self._cluster: LocalCluster | None = None
        self._store: RosCassandra | None = None
        self.keyspace = f"bench_{uuid.uuid4().hex[:12]}"
        if address:
            self.host, _, port = address.rpartition(":")
            self.port = int(port)
        else:
            heap = "1G" if nodes == 1 else "768M"
            self._cluster = LocalCluster(folder, nodes=nodes, port=free_port(), heap=heap)
            self.host, self.port = self._cluster.settings.host, self._cluster.settings.port

    @property
    def ours(self) -> bool:
        """Whether it is one of our own."""
        return self._cluster is not None

    def start(self) -> None:
        """Start it, to end with this process."""
        if self._cluster is not None:
            self._cluster.start(die_with_us=True)

    @property
    def store(self) -> RosCassandra:
        """A connection to the keyspace of the benchmark, which is made where it is missing."""
        if self._store is None:
            self._store = RosCassandra(self.host, self.port, keyspace=self.keyspace)
            self._store.connectToKeyspace(self.keyspace)
        return self._store

    def disconnect(self) -> None:
        """Close the connection, if there is one."""
        if self._store is not None:
            self._store.close()
            self._store = None

    def stop(self) -> None:
        """Drain and stop it: all that is stored is in the files of its tables then."""
        self.disconnect()
        if self._cluster is not None:
            self._cluster.stop()

    def end(self) -> None:
        """Stop it; leave nothing behind on one that is not ours."""
        if self._cluster is None:
            self.drop(self.keyspace)
        self.stop()

    def drop(self, keyspace: str) -> None:
        """Drop a keyspace."""
        cql = f'DROP KEYSPACE IF EXISTS "{keyspace}"'
        self.store.cassandra.schema_change(cql, what="ending the benchmark")

    def cpu(self) -> float | None:
        """Return the processor time of all its nodes so far, s; None where it is not ours."""
        if self._cluster is None:
            return None
        pids = [status.pid for status in self._cluster.status() if status.pid]
        times = [psutil.Process(pid).cpu_times() for pid in pids]
        return sum(one.user + one.system for one in times)

    def table_bytes(self, table: str) -> int | None:
        """Return the size of the files of a table and of its chunks; None where it is not ours."""
        if self._cluster is None:
            return None
        return self._bytes(self.keyspace, (f"{table}-*", f"{table}_c-*"))

    def keyspace_bytes(self, keyspace: str, files: str = "*") -> int:
        """Return the size of the files of all tables of messages in a keyspace of our server.

        Args:
            files: Which, as a pattern of their names.
        """
        return self._bytes(keyspace, ("t_*",), files)

    def _bytes(self, keyspace: str, patterns: Sequence[str], names: str = "*") -> int:
        assert self._cluster is not None
        data = self._cluster.nodes[0].directory / "data" / keyspace
        folders = [folder for pattern in patterns for folder in data.glob(pattern)]
        files = [path for folder in folders for path in folder.rglob(names) if path.is_file()]
        if not any(path.name.endswith("-Data.db") for path in files):
            raise RuntimeError(f"nothing of {patterns} is on disk in {data}")
        return sum(path.stat().st_size for path in files)
