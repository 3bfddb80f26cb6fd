# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Messages for a browser as a stream of frames: the serialised bytes, and schemas to read them.

A frame is a head of 16 bytes, little endian (uint32 channel, uint32 size, int64 time in ns since
1970), and ``size`` bytes. Those of channel 0 are JSON, an object of one key:

* ``channel``: ``{id, topic, type, md5sum, schema}``, before the first message of channel ``id``;
* ``problem``: ``{topic, text}``, in place of a message that cannot be read;
* ``end``: ``{next}``, the last frame. If a limit ended the stream, the next page begins with
  ``after=next``; null = no message is left. A stream without this frame was cut off. Of several
  stores it also has ``missing``, the stores that did not answer and the reason of each.

A schema is ``{root, types}``: types by name, each a list of fields and constants. The names in it
were checked (messages/spec.py): the browser never gets the recorded text of a definition.
"""

from __future__ import annotations

import json
import math
import struct
from functools import lru_cache
from typing import Iterable, Iterator, Mapping

from cassandra_ros.errors import CorruptMessage, MessageNotFound
from cassandra_ros.keys import encode_cursor
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.spec import Constant, Field
from cassandra_ros.stores.fleet.fleet_row import FleetRow
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_table import TopicTable
from cassandra_ros.viewing.answers import Json

CONTENT_TYPE = "application/x-cassandra-ros-frames"
CONTROL = 0
STREAM_CHUNK_BYTES = 256 * 1024
"""Maximum size of a chunk of the stream of frames, bytes; a larger message is sent in several."""
_HEAD = struct.Struct("<IIq")
_EXACT = 2**53
"""Maximum integer up to which JavaScript's numbers are exact."""


def frames(
    rows: Iterable[StoredRow | FleetRow],
    limit_bytes: int | None = None,
    missing: Mapping[str, str] | None = None,
) -> Iterator[bytes]:
    """Encode messages as chunks of a stream of frames.

    Memory: one message and STREAM_CHUNK_BYTES.

    Args:
        rows: The messages, in the order of sending.
        limit_bytes: Size of messages after which the stream ends, bytes; it has at least one
            message. None = it ends with the last row.
        missing: Stores that did not answer so far, and why; None = there is one store.

    Raises:
        StoreUnavailable, ConnectionFailed: Rows could not be read; those before were sent.
    """
    channels: dict[str, int] = {}
    waiting, sent, cursor = bytearray(), 0, None
    for row in rows:
        for data in _message(row, channels):
            if waiting and len(waiting) + len(data) > STREAM_CHUNK_BYTES:
                yield bytes(waiting)
                waiting.clear()
            if len(data) > STREAM_CHUNK_BYTES:
                yield from _pieces(data)
            else:
                waiting += data
        sent += row.size
        if limit_bytes is not None and sent >= limit_bytes:
            cursor = encode_cursor(row.position)
            break
    away = {} if missing is None else {"missing": dict(missing)}
    waiting += _control("end", {"next": cursor, **away})
    yield bytes(waiting)


def _message(row: StoredRow | FleetRow, channels: dict[str, int]) -> Iterator[bytes]:
    """Yield the head and the bytes of a message, after the frame of its channel if that is new."""
    channel = channels.get(row.table.name)
    if channel is None:
        channel = channels[row.table.name] = len(channels) + 1
        yield _control("channel", {"id": channel, **describe_channel(row.table)})
    try:
        wire = row.wire
    except (CorruptMessage, MessageNotFound) as exc:
        yield _control("problem", {"topic": row.topic, "text": str(exc)}, row.t)
        return
    yield _HEAD.pack(channel, len(wire), row.t)
    yield wire


def _pieces(data: bytes) -> Iterator[bytes]:
    view = memoryview(data)
    for at in range(0, len(data), STREAM_CHUNK_BYTES):
        yield bytes(view[at : at + STREAM_CHUNK_BYTES])


def _control(key: str, value: Json, t: int = 0) -> bytes:
    text = json.dumps({key: value}, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return _HEAD.pack(CONTROL, len(text), t) + text.encode("ascii")


def describe_channel(table: TopicTable) -> dict[str, Json]:
    """Return topic, type and schema of a table's messages, as JSON.

    The schema is null if the definition cannot be used, so that the bytes cannot be read.
    """
    definition = table.definition
    return {
        "topic": table.metadata.topic,
        "type": table.msg_type,
        "md5sum": table.metadata.md5sum,
        "schema": None if definition is None else describe_schema(definition),
    }


@lru_cache(maxsize=256)
def describe_schema(definition: Definition) -> dict[str, Json]:
    """Return the schema of a type and of all types that it uses; it must not be changed."""
    types: dict[str, Json] = {}
    for name, spec in definition.specs.items():
        types[name] = [*map(_constant, spec.constants), *map(_field, spec.fields)]
    return {"root": definition.type, "types": types}


def _field(field: Field) -> Json:
    entry: dict[str, Json] = {"name": field.name, "type": field.base}
    if not field.is_primitive:
        entry["isComplex"] = True
    if field.is_array:
        entry["isArray"] = True
        if field.length is not None:
            entry["arrayLength"] = field.length
    return entry


def _constant(constant: Constant) -> Json:
    value = constant.value
    exact = isinstance(value, str) or (math.isfinite(value) and abs(value) <= _EXACT)
    return {
        "name": constant.name,
        "type": Field("", constant.type).base,
        "isConstant": True,
        "value": value if exact else constant.text,
        "valueText": constant.text,
    }
