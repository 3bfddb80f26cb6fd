# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The answers that a handler may return: JSON, or one of these types.

NaN and the infinities, which are no JSON, are refused: handlers write null or a text for them.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Iterator, Mapping, Sequence, Union

from cassandra_ros.query.tree.json_values import AnswerBound

Json = Union[None, bool, int, float, str, "Sequence[Json]", "Mapping[str, Json]"]

BYTES = "application/octet-stream"


@dataclass(frozen=True)
class Bytes:
    """A body that is complete in memory."""

    data: bytes
    content_type: str = BYTES
    headers: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class StreamedBody:
    """A body that is made while it is sent, never faster than the browser reads it.

    The chunks are made one after the other, each on any thread of the pool. If the browser
    disconnects, the iterator is closed. An error before the first chunk becomes a status; a later
    one closes the connection, so that the client does not take the body for complete.
    """

    chunks: Iterator[bytes]
    content_type: str = BYTES
    headers: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class CachedFile:
    """A finished file on disk; a client may request parts of it (Range, If-Range, HEAD)."""

    path: Path
    name: str
    """Name under which a browser saves it, like 'window.bag'."""
    content_type: str
    etag: str
    """Tag of the content, without quotes."""


Answer = Union[Json, Bytes, StreamedBody, CachedFile]


def json_bytes(answer: Json) -> bytes:
    """Return the JSON of an answer, written row by row.

    Raises:
        AnswerTooLarge: The answer is larger than an answer may be.
    """
    bound = AnswerBound("the answer", "ask for a shorter time, fewer topics or fewer columns")
    rows: list[bytes] = []
    for text in _texts(answer):
        raw = text.encode("utf-8", "backslashreplace")
        bound.count_part(len(raw))
        rows.append(raw)
    return b"".join(rows)


def _texts(answer: Json) -> Iterator[str]:
    """Yield the JSON of an answer in pieces: each row of the lists in an object is one."""
    if not isinstance(answer, Mapping):
        yield _text(answer)
        return
    before = "{"
    for name, value in answer.items():
        yield f"{before}{_text(name)}:"
        before = ","
        if isinstance(value, list) and value and isinstance(value[0], list):
            for number, row in enumerate(value):
                yield ("," if number else "[") + _text(row)
            yield "]"
        else:
            yield _text(value)
    yield "}" if answer else "{}"


def _text(value: Json) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
