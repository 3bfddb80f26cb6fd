# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""MCAP by its Python packages, with their defaults: chunks of 1 MiB, zstd, crc."""

from __future__ import annotations

from pathlib import Path
from typing import IO, Any, Iterator

from mcap.reader import SeekingReader
from mcap.writer import Writer
from mcap_ros1.decoder import DecoderFactory
from mcap_ros1.writer import Writer as ObjectWriter

from suite.contenders.contender import Contender


class Mcap(Contender):
    """Writer.add_message of serialised messages."""

    name = "mcap"
    _file: IO[bytes] | None = None

    @property
    def path(self) -> str:
        """The file."""
        return str(self.folder / f"{self.name.replace(' ', '_')}.mcap")

    def open(self) -> None:
        batch = self.batch
        self._writer = Writer(self.path)
        self._writer.start(profile="ros1")
        definition = batch.cls._full_text.encode()
        schema = self._writer.register_schema(batch.cls._type, "ros1msg", definition)
        self._channel = self._writer.register_channel(batch.topic, "ros1", schema)

    def extend(self, first: int, last: int) -> None:
        add, channel, batch = self._writer.add_message, self._channel, self.batch
        for t_ns, wire in zip(batch.times[first:last], batch.wires[first:last]):
            add(channel, t_ns, wire, t_ns)

    def finish(self) -> None:
        self._writer.finish()

    def open_reading(self) -> None:
        self._file = open(self.path, "rb")
        self._reader = SeekingReader(self._file, decoder_factories=[DecoderFactory()])

    def objects(self) -> Iterator[Any]:
        with open(self.path, "rb") as file:
            reader = SeekingReader(file, decoder_factories=[DecoderFactory()])
            for found in reader.iter_decoded_messages():
                yield found.decoded_message

    def raw(self) -> Iterator[tuple[int, bytes]]:
        with open(self.path, "rb") as file:
            for _, _channel, message in SeekingReader(file).iter_messages():
                yield message.log_time, message.data

    def lookup(self, t_ns: int) -> Any:
        reader = self._reader
        for found in reader.iter_decoded_messages(None, t_ns, t_ns + 1):
            return found.decoded_message
        raise KeyError(t_ns)

    def size(self) -> int:
        return Path(self.path).stat().st_size

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None


class McapObjects(Mcap):
    """mcap_ros1's Writer.write_message of message objects."""

    name = "mcap objects"

    def open(self) -> None:
        self._objects = list(self.batch.objects())
        self._output = open(self.path, "wb")
        self._writer = ObjectWriter(self._output)

    def extend(self, first: int, last: int) -> None:
        write, topic = self._writer.write_message, self.batch.topic
        for t_ns, msg in zip(self.batch.times[first:last], self._objects[first:last]):
            write(topic, msg, t_ns)

    def finish(self) -> None:
        self._writer.finish()
        self._output.close()
