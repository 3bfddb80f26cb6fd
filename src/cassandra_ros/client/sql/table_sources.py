# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What DuckDB scans: objects with the methods of Arrow's C stream interface.

DuckDB reads such an object anew for each table in its plan, also where a table is joined with
itself. It pushes nothing into it, so that all conditions are checked by DuckDB. A table is a topic,
a list such as that of the runs, or the poses of a frame in another: tf('map', 'base_link').
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Callable, Iterator, Sequence

from cassandra_ros.client.sql.event_names import EVENT, EventNames, has_event_field
from cassandra_ros.client.sql.pushed_conditions import UNBOUNDED_READ, PushedRead
from cassandra_ros.errors import InvalidName, TopicNotFound
from cassandra_ros.keys import MAX_NS
from cassandra_ros.places.frame_poses import TF, TF_STATIC, FrameChain, TfRecording
from cassandra_ros.places.poses import Poses
from cassandra_ros.query.arrays.arrow_batches import ArrowSchema, read_record_batches
from cassandra_ros.query.arrays.arrow_types import Wanted, load_arrow
from cassandra_ros.query.plan.pushdown import Pushdown, Watch
from cassandra_ros.read import Read, TimeRange, Whose
from cassandra_ros.topics.cassandra_topic import CassandraTopic
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.event_times import EventTimes
from cassandra_ros.topics.keyspace import Keyspace

if TYPE_CHECKING:
    import pyarrow


class TableSource(ABC):
    """A table for DuckDB, read anew for each scan.

    Args:
        arrow: The module pyarrow.
        columns: Names and Arrow types of the columns.

    Attributes:
        columns: Names and Arrow types of the columns.
        error: Error that ended a read; DuckDB only knows its text.
        hints: Why there are no rows, known when all was read.
    """

    def __init__(self, arrow: Any, columns: pyarrow.Schema) -> None:
        self._arrow = arrow
        self.columns = columns
        self.error: BaseException | None = None
        self.hints: list[str] = []

    def __arrow_c_schema__(self) -> Any:
        return self.columns.__arrow_c_schema__()

    def __arrow_c_stream__(self, requested_schema: object = None) -> Any:
        reader = self._arrow.RecordBatchReader.from_batches(self.columns, self.batches())
        return reader.__arrow_c_stream__()

    def batches(self) -> Iterator[pyarrow.RecordBatch]:
        """Yield what is read, as record batches; keep the error that ends it."""
        try:
            yield from self._batches()
        except Exception as exc:
            self.error = exc
            raise

    @abstractmethod
    def _batches(self) -> Iterator[pyarrow.RecordBatch]:
        """Yield what is read, as record batches."""


class TopicSource(TableSource):
    """The messages of a topic as a table. Hints are names that are not stored.

    Args:
        keyspace: Keyspace of the topic.
        topic: The topic.
        whose: Robots and runs whose messages are read.
        wanted: Columns to read; None = all.
        watch: Called repeatedly during a read; an exception from it ends the read.
        events: Whether there is a column EVENT, if the topic may have one.

    Attributes:
        topic: The topic.
        tables: Tables of the topic when the source was made.
        schema: The columns that are made of messages.
        has_events: Whether EVENT is a column.
        pushed: What is read; the caller sets it when the statement is known.
        messages: Number of messages read so far, in all scans together.
        choosers: What the server checked, one for each scan.
    """

    def __init__(
        self,
        keyspace: Keyspace,
        topic: CassandraTopic,
        whose: Whose,
        wanted: Wanted | None,
        watch: Watch,
        events: bool = False,
    ) -> None:
        self._keyspace = keyspace
        self._whose = whose
        self._watch = watch
        self.topic = topic
        self.tables = topic.tables
        definitions = [t.definition for t in self.tables if t.definition is not None]
        named = any(table.named for table in self.tables)  # names do not lie in the time of events
        self.has_events = events and not named and not has_event_field(definitions)
        if self.has_events and wanted is not None:
            wanted = {**wanted, "node": {}}  # events are those of a robot
        self.schema = ArrowSchema(self.tables, wanted)
        arrow, columns = self.schema.arrow, self.schema.schema
        if self.has_events:
            kind = arrow.list_(arrow.string())
            columns = columns.insert(len(self.schema.own), arrow.field(EVENT, kind))
        super().__init__(arrow, columns)
        self.pushed: PushedRead = UNBOUNDED_READ
        self.messages = 0
        self.choosers: list[Pushdown] = []

    def read(self) -> Read | None:
        """Return what is read; None = no message can match."""
        pushed, whose = self.pushed, self._whose
        if pushed.nodes is not None:
            whose = whose.both(Whose(tuple(sorted(pushed.nodes))))
        if pushed.runs is not None:
            writers = map(self._keyspace.runs.called, pushed.runs)
            whose = whose.both(Whose(None, frozenset().union(*writers)))
        if pushed.empty or whose.empty:
            return None
        # The keys of messages with names are not times.
        time_range = TimeRange() if self.schema.named else pushed.time_range
        return Read(time_range, whose)

    def _batches(self) -> Iterator[pyarrow.RecordBatch]:
        read = self.read()
        if read is not None:
            for batch in self._read_events(read, self._make_chooser()):
                self.messages += batch.num_rows
                yield batch
        if not self.messages and not self.hints:
            self.hints += filter(None, self._unknown_names())

    def _unknown_names(self) -> Iterator[str]:
        """Yield for each name that bounds what is read a text if nothing has it, else ''."""
        pushed, runs = self.pushed, self._keyspace.runs
        yield from map(runs.unknown_robot, sorted(pushed.nodes or ()))
        yield from map(runs.unknown, sorted(pushed.runs or ()))
        yield from map(self._unknown_event, sorted(pushed.events or ()))

    def _unknown_event(self, name: str) -> str:
        try:
            return self._keyspace.events.unknown(name, like=False)
        except InvalidName as exc:  # no event can have this name
            return str(exc)

    def _make_chooser(self) -> Pushdown | None:
        """Return what the server checks in a scan; None = there is no condition."""
        if self.pushed.condition is None:
            return None
        nan, watch = self.pushed.floats, self._watch
        chooser = Pushdown(self.pushed.condition, watch=watch, nan=nan)
        self.choosers.append(chooser)
        return chooser

    def _read_events(self, read: Read, chooser: Pushdown | None) -> Iterator[pyarrow.RecordBatch]:
        """Yield the messages of a read, with EVENT if there is this column."""
        if not self.has_events:
            yield from self._read(read, chooser)
            return
        events, reads = self._keyspace.events.within(read.time_range), [read]
        if self.pushed.events is not None:
            event_times = EventTimes(event for event in events if event.name in self.pushed.events)
            reads = event_times.reads(read)
        names, place = EventNames(self._arrow, events), len(self.schema.own)
        for event_read in reads:
            self._watch()
            for batch in self._read(event_read, chooser):
                arrays = [*batch.columns]
                arrays.insert(place, names.column(batch))
                yield self._arrow.RecordBatch.from_arrays(arrays, schema=self.columns)

    def _read(self, read: Read, chooser: Pushdown | None) -> Iterator[pyarrow.RecordBatch]:
        chosen = replace(read, chooser=chooser)
        batches = partial(self._keyspace.rows.batches, self.tables, chosen)
        return read_record_batches(self.topic.name, self.schema, batches, self._watch)


class ListSource(TableSource):
    """A table of a few rows, such as the runs, made when it is read.

    Args:
        arrow: The module pyarrow.
        columns: Names and Arrow types of its columns.
        rows: Returns its rows; called for each scan.
    """

    def __init__(
        self, arrow: Any, columns: pyarrow.Schema, rows: Callable[[], Sequence[Sequence[Any]]]
    ) -> None:
        super().__init__(arrow, columns)
        self._rows = rows

    def _batches(self) -> Iterator[pyarrow.RecordBatch]:
        columns = list(zip(*self._rows())) or [()] * len(self.columns)
        arrays = [
            self._arrow.array(list(values), field.type)
            for values, field in zip(columns, self.columns)
        ]
        yield self._arrow.RecordBatch.from_arrays(arrays, schema=self.columns)


class FrameSource(TableSource):
    """Poses of a frame in another, for each robot: at each time at which tf has one of the way.

    Columns are KEY (receive time), NODE, translation (m) and rotation (a unit quaternion). A hint
    is a frame that is in no transform.

    Args:
        catalog: The topics.
        whose: Robots and runs whose transforms are read.
        target: Frame in which the poses are.
        frame: The moving frame.
        watch: Called repeatedly during a read; an exception from it ends the read.
    """

    def __init__(
        self, catalog: Catalog, whose: Whose, target: str, frame: str, watch: Watch
    ) -> None:
        arrow = load_arrow("sql")
        self._catalog = catalog
        self._whose = whose
        self._frames = (target, frame)
        self._watch = watch
        kinds = [
            arrow.struct([(axis, arrow.float64()) for axis in axes]) for axes in ("xyz", "xyzw")
        ]
        own = [("KEY", arrow.timestamp("ns")), ("NODE", arrow.string())]
        columns = [*own, *zip(("translation", "rotation"), kinds)]
        super().__init__(arrow, arrow.schema(columns))

    def _robots(self) -> Sequence[str]:
        """Return the nodeIDs with transforms, of those that are asked for.

        Raises:
            TopicNotFound: No transforms of any robot are stored.
        """
        robots: set[str] = set()
        for topic in (TF, TF_STATIC):
            if self._catalog.exists(topic):
                robots.update(self._catalog.keyspace.nodes(self._catalog.get(topic).tables))
        if not robots:
            raise TopicNotFound(f"neither {TF} nor {TF_STATIC} is stored, so there are no frames")
        return sorted(
            robots if self._whose.nodes is None else robots.intersection(self._whose.nodes)
        )

    def _batches(self) -> Iterator[pyarrow.RecordBatch]:
        arrow, (target, frame) = self._arrow, self._frames
        reasons: list[str] = []
        for node in self._robots():
            writers = self._whose.writers
            chain = FrameChain(TfRecording(self._catalog.get, node, writers), frame, target)
            for track in Poses(chain).tracks(0, MAX_NS):
                self._watch()
                keys = arrow.array(track.times, arrow.timestamp("ns"))
                vectors = (track.poses.moved, track.poses.turned)
                structs = [
                    arrow.StructArray.from_arrays(
                        [arrow.array(values[:, n]) for n in range(values.shape[1])],
                        fields=list(field.type),
                    )
                    for values, field in zip(vectors, list(self.columns)[2:])
                ]
                nodes = arrow.repeat(node, len(track.times))
                yield arrow.RecordBatch.from_arrays([keys, nodes, *structs], schema=self.columns)
            reasons.append(chain.unknown_frame())
        if all(reasons) and not self.hints:
            self.hints += reasons[:1]
