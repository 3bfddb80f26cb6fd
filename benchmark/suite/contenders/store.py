# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Our store, in one of its formats."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Iterator

from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.metadata import FORMAT_NAMES
from cassandra_ros.store.tables.lengths import bucket_for, span_for
from cassandra_ros.store.tables.row_table import LARGE_MESSAGE_CHUNK_BYTES
from cassandra_ros.topics.cassandra_topic import CassandraTopic
from suite.contenders.contender import Contender
from suite.contenders.rosbags import Rosbag
from suite.messages import Batch
from suite.server import Server

FORMAT_NAMES = tuple(name for name in ("packed", "binary", "ros") if name in FORMAT_NAMES)


class Store(Contender):
    """RosCassandra.messageWriter, of serialised messages; acknowledged by the server.

    Args:
        server: Where it is kept.
        format: Name of the format.
    """

    def __init__(self, batch: Batch, folder: Path, server: Server, format: str) -> None:
        super().__init__(batch, folder)
        self.name = self.format = format
        self.server = server

    @property
    def topic(self) -> CassandraTopic:
        """The topic."""
        return self.server.store.getTopic(self.batch.topic)

    def open(self) -> None:
        # As an import: what the table is like follows from the rates, and blocks are filled.
        self._writer = self.server.store.messageWriter(format=self.format, block_sec=None)
        hz, bytes_per_sec = rate = self.batch.rate
        self._handle = self._writer.connect(
            self.batch.connection,
            bucket_for(*rate),
            span_ns=span_for(*rate),
            large=bytes_per_sec > LARGE_MESSAGE_CHUNK_BYTES * hz,
        )
        assert self._handle.format == self.format, self._handle.warning
        self.table = self._handle.table.name

    def extend(self, first: int, last: int) -> None:
        write, handle, batch = self._writer.write, self._handle, self.batch
        wires, count = batch.wires[first:last], first
        for t_ns, wire in zip(batch.times[first:last], wires):
            write(handle, t_ns, count, wire)
            count += 1

    def finish(self) -> None:
        self._writer.close()

    def open_reading(self) -> None:
        self._topic = self.topic

    def objects(self) -> Iterator[Any]:
        for _, msg in self.topic.items():
            yield msg

    def raw(self) -> Iterator[tuple[int, bytes]]:
        for row in self.topic.rows():
            yield row.key.to_nsec(), row.wire

    def lookup(self, t_ns: int) -> Any:
        return self._topic.getData(t_ns)

    def size(self) -> int | None:
        return self.server.table_bytes(self.table)

    def discard(self) -> None:
        if self.server.store.existTopic(self.batch.topic):
            self.server.store.removeTopic(self.batch.topic)


class StoreImport(Store):
    """import_bag of a bag with these messages: what 'cassandra_bag import' does, with its table."""

    def __init__(self, batch: Batch, folder: Path, server: Server, format: str) -> None:
        super().__init__(batch, folder, server, format)
        self.name = f"{format} import"

    def open(self) -> None:
        self._source = folder_bag(self.batch, self.folder)

    def extend(self, first: int, last: int) -> None:
        assert (first, last) == (0, len(self.batch)), "a bag is imported whole"
        report = import_bag(self.server.store, self._source, format=self.format)
        assert report.messages == last and not report.lost, report

    def finish(self) -> None:
        pass


def folder_bag(batch: Batch, folder: Path) -> Path:
    """Return a bag of the batch, written where the folder has none."""
    folder = folder / "source"
    source = Rosbag(batch, folder)
    if not folder.exists():
        folder.mkdir()
        source.open()
        source.extend(0, len(batch))
        source.finish()
    return Path(source.path)
