# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Conversion of a stored topic to another format, while others read it.

For each definition of the topic a new table is filled, which readers do not see yet. It is compared
with the old tables message by message, and replaces them by one change of its comment
(``store/tables/schema.py``). Some seconds later, when every client has read the comment, the old
tables are dropped. A client that reads one of them then goes on in the new table
(``topics/row_reader.py``).
"""

from __future__ import annotations

import logging
import time
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Dict, Iterator, Sequence, Tuple

from cassandra_ros.errors import (
    AccessDenied,
    CassandraRosError,
    DefinitionError,
    SchemaConflict,
    TopicNotFound,
)
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.formats.table import FALLBACK_FORMAT, format_class
from cassandra_ros.metadata import Kind, TopicMetadata
from cassandra_ros.read import EVERYBODY, Read, TimeRange, Whose
from cassandra_ros.store.rows.fetch import list_names
from cassandra_ros.store.tables import replacement
from cassandra_ros.store.tables.directory import STALE_SEC
from cassandra_ros.store.tables.expiry import set_lifetime
from cassandra_ros.store.tables.lengths import span_for
from cassandra_ros.store.tables.schema import TablePlan
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.new_tables import check_packed, planner
from cassandra_ros.topics.stored_totals import ALL_BUCKETS, buckets_of, writers_of
from cassandra_ros.topics.topic_table import TopicTable
from cassandra_ros.topics.upkeep.table_copy import NewRobots, Progress, TableCopy

_log = logging.getLogger(__name__)

MAX_TRIES = 3
"""Maximum number of times that a table is filled if other clients change the old ones meanwhile."""
QUIET_SEC = STALE_SEC
"""Silence of a writer after which its open bucket counts as abandoned, s."""
DELETING_SEC = 5.0
"""Time after a deletion within which a bucket counts as in use, s. A client that goes on deleting
renews the mark."""
LOOK_SEC = 1.0
"""Interval at which the directory is asked whether a writer goes on, s."""


@dataclass
class Converted:
    """Result of a conversion, after which all messages are in the new tables."""

    topic: str
    format: str
    """The requested format."""
    messages: int = 0
    """Number of converted messages; 0 if all were already in this format."""
    tables: int = 0
    """Number of replaced tables."""
    warnings: list[str] = field(default_factory=list)


class _Changed(Exception):
    """A table was changed while it was copied."""


@dataclass(frozen=True)
class _Plan:
    """The tables of one definition, and the format of the table that will replace them."""

    olds: Sequence[TopicTable]
    newest: TopicTable
    format: str

    @property
    def metadata(self) -> TopicMetadata:
        """Metadata for the planner of the new table: its indexes are only fields, without columns.

        Of a format with blocks, span_ns is still to be set.
        """
        fields = {name: "" for old in self.olds for name in old.metadata.indexes}
        names = {n: f for old in self.olds for n, f in old.metadata.index_names.items()}
        return self.newest.metadata.with_(
            format=self.format, span_ns=0, indexes=fields, index_names=names
        )


def convert_topic(
    space: Keyspace, topic: str, format_name: str, progress: Progress = None
) -> Converted:
    """Store a topic in another format from now on, while others read it.

    Readers see each message at all times, and once; their keys and cursors stay valid. The messages
    keep their bytes, times, nodes, runs and connections. Messages that expire keep their remaining
    lifetime, rounded up to a hundredth of the topic's TTL; in topics with a time key it is that of
    the latest message in the same bucket (at most a 24th of the TTL longer). Messages that clients
    add meanwhile go into another table, in the new format unless the client asks for another one. A
    conversion that was killed begins again when it is called again, with the same result.

    Args:
        topic: Full name of the topic.
        progress: Called with the number of messages written or compared so far, and the total.

    Raises:
        TopicNotFound, UnknownFormat.
        InvalidOption: Messages with names or values as keys cannot be packed; nothing was made.
        SchemaConflict: The topic is being recorded, or was changed or removed meanwhile.
        WriteFailed, StoreUnavailable, CorruptMessage: The topic stays in its old format.
    """
    report = Converted(topic, format_name)
    plans = _plans(space, report)
    if not plans:
        _clear_leftovers(space, topic)
        return report
    for plan in plans:
        if format_class(plan.format).PACKED:
            check_packed(plan.metadata, plan.newest.definition)
    _await_writers(space, topic, [old for plan in plans for old in plan.olds])
    _clear_leftovers(space, topic)
    for plan in plans:
        report.messages += Conversion(space, plan, progress, {}).run()
        report.tables += len(plan.olds)
    return report


def move_messages(space: Keyspace, topic: str, robots: NewRobots, progress: Progress) -> None:
    """Give messages of a topic another nodeID, while others read it; as convert_topic.

    The tables that have such messages are replaced by others of the same format. If it was killed,
    the same call goes on.

    Raises:
        SchemaConflict, WriteFailed, StoreUnavailable, CorruptMessage: As convert_topic; the
            messages that were not moved keep their nodeID.
    """
    listed = space.schema.listing(fresh=True).every
    tables = space.tables.of_topic(topic)
    has_moves = any(_has_moves(space, table, robots) for table in tables)
    # A killed call may have moved all messages, and left the earlier table.
    has_leftovers = any(name in listed for table in tables for name in table.metadata.replaces)
    if not has_moves and not has_leftovers:
        return
    _await_writers(space, topic, tables)
    _clear_leftovers(space, topic)
    for table in space.tables.of_topic(topic):
        if _has_moves(space, table, robots):
            plan = _Plan([table], table, table.metadata.format)
            Conversion(space, plan, progress, robots).run()


def _has_moves(space: Keyspace, table: TopicTable, robots: NewRobots) -> bool:
    """Return whether a table has messages that get another nodeID."""
    return any(pair in robots for pair in writers_of(space.directory, table))


def _plans(space: Keyspace, report: Converted) -> list[_Plan]:
    """Return the work to do, by definition; empty if all is in the requested format."""
    format_class(report.format)
    space.schema.tables(fresh=True)
    tables = space.tables.of_topic(report.topic)
    if not tables:
        raise TopicNotFound(f"topic {report.topic} has no type yet: there is nothing to convert")
    groups: dict[Kind, list[TopicTable]] = {}
    for table in tables:
        groups.setdefault(table.kind, []).append(table)
    plans = []
    for olds in groups.values():
        newest = max(olds, key=lambda old: (old.metadata.date, old.name))
        usable = _usable_format(newest, report)
        if [old.metadata.format for old in olds] != [usable]:
            plans.append(_Plan(olds, newest, usable))
    return plans


def _usable_format(table: TopicTable, report: Converted) -> str:
    """Return the requested format, or binary if it cannot use the definition."""
    metadata = table.metadata
    try:
        fmt = format_class(report.format)(metadata.msg_type, metadata.md5sum, table.definition)
        if report.format != FALLBACK_FORMAT:
            fmt.require_class()
        return report.format
    except DefinitionError as exc:
        text = (
            f"messages of topic {report.topic} with type {metadata.msg_type} [{metadata.md5sum}] "
            f"are kept as binary, their fields cannot be queried: {exc}"
        )
        report.warnings.append(text)
        _log.warning("%s", text)
        return FALLBACK_FORMAT


State = Dict[Tuple[object, ...], object]
"""What a client changes when it writes to tables or deletes in them: the entry of a writer's bucket
→ its heartbeat; a table with names → a number that is another one for other messages."""


def _state(space: Keyspace, tables: Sequence[TopicTable]) -> State:
    """Return the state of tables by the directory, which writers and deletions change first.

    The directory does not list messages with names, so these are read.
    """
    state: State = {}
    for table in tables:
        if table.named:
            names = [key.position for key in list_names(table, None)]
            state[table.name,] = (len(names), sum(map(hash, names)))
            continue
        for row in buckets_of(space.directory, table, EVERYBODY):
            state[table.name, row.node, row.bucket, row.writer] = row.heartbeat
    return state


def _await_writers(space: Keyspace, topic: str, tables: Sequence[TopicTable]) -> None:
    """Wait until no client writes to the tables, or deletes in them.

    It returns at once if no bucket is in use, else when the clients that use one have been silent
    for long enough: QUIET_SEC, or DELETING_SEC. Messages with names have no buckets, so nothing is
    waited for.

    Raises:
        SchemaConflict: A client goes on, or began meanwhile.
    """
    first: State | None = None
    while True:
        now: State = {}
        for table in tables:
            for row in () if table.named else buckets_of(space.directory, table, EVERYBODY):
                quiet_sec = QUIET_SEC if row.writing else DELETING_SEC
                if not row.closed and row.age_sec <= quiet_sec:
                    now[table.name, row.node, row.bucket, row.writer] = row.heartbeat
        if not now:
            return
        if first is None:
            first = now
            text = (
                "topic %s has a writer that did not end, or was deleted from just now: waiting up "
                "to %.0f s to see whether a client goes on"
            )
            _log.warning(text, topic, QUIET_SEC)
        if any(first.get(place) != beat for place, beat in now.items()):
            raise SchemaConflict(
                f"topic {topic} is being recorded and cannot be copied into another format, or for "
                "another robot: end the recording, or the clients that add messages to it, and try "
                "it again; nothing was changed in the topic"
            )
        time.sleep(LOOK_SEC)


def _clear_leftovers(space: Keyspace, topic: str) -> None:
    """Delete what killed conversions left, and the entries of replaced tables.

    Before that, what clients stored in a replaced table after the switch is copied. No client
    may write into the new table meanwhile: it may be the one whose rows are copied.
    """
    listed = space.schema.listing(fresh=True).every
    replaced: list[tuple[TopicTable, list[TopicTable]]] = []
    for table in space.tables.of_topic(topic):
        names = [name for name in table.metadata.replaces if name in listed]
        if names and table.metadata.since_us:
            replaced.append((table, [space.tables.get(name, listed[name]) for name in names]))
    _await_writers(space, topic, [table for table, _ in replaced])
    for table, olds in replaced:
        TableCopy(space, olds, table, None, {}).add_written_since(table.metadata.since_us)
    replacement.clear(space.schema, topic, space.delete_entries)
    for table in space.tables.of_topic(topic):
        for old in table.metadata.replaces:
            if space.directory.nodes(old, *ALL_BUCKETS):
                space.delete_entries(old)


def block_span(space: Keyspace, tables: Sequence[TopicTable], connections: int) -> int:
    """Return the maximum time range of a block with the messages of some tables, ns; 0 = unknown.

    Args:
        connections: Number of their connections.
    """
    span_ns = max(table.metadata.span_ns for table in tables)
    if span_ns:
        return span_ns
    rows = [r for table in tables for r in buckets_of(space.directory, table) if r.rows]
    # As if each writer had the same number of connections: only the magnitude matters.
    per_writer = max(1.0, connections / max(1, len({row.writer for row in rows})))
    seconds = [max(1.0, (row.t_max - row.t_min) / SECOND_NS) * per_writer for row in rows]
    rate_hz = max((row.rows / lasted for row, lasted in zip(rows, seconds)), default=0.0)
    rate = max((row.bytes / lasted for row, lasted in zip(rows, seconds)), default=0.0)
    return span_for(rate_hz, rate)


class Conversion:
    """Conversion of the tables of one definition of a topic.

    Args:
        robots: Messages that get another nodeID; see TableCopy.
    """

    def __init__(self, space: Keyspace, plan: _Plan, progress: Progress, robots: NewRobots) -> None:
        self._space = space
        self._plan = plan
        self._olds = plan.olds
        self._names = [old.name for old in plan.olds]
        self._topic = plan.newest.metadata.topic
        self._progress = progress
        self._robots = robots

    def run(self) -> int:
        """Convert the tables; return the number of messages."""
        tries = 1
        while True:
            try:
                return self._once()
            except _Changed:
                _log.info("topic %s was changed while it was converted; anew", self._topic)
                if tries == MAX_TRIES:
                    raise SchemaConflict(
                        f"topic {self._topic} was changed by other clients whenever it was "
                        "converted; nothing was converted, and nothing lost: end what adds or "
                        "deletes messages, and convert it again"
                    ) from None
                tries += 1

    def _once(self) -> int:
        """Convert the tables once; return the number of messages.

        Raises:
            _Changed: They were changed while they were copied; the new table is deleted.
        """
        new = self._begin()
        try:
            self._await_clients()
            _await_writers(self._space, self._topic, self._olds)
            before = _state(self._space, self._olds)
            copy = TableCopy(self._space, self._olds, new, self._progress, self._robots)
            copy.fill()
            count = copy.compare()
            if new.metadata.ttl:
                set_lifetime(self._space.schema, new.name, new.metadata.ttl)
            if _state(self._space, self._olds) != before:
                raise _Changed
            # From here on readers see the new table, and nothing takes that back.
            replacement.finish(self._space.schema, new.name, self._names)
        except BaseException:
            self._give_up(new)
            raise
        self._await_clients()
        # Before the old tables are dropped: what a client has still stored there.
        if _state(self._space, self._olds) != before:
            copy.add_late()
        else:
            for read in self._open_buckets():
                copy.add_late(read)
        try:
            replacement.drop(self._space.schema, self._names)
        except AccessDenied as exc:
            raise AccessDenied(
                f"topic {self._topic} is converted, but its earlier tables stay on the disk until "
                f"a user who may drop them converts it once more: {exc}",
                right=exc.right,
            ) from exc
        return count

    def _open_buckets(self) -> Iterator[Read]:
        """Yield reads of the old buckets that stayed open.

        What a client wrote there when it reached the store again may have changed nothing in the
        directory.
        """
        for table in self._olds:
            length = table.bucket_ns
            for row in () if table.named else buckets_of(self._space.directory, table, EVERYBODY):
                if not row.closed:
                    low = row.bucket * length
                    whose = Whose((row.node,), frozenset([row.writer]))
                    yield Read(TimeRange(low, low + length - 1), whose)

    def _await_clients(self) -> None:
        """Wait until every client has read the changed comments.

        Before the copy: afterwards no client writes into the old tables. After the switch: clients
        that cannot read the comments may go on writing into the old tables until they can;
        ``add_late`` copies these messages.
        """
        time.sleep(replacement.SETTLE_SEC)

    def _begin(self) -> TopicTable:
        """Make the new table, which readers do not see yet, with the headers of the old ones."""
        headers = list(self._space.registry.headers(self._names))
        span_ns = 0
        if format_class(self._plan.format).PACKED:
            span_ns = block_span(self._space, self._olds, len(headers))
        # What comes late comes after SETTLE_SEC, which is more than clocks of servers differ.
        since_us = self._space.cassandra.server_time_us()
        metadata_of_new = self._plan.metadata.with_(span_ns=span_ns, since_us=since_us)

        def planned(olds: Sequence[TopicMetadata]) -> TablePlan:
            # The plan already contains what the metadata of the other tables say.
            return planner(metadata_of_new, self._plan.newest.definition)([metadata_of_new])

        name, metadata = replacement.begin(self._space.schema, planned, self._topic, self._names)
        new = self._space.tables.get(name, metadata)
        if headers:
            self._space.registry.put_headers([(name, conn, header) for _, conn, header in headers])
        return new

    def _give_up(self, new: TopicTable) -> None:
        """Delete the new table, unless it has already replaced the old ones."""
        with suppress(CassandraRosError):  # the next conversion deletes what is left
            replacement.drop(self._space.schema, [new.name], self._space.delete_entries)
