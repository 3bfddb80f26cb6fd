# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The bag, by the rosbag module."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Iterator

import rosbag
from genpy import Time

from suite.contenders.contender import Contender


class Rosbag(Contender):
    """Bag.write of serialised messages (raw=True), not compressed."""

    name = "rosbag"
    compression = rosbag.Compression.NONE
    _reader: rosbag.Bag | None = None
    _writer: rosbag.Bag | None = None

    @property
    def path(self) -> str:
        """The bag."""
        return str(self.folder / f"{self.name.replace(' ', '_')}.bag")

    def open(self) -> None:
        self._writer = rosbag.Bag(self.path, "w", compression=self.compression)

    def extend(self, first: int, last: int) -> None:
        batch, write, header = self.batch, self._writer.write, self.batch.header
        topic, cls = batch.topic, batch.cls
        kind, md5sum = cls._type, cls._md5sum
        for t_ns, wire in zip(batch.times[first:last], batch.wires[first:last]):
            t = Time(*divmod(t_ns, 10**9))
            write(topic, (kind, wire, md5sum, 0, cls), t, raw=True, connection_header=header)

    def finish(self) -> None:
        self._writer.close()

    def open_reading(self) -> None:
        self._reader = rosbag.Bag(self.path)

    def objects(self) -> Iterator[Any]:
        with rosbag.Bag(self.path) as bag:
            for _, msg, _t in bag.read_messages():
                yield msg

    def raw(self) -> Iterator[tuple[int, bytes]]:
        with rosbag.Bag(self.path) as bag:
            for _, message, t in bag.read_messages(raw=True):
                yield t.to_nsec(), message[1]

    def lookup(self, t_ns: int) -> Any:
        t = Time(*divmod(t_ns, 10**9))
        for _, msg, _t in self._reader.read_messages(self.batch.topic, t, t):
            return msg
        raise KeyError(t_ns)

    def size(self) -> int:
        return Path(self.path).stat().st_size

    def close(self) -> None:
        if self._reader is not None:
            self._reader.close()
            self._reader = None


class RosbagObjects(Rosbag):
    """Bag.write of message objects."""

    name = "rosbag objects"

    def open(self) -> None:
        super().open()
        self._objects = list(self.batch.objects())

    def extend(self, first: int, last: int) -> None:
        write, topic = self._writer.write, self.batch.topic
        for t_ns, msg in zip(self.batch.times[first:last], self._objects[first:last]):
            write(topic, msg, Time(*divmod(t_ns, 10**9)))


class RosbagBz2(Rosbag):
    """The bag compressed with bz2."""

    name = "rosbag bz2"
    compression = rosbag.Compression.BZ2
