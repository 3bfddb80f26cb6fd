# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Maps as a PNG, and as files of map_server: an image with three greys, and YAML metadata."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from cassandra_ros.errors import InvalidName
from cassandra_ros.installation import optional_module
from cassandra_ros.own_files import whole_file
from cassandra_ros.viewing.mapping.occupancy import OccupancyMap

OCCUPIED_FROM = 65
"""Minimum probability of an occupied cell, %, included, as in map_saver."""
FREE_BELOW = 50
"""Probability below which a cell is free, %. A cell that a beam crossed once is free."""
_OCCUPIED, _UNKNOWN, _FREE = 0, 205, 254
"""Grey values of map_server and map_saver."""

# Indexed by a cell's byte, so that a large map needs no array of floats.
_PERCENT = np.arange(256).astype(np.uint8).view(np.int8)
_SEEN = np.where(_PERCENT < 0, 0, 255).astype(np.uint8)
_GREYS = np.where(_PERCENT < 0, _UNKNOWN, np.rint(255 - 2.55 * np.clip(_PERCENT, 0, 100))).astype(
    np.uint8
)


def trinary(made: OccupancyMap) -> np.ndarray:  # type: ignore[type-arg]
    """Return the grey values of a map, by rows of an image: the first row has the largest y."""
    cells = made.cells
    greys = np.full(cells.shape, _UNKNOWN, np.uint8)
    greys[(cells >= 0) & (cells < FREE_BELOW)] = _FREE
    greys[cells >= OCCUPIED_FROM] = _OCCUPIED
    return greys[::-1]


def map_paths(path: str | Path) -> tuple[Path, Path]:
    """Return the paths of a map's image and YAML file, given one of them.

    Raises:
        InvalidName: The path ends neither in .pgm nor in .yaml.
    """
    path = Path(path)
    if path.suffix not in (".pgm", ".yaml"):
        raise InvalidName(f"{str(path)!r} is not a name of a map: give NAME.pgm or NAME.yaml")
    return path.with_suffix(".pgm"), path.with_suffix(".yaml")


def save_map(made: OccupancyMap, path: str | Path) -> tuple[Path, Path]:
    """Write a map for map_server; return the paths of the image and of the YAML file.

    Args:
        made: The map.
        path: NAME.pgm or NAME.yaml: both are written, the image first, each atomically.

    Raises:
        InvalidName: The path has another ending.
        OSError: A file cannot be written.
    """
    image, description = map_paths(path)
    head = f"P5\n# {made.resolution:g} m a pixel\n{made.width} {made.height}\n255\n"
    with whole_file(image) as file:
        file.write(head.encode("ascii") + trinary(made).tobytes())
    # For map_server a pixel is free if its darkness is below free_thresh. The darkness of the
    # grey for unknown is 0.19608.
    entries = {
        "image": image.name,
        "resolution": made.resolution,
        "origin": [made.x, made.y, made.yaw],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    text = yaml.safe_dump(entries, sort_keys=False, default_flow_style=None, allow_unicode=True)
    with whole_file(description) as file:
        file.write(text.encode("utf-8"))
    return image, description


def map_png(made: OccupancyMap, transparent: bool = False) -> bytes:
    """Return a map as PNG, one pixel per cell, the row with the largest y first.

    The PNG also contains map_info, in a text field called ``map``.

    Args:
        made: The map.
        transparent: Whether unknown cells are transparent instead of grey.

    Raises:
        MissingDependency: Pillow is not installed.
    """
    image = optional_module("PIL.Image", "a picture of a map")
    plugin = optional_module("PIL.PngImagePlugin", "a picture of a map")
    cells = made.cells[::-1].view(np.uint8)
    layers = [_GREYS[cells]]
    if transparent:
        layers.append(_SEEN[cells])
    # A picture needs at least one pixel.
    shape = max(made.height, 1), max(made.width, 1)
    empty = np.full(shape, _UNKNOWN, np.uint8), np.zeros(shape, np.uint8)
    planes = [image.fromarray(p if p.size else e) for p, e in zip(layers, empty)]
    picture = image.merge("LA", planes) if transparent else planes[0]
    notes = plugin.PngInfo()
    notes.add_text("map", json.dumps(map_info(made)))
    out = io.BytesIO()
    picture.save(out, "PNG", pnginfo=notes, compress_level=4)
    return out.getvalue()


def map_info(made: OccupancyMap) -> dict[str, Any]:
    """Return the metadata of a map's picture: x, y, yaw are those of its lower left corner."""
    return {
        "frame": made.frame,
        "resolution": made.resolution,
        "x": made.x,
        "y": made.y,
        "yaw": made.yaw,
        "width": made.width,
        "height": made.height,
    }
