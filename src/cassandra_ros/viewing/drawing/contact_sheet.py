# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A contact sheet, many small pictures in one with captions, and its file, written atomically."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Sequence

from cassandra_ros.errors import InvalidOption, cannot_write
from cassandra_ros.installation import optional_module
from cassandra_ros.own_files import whole_file

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageFont import FreeTypeFont, ImageFont

_GAP = 6
"""Distance between cells, pixels."""
_TEXT = 12
_TITLE = 16
"""Height of the title's letters, pixels."""
_GROUND, _INK, _FAINT = (255, 255, 255), (20, 20, 20), (235, 235, 235)

ENDINGS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG", ".webp": "WEBP"}
"""Formats in Pillow's names, by file name ending."""


class CaptionedPicture(NamedTuple):
    """A picture of a sheet and its caption."""

    caption: str
    picture: Image | None
    """Picture; None if it could not be drawn: the caption says why."""


def draw_sheet(cells: Sequence[CaptionedPicture], columns: int, width: int, title: str) -> Image:
    """Draw small pictures in rows.

    Args:
        cells: Cells in their order, at least one; a picture is at most ``width`` wide.
        columns: Maximum number of cells in a row, at least 1.
        width: Width of a cell, pixels.
        title: Text above the cells.

    Raises:
        MissingDependency: Pillow is not installed.
    """
    image = optional_module("PIL.Image", "a contact sheet")
    draw = optional_module("PIL.ImageDraw", "a contact sheet")
    fonts = optional_module("PIL.ImageFont", "a contact sheet")
    text, large = fonts.load_default(_TEXT), fonts.load_default(_TITLE)
    height = max([cell.picture.height for cell in cells if cell.picture is not None] or [width])
    columns = min(columns, len(cells))
    step_x, step_y = width + _GAP, height + _TEXT + 3 * _GAP
    top = _TITLE + 3 * _GAP
    size = (_GAP + columns * step_x, top + -(-len(cells) // columns) * step_y)
    sheet: Image = image.new("RGB", size, _GROUND)
    pen = draw.Draw(sheet)
    pen.text((_GAP, _GAP), fitted(title, large, size[0] - 2 * _GAP), _INK, font=large)
    for number, cell in enumerate(cells):
        x, y = _GAP + number % columns * step_x, top + number // columns * step_y
        pen.rectangle((x, y, x + width - 1, y + height - 1), _FAINT)
        if cell.picture is not None:
            inner = x + (width - cell.picture.width) // 2, y + (height - cell.picture.height) // 2
            sheet.paste(cell.picture, inner)
        pen.text((x, y + height + _GAP), fitted(cell.caption, text, width), _INK, font=text)
    return sheet


def fitted(text: str, font: FreeTypeFont | ImageFont, width: int) -> str:
    """Shorten a text to at most ``width`` pixels."""
    if font.getlength(text) <= width:
        return text
    while text and font.getlength(text + "...") > width:
        text = text[:-1]
    return text + "..."


def check_picture_path(path: str | os.PathLike[str], force: bool = False) -> None:
    """Check the path of a picture before it is drawn.

    Args:
        path: Path of the file.
        force: Whether an existing file may be replaced.

    Raises:
        InvalidOption: The ending is not in ENDINGS, or the file exists.
    """
    if Path(path).suffix.lower() not in ENDINGS:
        endings = ", ".join(ENDINGS)
        raise InvalidOption(
            f"{os.fspath(path)} is not a name of a picture: known endings are {endings}"
        )
    if os.path.exists(path) and not force:
        text = f"{os.fspath(path)} exists; choose another name, or replace it with --force"
        raise InvalidOption(text)


def save_picture(picture: Image, path: str | os.PathLike[str]) -> int:
    """Write a picture in the format of the file's ending; return its size in bytes.

    Raises:
        InvalidOption: The file cannot be written, or the format does not allow so large a picture.
            An existing file then stays.
    """
    image = io.BytesIO()
    form = ENDINGS[Path(path).suffix.lower()]
    try:
        picture.save(image, form)
    except (OSError, ValueError) as exc:
        raise InvalidOption(
            f"{os.fspath(path)} cannot be made: {picture.width} x {picture.height} pixels are too "
            f"many for {form}; take .png, or fewer or smaller pictures ({exc})"
        ) from exc
    try:
        with whole_file(Path(path)) as file:
            file.write(image.getvalue())
    except OSError as exc:
        raise InvalidOption(cannot_write(path, exc)) from exc
    return len(image.getvalue())
