# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Routes for places: when robots were in a region, and the tracks of robots."""

from __future__ import annotations

import itertools
from typing import Sequence

from cassandra_ros.errors import InvalidOption, StoreUnavailable
from cassandra_ros.places.earth import UNITS_PER_DEGREE
from cassandra_ros.places.regions import Polygon, Region
from cassandra_ros.places.tracks import find_tracks
from cassandra_ros.places.whereabouts import region_of
from cassandra_ros.query.protocols import WGS84, Disk
from cassandra_ros.viewing.answers import Json
from cassandra_ros.viewing.api_call import NODES, WHOLE_RANGE, ApiCall, whose_of
from cassandra_ros.viewing.route import Parameter, Route

MOST_STAYS = 1000
"""Maximum number of stays in one answer."""
USUAL_STAYS = 200
"""Default number of stays in one answer."""
MOST_POINTS = 20_000
"""Maximum number of points of a track."""
USUAL_POINTS = 2000
"""Default number of points of a track."""
_FRAME = Parameter(
    "frame",
    "text",
    "Frame of the coordinates; missing: map, odom, or the only one there is. In WGS84, x is the "
    "longitude and y the latitude, degrees.",
)
_ROBOT = Parameter(
    "robot",
    "text",
    "Frame of the robot, or a topic of its poses or of latitude and longitude; missing: found by "
    "the viewer.",
)
_RUNS = Parameter("runs", "texts", "Runs whose poses are used, if they recorded any.")


def _near(call: ApiCall) -> Json:
    limit = call.count("limit") or 0
    if not 1 <= limit <= MOST_STAYS:
        raise InvalidOption(f"limit is 1 to {MOST_STAYS}, not {limit}")
    places, robot = call.catalog.places, call.text("robot") or ""
    frame = (call.text("frame") or places.usual_frame(robot)).lstrip("/")
    low, high = call.time_range()
    stays_found: list[Json] = []
    nodes, writers = call.texts("nodes"), whose_of(call).writers
    visits = places.within(_region(call, frame), frame, robot, nodes, writers)
    more = False
    for node in visits.nodes:
        stays = visits.spans(low, high, node=node, watch=lambda: _check_waited_for(call))
        for start, end in itertools.islice(stays, limit - len(stays_found) + 1):
            if len(stays_found) == limit:
                more = True
                break
            stays_found.append({"node": node, "start": str(start), "end": str(end)})
    return {"stays": stays_found, "more": more}


def _places(call: ApiCall) -> Json:
    points = call.count("points") or 0
    if not 2 <= points <= MOST_POINTS:
        raise InvalidOption(f"points is 2 to {MOST_POINTS}, not {points}")
    places, robot = call.catalog.places, call.text("robot") or ""
    low, high = call.time_range()
    frame = (call.text("frame") or places.usual_frame(robot)).lstrip("/")
    tracks = find_tracks(
        places,
        (frame, robot),
        call.texts("nodes"),
        whose_of(call).writers,
        (low, high, points),
        lambda: _check_waited_for(call),
    )
    return {"frame": frame, "tracks": [track.told() for track in tracks]}


def _check_waited_for(call: ApiCall) -> None:
    if call.gone.is_set():
        raise StoreUnavailable("the client does not wait for the answer any more")


def _region(call: ApiCall, frame: str) -> Region:
    corners = call.text("polygon")
    x, y, radius = (call.number(name) for name in ("x", "y", "radius"))
    if corners:
        unit = UNITS_PER_DEGREE if frame == WGS84 else 1.0
        return Polygon([(x * unit, y * unit) for x, y in _corners(corners)])
    if x is None or y is None or radius is None:
        raise InvalidOption("give a region: x, y and radius, or polygon=x,y;x,y;x,y, in metres")
    if radius < 0:
        raise InvalidOption(f"radius is {radius}: it is 0 or more metres")
    centre = (y, x) if frame == WGS84 else (x, y)  # the latitude comes first
    return region_of(Disk(*centre, radius, frame))


def _corners(text: str) -> Sequence[tuple[float, float]]:
    try:
        pairs = [tuple(map(float, pair.split(","))) for pair in text.split(";") if pair]
        return [(x, y) for x, y in pairs]
    except ValueError as exc:
        raise InvalidOption(f"polygon {text[:80]!r}: give x,y;x,y;x,y in metres") from exc


ROUTES: tuple[Route, ...] = (
    Route(
        "/api/near",
        _near,
        "When robots were in a disk or a polygon: time ranges by robot, both ends included; more "
        "is true if there are further time ranges.",
        (
            Parameter("x", "number", "x of the centre of the disk, metres."),
            Parameter("y", "number", "y of the centre of the disk, metres."),
            Parameter("radius", "number", "Radius of the disk, metres, 0 or more; rim included."),
            Parameter(
                "polygon", "text", "Corners of a polygon, metres: x,y;x,y;x,y …; instead of a disk."
            ),
            _FRAME,
            _ROBOT,
            *WHOLE_RANGE,
            NODES,
            _RUNS,
            Parameter(
                "limit",
                "count",
                f"Maximum number of time ranges, 1 to {MOST_STAYS}.",
                False,
                USUAL_STAYS,
            ),
        ),
    ),
    Route(
        "/api/places",
        _places,
        "The tracks of robots: for each robot times, and x and y in the frame, thinned; joined "
        "has, for each point, whether the way from the point before is known.",
        (
            *WHOLE_RANGE,
            NODES,
            _RUNS,
            _FRAME,
            _ROBOT,
            Parameter(
                "points",
                "count",
                f"Maximum number of points of a track, 2 to {MOST_POINTS}.",
                False,
                USUAL_POINTS,
            ),
        ),
    ),
)
