# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The rows of a statement as text, written while they are read: table, csv, json, ndjson."""

from __future__ import annotations

import json
from itertools import chain, islice
from typing import Any, Iterable, Iterator, Sequence, TextIO, Tuple

from cassandra_ros.cli.table import shown
from cassandra_ros.messages.stamps import Stamp, isoTime
from cassandra_ros.query.json_values import jsonValue, toJson

Columns = Sequence[str]
Lines = Iterable[Tuple[Any, ...]]

PAGE_ROWS = 200
"""Rows of a table from which its widths are taken."""
MAX_CELL = 120
_QUOTED = set('",\r\n')


def write_table(columns: Columns, rows: Lines, stream: TextIO) -> None:
    """Write aligned columns for people; long values are cut.

    The widths are those of the first rows: what is longer later moves the rest of its line.
    """
    lines = iter(rows)
    page = list(islice(lines, PAGE_ROWS))
    right = [_are_numbers(column) for column in zip(*page)] or [False] * len(columns)
    texts = [[_cell(value) for value in row] for row in page]
    header = [shown(name) for name in columns]
    widths = [max(map(len, column)) for column in zip(header, *texts)]
    later = ([_cell(value) for value in row] for row in lines)
    for line in chain([header], texts, later):
        cells = [
            text.rjust(width) if is_right else text.ljust(width)
            for text, width, is_right in zip(line, widths, right)
        ]
        stream.write("  ".join(cells).rstrip() + "\n")


def _are_numbers(column: Sequence[Any]) -> bool:
    found = [value for value in column if value is not None]
    return bool(found) and all(
        isinstance(value, (int, float)) and not isinstance(value, bool) for value in found
    )


def _cell(value: Any) -> str:
    text = "-" if value is None else shown(_text(value))
    return text if len(text) <= MAX_CELL else text[: MAX_CELL - 1] + "…"


def _text(value: Any) -> str:
    if isinstance(value, str):
        return str(value)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Stamp):
        return isoTime(value.ns)
    if hasattr(value, "to_nsec"):
        ns = int(value.to_nsec())
        return f"{'-' if ns < 0 else ''}{abs(ns) // 10**9}.{abs(ns) % 10**9:09d} s"
    if isinstance(value, (bytes, bytearray)):
        return f"<{len(value)} bytes>"
    if isinstance(value, list):
        # More elements than characters are never shown.
        return "[" + ", ".join(_text(element) for element in value[:MAX_CELL]) + "]"
    return "-" if value is None else repr(value)


def write_csv(columns: Columns, rows: Lines, stream: TextIO) -> None:
    """Write CSV as RFC 4180 has it.

    Times are integer nanoseconds, bytes base64, arrays JSON. What is missing is an empty field,
    and an empty text one in quotes.
    """
    for row in chain([columns], rows):
        fields = [_field(value) for value in row]
        # An empty line would be no row to many programs.
        stream.write((",".join(fields) or '""') + "\r\n")


def _field(value: Any) -> str:
    if value is None:
        return ""
    text = value if isinstance(value, str) else _exact(value)
    if not text or not _QUOTED.isdisjoint(text):
        return '"' + text.replace('"', '""') + '"'
    return str(text)


def _exact(value: Any) -> str:
    if isinstance(value, float):
        return repr(float(value))
    return toJson(value).strip('"') if isinstance(value, (bytes, bytearray)) else toJson(value)


def write_json(columns: Columns, rows: Lines, stream: TextIO) -> None:
    """Write one list of objects."""
    opening = "[\n"
    for text in _objects(columns, rows):
        stream.write(opening + text)
        opening = ",\n"
    stream.write("[]\n" if opening == "[\n" else "\n]\n")


def write_ndjson(columns: Columns, rows: Lines, stream: TextIO) -> None:
    """Write an object a line."""
    for text in _objects(columns, rows):
        stream.write(text + "\n")


def _objects(columns: Columns, rows: Lines) -> Iterator[str]:
    for row in rows:
        found = {name: jsonValue(value) for name, value in zip(columns, row)}
        yield json.dumps(found, ensure_ascii=False, allow_nan=False)
