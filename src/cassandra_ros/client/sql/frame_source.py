# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The poses of a frame in another over time as a table: tf('map', 'base_link')."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Iterator, Sequence

from cassandra_ros.errors import TopicNotFound
from cassandra_ros.keys import MAX_NS
from cassandra_ros.places.frame_poses import TF, TF_STATIC, FrameChain, TfRecording
from cassandra_ros.places.poses import Poses
from cassandra_ros.query.arrays.arrow_types import load_arrow
from cassandra_ros.query.plan.pushdown import Watch
from cassandra_ros.read import Whose
from cassandra_ros.topics.catalog import Catalog

if TYPE_CHECKING:
    import pyarrow


class FrameSource:
    """Poses of a frame in another, for each robot: at each time at which tf has one of the way.

    Args:
        catalog: The topics.
        whose: Robots and runs whose transforms are read.
        target: Frame in which the poses are.
        frame: The moving frame.
        watch: Called repeatedly during a read; an exception from it ends the read.

    Attributes:
        columns: KEY (receive time), NODE, translation (m) and rotation (a unit quaternion).
        error: Error that ended a read.
        hints: Why there is no pose, known when all was read: a frame that is in no transform.
    """

    def __init__(
        self, catalog: Catalog, whose: Whose, target: str, frame: str, watch: Watch
    ) -> None:
        self._arrow = arrow = load_arrow("sql")
        self._catalog = catalog
        self._whose = whose
        self._frames = (target, frame)
        self._watch = watch
        kinds = [
            arrow.struct([(axis, arrow.float64()) for axis in axes]) for axes in ("xyz", "xyzw")
        ]
        self.columns = arrow.schema(
            [("KEY", arrow.timestamp("ns")), ("NODE", arrow.string())]
            + list(zip(("translation", "rotation"), kinds))
        )
        self.error: BaseException | None = None
        self.hints: list[str] = []

    def __arrow_c_schema__(self) -> Any:
        return self.columns.__arrow_c_schema__()

    def __arrow_c_stream__(self, requested_schema: object = None) -> Any:
        reader = self._arrow.RecordBatchReader.from_batches(self.columns, self._batches())
        return reader.__arrow_c_stream__()

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
        try:
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
                    yield arrow.RecordBatch.from_arrays(
                        [keys, nodes, *structs], schema=self.columns
                    )
                reasons.append(chain.unknown_frame())
            if all(reasons) and not self.hints:
                self.hints += reasons[:1]
        except Exception as exc:
            self.error = exc
            raise
