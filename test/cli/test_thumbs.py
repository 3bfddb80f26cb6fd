# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""cassandra_bag thumbs as it is typed: the pictures that are chosen are in the sheet."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image as Pillow
from sensor_msgs.msg import Image
from std_msgs.msg import String

T = 1_400_000_000_000_000_000


@pytest.fixture(scope="module")
def store(fresh):
    """A camera, a picture a second, whose red is its number."""
    with fresh() as store:
        topic = store.addTopic("/camera/image", "binary", msg_type="sensor_msgs/Image")
        for n in range(50):
            topic.addData(picture(n), key=T + n * 10**9, nodeID="husky")
        broken = store.addTopic("/broken", "binary", msg_type="sensor_msgs/Image")
        for n in range(3):
            broken.addData(picture(n, "rgb8" if n else "h264"), key=T + n * 10**9)
        store.addTopic("/text").addData(String("no picture"))
        yield store


def picture(number, encoding="rgb8"):
    msg = Image(height=6, width=8, encoding=encoding, step=24, data=bytes((number, 0, 0)) * 48)
    msg.header.seq = number
    return msg


@pytest.fixture
def thumbs(call, store, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def run(*words):
        return call("thumbs", *words, keyspace=store.keyspace)

    return run


def numbers_in(path):
    """The reds of a sheet in the order of its cells, by the middle of each."""
    values = np.asarray(Pillow.open(path))
    mine = (values[:, :, 1] == 0) & (values[:, :, 2] == 0)
    rows, columns = np.nonzero(mine)
    cells = {}
    for y, x in zip(rows, columns):
        cells.setdefault((y // 20, x // 10, values[y, x, 0]), 0)
    return [int(red) for _, _, red in sorted(cells)]


def test_a_sheet_has_the_pictures_of_even_times(thumbs, tmp_path):
    status, out, err = thumbs("/camera/image", "--columns", "3", "--rows", "2", "--width", "8")
    assert (status, err) == (0, "")
    assert "camera_image.png: 6 pictures of /camera/image, 2014-05-13 16:53:20.000 to" in out
    assert set(numbers_in(tmp_path / "camera_image.png")) == {0, 10, 20, 29, 39, 49}

    status, out, _ = thumbs("camera/image", "-o", "a.png", "--every", "20", "--json")
    found = json.loads(out)
    assert [each["time_ns"] for each in found["pictures"]] == [T, T + 20 * 10**9, T + 40 * 10**9]
    assert found["pictures"][0] == {"time_ns": T, "node": "husky", "drawn": True}
    assert found["size"] == (tmp_path / "a.png").stat().st_size
    assert (found["width"], found["height"]) == Pillow.open(tmp_path / "a.png").size
    # All of them where there is room, and only those that are asked for.
    for words, wanted in (
        (["--columns", "10"], list(range(50))),
        (["--start", f"{T + 48 * 10**9}", "--end", "1400000100"], [48, 49]),
        (["--where", "/camera/image: header.seq < 3"], [0, 1, 2]),
        (["--where", "camera/image: header.seq < 3", "--columns", "2", "--rows", "1"], [0, 2]),
        (["--node-id", "husky", "--rows", "1", "--columns", "2"], [0, 49]),
    ):
        status, out, err = thumbs("/camera/image", "-f", "-o", "a.png", "--width", "8", *words)
        assert (status, err) == (0, ""), words
        assert sorted(set(numbers_in(tmp_path / "a.png"))) == wanted, words


def test_a_message_that_cannot_be_drawn_leaves_an_empty_cell(thumbs, tmp_path):
    status, out, err = thumbs("/broken", "-o", "a.png", "--width", "8")
    assert status == 1 and err.count("\n") == 1 and "encoded as 'h264'" in err
    assert "2 pictures of /broken" in out
    assert sorted(set(numbers_in(tmp_path / "a.png"))) == [1, 2]
    status, out, err = thumbs("/broken", "-o", "b.png", "--end", f"{T}")
    assert (status, out, err.count("\n")) == (1, "", 1) and "encoded as 'h264'" in err
    assert not (tmp_path / "b.png").exists()


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["/text"], "/text holds std_msgs/String: pictures are made of sensor_msgs/Image and"),
        (["/camera/imag"], "did you mean /camera/image?"),
        (["/camera/image", "-o", "a.gif"], "known endings are .png"),
        (["/camera/image", "-o", "there.png"], "exists; choose another name"),
        (["/camera/image", "--columns", "0"], "at least one row and one column"),
        (["/camera/image", "--columns", "50", "--rows", "50"], "more than the 1000"),
        (["/camera/image", "--width", "9999"], "not within 1 to 2000 pixels"),
        (["/camera/image", "--width", "2000", "--rows", "6"], "36 pictures are more than the 33"),
        (["/camera/image", "--where", "/text: data = 'x'"], "is for /camera/image, which is drawn"),
        (["/camera/image", "--end", "1399999999"], "has no such message"),
    ],
    ids=range(10),
)
def test_what_is_wrong_is_told_in_a_line(thumbs, tmp_path, words, text):
    (tmp_path / "there.png").touch()
    status, out, err = thumbs(*words)
    assert (status, out, err.count("\n")) == (1, "", 1)
    assert text in err
    assert [path.name for path in tmp_path.iterdir()] == ["there.png"]


def test_messages_deleted_meanwhile_are_reported(thumbs, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "cassandra_ros.topics.overview.time_sample.spaced_rows", lambda *asked: iter(())
    )
    status, out, err = thumbs("/camera/image")
    assert (status, out) == (1, "") and "/camera/image had there was deleted meanwhile" in err
    assert not any(tmp_path.iterdir())
