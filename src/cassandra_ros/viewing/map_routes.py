# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Route of maps: occupancy grids made from stored scans and point clouds."""

from __future__ import annotations

import json
import threading
import time
from collections import OrderedDict
from typing import Callable, Hashable

from cassandra_ros.errors import StoreUnavailable
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.overview.plot_series import NEAR_KEPT_SEC
from cassandra_ros.viewing.answers import Bytes
from cassandra_ros.viewing.api_call import NODES, RUNS, WHOLE_RANGE, ApiCall, whose_of
from cassandra_ros.viewing.mapping.map_builder import (
    DEFAULT_RESOLUTION,
    MadeMap,
    MapOptions,
    makeMap,
)
from cassandra_ros.viewing.mapping.map_files import map_info, map_png
from cassandra_ros.viewing.mapping.sensor_poses import PoseChoice
from cassandra_ros.viewing.route import Parameter, Route
from cassandra_ros.viewing.viewer_settings import ViewerSettings

USUAL_MESSAGES = 1000
"""Default maximum number of messages for a map."""
_KEPT = 8
"""Maximum number of cached pictures."""


class MapCache:
    """The last requested pictures. Two requests for the same picture make it once."""

    def __init__(self, catalog: Catalog, settings: ViewerSettings) -> None:
        self._made: OrderedDict[Hashable, Bytes] = OrderedDict()
        self._making = threading.Lock()

    def get(self, key: Hashable, make: Callable[[], Bytes]) -> Bytes:
        """Return the picture of a key, made by ``make`` if it is not cached."""
        # One at a time: each uses a whole processor.
        with self._making:
            if key not in self._made:
                self._made[key] = make()
                while len(self._made) > _KEPT:
                    self._made.popitem(last=False)
            self._made.move_to_end(key)
            return self._made[key]


def _map(call: ApiCall) -> Bytes:
    store, name = call.store, call.text("topic") or ""
    topic, whose = store.getTopic(name), whose_of(call)
    start, end = call.stamp("start"), call.stamp("end")
    resolution, scans = call.number("resolution"), call.count("scans")
    options = MapOptions(
        resolution=DEFAULT_RESOLUTION if resolution is None else resolution,
        max_range=call.number("max_range"),
        min_height=call.number("min_height"),
        max_height=call.number("max_height"),
        most=scans,
    )
    choice = PoseChoice(frame=call.text("frame") or None, odom=call.text("odom") or None)

    def progress(done: int, total: int) -> None:
        if call.gone.is_set():
            raise StoreUnavailable(f"the client does not wait for the map of {name} any more")

    def make() -> Bytes:
        made = makeMap(
            store,
            name,
            start,
            end,
            nodeID=whose.nodes,
            run=whose.writers,
            name=call.text("name") or None,
            options=options,
            poses=choice,
            progress=progress,
        )
        return _answer(made)

    # The key includes the stored messages: further ones need a new picture. Poses may be stored
    # later than the messages recorded there.
    last, minute = topic.last(), time.time() // NEAR_KEPT_SEC
    choices = (whose, call.text("name"), options, choice, minute)
    cache_key = (topic.name, str(start), str(end), *choices)
    return call.cached(MapCache).get((*cache_key, topic.countTopicData(), str(last)), make)


def _answer(made: MadeMap) -> Bytes:
    description = {
        **map_info(made.map),
        "stamp": str(made.map.stamp),
        "used": made.used,
        "without_pose": made.without_pose,
        "unreadable": made.unreadable,
        "received": made.received,
        "sources": list(made.sources),
        "pose_topics": [offer._asdict() for offer in made.offers],
    }
    headers = {"X-Map": json.dumps(description), "Cache-Control": "no-cache"}
    return Bytes(map_png(made.map, transparent=True), "image/png", headers)


ROUTES: tuple[Route, ...] = (
    Route(
        "/api/map",
        _map,
        "An occupancy grid as a picture with one pixel for each cell: dark = occupied, transparent "
        "= not seen. Header X-Map has, as JSON, its place (frame, resolution in metres, pose x, y, "
        "yaw of the lower left corner), the messages that it was made from, and as pose_topics the "
        "topics with poses, the best first: share is the share of messages between two of its "
        "poses, taken is true for the topic whose poses were used.",
        (
            Parameter(
                "topic",
                "text",
                "Topic of LaserScan or PointCloud2; or of OccupancyGrid, whose newest message is "
                "shown as it is stored.",
                required=True,
            ),
            *WHOLE_RANGE,
            NODES,
            RUNS,
            Parameter("name", "text", "Name of the map, if maps are stored under names."),
            Parameter(
                "resolution", "number", "Length of a cell, metres.", default=DEFAULT_RESOLUTION
            ),
            Parameter("max_range", "number", "Maximum distance of used points, metres."),
            Parameter("min_height", "number", "Height below which points are floor, metres."),
            Parameter("max_height", "number", "Maximum height of used points, metres."),
            Parameter("frame", "text", "Frame of the map; missing: map, odom, or the topmost."),
            Parameter("odom", "text", "Topic of the robot's poses; missing: tf, else the best."),
            Parameter(
                "scans",
                "count",
                "Maximum number of messages, evenly spread.",
                default=USUAL_MESSAGES,
            ),
        ),
        kind="image/png",
    ),
)
