# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The index of places for runs that have ended: making it, and its state."""

from __future__ import annotations

from typing import Callable, Mapping, NamedTuple, Optional

from cassandra_ros.arguments import check_nodes
from cassandra_ros.errors import TopicNotFound
from cassandra_ros.keys import MAX_NS
from cassandra_ros.places.frame_poses import TF, TfRecording
from cassandra_ros.places.pose_topic import tells_fixes, tells_poses
from cassandra_ros.places.robots import fixed_frames
from cassandra_ros.places.run_index import RobotRun, RunIndex
from cassandra_ros.store.tables.place_index import IndexedPoses
from cassandra_ros.store.tables.registry import Run
from cassandra_ros.topics.cassandra_topic import CassandraTopic
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.run_finder import RunName
from cassandra_ros.topics.run_list import list_runs
from cassandra_ros.topics.stored_places import StoredPlaces

Progress = Optional[Callable[[int, int], None]]
"""Called with the seconds of a run that are done, and all its seconds."""


class PlacesOfRun(NamedTuple):
    """State of the index of places for one run."""

    run: str
    """Name of the run, or its writer id if it has no name."""
    node: str
    writer: int
    state: str
    """'indexed'; 'not indexed'; 'no poses'; 'goes on': it may still store poses of any time."""
    first_ns: int | None = None
    last_ns: int | None = None
    """Key times of its first and last pose in the index, ns."""
    visits: int = 0
    """Number of visits to squares that were added now."""


def index_places(
    catalog: Catalog, node: str | None, run: RunName, progress: Progress
) -> list[PlacesOfRun]:
    """Add runs to the index of places, of one node or some runs (None = all).

    Runs that are indexed stay as they are, unless a frame is fixed to another one in a new way.
    Runs that go on, and interrupted imports that may be repeated, are left out.
    """
    states: list[PlacesOfRun] = []
    stored = catalog.stored_places
    ttls = [t.metadata.ttl for topic in _pose_topics(stored) for t in topic.tables]
    # Visits must stay as long as any pose, 0 = for ever.
    ttl = 0 if 0 in ttls else max(ttls, default=0)
    for stored_run, state in _states(catalog, node, run):
        if state.state != "not indexed":
            states.append(state)
            continue
        whose = RobotRun(stored_run.node, stored_run.writer)
        result = RunIndex(stored, catalog.keyspace.place_index, whose, ttl).make(progress)
        if result is not None:
            state = state._replace(state="indexed", first_ns=result.poses_from)
            state = state._replace(last_ns=result.poses_to, visits=result.visits)
        states.append(state)
    return states


def places_of_runs(catalog: Catalog, node: str | None, run: RunName) -> list[PlacesOfRun]:
    """Return for each run whether the index of places has its poses; node None = all."""
    return [state for _, state in _states(catalog, node, run)]


def _states(catalog: Catalog, node: str | None, run: RunName) -> list[tuple[Run, PlacesOfRun]]:
    """Return the chosen runs, each with its state in the index."""
    check_nodes(node)
    writers = catalog.keyspace.runs.writers(run)
    runs = [
        stored_run
        for stored_run in list_runs(catalog.keyspace, catalog.tables(None))
        if node in (None, stored_run.node) and (writers is None or stored_run.writer in writers)
    ]
    comparison = _IndexComparison(catalog)
    return [(stored_run, comparison.state_of(stored_run)) for stored_run in runs]


def _pose_topics(stored: StoredPlaces) -> list[CassandraTopic]:
    """Return the topics from which places are indexed."""
    return [t for t in stored.topics() if t.name == TF or tells_poses(t) or tells_fixes(t)]


class _IndexComparison:
    """Compares the index of places with the stored poses."""

    def __init__(self, catalog: Catalog) -> None:
        self._stored = catalog.stored_places
        self._topics = _pose_topics(self._stored)
        names = [table.name for topic in self._topics for table in topic.tables]
        self._records: dict[tuple[str, int], list[IndexedPoses]] = {}
        """Node and writer of a run → its index records."""
        for record in catalog.keyspace.place_index.placed(names):
            self._records.setdefault((record.node, record.writer), []).append(record)

    def state_of(self, run: Run) -> PlacesOfRun:
        """Return the state of the index for a run.

        It is indexed if the records cover all of its poses, and each frame is still fixed as when
        they were made.
        """
        places = PlacesOfRun(run.name or str(run.writer), run.node, run.writer, "no poses")
        records = self._records.get((run.node, run.writer), [])
        extents = [
            extent
            for topic in self._topics
            for extent in self._stored.extents(topic, run.node, 0, MAX_NS)
            if extent.writer == run.writer
        ]
        if not extents:
            return places
        if run.state == "recording" or (run.kind == "import" and run.state != "ended"):
            return places._replace(state="goes on")
        tables = {record.table for record in records}
        is_covered = all(
            extent.table in tables
            and any(
                record.low <= extent.low and extent.high <= record.high
                for record in records
                if record.table == extent.table
            )
            for extent in extents
        )
        if not is_covered:
            return places._replace(state="not indexed")
        fixed = self._fixed(run.node)
        # A record of a topic of poses has the table in place of the robot's frame.
        chains = [record.above for record in records if record.robot != record.table]
        if any(fixed.get(name, "") != text for above in chains for name, text in above.items()):
            return places._replace(state="not indexed")
        first = min(record.low for record in records)
        last = max(record.high for record in records)
        return places._replace(state="indexed", first_ns=first, last_ns=last)

    def _fixed(self, node: str) -> Mapping[str, str]:
        """Return parent and pose of each fixed frame of a node, see fixed_frames; {} without tf."""
        try:
            return fixed_frames(TfRecording(self._stored.find, node))
        except TopicNotFound:
            return {}
