# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""When robots were near a place, or in what a lasso encloses; and where they were."""

from __future__ import annotations

import itertools
from typing import List, Sequence, Tuple

from cassandra_ros.errors import InvalidOption, StoreUnavailable
from cassandra_ros.keys import MAX_NS
from cassandra_ros.places.regions import DiskRegion, Polygon, Region
from cassandra_ros.places.tracks import find_tracks
from cassandra_ros.viewing.answers import Json
from cassandra_ros.viewing.call import Call
from cassandra_ros.viewing.choice import whose_chosen
from cassandra_ros.viewing.route import Parameter, Route

MOST_STAYS = 1000
USUAL_STAYS = 200
MOST_POINTS = 20_000
USUAL_POINTS = 2000
_FRAME = Parameter("frame", "text", "Of the coordinates; missing: map, odom, or what there is.")
_ROBOT = Parameter(
    "robot", "text", "The frame that moves, or a topic of poses; missing: to be found out."
)
_NODES = Parameter("nodes", "texts", "Only of these robots (nodeIDs); without: of all.")
_RUNS = Parameter("runs", "texts", "By the poses of these runs, where they recorded any.")


def _near(call: Call) -> Json:
    limit = call.count("limit")
    limit = USUAL_STAYS if limit is None else limit
    if not 1 <= limit <= MOST_STAYS:
        raise InvalidOption(f"limit is 1 to {MOST_STAYS}, not {limit}")
    frame, robot = call.text("frame") or "", call.text("robot") or ""
    places = call.catalog.places
    low, high = _ends(call)
    found: List[Json] = []
    nodes, writers = call.texts("nodes"), whose_chosen(call).writers
    asked = places.within(_region(call), frame or places.usual_frame(), robot, nodes, writers)
    more = False
    for node in asked.nodes:
        stays = asked.spans(low, high, node=node, watch=lambda: _check_waited_for(call))
        for start, end in itertools.islice(stays, limit - len(found) + 1):
            if len(found) == limit:
                more = True
                break
            found.append({"node": node, "start": str(start), "end": str(end)})
    return {"stays": found, "more": more}


def _places(call: Call) -> Json:
    points = call.count("points")
    points = USUAL_POINTS if points is None else points
    if not 2 <= points <= MOST_POINTS:
        raise InvalidOption(f"points is 2 to {MOST_POINTS}, not {points}")
    places = call.catalog.places
    low, high = _ends(call)
    frame, robot = call.text("frame") or places.usual_frame(), call.text("robot") or ""
    tracks = find_tracks(
        places,
        (frame, robot),
        call.texts("nodes"),
        whose_chosen(call).writers,
        (low, high, points),
        lambda: _check_waited_for(call),
    )
    return {"frame": frame, "tracks": [track.told() for track in tracks]}


def _check_waited_for(call: Call) -> None:
    if call.gone.is_set():
        raise StoreUnavailable("nobody waits for the answer any more")


def _ends(call: Call) -> Tuple[int, int]:
    low, high = call.time_ns("start"), call.time_ns("end")
    return 0 if low is None else low, MAX_NS if high is None else high


def _region(call: Call) -> Region:
    corners = call.text("polygon")
    x, y, radius = (call.number(name) for name in ("x", "y", "radius"))
    if corners:
        return Polygon(_corners(corners))
    if x is None or y is None or radius is None:
        raise InvalidOption("say where: x, y and radius, or polygon=x,y;x,y;x,y, in metres")
    if radius < 0:
        raise InvalidOption(f"radius is {radius}: it is 0 or more metres")
    return DiskRegion(x, y, radius)


def _corners(text: str) -> Sequence[Tuple[float, float]]:
    try:
        pairs = [tuple(map(float, pair.split(","))) for pair in text.split(";") if pair]
        return [(x, y) for x, y in pairs]
    except ValueError as exc:
        raise InvalidOption(f"polygon {text[:80]!r}: give x,y;x,y;x,y in metres") from exc


_TIMES = (
    Parameter("start", "time", "First time (default: that of all)."),
    Parameter("end", "time", "Last time, included (default: that of all)."),
)
ROUTES: tuple[Route, ...] = (
    Route(
        "/api/near",
        _near,
        "When robots were on a disk, or in what a polygon encloses: time ranges by robot, "
        "with both ends; more says that there are others behind the last.",
        (
            Parameter("x", "number", "Of the middle of a disk, metres."),
            Parameter("y", "number", "Of the middle of a disk, metres."),
            Parameter("radius", "number", "Of a disk, 0 or more metres, the rim included."),
            Parameter("polygon", "text", "Corners in metres, x,y;x,y;x,y …: instead of a disk."),
            _FRAME,
            _ROBOT,
            *_TIMES,
            _NODES,
            _RUNS,
            Parameter("limit", "count", f"So many at most, 1 to {MOST_STAYS}.", False, USUAL_STAYS),
        ),
    ),
    Route(
        "/api/places",
        _places,
        "Where robots were: for each a track of times and of x and y in metres, thinned; joined "
        "says of each point whether the way from the one before is known.",
        (
            *_TIMES,
            _NODES,
            _RUNS,
            _FRAME,
            _ROBOT,
            Parameter(
                "points", "count", f"Of a track, at most, 2 to {MOST_POINTS}.", False, USUAL_POINTS
            ),
        ),
    ),
)
