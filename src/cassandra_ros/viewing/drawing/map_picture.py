# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A map as a PNG: the darker a cell, the more probably it is occupied."""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np

from cassandra_ros.installation import optional_module
from cassandra_ros.viewing.mapping.occupancy import OccupancyMap

_UNKNOWN_GREY = 205
"""Grey value of unknown cells, as in map_server."""
# Indexed by a cell's byte, so that a large map needs no array of floats.
_PERCENT = np.arange(256).astype(np.uint8).view(np.int8)
_SEEN = np.where(_PERCENT < 0, 0, 255).astype(np.uint8)
_GREYS = np.where(
    _PERCENT < 0, _UNKNOWN_GREY, np.rint(255 - 2.55 * np.clip(_PERCENT, 0, 100))
).astype(np.uint8)


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
    empty = np.full(shape, _UNKNOWN_GREY, np.uint8), np.zeros(shape, np.uint8)
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
