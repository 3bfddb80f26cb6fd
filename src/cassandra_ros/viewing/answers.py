# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a handler may return: anything JSON can hold, or one of these.

Of the JSON ours is strict: NaN and the infinities, which JSON does not know, are refused. Who may
meet them writes null or a text.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Iterator, Mapping, Sequence, Union

from cassandra_ros.query.rows.answer_bound import AnswerBound

Json = Union[None, bool, int, float, str, "Sequence[Json]", "Mapping[str, Json]"]

BYTES = "application/octet-stream"


@dataclass(frozen=True)
class Bytes:
    """A body that is small and whole."""

    data: bytes
    content_type: str = BYTES
    headers: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Stream:
    """A body that is made while it is sent, never faster than the browser takes it.

    The chunks are asked for one after the other, each on some thread of the pool. Where the browser
    goes away the iterator is closed. Until the first chunk is there an error is told as one; after
    it the connection is cut, so that nobody takes a part for the whole.
    """

    chunks: Iterator[bytes]
    content_type: str = BYTES
    headers: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class SpooledFile:
    """A finished file on our disk, of which a browser may ask for parts (Range, If-Range, HEAD)."""

    path: Path
    name: str
    """As which it is saved, like 'window.bag'."""
    content_type: str
    etag: str
    """Tag of the content, without quotes."""


Answer = Union[Json, Bytes, Stream, SpooledFile]


def json_bytes(answer: Json) -> bytes:
    """Write the JSON of an answer, row by row.

    Raises:
        AnswerTooLarge: It has more bytes than one answer may have.
    """
    bound = AnswerBound("the answer", "ask for a shorter time, fewer topics or fewer columns")
    parts: list[bytes] = []
    for text in _texts(answer):
        raw = text.encode("utf-8", "backslashreplace")
        bound.take(len(raw))
        parts.append(raw)
    return b"".join(parts)


def _texts(answer: Json) -> Iterator[str]:
    """Yield the JSON of an answer, each row of the lists that an object holds by itself."""
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
