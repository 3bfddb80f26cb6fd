# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A contact sheet has its pictures where they belong, and its file is whole."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image, ImageFont

from cassandra_ros.errors import InvalidOption
from cassandra_ros.viewing.drawing.contact_sheet import (
    CaptionedPicture,
    check_picture_path,
    draw_sheet,
    fitted,
    save_picture,
)

COLOURS = [(255, 0, 0), (0, 255, 0), (0, 0, 255), (9, 9, 9), (250, 250, 0)]


def where(sheet, colour):
    """The box of a colour: left, top, right, bottom; the last two included."""
    rows, columns = np.nonzero((np.asarray(sheet) == colour).all(axis=2))
    return (columns.min(), rows.min(), columns.max(), rows.max())


def test_pictures_stand_in_rows():
    cells = [
        CaptionedPicture(str(n), Image.new("RGB", (40, 30), colour))
        for n, colour in enumerate(COLOURS)
    ]
    sheet = draw_sheet(cells, 3, 40, "five")
    boxes = [where(sheet, colour) for colour in COLOURS[:3] + COLOURS[4:]]
    assert all((right - left, bottom - top) == (39, 29) for left, top, right, bottom in boxes)
    assert len({box[1] for box in boxes[:3]}) == 1
    assert boxes[0][0] < boxes[1][0] < boxes[2][0] < sheet.width
    assert boxes[3][0] == boxes[1][0] and boxes[3][1] > boxes[0][3]
    assert boxes[3][3] < sheet.height
    # Something is written above and below.
    ink = np.asarray(sheet.convert("L")) < 100
    assert ink[: boxes[0][1]].any() and ink[boxes[0][3] + 1 : boxes[3][1]].any()


def test_one_that_is_missing_or_smaller_leaves_its_place():
    small = Image.new("RGB", (10, 30), COLOURS[0])
    sheet = draw_sheet(
        [CaptionedPicture("none", None), CaptionedPicture("small", small)], 8, 40, "x" * 500
    )
    left, _, right, _ = where(sheet, COLOURS[0])
    assert right - left == 9 and left > 46 + 10
    assert sheet.width < 120
    assert draw_sheet([CaptionedPicture("none", None)], 1, 40, "").height > 40


def test_texts_are_cut():
    font = ImageFont.load_default(12)
    assert fitted("short", font, 200) == "short"
    cut = fitted("a text that is longer", font, 60)
    assert cut.endswith("...") and font.getlength(cut) <= 60


def test_a_picture_is_written_whole_or_not_at_all(tmp_path):
    picture = Image.new("RGB", (3, 3))
    for name in ("a.png", "a.JPG", "a.webp"):
        assert save_picture(picture, tmp_path / name) == (tmp_path / name).stat().st_size
        assert Image.open(tmp_path / name).size == (3, 3)
    for name, text in (("a.png", "exists; choose another name"), ("a.gif", "known endings are")):
        with pytest.raises(InvalidOption, match=text):
            check_picture_path(tmp_path / name)
    check_picture_path(tmp_path / "a.png", force=True)
    with pytest.raises(InvalidOption, match="cannot be written: No such file"):
        save_picture(picture, tmp_path / "none" / "a.png")
    for name, form in (("a.JPG", "JPEG"), ("a.webp", "WEBP")):
        with pytest.raises(InvalidOption, match=f"70000 x 1 pixels are too many for {form}; take"):
            save_picture(Image.new("L", (70_000, 1)), tmp_path / name)
        assert Image.open(tmp_path / name).size == (3, 3)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.JPG", "a.png", "a.webp"]
