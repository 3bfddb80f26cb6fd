# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The index of places, noted while poses are recorded, from what is handed to the store.

A thread of its own notes some seconds at a time, about which nothing can come any more that changes
them: a way between two poses may last LONGEST_GAP_NS. What it does not note is looked at by whoever
asks, so it may fall behind, or give up, and no answer is wrong. Where what was noted does not hold
any more (a pose was lost, or deleted, or a clock went back) it is taken back.
"""

from __future__ import annotations

import logging
import threading
from bisect import bisect_left, bisect_right
from collections import deque
from concurrent.futures import Future
from typing import (
    TYPE_CHECKING,
    Any,
    Deque,
    Dict,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
)

from cassandra_ros.arrays.field_arrays import read_arrays
from cassandra_ros.errors import CassandraRosError, TopicNotFound
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.places.frame_poses import TF, TF_STATIC
from cassandra_ros.places.paths import LONGEST_GAP_NS
from cassandra_ros.places.run_index import RobotRun, TfVisits, TopicVisits
from cassandra_ros.query.protocols import Row, Table
from cassandra_ros.read import Read, Writers
from cassandra_ros.recording.live_row import LiveRow, LiveTable
from cassandra_ros.recording.losses import LossLog
from cassandra_ros.recording.store_future import is_there
from cassandra_ros.tables.place_index import Placed, Visited
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.key_selection import range_between
from cassandra_ros.transforms.transform_samples import TRANSFORMS_MD5

if TYPE_CHECKING:
    from cassandra_ros.recording.message_buffer import MessageSource

_log = logging.getLogger(__name__)

NOTE_SEC = 20.0
"""How often it is noted."""
MAX_HELD_BYTES = 64 * 1024 * 1024
"""Of poses that wait to be noted; beyond it the recording goes on without the index."""
END_SEC = 10.0
"""So long the end of a recording waits for the last part."""
POSES = (
    "nav_msgs/Odometry",
    "geometry_msgs/PoseWithCovarianceStamped",
    "geometry_msgs/PoseStamped",
    "geometry_msgs/TransformStamped",
)


class _Taken(NamedTuple):
    source: MessageSource
    t: int
    wire: bytes


class LiveTopic:
    """The last messages of one topic, as places/ reads stored ones.

    Args:
        before: Messages that are stored already and count as well.
    """

    def __init__(self, name: str, node: str, before: Sequence[Row] = ()) -> None:
        self.name = name
        self._node = node
        self._tables: Dict[str, Table] = {row.table.name: row.table for row in before}
        self._before = list(before)
        self._rows: List[Row] = []
        self._times: List[int] = []

    @property
    def tables(self) -> Sequence[Table]:
        """One for each type and definition that came."""
        return list(self._tables.values())

    def add(self, taken: _Taken) -> None:
        """Take a message; it comes behind those that were taken."""
        connection = taken.source.connection
        table = self._tables.get(connection.md5sum)
        if not isinstance(table, LiveTable):
            table = self._tables[connection.md5sum] = LiveTable(connection)
        if table.definition is None:
            return
        row = LiveRow(table, self.name, self._node, taken.t, taken.wire, len(taken.wire))
        at = bisect_right(self._times, taken.t)  # a clock may go back
        self._times.insert(at, taken.t)
        self._rows.insert(at, row)

    def drop(self, before: int) -> int:
        """Forget messages that came before a time, ns; return their bytes."""
        at = bisect_left(self._times, before)
        nbytes = sum(row.size for row in self._rows[:at])
        del self._times[:at], self._rows[:at]
        return nbytes

    def read(self, read: Read) -> Iterator[Row]:
        """Walk through the messages of a time range; all are of one node and one run."""
        low, high = read.time_range
        first, last = bisect_left(self._times, low), bisect_right(self._times, high)
        found = [row for row in self._before if low <= row.t <= high] + self._rows[first:last]
        yield from found[::-1] if read.reverse else found

    def getArrays(
        self,
        fields: Sequence[str],
        key: Optional[Stamp] = None,
        to_key: Optional[Stamp] = None,
        *,
        nodeID: Optional[str] = None,
        run: Writers = None,
    ) -> Dict[str, Any]:
        """Return fields of the messages in [key, to_key] as numpy arrays."""
        read = Read(range_between(key, to_key))
        return read_arrays(self, fields, None, lambda columns: self.read(read))

    def count(self, read: Read) -> int:
        """Count the messages of a time range."""
        return sum(1 for _ in self.read(read))

    def countBuckets(self) -> int:
        """Count its partitions: it has none."""
        return 0


def tells_places(connection: Connection) -> bool:
    """Say whether messages of a connection tell where a robot is."""
    try:
        if connection.topic in (TF, TF_STATIC):
            return connection.md5sum == TRANSFORMS_MD5
        return connection.type in POSES
    except CassandraRosError:  # not even a header
        return False


class PlaceKeeper:
    """Notes where the robot of one run is.

    Args:
        store: The catalog of the connected keyspace, when it answers.
        whose: nodeID and writer id of the run.
        losses: Of the run: which of the messages that were taken are not stored.
        wanted: Do so; else take nothing.
    """

    def __init__(
        self,
        store: Future[Catalog],
        whose: RobotRun,
        losses: LossLog,
        wanted: bool = True,
    ) -> None:
        self._store, self._whose, self._losses, self._wanted = store, whose, losses, wanted
        self._taken: Deque[_Taken] = deque()
        # Each is counted by one thread alone.
        self._came = self._gone = 0
        """Bytes of messages that were taken, and of those that are not held any more."""
        self._ending = threading.Event()
        self._gave_up = False
        self._thread: Optional[threading.Thread] = None
        self._topics: Dict[str, LiveTopic] = {}
        self._sources: Dict[str, MessageSource] = {}
        """The last connection of each topic: it knows its table."""
        self._first: Dict[str, int] = {}
        """From when on all poses of a topic are noted, ns."""
        self._said: Set[Tuple[str, str]] = set()
        """The tables and robots of which the index says how far it goes."""
        self._wrong = False
        """What it says does not hold any more."""
        self._tf: Optional[TfVisits] = None
        self._told: Dict[str, TopicVisits] = {}
        self._latest = 0
        self._noted = self._read_to = -1
        """All poses up to here are noted, or were looked at, ns; -1 = none."""

    def take(self, source: MessageSource, t: int, wire: bytes) -> None:
        """Take a message, in their order, if it tells where the robot is; wait for nothing.

        One thread at a time.
        """
        if not (source.tells_places and self._wanted) or self._gave_up or self._ending.is_set():
            return
        self._came += len(wire)
        if self._came - self._gone > MAX_HELD_BYTES:
            _log.warning("places are not noted any more: over %d bytes wait", MAX_HELD_BYTES)
            self._gave_up = True
            return
        self._taken.append(_Taken(source, t, wire))
        if self._thread is None:
            self._begin()

    def _begin(self) -> None:
        thread = threading.Thread(target=self._run, name="recorder-places", daemon=True)
        try:
            thread.start()
        except RuntimeError as exc:  # the system has no more: the recording goes on
            _log.warning("places are not noted: %s", exc)
            self._gave_up = True
            self._taken.clear()
            return
        self._thread = thread

    def close(self) -> None:
        """Note what is left, unless that takes too long."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join(END_SEC)

    def _run(self) -> None:
        try:
            while not self._ending.wait(NOTE_SEC):
                self._try_to_note(last=False)
            # What came when it was given up may follow at once on what was taken.
            self._try_to_note(last=not self._gave_up)
        finally:
            self._ending.set()
            self._taken.clear()

    def _try_to_note(self, *, last: bool) -> None:
        if not is_there(self._store):
            return
        try:
            self._note(last)
        except CassandraRosError as exc:
            _log.info("where the robot was is noted later, or found without: %s", exc)

    def _note(self, last: bool) -> None:
        self._sort()
        high = self._latest if last else self._latest - LONGEST_GAP_NS
        low = min(self._first.values(), default=0) if self._noted < 0 else self._noted + 1
        moving = [n for n, topic in self._topics.items() if n != TF_STATIC and topic.tables]
        if not all(self._sources[name].handle for name in moving):
            return  # a table is still being made
        self._take_back(moving)
        for name in moving:
            self._gone += self._topics[name].drop(self._noted - 2 * LONGEST_GAP_NS)
        if high < low:
            return  # nothing to note
        visits: List[Visited] = []
        placed: List[Placed] = []
        for name in moving:
            visits += self._visits(name, low, high)
            placed += self._placed(name, high)
        self._store.result().keyspace.place_index.put(visits, placed, self._ttl(moving))
        self._said.update((each.table, each.robot) for each in placed)
        self._noted, self._read_to = high, self._latest

    def _take_back(self, moving: Sequence[str]) -> None:
        """Say no more than holds: other poses may be stored than those that were taken."""
        index = self._store.result().keyspace.place_index
        for name in moving:
            table, first = self._table(name), self._first[name]
            lost = self._losses.last_ns(name)
            self._wrong |= first <= lost <= self._noted
            said = {robot for where, robot in self._said if where == table}
            if not said <= (index.noted(table, *self._whose) if said else set()):
                self._first[name] = max(first, self._noted + 1)  # somebody deleted poses
                self._said = {each for each in self._said if each[0] != table}
            self._first[name] = max(self._first[name], lost + 1)
        if self._wrong:
            for table in {table for table, _ in self._said}:
                index.withdraw(table, run=self._whose)
            self._said.clear()
            self._wrong = False

    def _sort(self) -> None:
        """Give what was taken to its topics."""
        while self._taken:
            taken = self._taken.popleft()
            name = taken.source.topic
            if name not in self._topics:
                before = self._stored_statics() if name == TF_STATIC else ()
                self._topics[name] = LiveTopic(name, self._whose.node, before)
                self._first[name] = max(taken.t, self._noted + 1)
            if name == TF_STATIC:
                # What was noted holds for the frames as they were fixed until now.
                self._begin_anew(self._noted)
            elif taken.t <= self._noted:  # a clock went back: what lies around it is not held
                self._wrong = True
                self._begin_anew(self._latest)
            elif taken.t <= self._read_to:
                self._begin_anew(self._noted)
            self._topics[name].add(taken)
            self._sources[name] = taken.source
            self._latest = max(self._latest, taken.t)

    def _begin_anew(self, noted: int) -> None:
        """Note what is behind a time, ns: what was read of it does not hold any more."""
        self._tf, self._noted = None, noted
        self._first = {name: max(t, noted + 1) for name, t in self._first.items()}
        self._told.clear()

    def _stored_statics(self) -> List[Row]:
        """Return the fixed transforms that others stored: who asks takes the last of them all."""
        try:
            topic = self._store.result().get(TF_STATIC)
        except TopicNotFound:
            return []
        return list(topic.rows(nodeID=self._whose.node))

    def _find(self, name: str) -> LiveTopic:
        if name == TF_STATIC and name not in self._topics:
            statics = self._stored_statics()
            if statics:
                return LiveTopic(name, self._whose.node, statics)
        if name not in self._topics:
            raise TopicNotFound(f"topic {name} is not recorded")
        return self._topics[name]

    def _visits(self, name: str, low: int, high: int) -> List[Visited]:
        if name == TF:
            if self._tf is None:
                self._tf = TfVisits(self._find, self._whose)
            return list(self._tf.visits(low, high))
        if name not in self._told:
            self._told[name] = TopicVisits(self._find, name, self._whose)
        return list(self._told[name].visits(self._table(name), low, high))

    def _placed(self, name: str, high: int) -> List[Placed]:
        notes = self._tf if name == TF else self._told[name]
        if notes is None:
            return []
        return notes.placed(self._table(name), self._first[name], high)

    def _table(self, name: str) -> str:
        handle = self._sources[name].handle
        return "" if handle is None else handle.table.name

    def _ttl(self, names: Sequence[str]) -> int:
        """Return how long what is noted stays, seconds; 0 = for ever."""
        handles = [self._sources[name].handle for name in names]
        ttls = [handle.table.metadata.ttl for handle in handles if handle is not None]
        return 0 if 0 in ttls else max(ttls, default=0)
