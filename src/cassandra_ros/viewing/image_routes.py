# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Single messages: as JSON, and of images their pictures."""

from __future__ import annotations

import json

from cassandra_ros.drawing.images import jpeg_of
from cassandra_ros.errors import InvalidOption, MessageNotFound
from cassandra_ros.keys import Position, RowName, decode_cursor, encode_cursor
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.topics.key_selection import AnyKey
from cassandra_ros.topics.message_text import MessageText
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.viewing.answers import Bytes
from cassandra_ros.viewing.call import Call
from cassandra_ros.viewing.route import Parameter, Route

MAX_WIDTH = 16_384
"""Pixels."""
_KEPT = {"Cache-Control": "private, max-age=3600"}
"""What lies at a position stays the same, until it is deleted."""


def _message(call: Call) -> Bytes:
    row = _row(call)
    known = {
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
    }
    elements, characters = call.count("elements"), call.count("characters")
    text = MessageText(True, elements, characters, bounded=True).of(row)
    body = f'{json.dumps(known, ensure_ascii=False)[:-1]}, "message": {text}}}'
    return Bytes(body.encode("utf-8", "surrogatepass"), "application/json")


def _image(call: Call) -> Bytes:
    width = call.count("width")
    if width is not None and not 1 <= width <= MAX_WIDTH:
        raise InvalidOption(f"width {width} is no number of pixels of 1 to {MAX_WIDTH}")
    row = _row(call)
    return Bytes(jpeg_of(row, width), "image/jpeg", _KEPT if call.text("position") else {})


def _row(call: Call) -> StoredRow:
    """Find the message that a call is about.

    Raises:
        InvalidOption: Not one of position and key is given.
        MessageNotFound, TopicNotFound, InvalidKey: There is none; the key is none.
    """
    topic = call.store.getTopic(call.text("topic") or "")
    position, text = call.text("position"), call.text("key")
    if (position is None) == (text is None):
        raise InvalidOption("give position or key, which tell the message")
    nearest = None
    if position is not None:
        key: AnyKey = _key_at(decode_cursor(position))
    else:
        key, nearest = topic.keyOfText(text or ""), call.text("nearest")
    row = topic.getRow(key, nearest=nearest)
    if row is None:
        topic.getData(key, nearest=nearest)  # its error says what lies near
        raise MessageNotFound(f"topic {topic.name} has no message at {key!r:.80}")
    return row


def _key_at(position: Position) -> AnyKey:
    if position.name:
        return RowName.of(position)
    return Stamp.from_ns(position.t, position.node, position.seq, position.table)


_ONE = (
    Parameter("topic", "text", "Its topic.", required=True),
    Parameter("position", "text", "Its place: the cursor that another answer gave for it."),
    Parameter(
        "key",
        "text",
        "Instead: its time in nanoseconds or ISO 8601, or what else the topic's keys are.",
    ),
    Parameter(
        "nearest",
        "text",
        "With key: before (at it or before), after or either (default: only at the key itself).",
    ),
)
ROUTES: tuple[Route, ...] = (
    Route(
        "/api/message",
        _message,
        "A message as JSON: its place and its content, as rosbridge writes it. Numbers have all "
        "their digits, which JavaScript rounds above 2**53.",
        (
            *_ONE,
            Parameter(
                "elements", "count", "Of longer arrays only type and length (default: all of it)."
            ),
            Parameter(
                "characters", "count", "Of longer strings only the length, bytes (default: all)."
            ),
        ),
    ),
    Route(
        "/api/image",
        _image,
        "The picture of a sensor_msgs/Image or CompressedImage, as JPEG; depths from black (the "
        "least) to white.",
        (
            *_ONE,
            Parameter(
                "width",
                "count",
                f"Pixels, 1 to {MAX_WIDTH}: shrink it to so many (default: its own).",
            ),
        ),
        "image/jpeg",
    ),
)
