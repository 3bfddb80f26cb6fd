# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Write the rows of a statement while they are read: as table, csv, json, ndjson or Parquet."""

from __future__ import annotations

import io
import json
import os
import sys
from contextlib import contextmanager
from itertools import chain, islice
from pathlib import Path
from types import ModuleType
from typing import IO, TYPE_CHECKING, Any, Iterable, Iterator, Sequence, Tuple

from cassandra_ros.cli.terminal_text import align, write_utf8
from cassandra_ros.errors import CassandraRosError, InvalidOption, cannot_write
from cassandra_ros.installation import optional_module
from cassandra_ros.messages.stamps import Stamp, iso_time
from cassandra_ros.own_files import whole_file
from cassandra_ros.printable import shown
from cassandra_ros.query.arrays.array_types import ArrayType
from cassandra_ros.query.tree.json_values import AnswerBound, json_value, least_bytes, to_json

if TYPE_CHECKING:
    import pyarrow

ColumnNames = Sequence[str]
"""Name of each column; two columns may have the same one."""
ColumnTypes = Sequence[Tuple[str, ArrayType]]
"""Name and type of each column."""
Rows = Iterable[Tuple[object, ...]]

WIDTH_SAMPLE_ROWS = 200
"""Number of first rows of a table from which the column widths are computed."""
MAX_CELL = 120
"""Maximum number of characters in a cell of a table."""
GROUP_ROWS = 20_000
"""Maximum number of rows in a row group of Parquet."""
GROUP_BYTES = 32 * 1024 * 1024
"""Approximate maximum size of a row group of Parquet, bytes."""

_NAMES = {"bool": "bool_", "string": "string", "mixed": "string"}
"""ROS type -> function of pyarrow that makes the type, if it has another name."""
_MAX_INT64 = 2**63 - 1
_QUOTED = set('",\r\n')


def write_table(columns: ColumnNames, rows: Rows, stream: IO[str]) -> None:
    """Write aligned columns for people; long values are cut.

    The column widths are those of the first WIDTH_SAMPLE_ROWS rows. A longer value in a later row
    shifts the rest of its line.
    """
    lines = iter(rows)
    texts: list[list[str]] = []
    kinds: list[list[bool | None]] = []
    for row in islice(lines, WIDTH_SAMPLE_ROWS):  # only the cut texts are kept in memory
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
    """Return whether all values of a column are numbers, of which there is one; None = no value."""
    present = [is_number for is_number in kinds if is_number is not None]
    return bool(present) and all(present)


def _cell(value: object) -> str:
    return "-" if value is None else shown(_text(value), MAX_CELL)


def _text(value: object) -> str:
    """Return a value as text for people: exact times, but only the first elements of an array."""
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
    if isinstance(value, dict):
        return "{" + ", ".join(f"{name}: {_text(element)}" for name, element in value.items()) + "}"
    return "-" if value is None else repr(value)


def write_csv(columns: ColumnNames, rows: Rows, stream: IO[str]) -> None:
    """Write CSV as defined in RFC 4180.

    Times are integer nanoseconds, bytes base64, arrays JSON. A missing value is an empty field, an
    empty text is an empty field in quotes.
    """
    for row in chain([columns], rows):
        if not row or (len(row) == 1 and row[0] is None):
            # Many programs ignore empty lines.
            stream.write('""')
        for number, value in enumerate(row):  # one by one: the whole row may be very large
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
    """Return a value that is not a text as exact text: as JSON, but NaN and infinities by name."""
    if isinstance(value, float):
        return repr(float(value))
    text = to_json(value)
    return text.strip('"') if isinstance(value, (bytes, bytearray)) else text


def write_json(columns: ColumnNames, rows: Rows, stream: IO[str]) -> None:
    """Write the rows as one JSON list of objects."""
    opening = "[\n"
    for row in rows:
        stream.write(opening)
        _write_object(columns, row, stream)
        opening = ",\n"
    stream.write("[]\n" if opening == "[\n" else "\n]\n")


def write_ndjson(columns: ColumnNames, rows: Rows, stream: IO[str]) -> None:
    """Write each row as a JSON object on a line of its own."""
    for row in rows:
        _write_object(columns, row, stream)
        stream.write("\n")


def _write_object(columns: ColumnNames, row: tuple[object, ...], stream: IO[str]) -> None:
    """Write a row as a JSON object, value by value: the whole row may be very large."""
    opening = "{"
    for name, value in dict(zip(columns, row)).items():
        stream.write(f"{opening}{_json(name)}: ")
        stream.write(_json(json_value(value)))
        opening = ", "
    stream.write("{}" if opening == "{" else "}")


def _json(value: object) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


def load_parquet() -> tuple[ModuleType, ModuleType]:
    """Return the modules pyarrow and pyarrow.parquet.

    Raises:
        MissingDependency: They are not installed.
    """
    purpose = "--output parquet"
    return optional_module("pyarrow", purpose), optional_module("pyarrow.parquet", purpose)


def write_parquet(columns: ColumnTypes, rows: Rows, stream: IO[bytes]) -> None:
    """Write rows to Parquet in row groups.

    Numbers keep their types. Times become timestamps in UTC and durations become durations, both
    in ns. uint8[] becomes binary, other arrays become lists. If the definitions of a topic give a
    column different types, its values are JSON texts.
    """
    arrow, parquet = load_parquet()
    groups = _groups(rows)
    first = next(groups, [])
    kinds = [_narrow_type(kind, [row[n] for row in first]) for n, (_, kind) in enumerate(columns)]
    schema = arrow.schema(
        [(name, _arrow_type(arrow, kind)) for (name, _), kind in zip(columns, kinds)]
    )
    with parquet.ParquetWriter(stream, schema) as writer:
        for group in chain([first] if first else [], groups):
            fields = zip(schema, kinds, zip(*group))
            arrays = [_array(arrow, field, kind, values) for field, kind, values in fields]
            writer.write_table(arrow.Table.from_arrays(arrays, schema=schema))


def write_batches(batches: Iterator[pyarrow.RecordBatch], path: str | None, force: bool) -> None:
    """Write record batches of Arrow to Parquet, with their own types; there is at least one batch.

    Raises:
        MissingDependency: pyarrow is not installed.
        InvalidOption: The file exists or cannot be made, or Parquet has no such type.
    """
    arrow, parquet = load_parquet()
    first = next(batches)
    try:
        with open_output(path, force, True) as stream:
            with parquet.ParquetWriter(stream, first.schema) as writer:
                for batch in chain([first], batches):
                    writer.write_batch(batch, row_group_size=GROUP_ROWS)
    except arrow.ArrowNotImplementedError as exc:
        raise InvalidOption(f"Parquet cannot hold this: {exc}; cast the column to text") from exc


def _groups(rows: Rows) -> Iterator[list[tuple[object, ...]]]:
    """Yield the rows in row groups. AnswerTooLarge: a row alone has too many bytes."""
    group: list[tuple[object, ...]] = []
    size = 0
    for row in rows:
        bound = AnswerBound("a row", "select fewer columns, or write it by --output csv or ndjson")
        bound.count_part(sum(map(least_bytes, row)))
        group.append(row)
        size += bound.bytes
        if len(group) >= GROUP_ROWS or size >= GROUP_BYTES:
            yield group
            group, size = [], 0
    if group:
        yield group


def _narrow_type(kind: ArrayType, values: Sequence[object]) -> ArrayType:
    """Return the type int64 for a column of integer sums if all values fit, else the same type.

    Args:
        kind: Type of the column.
        values: Its values in the first row group. A later value that does not fit is an error,
            because the file begins with the type.
    """
    sums = [value for value in values if isinstance(value, int)]
    fits = all(abs(value) <= _MAX_INT64 for value in sums)
    return ArrayType("int64") if kind.kind == "sum" and fits else kind


def _arrow_type(arrow: ModuleType, kind: ArrayType) -> pyarrow.DataType:
    depth = kind.depth
    if kind.kind == "uint8" and depth:
        column_type, depth = arrow.binary(), depth - 1
    elif kind.kind == "time":
        column_type = arrow.timestamp("ns", tz="UTC")
    elif kind.kind == "duration":
        column_type = arrow.duration("ns")
    elif kind.kind == "sum":
        column_type = arrow.decimal128(38, 0)
    else:
        column_type = getattr(arrow, _NAMES.get(kind.kind, kind.kind))()
    for _ in range(depth):
        column_type = arrow.list_(column_type)
    return column_type


def _array(
    arrow: ModuleType, field: pyarrow.Field, kind: ArrayType, values: Sequence[object]
) -> pyarrow.Array:
    mixed = kind.kind == "mixed"
    plain_values = [to_json(v) if mixed and v is not None else _plain(v) for v in values]
    try:
        return arrow.array(plain_values, field.type)
    except (arrow.ArrowException, OverflowError) as exc:
        raise InvalidOption(
            f"column {field.name} cannot be written as Parquet's {field.type}: {exc}"
        ) from exc


def _plain(value: object) -> object:
    if isinstance(value, list):
        return [_plain(element) for element in value]
    return int(value.to_nsec()) if hasattr(value, "to_nsec") else value


def write(columns: ColumnTypes, rows: Rows, output: str, path: str | None, force: bool) -> None:
    """Write the rows of a statement.

    Args:
        columns: Name and type of each column; only Parquet uses the types.
        rows: The rows.
        output: Format: 'table', 'csv', 'json', 'ndjson' or 'parquet'.
        path: File to write; None = standard output.
        force: Replace an existing file.

    Raises:
        MissingDependency: The format is Parquet, and pyarrow is not installed.
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
    """Open standard output, or a file that gets its name only when it is complete.

    The file is named PATH.active until then; an error in the block deletes it. If the path is not a
    regular file (/dev/stdout, a pipe), it is written directly. Standard output takes texts,
    whatever ``binary`` says.

    Raises:
        InvalidOption: The file exists, or cannot be made or written.
    """
    if path is None:
        write_utf8()
        yield sys.stdout
        return
    special = os.path.exists(path) and not os.path.isfile(path)
    if os.path.exists(path) and not special and not force:
        raise InvalidOption(f"{path} exists; choose another name, or replace it with --force")
    try:
        with open(path, "wb") if special else whole_file(Path(path), sync=False) as file:
            stream: IO[Any] = (
                file if binary else io.TextIOWrapper(file, encoding="utf-8", newline="")
            )
            try:
                yield stream
            finally:  # into a pipe, also what was written before an error
                stream.flush()
    except OSError as exc:
        if isinstance(exc, (CassandraRosError, BrokenPipeError)):
            raise
        raise InvalidOption(cannot_write(path, exc)) from exc
