# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Occupancy grids made of stored scans and clouds."""

from __future__ import annotations

import json
import threading
from collections import OrderedDict
from typing import Callable, FrozenSet, Hashable, Optional

from cassandra_ros.drawing.map_picture import map_info, map_png
from cassandra_ros.errors import StoreUnavailable
from cassandra_ros.mapping.map_builder import DEFAULT_RESOLUTION, MadeMap, MapOptions, makeMap
from cassandra_ros.mapping.sensor_poses import PoseChoice
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.viewing.answers import Bytes
from cassandra_ros.viewing.call import Call
from cassandra_ros.viewing.route import Parameter, Route
from cassandra_ros.viewing.viewer_settings import ViewerSettings

USUAL_MESSAGES = 1000
_KEPT = 8
"""Pictures that are kept for those who ask for the same."""


class MapCache:
    """The pictures that were asked for last; one that is being made is made once."""

    def __init__(self, catalog: Catalog, settings: ViewerSettings) -> None:
        self._made: OrderedDict[Hashable, Bytes] = OrderedDict()
        self._making = threading.Lock()

    def get(self, key: Hashable, make: Callable[[], Bytes]) -> Bytes:
        """Return what is kept under a key, else what ``make`` returns."""
        # One at a time: each takes a processor for itself.
        with self._making:
            if key not in self._made:
                self._made[key] = make()
                while len(self._made) > _KEPT:
                    self._made.popitem(last=False)
            self._made.move_to_end(key)
            return self._made[key]


def _map(call: Call) -> Bytes:
    store, name = call.store, call.text("topic") or ""
    topic, runs = store.getTopic(name), _writers(call)
    nodes = call.texts("nodes") or None
    start, end = (_stamp(call, each) for each in ("start", "end"))
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
            raise StoreUnavailable(f"nobody waits for the map of {name} any more")

    def make() -> Bytes:
        made = makeMap(
            store,
            name,
            start,
            end,
            nodeID=nodes,
            run=runs,
            name=call.text("name") or None,
            options=options,
            poses=choice,
            progress=progress,
        )
        return _answer(made)

    # More may have been stored since.
    last = topic.last()
    asked = (topic.name, str(start), str(end), nodes, runs, call.text("name"), options, choice)
    return call.shared(MapCache).get((*asked, topic.countTopicData(), str(last)), make)


def _stamp(call: Call, name: str) -> Optional[Stamp]:
    ns = call.time_ns(name)
    return None if ns is None else Stamp.from_ns(ns)


def _writers(call: Call) -> Optional[FrozenSet[int]]:
    """Return the writer ids of all runs that are asked for; None = of any."""
    names = call.texts("runs")
    if not names:
        return None
    found = (call.catalog.keyspace.runs.writers(name) for name in names)
    return frozenset().union(*(writers for writers in found if writers is not None))


def _answer(made: MadeMap) -> Bytes:
    told = {
        **map_info(made.map),
        "stamp": str(made.map.stamp),
        "used": made.used,
        "without_pose": made.without_pose,
        "unreadable": made.unreadable,
        "received": made.received,
        "sources": list(made.sources),
        "pose_topics": [offer._asdict() for offer in made.offers],
    }
    headers = {"X-Map": json.dumps(told), "Cache-Control": "no-cache"}
    return Bytes(map_png(made.map, transparent=True), "image/png", headers)


ROUTES: tuple[Route, ...] = (
    Route(
        "/api/map",
        _map,
        "An occupancy grid as a picture: a pixel a cell, dark where something is, transparent "
        "where nothing was seen. Header X-Map says as JSON where it lies (frame, resolution in "
        "metres, pose x, y, yaw of the lower left corner), what it was made of, and as pose_topics "
        "which topics tell poses, the best first: share is that of the messages that lie between "
        "two of its poses, taken says whether the map was made of them.",
        (
            Parameter(
                "topic",
                "text",
                "Topic of LaserScan or PointCloud2, or of OccupancyGrid, of which the newest is "
                "shown as it is stored.",
                required=True,
            ),
            Parameter("start", "time", "First time (default: that of all)."),
            Parameter("end", "time", "Last time, included (default: that of all)."),
            Parameter("nodes", "texts", "Only of these robots (nodeIDs); without: of all."),
            Parameter("runs", "texts", "Only of these runs; without: of all."),
            Parameter("name", "text", "Of maps that are stored under names this one."),
            Parameter(
                "resolution", "number", "Length of a cell, metres.", default=DEFAULT_RESOLUTION
            ),
            Parameter("max_range", "number", "What is further away is left out, metres."),
            Parameter("min_height", "number", "What lies below is floor, metres."),
            Parameter("max_height", "number", "What lies above is left out, metres."),
            Parameter("frame", "text", "The map's frame (default: map, odom, or the topmost)."),
            Parameter("odom", "text", "Topic of the robot's poses (default: tf, else the best)."),
            Parameter(
                "scans", "count", "So many messages at most, evenly spread.", default=USUAL_MESSAGES
            ),
        ),
        kind="image/png",
    ),
)
