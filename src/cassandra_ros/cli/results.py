# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The rows of a statement, written while they are read: table, csv, json, ndjson, Parquet."""

from __future__ import annotations

import io
import json
import os
import sys
from contextlib import contextmanager
from itertools import chain, islice
from types import ModuleType
from typing import IO, TYPE_CHECKING, Any, Iterable, Iterator, Sequence, Tuple

from cassandra_ros.arrays.array_types import ArrayType
from cassandra_ros.cli.terminal_text import align
from cassandra_ros.errors import InvalidOption
from cassandra_ros.installation import optional_module
from cassandra_ros.messages.stamps import Stamp, iso_time
from cassandra_ros.printable import shown
from cassandra_ros.query.rows.answer_bound import AnswerBound, least_bytes
from cassandra_ros.query.tree.json_values import json_value, to_json

if TYPE_CHECKING:
    import pyarrow

Columns = Sequence[str]
Types = Sequence[Tuple[str, ArrayType]]
Lines = Iterable[Tuple[object, ...]]

PAGE_ROWS = 200
"""Rows of a table from which its widths are taken."""
MAX_CELL = 120
GROUP_ROWS = 20_000
GROUP_BYTES = 32 * 1024 * 1024
"""A row group holds as many rows, or about as many bytes."""

_NAMES = {"bool": "bool_", "string": "string", "mixed": "string"}
"""Those of pyarrow's functions that are not called like the ROS type."""
_MAX_INT64 = 2**63 - 1
_QUOTED = set('",\r\n')


def write_table(columns: Columns, rows: Lines, stream: IO[str]) -> None:
    """Write aligned columns for people; long values are cut.

    The widths are those of the first rows: what is longer later moves the rest of its line.
    """
    lines = iter(rows)
    texts: list[list[str]] = []
    kinds: list[list[bool | None]] = []
    for row in islice(lines, PAGE_ROWS):  # of long values nothing is kept
        texts.append([_cell(value) for value in row])
        kinds.append([None if value is None else _is_number(value) for value in row])
    right = [_are_numbers(column) for column in zip(*kinds)] or [False] * len(columns)
    header = [shown(name) for name in columns]
    widths = [max(map(len, column)) for column in zip(header, *texts)]
    later = ([_cell(value) for value in row] for row in lines)
    for line in chain([header], texts, later):
        stream.write(align(line, widths, right) + "\n")


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _are_numbers(kinds: Sequence[bool | None]) -> bool:
    found = [number for number in kinds if number is not None]
    return bool(found) and all(found)


def _cell(value: object) -> str:
    return "-" if value is None else shown(_text(value), MAX_CELL)


def _text(value: object) -> str:
    if isinstance(value, str):
        return str(value)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Stamp):
        return iso_time(value.ns)
    if hasattr(value, "to_nsec"):
        ns = int(value.to_nsec())
        return f"{'-' if ns < 0 else ''}{abs(ns) // 10**9}.{abs(ns) % 10**9:09d} s"
    if isinstance(value, (bytes, bytearray)):
        return f"<{len(value)} bytes>"
    if isinstance(value, list):
        # More elements than characters are never shown.
        return "[" + ", ".join(_text(element) for element in value[:MAX_CELL]) + "]"
    return "-" if value is None else repr(value)


def write_csv(columns: Columns, rows: Lines, stream: IO[str]) -> None:
    """Write CSV as RFC 4180 has it.

    Times are integer nanoseconds, bytes base64, arrays JSON. What is missing is an empty field,
    and an empty text one in quotes.
    """
    for row in chain([columns], rows):
        if not row or (len(row) == 1 and row[0] is None):
            # An empty line would be no row to many programs.
            stream.write('""')
        for number, value in enumerate(row):  # one by one: together they may be of any size
            stream.write(("," if number else "") + _field(value))
        stream.write("\r\n")


def _field(value: object) -> str:
    if value is None:
        return ""
    text = value if isinstance(value, str) else _exact(value)
    if not text or not _QUOTED.isdisjoint(text):
        return '"' + text.replace('"', '""') + '"'
    return str(text)


def _exact(value: object) -> str:
    if isinstance(value, float):
        return repr(float(value))
    return to_json(value).strip('"') if isinstance(value, (bytes, bytearray)) else to_json(value)


def write_json(columns: Columns, rows: Lines, stream: IO[str]) -> None:
    """Write one list of objects."""
    opening = "[\n"
    for row in rows:
        stream.write(opening)
        _write_object(columns, row, stream)
        opening = ",\n"
    stream.write("[]\n" if opening == "[\n" else "\n]\n")


def write_ndjson(columns: Columns, rows: Lines, stream: IO[str]) -> None:
    """Write an object a line."""
    for row in rows:
        _write_object(columns, row, stream)
        stream.write("\n")


def _write_object(columns: Columns, row: Tuple[object, ...], stream: IO[str]) -> None:
    """Write a row value by value: together they may be of any size."""
    opening = "{"
    for name, value in dict(zip(columns, row)).items():
        stream.write(f"{opening}{_json(name)}: ")
        stream.write(_json(json_value(value)))
        opening = ", "
    stream.write("{}" if opening == "{" else "}")


def _json(value: object) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


def load_parquet() -> tuple[ModuleType, ModuleType]:
    """Import pyarrow and pyarrow.parquet; raises MissingDependency where they are not."""
    purpose = "--output parquet"
    return optional_module("pyarrow", purpose), optional_module("pyarrow.parquet", purpose)


def write_parquet(columns: Types, rows: Lines, stream: IO[bytes]) -> None:
    """Write rows in row groups.

    Numbers keep their types, times are timestamps in UTC and durations durations, both in ns;
    uint8[] is binary, other arrays are lists. Columns whose type differs among the definitions of
    a topic hold JSON.
    """
    arrow, parquet = load_parquet()
    groups = _groups(rows)
    first = next(groups, [])
    kinds = [_narrowed(kind, [row[n] for row in first]) for n, (_, kind) in enumerate(columns)]
    schema = arrow.schema(
        [(name, _arrow_type(arrow, kind)) for (name, _), kind in zip(columns, kinds)]
    )
    with parquet.ParquetWriter(stream, schema) as writer:
        for group in chain([first] if first else [], groups):
            found = zip(schema, kinds, zip(*group))
            arrays = [_array(arrow, field, kind, values) for field, kind, values in found]
            writer.write_table(arrow.Table.from_arrays(arrays, schema=schema))


def _groups(rows: Lines) -> Iterator[list[Tuple[object, ...]]]:
    group: list[Tuple[object, ...]] = []
    size = 0
    for row in rows:
        bound = AnswerBound("a row", "select fewer columns, or write it by --output csv or ndjson")
        bound.take(sum(map(least_bytes, row)))
        group.append(row)
        size += bound.bytes
        if len(group) >= GROUP_ROWS or size >= GROUP_BYTES:
            yield group
            group, size = [], 0
    if group:
        yield group


def _narrowed(kind: ArrayType, values: Sequence[object]) -> ArrayType:
    """Let a sum of integers, of which there is one, be an int64 where it fits."""
    sums = [value for value in values if isinstance(value, int)]
    fits = all(abs(value) <= _MAX_INT64 for value in sums)
    return ArrayType("int64") if kind.kind == "sum" and fits else kind


def _arrow_type(arrow: ModuleType, kind: ArrayType) -> pyarrow.DataType:
    depth = kind.depth
    if kind.kind == "uint8" and depth:
        found, depth = arrow.binary(), depth - 1
    elif kind.kind == "time":
        found = arrow.timestamp("ns", tz="UTC")
    elif kind.kind == "duration":
        found = arrow.duration("ns")
    elif kind.kind == "sum":
        found = arrow.decimal128(38, 0)
    else:
        found = getattr(arrow, _NAMES.get(kind.kind, kind.kind))()
    for _ in range(depth):
        found = arrow.list_(found)
    return found


def _array(
    arrow: ModuleType, field: pyarrow.Field, kind: ArrayType, values: Sequence[object]
) -> pyarrow.Array:
    mixed = kind.kind == "mixed"
    found = [to_json(v) if mixed and v is not None else _plain(v) for v in values]
    try:
        return arrow.array(found, field.type)
    except (arrow.ArrowException, OverflowError) as exc:
        raise InvalidOption(
            f"column {field.name} cannot be written as Parquet's {field.type}: {exc}"
        ) from exc


def _plain(value: object) -> object:
    if isinstance(value, list):
        return [_plain(element) for element in value]
    return int(value.to_nsec()) if hasattr(value, "to_nsec") else value


def write(columns: Types, rows: Lines, output: str, path: str | None, force: bool) -> None:
    """Write rows in one of the forms.

    Args:
        columns: Name and type of each; only Parquet looks at the types.
        rows: Of a statement.
        output: 'table', 'csv', 'json', 'ndjson' or 'parquet'.
        path: A file; None = standard output.
        force: Replace a file that exists.

    Raises:
        MissingDependency: parquet, and pyarrow is not installed.
        InvalidOption: The file exists or cannot be made, or a value does not fit into Parquet.
    """
    binary = output == "parquet"
    with open_output(path, force, binary) as stream:
        if binary:
            write_parquet(columns, rows, stream)
            return
        texts = {"table": write_table, "csv": write_csv, "json": write_json, "ndjson": write_ndjson}
        texts[output]([name for name, _ in columns], rows, stream)
        stream.flush()


@contextmanager
def open_output(path: str | None, force: bool, binary: bool) -> Iterator[IO[Any]]:
    """Open what is written to: standard output, or a file that is there only when it is complete.

    A file is called PATH.active until all is written. What is no regular file (/dev/stdout, a
    pipe) is written to at once.
    """
    if path is None:
        if isinstance(sys.stdout, io.TextIOWrapper):
            sys.stdout.reconfigure(encoding="utf-8")
        yield sys.stdout
        return
    special = os.path.exists(path) and not os.path.isfile(path)
    if os.path.exists(path) and not special and not force:
        raise InvalidOption(f"{path} exists; choose another name, or replace it with --force")
    active = path if special else f"{path}.active"
    try:
        stream: IO[Any] = (
            open(active, "wb") if binary else open(active, "w", encoding="utf-8", newline="")
        )
    except OSError as exc:
        raise InvalidOption(f"{path} cannot be written: {exc.strerror}") from exc
    try:
        with stream:
            yield stream
        if not special:
            os.replace(active, path)
    except BaseException:
        if not special:
            os.unlink(active)
        raise
