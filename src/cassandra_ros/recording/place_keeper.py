# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The index of places, written while poses are recorded, from the messages handed to the store.

A thread indexes a few seconds at a time, after LONGEST_GAP_NS, when later poses cannot change them
any more. Queries read the poses of times that are not indexed, so that the index may be late or
incomplete and answers are still right. Entries that have become wrong (a pose was lost or deleted,
or a clock went back) are deleted.
"""

from __future__ import annotations

import logging
import threading
from bisect import bisect_left, bisect_right
from collections import deque
from concurrent.futures import Future
from functools import partial
from typing import TYPE_CHECKING, Any, Iterator, NamedTuple, Sequence

from cassandra_ros.errors import CassandraRosError, TopicNotFound
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.places.frame_poses import TF, TF_STATIC
from cassandra_ros.places.paths import LONGEST_GAP_NS
from cassandra_ros.places.robots import FIX_TYPES, POSE_TYPES
from cassandra_ros.places.run_index import RobotRun, TfVisits, TopicVisits
from cassandra_ros.places.transforms.transform_samples import TRANSFORM_KIND
from cassandra_ros.query.arrays.batch import row_batches
from cassandra_ros.query.arrays.field_arrays import as_arrays, gather_fields
from cassandra_ros.query.protocols import Row, Table
from cassandra_ros.read import Read, Writers
from cassandra_ros.recording.live_row import LiveRow, LiveTable
from cassandra_ros.recording.losses import LossLog
from cassandra_ros.recording.store_future import is_there
from cassandra_ros.store.tables.place_index import IndexedPoses, VisitRow
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.message_writer import connection_kind
from cassandra_ros.topics.row_finder import range_between

if TYPE_CHECKING:
    from cassandra_ros.recording.message_buffer import MessageSource

_log = logging.getLogger(__name__)

NOTE_SEC = 20.0
"""Interval at which the index is written, s."""
MAX_HELD_BYTES = 64 * 1024 * 1024
"""Maximum size of the pose messages that wait for the index, bytes. Above it indexing ends."""
END_SEC = 10.0
"""Maximum time that the end of a recording waits for the last entries, s."""


class _PoseMessage(NamedTuple):
    """A message with poses that waits to be indexed."""

    source: MessageSource
    t: int
    """Time of reception, ns."""
    wire: bytes


class LiveTopic:
    """The last messages of one topic in memory, with the methods of a stored topic.

    Args:
        before: Messages that were stored before, which belong to the topic, too. ``drop`` keeps
            them.
    """

    def __init__(self, name: str, node: str, before: Sequence[Row] = ()) -> None:
        self.name = name
        self._node = node
        self._tables: dict[str, Table] = {row.table.name: row.table for row in before}
        self._before = list(before)
        self._rows: list[Row] = []
        """The other messages, by time of reception."""
        self._times: list[int] = []
        """Their times, ns."""

    @property
    def tables(self) -> Sequence[Table]:
        """Tables, one for each received type and definition."""
        return list(self._tables.values())

    def add(self, taken: _PoseMessage) -> None:
        """Add a message; one whose definition cannot be used is left out."""
        connection = taken.source.connection
        name = str(connection_kind(connection))
        table = self._tables.get(name)
        if not isinstance(table, LiveTable):
            table = self._tables[name] = LiveTable(connection)
        if table.definition is None:
            return
        row = LiveRow(table, self.name, self._node, taken.t, taken.wire, len(taken.wire))
        at = bisect_right(self._times, taken.t)  # a clock may go back
        self._times.insert(at, taken.t)
        self._rows.insert(at, row)

    def drop(self, before: int) -> int:
        """Remove messages received before a time, ns; return their size, bytes."""
        at = bisect_left(self._times, before)
        nbytes = sum(row.size for row in self._rows[:at])
        del self._times[:at], self._rows[:at]
        return nbytes

    def read(self, read: Read) -> Iterator[Row]:
        """Yield the messages of a time range; all are of one robot and one run."""
        low, high = read.time_range
        first, last = bisect_left(self._times, low), bisect_right(self._times, high)
        rows = [row for row in self._before if low <= row.t <= high] + self._rows[first:last]
        yield from rows[::-1] if read.reverse else rows

    def getArrays(
        self,
        fields: Sequence[str],
        key: Stamp | None = None,
        to_key: Stamp | None = None,
        *,
        nodeID: str | None = None,
        run: Writers = None,
    ) -> dict[str, Any]:
        """Return fields of the messages in [key, to_key] as numpy arrays.

        nodeID and run are ignored: all messages are of one robot and run. A stored topic has them.
        """
        rows = self.read(Read(range_between(key, to_key)))
        return as_arrays(gather_fields(self, fields, None, partial(row_batches, rows)))

    def count(self, read: Read) -> int:
        """Count the messages of a time range."""
        return sum(1 for _ in self.read(read))

    def countBuckets(self) -> int:
        """Return the number of buckets: 0, because nothing is stored."""
        return 0


def tells_places(connection: Connection) -> bool:
    """Return whether the messages of a connection have poses of a robot, or its position."""
    try:
        if connection.topic in (TF, TF_STATIC):
            return connection_kind(connection) == TRANSFORM_KIND
        return connection.type in POSE_TYPES + FIX_TYPES
    except CassandraRosError:  # not even a header
        return False


class PlaceKeeper:
    """Writes the index of places of one run.

    Args:
        store: Future of the catalog of the connected keyspace.
        whose: nodeID and writer id of the run.
        losses: Losses of the run: messages that were taken here but not stored.
        wanted: Whether to write the index; otherwise messages are ignored.
    """

    def __init__(
        self,
        store: Future[Catalog],
        whose: RobotRun,
        losses: LossLog,
        wanted: bool = True,
    ) -> None:
        self._store, self._whose, self._losses, self._is_wanted = store, whose, losses, wanted
        self._taken: deque[_PoseMessage] = deque()
        # Each is changed by one thread alone.
        self._came = self._gone = 0
        """Size of the messages taken, and of those removed from memory, bytes."""
        self._ending = threading.Event()
        self._gave_up = False
        self._thread: threading.Thread | None = None
        # From here on only that thread uses what follows.
        self._topics: dict[str, LiveTopic] = {}
        """Topics of which messages were taken, with those that later poses still need."""
        self._sources: dict[str, MessageSource] = {}
        """Source of the last message of each topic: its handle names the table of the topic."""
        self._first: dict[str, int] = {}
        """Time from which on all poses of a topic are indexed, ns."""
        self._indexed: set[tuple[str, str]] = set()
        """Tables and robots for which this object has stored an indexed time range."""
        self._is_wrong = False
        """Whether these time ranges have become wrong and must be deleted."""
        self._tf_visits: TfVisits | None = None
        """Visits of the robots in tf; None = to be made, with the next poses."""
        self._topic_visits: dict[str, TopicVisits] = {}
        """Visits by the poses of other topics, by name of the topic."""
        self._latest = 0
        """Time of the latest message, ns."""
        self._noted = self._read_to = -1
        """Times up to which all poses are indexed, and were read, ns; -1 = no pose yet."""

    def add_message(self, source: MessageSource, t: int, wire: bytes) -> None:
        """Take a message with poses of the robot, without waiting.

        Call it for sources with ``tells_places`` only, in the order of reception, by one thread at
        a time.
        """
        if not self._is_wanted or self._gave_up or self._ending.is_set():
            return
        self._came += len(wire)
        if self._came - self._gone > MAX_HELD_BYTES:
            _log.warning("places are not indexed any more: more than %d bytes wait", MAX_HELD_BYTES)
            self._gave_up = True
            return
        self._taken.append(_PoseMessage(source, t, wire))
        if self._thread is None:
            self._begin()

    def _begin(self) -> None:
        """Start the thread, with the first message: most recordings have no poses."""
        thread = threading.Thread(target=self._run, name="recorder-places", daemon=True)
        try:
            thread.start()
        except RuntimeError as exc:  # the system has no free thread: the recording goes on
            _log.warning("places are not indexed: %s", exc)
            self._gave_up = True
            self._taken.clear()
            return
        self._thread = thread

    def close(self, *, wait: bool = True) -> None:
        """Index the remaining poses, for at most END_SEC; without ``wait`` in the background."""
        self._ending.set()
        if self._thread is not None and wait:
            self._thread.join(END_SEC)

    def _run(self) -> None:
        """Index each NOTE_SEC until the end; then take no message any more."""
        try:
            while not self._ending.wait(NOTE_SEC):
                self._try_to_note(last=False)
            # After giving up, poses that were not taken may follow directly on the last taken one.
            self._try_to_note(last=not self._gave_up)
        finally:
            self._ending.set()
            self._taken.clear()

    def _try_to_note(self, *, last: bool) -> None:
        """Index what can be indexed; if that fails, the next call does so from the same time on."""
        if not is_there(self._store):
            return
        try:
            self._note(last)
        except CassandraRosError as exc:
            _log.info("places are indexed later, or found without the index: %s", exc)

    def _note(self, last: bool) -> None:
        """Index the poses up to LONGEST_GAP_NS before the latest one; with ``last`` up to that.

        In this order: what has become wrong is deleted first, and ``_noted`` grows only when all is
        stored.
        """
        self._add_taken()
        high = self._latest if last else self._latest - LONGEST_GAP_NS
        low = min(self._first.values(), default=0) if self._noted < 0 else self._noted + 1
        moving = [n for n, topic in self._topics.items() if n != TF_STATIC and topic.tables]
        if not all(self._sources[name].handle for name in moving):
            return  # a table is still being made
        self._take_back(moving)
        for name in moving:
            # The next poses need the transforms and the path before them.
            self._gone += self._topics[name].drop(self._noted - 2 * LONGEST_GAP_NS)
        if high < low:
            return  # no pose to index
        visits: list[VisitRow] = []
        placed: list[IndexedPoses] = []
        for name in moving:
            visits += self._visits(name, low, high)
            placed += self._indexed_poses(name, high)
        self._store.result().keyspace.place_index.put(visits, placed, self._ttl(moving))
        self._indexed.update((poses.table, poses.robot) for poses in placed)
        self._noted, self._read_to = high, self._latest

    def _take_back(self, moving: Sequence[str]) -> None:
        """Delete indexed time ranges that are wrong: other poses are stored than those taken."""
        index = self._store.result().keyspace.place_index
        for name in moving:
            table, first = self._table(name), self._first[name]
            lost = self._losses.last_ns(name)
            self._is_wrong |= first <= lost <= self._noted
            robots = {robot for where, robot in self._indexed if where == table}
            if robots and not robots <= index.noted(table, *self._whose):
                # Another client deleted poses, and with them this part of the index.
                self._first[name] = max(first, self._noted + 1)
                self._indexed -= {(table, robot) for robot in robots}
            self._first[name] = max(self._first[name], lost + 1)
        if self._is_wrong:
            for table in {table for table, _ in self._indexed}:
                index.withdraw(table, run=self._whose)
            self._indexed.clear()
            self._is_wrong = False

    def _add_taken(self) -> None:
        """Add the taken messages to their topics; begin anew where they change earlier poses."""
        while self._taken:
            taken = self._taken.popleft()
            name = taken.source.topic
            if name not in self._topics:
                before = self._stored_statics() if name == TF_STATIC else ()
                self._topics[name] = LiveTopic(name, self._whose.node, before)
                self._first[name] = max(taken.t, self._noted + 1)
            if name == TF_STATIC:
                # The index so far is right for the static transforms before this message.
                self._begin_anew(self._noted)
            elif taken.t <= self._noted:  # a clock went back: poses around it are not in memory
                self._is_wrong = True
                self._begin_anew(self._latest)
            elif taken.t <= self._read_to:
                self._begin_anew(self._noted)
            self._topics[name].add(taken)
            self._sources[name] = taken.source
            self._latest = max(self._latest, taken.t)

    def _begin_anew(self, noted: int) -> None:
        """Go on with the poses after ``noted``, ns: what was computed so far is wrong for them.

        Earlier poses stay as they are, indexed or not.
        """
        self._tf_visits, self._noted = None, noted
        self._first = {name: max(t, noted + 1) for name, t in self._first.items()}
        self._topic_visits.clear()

    def _stored_statics(self) -> list[Row]:
        """Return the stored static transforms of the robot: queries use the last of all."""
        try:
            topic = self._store.result().get(TF_STATIC)
        except TopicNotFound:
            return []
        return list(topic.rows(nodeID=self._whose.node))

    def _find(self, name: str) -> LiveTopic:
        """Return a topic for the visits; static transforms may all have been stored before.

        Raises:
            TopicNotFound: No message of it was taken.
        """
        if name == TF_STATIC and name not in self._topics:
            statics = self._stored_statics()
            if statics:
                return LiveTopic(name, self._whose.node, statics)
        if name not in self._topics:
            raise TopicNotFound(f"topic {name} is not recorded")
        return self._topics[name]

    def _visits(self, name: str, low: int, high: int) -> list[VisitRow]:
        """Return the visits by the poses of a topic in [low, high], ns."""
        if name == TF:
            if self._tf_visits is None:
                self._tf_visits = TfVisits(self._find, self._whose)
            return list(self._tf_visits.visits(low, high))
        if name not in self._topic_visits:
            self._topic_visits[name] = TopicVisits(self._find, name, self._whose)
        return list(self._topic_visits[name].visits(self._table(name), low, high))

    def _indexed_poses(self, name: str, high: int) -> list[IndexedPoses]:
        """Return the entries that say that the poses of a topic up to ``high``, ns, are indexed.

        Call it after ``_visits``.
        """
        visits = self._tf_visits if name == TF else self._topic_visits[name]
        if visits is None:
            return []
        return visits.placed(self._table(name), self._first[name], high)

    def _table(self, name: str) -> str:
        """Return the name of the table of a topic; '' = it has none yet."""
        handle = self._sources[name].handle
        return "" if handle is None else handle.table.name

    def _ttl(self, names: Sequence[str]) -> int:
        """Return the time to live of index entries, s: the longest of the topics; 0 = for ever."""
        handles = [self._sources[name].handle for name in names]
        ttls = [handle.table.metadata.ttl for handle in handles if handle is not None]
        return 0 if 0 in ttls else max(ttls, default=0)
