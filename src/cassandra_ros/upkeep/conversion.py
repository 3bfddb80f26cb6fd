# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A stored topic is kept in another format from now on, while others read it.

Of the tables of each definition a new one is filled that nobody sees, compared with them message by
message, and takes their place by one change of its comment (``tables/succession.py``). Some seconds
later, when every client has heard of it, the old ones are dropped. Whoever is amid one of them then
goes on in the new one (``following.py``).
"""

from __future__ import annotations

import logging
import time
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Dict, List, Optional, Sequence, Tuple

from cassandra_ros.errors import (
    CassandraRosError,
    DefinitionError,
    SchemaConflict,
    TopicNotFound,
)
from cassandra_ros.formats.table import FALLBACK_FORMAT, format_class
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.store.fetch import list_names
from cassandra_ros.tables import replacement
from cassandra_ros.tables.directory import STALE_SEC, span_for
from cassandra_ros.tables.expiry import set_lifetime
from cassandra_ros.tables.schema import Planned
from cassandra_ros.topics.key_selection import EVERYBODY
from cassandra_ros.topics.keyspace import Keyspace, check_packed
from cassandra_ros.topics.stored_totals import buckets_of
from cassandra_ros.topics.topic_table import TopicTable
from cassandra_ros.upkeep.table_copy import Copy, Progress

_log = logging.getLogger(__name__)

MAX_TRIES = 3
"""So often a table is filled while others change what it is filled with."""
QUIET_SEC = STALE_SEC
"""A time range that is open is nobody's when its writer was silent so long."""
DELETING_SEC = 5.0
"""So long after some were deleted from one: before more are it is said anew."""
LOOK_SEC = 1.0


@dataclass
class Converted:
    """What became of a topic; all of it is stored in the new tables."""

    topic: str
    format: str
    """The format that was asked for."""
    messages: int = 0
    """Messages that were converted; 0 where all were in that format."""
    tables: int = 0
    """Tables that were replaced."""
    warnings: List[str] = field(default_factory=list)


class _Changed(Exception):
    """What was copied changed meanwhile."""


@dataclass(frozen=True)
class _Plan:
    """The tables of one definition, and what is to replace them."""

    olds: Sequence[TopicTable]
    newest: TopicTable
    format: str

    @property
    def metadata(self) -> TopicMetadata:
        """What the comment of the new table is to say, as far as it is known before."""
        was = self.newest.metadata
        fields = {name: "" for old in self.olds for name in old.metadata.indexes}
        names = {n: f for old in self.olds for n, f in old.metadata.index_names.items()}
        return was.with_(format=self.format, span_ns=0, indexes=fields, index_names=names)


def convert_topic(
    space: Keyspace,
    topic: str,
    format_name: str,
    progress: Progress = None,
) -> Converted:
    """Keep a stored topic in another format from now on, while others read it.

    Who reads sees each message all the time and once; keys and cursors that he has stay good. The
    messages keep their bytes, times, nodes, runs and connections. Where they expire they keep the
    time that is left to them, rounded up to a hundredth of the topic's ttl, and of topics by time
    to that of the latest of their time range (a 24th of the ttl at most). What clients add
    meanwhile goes into a table beside, in the new format where they did not ask for another one.
    Killed and started again it begins anew, and ends the same.

    Args:
        topic: Its whole name.
        progress: Called with how many messages of how many were written, or compared afterwards.

    Raises:
        TopicNotFound, UnknownFormat.
        InvalidOption: Messages by names or values cannot be packed; nothing was made.
        SchemaConflict: The topic is being recorded, or was changed or removed meanwhile.
        WriteFailed, StoreUnavailable, CorruptMessage: It stays in the format that it had.
    """
    report = Converted(topic, format_name)
    plans = _plans(space, report)
    if not plans:
        _forget_left(space, topic)
        return report
    for plan in plans:
        if format_class(plan.format).PACKED:
            check_packed(plan.metadata, plan.newest.definition)
    _await_writers(space, topic, [old for plan in plans for old in plan.olds])
    _forget_left(space, topic)
    for plan in plans:
        report.messages += Conversion(space, plan, progress).run()
        report.tables += len(plan.olds)
    return report


def _plans(space: Keyspace, report: Converted) -> List[_Plan]:
    """Plan what is to be done, by definition; nothing where it is done."""
    format_class(report.format)
    space.schema.tables(fresh=True)
    tables = space.tables.of_topic(report.topic)
    if not tables:
        raise TopicNotFound(f"topic {report.topic} has no type yet: there is nothing to convert")
    groups: Dict[Tuple[str, str], List[TopicTable]] = {}
    for table in tables:
        groups.setdefault(table.metadata.kind, []).append(table)
    plans = []
    for olds in groups.values():
        newest = max(olds, key=lambda old: (old.metadata.date, old.name))
        wanted = _usable_format(newest, report)
        if [old.metadata.format for old in olds] != [wanted]:
            plans.append(_Plan(olds, newest, wanted))
    return plans


def _usable_format(table: TopicTable, report: Converted) -> str:
    """Return the format that was asked for, or binary where the definition cannot be used."""
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


def _state(space: Keyspace, tables: Sequence[TopicTable]) -> State:
    """Tell by the directory what lies in tables: who adds or deletes rows notes it there first.

    Of messages under names, which it does not list, all names are counted.
    """
    found: State = {}
    for table in tables:
        if table.named:
            names = [key.position for key in list_names(table, None)]
            found[table.name,] = (len(names), sum(map(hash, names)))
            continue
        for row in buckets_of(space.directory, table, EVERYBODY):
            found[table.name, row.node, row.bucket, row.writer] = row.heartbeat
    return found


def _await_writers(space: Keyspace, topic: str, tables: Sequence[TopicTable]) -> None:
    """Return when nobody has tables open; SchemaConflict: somebody records the topic."""
    first: Optional[State] = None
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
                "topic %s has a writer that did not end, or was deleted from just now: looking for "
                "up to %.0f s whether somebody goes on"
            )
            _log.warning(text, topic, QUIET_SEC)
        if any(first.get(place) != beat for place, beat in now.items()):
            raise SchemaConflict(
                f"topic {topic} is being recorded and cannot be converted now: end the recording, "
                "or the clients that add messages to it, and convert it again; nothing was changed"
            )
        time.sleep(LOOK_SEC)


def _forget_left(space: Keyspace, topic: str) -> None:
    """Remove what killed conversions left, and what is still noted of replaced tables."""
    for name in replacement.clear(space.schema, topic):
        space.directory.forget(name)
        space.registry.forget(name)
        space.place_index.forget(name)
    for table in space.tables.of_topic(topic):
        for old in table.metadata.replaces:
            if space.directory.nodes(old, -(2**63), 2**63 - 1):
                space.directory.forget(old)
                space.registry.forget(old)
                space.place_index.forget(old)


class Conversion:
    """Converts the tables of one definition of a topic."""

    def __init__(self, space: Keyspace, plan: _Plan, progress: Progress) -> None:
        self._space = space
        self._plan = plan
        self._olds = plan.olds
        self._names = [old.name for old in plan.olds]
        self._topic = plan.newest.metadata.topic
        self._progress = progress

    def run(self) -> int:
        """Do it; return the number of messages."""
        for left in reversed(range(MAX_TRIES)):
            try:
                return self._once()
            except _Changed:
                _log.info("topic %s was changed while it was converted; anew", self._topic)
                if not left:
                    raise SchemaConflict(
                        f"topic {self._topic} was changed by other clients whenever it was "
                        "converted; nothing was converted, and nothing lost: end what adds or "
                        "deletes messages, and convert it again"
                    ) from None
        raise AssertionError("the loop above returns or raises")

    def _once(self) -> int:
        new = self._begin()
        try:
            self._settle()
            _await_writers(self._space, self._topic, self._olds)
            before = _state(self._space, self._olds)
            copy = Copy(self._space, self._olds, new, self._progress)
            copy.fill()
            count = copy.compare()
            if new.metadata.ttl:
                set_lifetime(self._space.schema, new.name, new.metadata.ttl)
            if _state(self._space, self._olds) != before:
                raise _Changed
            replacement.finish(self._space.schema, new.name, self._names)
        except BaseException:
            self._give_up(new)
            raise
        self._settle()
        if _state(self._space, self._olds) != before:
            copy.add_late()
        replacement.drop(self._space.schema, self._names)
        return count

    def _settle(self) -> None:
        """Wait until every client has read the changed comments.

        Before the copy: no client of this release writes into the old tables afterwards. After the
        switch: clients of earlier releases, and those that cannot read the comments, may write into
        the old tables until they hear of the new one; ``add_late`` takes these messages along.
        """
        time.sleep(replacement.SETTLE_SEC)

    def _span(self, connections: int) -> int:
        """Choose how much time a block is to cover, ns; 0 = nobody knows, or a row is a message."""
        if not format_class(self._plan.format).PACKED:
            return 0
        known = max(old.metadata.span_ns for old in self._olds)
        if known:
            return known
        rows = [r for old in self._olds for r in buckets_of(self._space.directory, old) if r.rows]
        # As if each writer had as many connections: what counts is about how fast one fills blocks.
        each = max(1.0, connections / max(1, len({row.writer for row in rows})))
        seconds = [max(1.0, (row.t_max - row.t_min) / SECOND_NS) * each for row in rows]
        rate_hz = max((row.rows / lasted for row, lasted in zip(rows, seconds)), default=0.0)
        rate = max((row.bytes / lasted for row, lasted in zip(rows, seconds)), default=0.0)
        return span_for(rate_hz, rate)

    def _begin(self) -> TopicTable:
        headers = list(self._space.registry.headers(self._names))
        wanted = self._plan.metadata.with_(span_ns=self._span(len(headers)))

        def planned(olds: Sequence[TopicMetadata]) -> Planned:
            # As if beside itself: what the others say stands in it already.
            return self._space.planner(wanted, self._plan.newest.definition)([wanted])

        name, metadata = replacement.begin(self._space.schema, planned, self._topic, self._names)
        new = self._space.tables.get(name, metadata)
        for _, conn, header in headers:
            self._space.registry.put_header(name, conn, header)
        return new

    def _give_up(self, new: TopicTable) -> None:
        """Remove the new table, unless it has replaced the others already."""
        with suppress(CassandraRosError):  # the next conversion removes what is left
            replacement.drop(self._space.schema, [new.name])
            if new.name not in self._space.schema.tables():
                self._space.directory.forget(new.name)
                self._space.registry.forget(new.name)
                self._space.place_index.forget(new.name)
