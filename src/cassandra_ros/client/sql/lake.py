# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Topics as Parquet files, one for each topic, day and robot: ``TOPIC/day=…/robot=…``.

A file is written anew if the directory lists its buckets otherwise than when it was written, or if
the topic has other columns now. It is written beside the old one, and takes its place whole. What
was written is listed in a file of each topic's folder, which programs that read Parquet ignore
because of its name. Files of messages that the store does not have any more are kept.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable, Iterable, Iterator, Mapping, NamedTuple
from urllib.parse import quote

from cassandra_ros.client.sql.duck_database import DuckDatabase
from cassandra_ros.client.sql.pushed_conditions import PushedRead
from cassandra_ros.client.sql.table_sources import TopicSource
from cassandra_ros.errors import CorruptMessage, InvalidOption, cannot_write
from cassandra_ros.installation import optional_module
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.own_files import lock_own, whole_file
from cassandra_ros.query.arrays.arrow_types import load_arrow
from cassandra_ros.query.plan.pushdown import unwatched
from cassandra_ros.query.tree.field_names import all_fields
from cassandra_ros.query.tree.units import unit_of_field
from cassandra_ros.read import EVERYBODY, TimeRange
from cassandra_ros.store.rows.row_counts import recount_open_buckets
from cassandra_ros.store.tables.directory import STALE_SEC
from cassandra_ros.topics.cassandra_topic import CassandraTopic
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.stored_totals import buckets_of
from cassandra_ros.topics.topic_table import TopicTable

if TYPE_CHECKING:
    import pyarrow

_log = logging.getLogger(__name__)

FILE = "messages.parquet"
"""Name of the file in the folder of a day and robot."""
LISTING = "_lake.json"
"""Name of the file in a topic's folder that lists what was written, and from which state."""
LOCK = "_lake.lock"
"""Name of the file in the lake's folder that the program which writes it has locked."""
NO_ROBOT = "-"
"""Name of the robot in the folder of messages without a nodeID: pandas reads no missing one."""
GROUP_ROWS = 100_000
"""Maximum number of messages in a row group."""
GROUP_BYTES = 64 * 1024 * 1024
"""Size from which a row group is written, bytes in memory."""
_DAY_NS = 86_400 * SECOND_NS
_EPOCH = datetime(1970, 1, 1)
OPEN = "open"
"""State of a file with messages of a bucket that is still being written: it is written again."""

Progress = Callable[[str, int], None]
"""Gets the path of a file that was written or compared, and its number of messages."""


class DayPart(NamedTuple):
    """The messages of a topic by one robot on one day."""

    day: int
    """Number of the day since 1970, UTC."""
    node: str

    @property
    def folder(self) -> str:
        """Its folder, inside that of the topic."""
        date = _EPOCH + timedelta(days=self.day)
        return f"day={date:%Y-%m-%d}/robot={_folder_name(self.node) or NO_ROBOT}"

    @property
    def pushed(self) -> PushedRead:
        """What is read for it."""
        low = self.day * _DAY_NS
        return PushedRead(TimeRange(low, low + _DAY_NS - 1), frozenset([self.node]))


@dataclass
class LakeReport:
    """What was written, or compared, of a lake."""

    files: int = 0
    """Number of files that were written or compared."""
    unchanged: int = 0
    """Number of files that were up to date."""
    messages: int = 0
    """Number of messages in the files that were written or compared."""
    differences: list[str] = field(default_factory=list)
    """What differs between a file and the store, one sentence for each."""


class Lake:
    """A folder with topics as Parquet files.

    Args:
        catalog: The topics.
        folder: The folder; it is made if it is missing.
        topics: Names of the topics; None = all.

    Raises:
        InvalidOption: The folder cannot be made.
        MissingDependency: pyarrow is not installed.
        TopicNotFound: One of the topics is not stored.
    """

    def __init__(
        self, catalog: Catalog, folder: str | os.PathLike[str], topics: Iterable[str] | None = None
    ) -> None:
        self._arrow = load_arrow("a lake")
        self._parquet = optional_module("pyarrow.parquet", "a lake")
        self._catalog = catalog
        self._topics = catalog.all(None) if topics is None else list(map(catalog.get, topics))
        self._folder = Path(folder)
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as exc:
            raise InvalidOption(f"{folder} cannot be made: {exc.strerror}") from exc

    def write(self, progress: Progress = lambda path, count: None) -> LakeReport:
        """Write what is new or has changed.

        Raises:
            InvalidOption: A file cannot be written, or another program writes the lake.
        """
        report = LakeReport()
        with self._write_lock():
            for topic in self._timed_topics():
                self._write_topic(topic, report, progress)
        return report

    @contextmanager
    def _write_lock(self) -> Iterator[None]:
        """Keep other programs from writing: two would write into one file."""
        path = self._folder / LOCK
        try:
            lock = lock_own(path)
        except BlockingIOError as exc:
            reason = "is being written by another program: try again when it has ended"
            raise InvalidOption(f"{self._folder} {reason}") from exc
        except OSError as exc:
            raise InvalidOption(cannot_write(path, exc)) from exc
        try:
            yield
        finally:
            os.close(lock)

    def _timed_topics(self) -> Iterator[CassandraTopic]:
        """Yield the topics whose messages have times."""
        for topic in self._topics:
            if any(table.named for table in topic.tables):
                _log.warning("topic %s is left out: its keys are names, not times", topic.name)
            elif topic.tables:
                yield topic

    def _write_topic(self, topic: CassandraTopic, report: LakeReport, progress: Progress) -> None:
        """Write the files of a topic that are not up to date.

        The listing is written after each file: what was listed is complete after a kill, too.
        """
        source = self._source(topic)
        folder = self._folder / _folder_name(topic.name.lstrip("/"))
        listing = _read_listing(folder)
        schema = hashlib.sha256(source.schema.schema.serialize().to_pybytes()).hexdigest()
        files = listing["files"] if listing.get("schema") == schema else {}
        for day_part, state in self._parts(source.tables):
            written = files.get(day_part.folder, {})
            path = folder / day_part.folder / FILE
            if state != OPEN and written.get("state") == state and path.exists():
                report.unchanged += 1
                continue
            source.pushed = day_part.pushed
            count = self._write_file(source, path)
            if count:
                files[day_part.folder] = {"state": state, "messages": count}
                report.files += 1
                report.messages += count
                progress(str(path), count)
            if count or files:
                _write_listing(folder, {"topic": topic.name, "schema": schema, "files": files})

    def _source(self, topic: CassandraTopic) -> TopicSource:
        return TopicSource(self._catalog.keyspace, topic, EVERYBODY, None, unwatched)

    def _parts(self, tables: Iterable[TopicTable]) -> list[tuple[DayPart, str]]:
        """Return the parts of a topic, each with the state of its buckets in the directory.

        The state is OPEN, or a digest that is another one when messages or runs may have changed.
        """
        states: dict[DayPart, list[Any]] = {}
        unfinished: set[DayPart] = set()
        for table in tables:
            directory = self._catalog.keyspace.directory
            rows = buckets_of(directory, table)
            # What a killed recorder or a deletion has left open is counted, or it would be written
            # each time. With a TTL messages go one by one, and the lake keeps them.
            counts_hold = not table.metadata.ttl
            for row in recount_open_buckets(directory, table, rows) if counts_hold else rows:
                finished = row.closed or (counts_hold and row.age_sec > STALE_SEC)
                if finished and not row.rows:
                    continue
                low = row.bucket * table.metadata.bucket_ns
                high = low + table.metadata.bucket_ns - 1
                for day in range(low // _DAY_NS, high // _DAY_NS + 1):
                    day_part = DayPart(day, row.node)
                    run = self._catalog.keyspace.runs.text(row.writer)  # column RUN
                    counts = (row.rows, row.bytes, row.t_min, row.t_max, row.odd, run)
                    states.setdefault(day_part, []).append(
                        (table.name, row.bucket, row.writer, counts)
                    )
                    if not finished:
                        unfinished.add(day_part)
        return [
            (day_part, OPEN if day_part in unfinished else _json_digest(sorted(rows)))
            for day_part, rows in sorted(states.items())
        ]

    def _write_file(self, source: TopicSource, path: Path) -> int:
        """Write the messages of a part; return their number.

        Without messages nothing is written, and a file that is there stays.
        """
        schema = source.schema.schema.with_metadata(_metadata(source.topic, source.tables))
        groups = (table for table in self._groups(source, schema) if table.num_rows)
        table = next(groups, None)
        if table is None:
            return 0
        count = 0
        draft = path.with_name(f".{path.name}.active")  # readers of a folder pass such names over
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with whole_file(path, draft) as file:
                with self._parquet.ParquetWriter(file, schema, compression="zstd") as writer:
                    while table is not None:
                        writer.write_table(table.sort_by("KEY"), row_group_size=GROUP_ROWS)
                        count += table.num_rows
                        table = next(groups, None)
        except OSError as exc:
            raise InvalidOption(cannot_write(path, exc)) from exc
        return count

    def _groups(self, source: TopicSource, schema: pyarrow.Schema) -> Iterator[pyarrow.Table]:
        """Yield what a source reads in row groups, in the order in which it is read."""
        batches: list[pyarrow.RecordBatch] = []
        rows = size = 0
        for batch in source.batches():
            batches.append(batch)
            rows += batch.num_rows
            size += batch.nbytes
            if rows >= GROUP_ROWS or size >= GROUP_BYTES:
                yield self._arrow.Table.from_batches(batches).cast(schema)
                batches, rows, size = [], 0, 0
        if batches:
            yield self._arrow.Table.from_batches(batches).cast(schema)

    def verify(self, progress: Progress = lambda path, count: None) -> LakeReport:
        """Compare the files with the store: their numbers of messages, and a digest of all values.

        A file that cannot be read is a difference.

        Raises:
            MissingDependency: DuckDB is not installed.
        """
        report = LakeReport()
        for topic in self._timed_topics():
            source = self._source(topic)
            folder = self._folder / _folder_name(topic.name.lstrip("/"))
            parts = {day_part.folder: day_part for day_part, _ in self._parts(source.tables)}
            for name in sorted({*parts, *_read_listing(folder)["files"]}):
                path = folder / name / FILE
                stored: tuple[int, int | None] = (0, None)
                if name in parts:  # else all its messages were deleted
                    source.pushed = parts[name].pushed
                    stored = _count_and_digest(source)
                in_file: tuple[int, int | None] = (0, None)
                if path.exists():
                    try:
                        in_file = _count_and_digest(_FileSource(self._parquet, path))
                    except (self._arrow.ArrowException, OSError, CorruptMessage) as exc:
                        report.differences.append(f"{path} cannot be read: {exc}")
                        continue
                report.files += 1
                report.messages += in_file[0]
                progress(str(path), in_file[0])
                if in_file[0] != stored[0]:
                    text = f"{path} has {in_file[0]} messages, the store {stored[0]}"
                    report.differences.append(text)
                elif in_file != stored:
                    report.differences.append(f"{path} has other values than the store")
        return report


class _FileSource:
    """A Parquet file as DuckDB scans it."""

    def __init__(self, parquet: Any, path: Path) -> None:
        self._file = parquet.ParquetFile(path)

    def __arrow_c_schema__(self) -> Any:
        return self._file.schema_arrow.__arrow_c_schema__()

    def __arrow_c_stream__(self, requested_schema: object = None) -> Any:
        arrow, schema = load_arrow("a lake"), self._file.schema_arrow
        batches = self._file.iter_batches(4096)
        return arrow.RecordBatchReader.from_batches(schema, batches).__arrow_c_stream__()


def _count_and_digest(source: TopicSource | _FileSource) -> tuple[int, int | None]:
    """Return the number of rows of a table, and a digest of them that their order does not change.

    The digest is the sum of the hashes of all rows, by DuckDB; None = there are no rows.
    """
    database = DuckDatabase()
    try:
        database.add_table("messages", source)
        statement = "SELECT count(*), sum(hash(m)::HUGEINT) FROM messages m"
        ((count, digest),) = database.connection.execute(statement).fetchall()
        return count, digest
    except database.duckdb.Error as exc:
        error = getattr(source, "error", None)
        raise error or CorruptMessage(f"a file of the lake cannot be read: {exc}") from exc
    finally:
        database.close()


def _folder_name(name: str) -> str:
    """Return a name as that of a folder which no reader takes for hidden."""
    folder = quote(name, safe="")
    first = {"_": "%5F", ".": "%2E", "-": "%2D"}.get(folder[:1])
    return folder if first is None else first + folder[1:]


def _json_digest(state: Any) -> str:
    return hashlib.sha256(json.dumps(state).encode()).hexdigest()


def _read_listing(folder: Path) -> dict[str, Any]:
    """Return what was written of a topic: 'files' always, 'schema' if the listing is there."""
    try:
        listing = json.loads((folder / LISTING).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {"files": {}}  # all files are written anew
    valid = isinstance(listing, dict) and isinstance(listing.get("files"), dict)
    return listing if valid else {"files": {}}


def _write_listing(folder: Path, listing: Mapping[str, Any]) -> None:
    """Write the listing whole: a kill leaves the old one or the new one."""
    try:
        with whole_file(folder / LISTING) as file:
            file.write(json.dumps(listing, indent=1).encode("utf-8"))
    except OSError as exc:
        raise InvalidOption(cannot_write(folder / LISTING, exc)) from exc


def _metadata(topic: CassandraTopic, tables: Iterable[TopicTable]) -> dict[str, str]:
    """Return what a file says of itself: topic, types with definitions, units of fields."""
    types, units = {}, {}
    for table in tables:
        metadata, definition = table.metadata, table.definition
        key = " ".join((metadata.md5sum, *(table.kind.arrays or ())))  # which the md5 leaves out
        types[key] = {"type": metadata.msg_type, "definition": metadata.definition}
        for ref in () if definition is None else all_fields(definition):
            unit = unit_of_field(ref.steps, definition) if definition is not None else ""
            if unit:
                units[ref.column] = unit
            elif ref.type in ("time", "duration"):
                units[ref.column] = "ns"
    return {
        "cassandra_ros.topic": topic.name,
        "cassandra_ros.types": json.dumps(types),
        "cassandra_ros.units": json.dumps(units, ensure_ascii=False),
    }
