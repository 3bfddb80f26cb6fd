# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Write MCAP files of the profile ros1, which Foxglove and the mcap tools can read."""

from __future__ import annotations

import os
from typing import NamedTuple

from mcap.well_known import MessageEncoding, Profile, SchemaEncoding
from mcap.writer import CompressionType, Writer

from cassandra_ros.errors import BagError
from cassandra_ros.files.bag import mcap_events
from cassandra_ros.files.bag.file_writer import FileWriter
from cassandra_ros.files.bag.mcap_channel import NUMBER, to_channel
from cassandra_ros.store.tables.event_table import Event

MCAP_CHUNK_BYTES = 1 << 20
"""Size of a chunk's content above which the chunk is closed, bytes; the default of mcap."""
_MAX_CHANNELS = 2**16 - 1
"""Maximum number of channels in a file: their ids have 16 bits, and the library begins with 1."""
_COMPRESSIONS = {
    "none": CompressionType.NONE,
    "lz4": CompressionType.LZ4,
    "zstd": CompressionType.ZSTD,
}


class _RegisteredIds(NamedTuple):
    """The ids of the schemas and channels that the library has assigned; the maps are filled."""

    schemas: dict[tuple[str, bytes], int]
    """(type, definition) -> schema id."""
    channels: dict[int, int]
    """Connection number -> channel id."""


class McapWriter(FileWriter):
    """An MCAP that is being written, see FileWriter. Memory: one chunk, connections, the index.

    Each connection is a channel. The metadata of the channel hold the fields of the connection
    header except topic, type and definition, see mcap_channel.

    Args:
        path: The file to write; an existing file is replaced when the MCAP is closed.
        compression: 'none', 'lz4' or 'zstd'.
        chunk_bytes: Size of a chunk's content above which the chunk is closed, uncompressed bytes.

    Raises:
        BagError: The compression is unknown, or the file cannot be made.
    """

    keeps_publish_times = True

    def __init__(
        self,
        path: str | os.PathLike[str],
        compression: str = "zstd",
        chunk_bytes: int = MCAP_CHUNK_BYTES,
    ) -> None:
        if compression not in _COMPRESSIONS:
            names = ", ".join(_COMPRESSIONS)
            raise BagError(f"{compression!r} is not a compression of MCAP; known are {names}")
        super().__init__(path)
        self._registered = _RegisteredIds({}, {})
        self._writer = Writer(self._file, chunk_bytes, _COMPRESSIONS[compression])
        self._writer.start(Profile.ROS1, "cassandra_ros")

    def write(
        self, number: int, t_ns: int, data: bytes, delay_ns: int = 0, sequence: int = 0
    ) -> None:
        """Append a message, see FileWriter; raises BagError also for too many channels."""
        try:
            channel = self._registered.channels.get(number)
            if channel is None:
                channel = self._registered.channels[number] = self._register(number)
            self._writer.add_message(channel, t_ns, data, (t_ns + delay_ns) % 2**64, sequence)
        except OSError as exc:
            raise self._failure(exc) from exc

    def add_event(self, event: Event) -> bool:
        """Write an event as metadata, see FileWriter."""
        try:
            self._writer.add_metadata(mcap_events.NAME, mcap_events.fields_of(event))
        except OSError as exc:
            raise self._failure(exc) from exc
        return True

    def _finish(self) -> None:
        self._writer.finish()  # type: ignore[no-untyped-call]  # of the library

    def _register(self, number: int) -> int:
        """Write the schema and the channel of a connection; return the channel id.

        Raises:
            BagError: The file has as many channels as an MCAP can have.
        """
        if len(self._registered.channels) == _MAX_CHANNELS:
            raise BagError(
                f"{self.path}: an MCAP has at most {_MAX_CHANNELS} channels, and each publisher of "
                "a topic is one; export fewer topics or runs, or into a bag"
            )
        connection = self._connections[number]
        text = to_channel(connection)
        schemas, key = self._registered.schemas, (text.type, text.definition)
        if key not in schemas:
            schemas[key] = self._writer.register_schema(
                text.type, SchemaEncoding.ROS1, text.definition
            )
        metadata = text.metadata
        # The library gives the next channel this id: it counts from 1.
        if number != len(self._registered.channels) + 1:
            metadata[NUMBER] = str(number)
        return self._writer.register_channel(
            connection.topic, MessageEncoding.ROS1, schemas[key], metadata
        )
