# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Maps as a browser asks for them."""

from __future__ import annotations

import io
import json

import numpy as np
from compiled import compiled
from mapping.room import SHIFT, T0, assert_room
from PIL import Image

from cassandra_ros.viewing import map_routes
from cassandra_ros.viewing.mapping.occupancy import OccupancyMap

SEC = 10**9


def ask(viewer, **parameters):
    """Return a map as it is told and drawn."""
    found = viewer.ask("/api/map", parameters)
    assert (found.status, found.headers["Content-Type"]) == (200, "image/png"), found.text
    told = json.loads(found.headers["X-Map"])
    grey, alpha = np.moveaxis(np.asarray(Image.open(io.BytesIO(found.data))), 2, 0)
    assert grey.shape == (told["height"], told["width"])
    cells = np.where(alpha > 0, np.rint((255 - grey.astype(int)) / 2.55), -1)[::-1]
    place = (told["resolution"], told["x"], told["y"], told["yaw"], told["frame"])
    return OccupancyMap(cells.astype(np.int8), *place, int(told["stamp"])), told


def test_a_map_is_a_picture_and_what_it_means(viewer):
    compiled("tf2_py")
    made, told = ask(viewer, topic="/scan")
    assert_room(made, SHIFT)
    assert (told["used"], told["without_pose"], told["sources"]) == (63, 1, ["tf (map to laser)"])
    odom, told = ask(viewer, topic="scan", odom="/odom", resolution=0.1, nodes="robot")
    assert (odom.frame, odom.resolution) == ("odom", 0.1)
    ((topic, share, taken),) = (each.values() for each in told["pose_topics"])
    assert (topic, share > 0.9, taken) == ("/odom", True, True)
    assert_room(odom)
    window = {"start": f"{T0}", "end": f"{T0 + SEC}"}
    assert ask(viewer, topic="/scan", **window)[1]["used"] == 10
    assert ask(viewer, topic="/scan", scans=20)[1]["used"] <= 20


def test_the_same_map_is_made_once_until_more_is_stored(viewer, store, monkeypatch):
    calls = []
    make = map_routes.makeMap
    monkeypatch.setattr(map_routes, "makeMap", lambda *a, **k: calls.append(1) or make(*a, **k))
    for _ in range(2):
        ask(viewer, topic="/scan", resolution=0.2)
    assert len(calls) == 1
    topic = store.getTopic("/scan")
    message = topic.getData(topic.last())
    message.header.stamp.secs += 1
    topic.addData(message, topic.last() + 1, nodeID="robot")
    assert ask(viewer, topic="/scan", resolution=0.2)[1]["without_pose"] == 2
    assert len(calls) == 2


def test_what_cannot_be_drawn_is_told(viewer):
    compiled("tf2_py")
    for status, error, parameters in (
        (400, "InvalidOption", {}),
        (404, "TopicNotFound", {"topic": "/nothing"}),
        (404, "RunNotFound", {"topic": "/scan", "runs": "yesterday"}),
        (400, "TypeMismatch", {"topic": "/odom"}),
        (400, "InvalidOption", {"topic": "/scan", "resolution": "-1"}),
        (400, "InvalidOption", {"topic": "/scan", "resolution": "0.0001"}),
        (400, "InvalidOption", {"topic": "/scan", "max_height": "-50"}),
        (404, "MessageNotFound", {"topic": "/scan", "end": "1.5"}),
        (404, "TransformException", {"topic": "/scan", "frame": "attic"}),
        (400, "InvalidOption", {"topic": "/scan", "colour": "red"}),
    ):
        found, told = viewer.fail("/api/map", **parameters)
        assert (found, told["error"]) == (status, error), told
        assert told["text"]
