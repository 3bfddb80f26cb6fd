# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Places as the map's page asks for them: tracks, and what a lasso encloses."""

from __future__ import annotations

import numpy as np
import pytest
from mapping.room import SHIFT, T0, driven, joined
from sensor_msgs.msg import NavSatFix
from viewers import running_viewer

from cassandra_ros.errors import StoreUnavailable
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.viewing.api_call import ApiCall
from cassandra_ros.viewing.near_routes import ROUTES
from cassandra_ros.viewing.viewer_context import ViewerContext
from cassandra_ros.viewing.viewer_settings import ViewerSettings

SEC = 10**9


@pytest.mark.suite("test", "the way of a robot is indexed first")
def test_where_robots_were(viewer):
    found = viewer.get("/api/places")
    (track,) = found["tracks"]
    assert (found["frame"], track["node"], track["frame"]) == ("map", "robot", "map")
    times = np.array(track["times"], np.int64)
    assert len(times) == len(track["x"]) == len(track["y"]) == len(track["joined"]) > 20
    assert not track["joined"][0]
    assert all(track["joined"][1:])
    for n in (0, len(times) // 2, -1):
        x, y, _ = joined(SHIFT, driven((int(times[n]) - T0) / SEC))
        assert (track["x"][n], track["y"][n]) == pytest.approx((x, y), abs=0.05)
    (few,) = viewer.get("/api/places", points=10, frame="odom", nodes="robot")["tracks"]
    assert 2 <= len(few["x"]) <= 12
    assert few["frame"] == "odom"
    runs = [run["id"] for run in viewer.get("/api/runs")["runs"]]
    assert viewer.get("/api/places", runs=runs)["tracks"][0]["x"] == track["x"]
    assert viewer.fail("/api/places", runs="none")[1]["error"] == "RunNotFound"
    text = viewer.fail("/api/places", nodes="robt")[1]["text"]
    assert "no pose of robot 'robt' is stored (did you mean robot?)" in text
    part = viewer.get("/api/places", start=str(T0), end=str(T0 + SEC))["tracks"][0]
    assert int(part["times"][-1]) <= T0 + SEC
    assert viewer.get("/api/places", start=str(T0 - 9 * SEC), end=str(T0 - SEC))["tracks"] == []


def test_what_a_lasso_encloses(viewer, store):
    x, y, _ = joined(SHIFT, driven(2.0))
    disk = viewer.get("/api/near", x=x, y=y, radius=0.5)
    assert disk["stays"]
    assert not disk["more"]
    stays = [(int(stay["start"]), int(stay["end"])) for stay in disk["stays"]]
    assert any(start <= T0 + 2 * SEC <= end for start, end in stays)
    # The same in a statement: each scan of these times, and no other.
    times = [
        key.to_nsec()
        for (key,) in store.executeCQL("select KEY from /scan where NEAR(?, ?, 0.5)", [x, y])
    ]
    assert times
    assert all(any(start <= t <= end for start, end in stays) for t in times)
    square = f"{x - 0.5},{y - 0.5};{x + 0.5},{y - 0.5};{x + 0.5},{y + 0.5};{x - 0.5},{y + 0.5}"
    lasso = viewer.get("/api/near", polygon=square, nodes="robot", frame="map", robot="/base")
    (first, *_) = lasso["stays"]
    assert first["node"] == "robot"
    assert int(first["start"]) <= stays[0][0]
    assert int(first["end"]) >= stays[0][1]
    assert viewer.get("/api/near", polygon=square, limit=1)["more"] is (len(lasso["stays"]) > 1)


def test_latitude_and_longitude(fresh):
    """x is the longitude and y the latitude; without poses WGS84 is the usual frame."""
    with fresh() as store:
        fixes = store.addTopic("/fix", msg_type="sensor_msgs/NavSatFix")
        for n in range(21):
            longitude = 179.999 + 1e-4 * n
            fix = NavSatFix(latitude=10.0, longitude=longitude - 360 * (longitude > 180))
            fixes.addData(fix, key=Stamp.from_ns(T0 + n * SEC))
        with running_viewer(store) as viewer:
            found = viewer.get("/api/places")
            (track,) = found["tracks"]
            assert found["frame"] == "WGS84"
            assert track["y"] == pytest.approx([10.0] * len(track["y"]))
            assert (track["x"][0], track["x"][-1]) == pytest.approx((179.999, -179.999))
            assert viewer.get("/api/places", robot="/fix", frame="WGS84")["tracks"] == [track]
            (stay,) = viewer.get("/api/near", x=179.9995, y=10, radius=20, robot="/fix")["stays"]
            assert (int(stay["start"]) + int(stay["end"])) / 2 == pytest.approx(
                T0 + 5 * SEC, abs=1e8
            )
            square = "-179.9997,9.9;-179.9993,9.9;-179.9993,10.1;-179.9997,10.1"
            (stay,) = viewer.get("/api/near", polygon=square)["stays"]
            middle = (int(stay["start"]) + int(stay["end"])) / 2
            assert middle == pytest.approx(T0 + 15 * SEC, abs=1e8)
            text = viewer.fail("/api/near", x=10, y=179.9995, radius=20)[1]["text"]
            assert "no place on the Earth" in text
            text = viewer.fail("/api/near", x=1, y=1, radius=20, frame="map")[1]["text"]
            assert "/fix tells latitude and longitude" in text


def test_who_leaves_ends_the_search_also_where_nothing_is_found(store):
    (route,) = (route for route in ROUTES if route.path == "/api/near")
    asked = {"x": ["900"], "y": ["900"], "radius": ["1"]}
    call = ApiCall(ViewerContext(store, ViewerSettings()), route, asked, {})
    assert route.answer(call)["stays"] == []
    call.gone.set()
    with pytest.raises(StoreUnavailable, match="the client does not wait"):
        route.answer(call)


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({}, "give a region"),
        ({"polygon": "0,0;1,1"}, "3 to 1000 corners"),
        ({"polygon": "0,0;1;2,2"}, "give x,y;x,y;x,y"),
        ({"x": 0, "y": 0, "radius": -1}, "0 or more metres"),
        ({"x": 0, "y": 0, "radius": 1, "frame": "moon"}, "no pose in frame 'moon' is stored"),
        ({"x": 0, "y": 0, "radius": 1, "robot": "arm"}, "'arm' is not a frame of tf, and no topic"),
        ({"x": 0, "y": 0, "radius": 1, "limit": 0}, "limit is 1 to"),
    ],
)
def test_questions_that_make_no_sense(viewer, parameters, text):
    found = viewer.ask("/api/near", parameters)
    assert found.status == 400
    assert text in found.json()["text"]
