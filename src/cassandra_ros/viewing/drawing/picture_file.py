# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Atomic writing of a picture to a file."""

from __future__ import annotations

import io
import os
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from cassandra_ros.errors import InvalidOption, cannot_write
from cassandra_ros.own_files import new_file

if TYPE_CHECKING:
    from PIL.Image import Image

ENDINGS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG", ".webp": "WEBP"}
"""Formats in Pillow's names, by file name ending."""


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
    image, active = io.BytesIO(), Path(f"{os.fspath(path)}.active")
    form = ENDINGS[Path(path).suffix.lower()]
    try:
        picture.save(image, form)
    except (OSError, ValueError) as exc:
        raise InvalidOption(
            f"{os.fspath(path)} cannot be made: {picture.width} x {picture.height} pixels are too "
            f"many for {form}; take .png, or fewer or smaller pictures ({exc})"
        ) from exc
    try:
        with open(new_file(active), "wb") as file:
            file.write(image.getvalue())
        os.replace(active, path)
    except OSError as exc:
        with suppress(OSError):
            active.unlink()
        raise InvalidOption(cannot_write(path, exc)) from exc
    return len(image.getvalue())
