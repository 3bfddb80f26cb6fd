# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Routes for a single message: its JSON, and the picture of an image message."""

from __future__ import annotations

import json
from types import MappingProxyType
from typing import Callable, Mapping

from cassandra_ros.errors import InvalidOption, MessageNotFound
from cassandra_ros.keys import Position, RowName, decode_cursor, encode_cursor
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.topics.message_text import MessageText
from cassandra_ros.topics.row_finder import AnyKey
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.viewing.answers import Bytes, Json
from cassandra_ros.viewing.api_call import ApiCall
from cassandra_ros.viewing.drawing.images import jpeg_of
from cassandra_ros.viewing.route import Parameter, Route

MAX_WIDTH = 16_384
"""Maximum width of a picture, pixels."""
_KEPT = {"Cache-Control": "private, max-age=3600"}
"""Headers of a picture that is found by its position: it never changes."""


def _message(call: ApiCall) -> Bytes:
    return message_answer(call, _row(call))


def message_answer(
    call: ApiCall, row: StoredRow, more: Mapping[str, Json] = MappingProxyType({})
) -> Bytes:
    """Return a message as JSON, with more entries after its position."""
    entries = {
        "topic": row.topic,
        "time": str(row.t),
        "received": str(row.received),
        "node": row.node,
        "run": row.run,
        "type": row.type,
        "md5sum": row.md5sum,
        "size": row.size,
        "name": row.name,
        "position": encode_cursor(row.position),
        **more,
    }
    elements, characters = call.count("elements"), call.count("characters")
    text = MessageText(True, elements, characters, bounded=True).of(row)
    body = f'{json.dumps(entries, ensure_ascii=False)[:-1]}, "message": {text}}}'
    return Bytes(body.encode("utf-8", "surrogatepass"), "application/json")


def _image(call: ApiCall) -> Bytes:
    return image_answer(call, _row(call))


def image_answer(call: ApiCall, row: StoredRow) -> Bytes:
    """Return the picture of an image message."""
    width = call.count("width")
    if width is not None and not 1 <= width <= MAX_WIDTH:
        raise InvalidOption(f"width {width} is not a number of pixels of 1 to {MAX_WIDTH}")
    return Bytes(jpeg_of(row, width), "image/jpeg", _KEPT if call.text("position") else {})


def _row(call: ApiCall) -> StoredRow:
    """Return the message that a call selects.

    Raises:
        InvalidOption: Neither or both of position and key are given.
        MessageNotFound, TopicNotFound: The message or the topic is not stored.
        InvalidKey: The key cannot be read.
    """
    topic = call.store.getTopic(call.text("topic") or "")
    key, nearest = key_of(call, topic.keyOfText)
    row = topic.getRow(key, nearest=nearest)
    if row is None:
        topic.getData(key, nearest=nearest)  # its error has the nearest keys
        raise MessageNotFound(f"topic {topic.name} has no message at {key!r:.80}")
    return row


def key_of(call: ApiCall, read: Callable[[str], AnyKey]) -> tuple[AnyKey, str | None]:
    """Return the key that a call selects, which a function reads from its text, and nearest."""
    position, text = call.text("position"), call.text("key")
    if position is not None and text is None:
        return _key_at(decode_cursor(position)), None
    if position is None and text is not None:
        return read(text), call.text("nearest")
    raise InvalidOption("give either position or key of the message")


def _key_at(position: Position) -> AnyKey:
    if position.name:
        return RowName.of(position)
    return Stamp.from_ns(position.t, position.node, position.seq, position.table)


_ONE = (
    Parameter("topic", "text", "Name of its topic.", required=True),
    Parameter("position", "text", "Position of the message: its cursor in another answer."),
    Parameter(
        "key",
        "text",
        "Instead of position: its time in nanoseconds or ISO 8601, or another key of the topic.",
    ),
    Parameter(
        "nearest",
        "text",
        "With key: before, after or either selects the nearest message; missing: only the key.",
    ),
)
ROUTES: tuple[Route, ...] = (
    Route(
        "/api/message",
        _message,
        "A message as JSON: its position and its content, as rosbridge writes it. Numbers have all "
        "their digits; JavaScript rounds those above 2**53.",
        (
            *_ONE,
            Parameter(
                "elements",
                "count",
                "Maximum number of elements of an array; longer ones become type and length.",
            ),
            Parameter(
                "characters",
                "count",
                "Maximum length of a string, bytes; longer ones become their length.",
            ),
        ),
    ),
    Route(
        "/api/image",
        _image,
        "The picture of a sensor_msgs/Image or CompressedImage, as JPEG; depths from black "
        "(minimum) to white (maximum).",
        (
            *_ONE,
            Parameter(
                "width",
                "count",
                f"Maximum width, pixels, 1 to {MAX_WIDTH}; missing: that of the image.",
            ),
        ),
        "image/jpeg",
    ),
)
