# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Which part of a file a request asks for, by RFC 9110: Range and If-Range."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Mapping

_ONE_RANGE = re.compile(r"bytes=[ \t]*([0-9]{0,19})-([0-9]{0,19})[ \t]*", re.IGNORECASE)


@dataclass(frozen=True)
class Part:
    """What is answered of a file."""

    status: int
    """200: the whole; 206: a part; 416: the file has no such part."""
    start: int
    """Offset of the first byte."""
    count: int
    """Number of bytes."""
    size: int
    """Of the file, bytes."""

    def headers(self) -> dict[str, str]:
        """Return what an answer says of it."""
        found = {"Accept-Ranges": "bytes", "Content-Length": str(self.count)}
        if self.status == 206:
            last = self.start + self.count - 1
            found["Content-Range"] = f"bytes {self.start}-{last}/{self.size}"
        elif self.status == 416:
            found["Content-Range"] = f"bytes */{self.size}"
        return found


def asked_part(headers: Mapping[str, str], etag: str, size: int) -> Part:
    """Read which part of a file is asked for.

    What is no range, is of another unit, or several at once, is answered by the whole file, as
    RFC 9110 allows it. So is a range of another content than the present one: who goes on with a
    download must not get the end of another file.

    Args:
        headers: Of the request; their names in small letters.
        etag: Of the file as it is now, without quotes.
        size: Of the file, bytes.
    """
    whole = Part(200, 0, size, size)
    match = _ONE_RANGE.fullmatch(headers.get("range", ""))
    # If-Range may give a date, which says less than we know of the content.
    if match is None or headers.get("if-range", f'"{etag}"').strip() != f'"{etag}"':
        return whole
    first, last = (int(text) if text else None for text in match.groups())
    if first is None:
        if last is None:
            return whole
        first, last = max(0, size - last), size - 1
    elif last is not None and last < first:
        return whole
    if first >= size:
        return Part(416, 0, 0, size)
    end = size - 1 if last is None else min(last, size - 1)
    return Part(206, first, end - first + 1, size)


def names_etag(text: str, etag: str) -> bool:
    """Say whether a list of tags, as of If-None-Match, names one, or all by a star."""
    tags = (tag.strip() for tag in text.split(","))
    return any(tag in ("*", f'"{etag}"', f'W/"{etag}"') for tag in tags)
