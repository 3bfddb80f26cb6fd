# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Messages for a browser as a stream of frames: the bytes as they were sent, and how to read them.

A frame is a head of 16 bytes, little endian (uint32 channel, uint32 size, int64 time in ns since
1970), and ``size`` bytes. Those of channel 0 are JSON, an object of one key:

* ``channel``: ``{id, topic, type, md5sum, schema}``, before the first message of channel ``id``;
* ``problem``: ``{topic, text}``, in place of a message that cannot be read;
* ``end``: ``{next}``, the last frame. What was cut off by a bound is read on with ``after=next``,
  null where nothing is left. Without it the stream was cut.

A schema is ``{root, types}``: types by name, each a list of fields and constants. The names in it
were checked (messages/spec.py): no text of a definition reaches the browser as it was recorded.
"""

from __future__ import annotations

import json
import math
import struct
from functools import lru_cache
from typing import Iterable, Iterator

from cassandra_ros.errors import CorruptMessage, MessageNotFound
from cassandra_ros.keys import encode_cursor
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.spec import Constant, Field
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_table import TopicTable
from cassandra_ros.viewing.answers import Json

CONTENT_TYPE = "application/x-cassandra-ros-frames"
CONTROL = 0
CHUNK_BYTES = 256 * 1024
"""Of a stream are made at a time; a larger message goes out in pieces of this size."""
_HEAD = struct.Struct("<IIq")
_EXACT = 2**53
"""Beyond it a number of JavaScript is no longer every integer."""


def frames(rows: Iterable[StoredRow], limit_bytes: int | None = None) -> Iterator[bytes]:
    """Encode messages as chunks of a stream of frames.

    Memory: one message and CHUNK_BYTES.

    Args:
        rows: In the order in which they are sent.
        limit_bytes: After so many bytes of messages the stream ends, with at least one message in
            it; None = with the last row.

    Raises:
        StoreUnavailable, ConnectionFailed: As of reading; what came before was sent.
    """
    channels: dict[str, int] = {}
    waiting, sent, cursor = bytearray(), 0, None
    for row in rows:
        for part in _message(row, channels):
            if waiting and len(waiting) + len(part) > CHUNK_BYTES:
                yield bytes(waiting)
                waiting.clear()
            if len(part) > CHUNK_BYTES:
                yield from _pieces(part)
            else:
                waiting += part
        sent += row.size
        if limit_bytes is not None and sent >= limit_bytes:
            cursor = encode_cursor(row.position)
            break
    waiting += _control("end", {"next": cursor})
    yield bytes(waiting)


def _message(row: StoredRow, channels: dict[str, int]) -> Iterator[bytes]:
    """Yield a message's head and bytes, before them its channel where that is new."""
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
    for at in range(0, len(data), CHUNK_BYTES):
        yield bytes(view[at : at + CHUNK_BYTES])


def _control(key: str, value: Json, t: int = 0) -> bytes:
    text = json.dumps({key: value}, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return _HEAD.pack(CONTROL, len(text), t) + text.encode("ascii")


def describe_channel(table: TopicTable) -> dict[str, Json]:
    """Describe what the messages of a table are and how they are read, as JSON.

    The schema is null where the definition is unusable: nobody can read these bytes.
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
    """Describe a type and all that it uses, as JSON; not to be changed."""
    types: dict[str, Json] = {}
    for name, spec in definition.specs.items():
        types[name] = [*map(_constant, spec.constants), *map(_field, spec.fields)]
    return {"root": definition.type, "types": types}


def _field(field: Field) -> Json:
    found: dict[str, Json] = {"name": field.name, "type": field.base}
    if not field.is_primitive:
        found["isComplex"] = True
    if field.is_array:
        found["isArray"] = True
        if field.length is not None:
            found["arrayLength"] = field.length
    return found


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
