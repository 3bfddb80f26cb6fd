# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Single messages for a page: as JSON, and images as JPEG."""

from __future__ import annotations

import io

import pytest
from PIL import Image as Pillow
from sensor_msgs.msg import Image
from std_msgs.msg import Float64MultiArray, Int64
from viewers import running_viewer

T = 1_400_000_000_123_456_789


@pytest.fixture(scope="module")
def viewer(fresh):
    with fresh() as store:
        camera = store.addTopic("/camera", "packed", msg_type="sensor_msgs/Image")
        for n in range(2):
            data = bytes((200, 100 * n, 0)) * 64 * 32
            msg = Image(height=32, width=64, encoding="rgb8", step=192, data=data)
            camera.addData(msg, key=T + n * 10**9, nodeID="husky")
        numbers = store.addTopic("/numbers", "binary")
        numbers.addData(Float64MultiArray(data=[float("nan"), 1.5, 2.5]), key=T)
        store.addTopic("/maps", key_format="manual").addData(Int64(2**60 + 1), key="kitchen")
        with running_viewer(store) as viewer:
            yield viewer


def test_a_message_is_found_by_its_key_and_by_its_place(viewer):
    found = viewer.get("/api/message", topic="/camera", key=str(T))
    assert (found["topic"], found["time"], found["node"]) == ("/camera", str(T), "husky")
    assert (found["type"], found["message"]["width"]) == ("sensor_msgs/Image", 64)
    assert len(found["message"]["data"]) == 64 * 32 * 4  # base64
    assert viewer.get("/api/message", topic="camera", position=found["position"]) == found
    late = viewer.get("/api/message", topic="/camera", key=str(T + 1), nearest="after")
    assert late["time"] == str(T + 10**9)
    short = viewer.get("/api/message", topic="/camera", key=str(T), elements="5", characters="1")
    assert short["message"]["data"] == "<array type: uint8, length: 6144>"
    assert short["message"]["encoding"] == "<string length: 4>"
    assert viewer.get("/api/message", topic="/numbers", key=str(T))["message"]["data"] == [
        None,
        1.5,
        2.5,
    ]
    kitchen = viewer.get("/api/message", topic="/maps", key="kitchen")
    assert (kitchen["name"], kitchen["message"]["data"]) == ("kitchen", 2**60 + 1)
    same = viewer.get("/api/message", topic="/maps", position=kitchen["position"])
    assert same == kitchen


def test_an_image_is_a_jpeg(viewer):
    found = viewer.ask("/api/image", {"topic": "/camera", "key": str(T)})
    assert found.headers["Content-Type"] == "image/jpeg"
    picture = Pillow.open(io.BytesIO(found.data))
    assert (picture.format, picture.size) == ("JPEG", (64, 32))
    assert all(abs(a - b) < 8 for a, b in zip(picture.getpixel((9, 9)), (200, 0, 0)))
    place = viewer.get("/api/message", topic="/camera", key=str(T + 10**9))["position"]
    found = viewer.ask("/api/image", {"topic": "/camera", "position": place, "width": "16"})
    assert Pillow.open(io.BytesIO(found.data)).size == (16, 8)


@pytest.mark.parametrize(
    ("path", "parameters", "status", "text"),
    [
        ("message", {"topic": "/camera", "key": str(T + 5)}, 404, "has no message at"),
        ("message", {"topic": "/camera"}, 400, "position or key"),
        ("message", {"topic": "/camera", "key": "1", "position": "x"}, 400, "position or key"),
        ("message", {"topic": "/camera", "position": "x"}, 400, "is not a cursor"),
        ("message", {"topic": "/camera", "key": str(T), "nearest": "x"}, 400, "not one of before"),
        ("message", {"topic": "/cam", "key": str(T)}, 404, "did you mean /camera"),
        ("message", {"key": str(T)}, 400, "needs the parameter topic"),
        ("image", {"topic": "/numbers", "key": str(T)}, 400, "pictures are made of"),
        ("image", {"topic": "/camera", "key": str(T), "width": "0"}, 400, "not a number of pixels"),
    ],
)
def test_what_fails_says_why(viewer, path, parameters, status, text):
    found = viewer.fail(f"/api/{path}", **parameters)
    assert found[0] == status and text in found[1]["text"]
