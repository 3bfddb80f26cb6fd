# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A finished map: the probability of each cell in per cent, as in nav_msgs/OccupancyGrid."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.classes import message_class
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.viewing.mapping.grid import LogOddsGrid

OCCUPANCY_GRID = "nav_msgs/OccupancyGrid"
UNKNOWN = -1
# The definition is repeated here, so that nav_msgs need not be installed to make maps.
_SECTION = "\n" + "=" * 80 + "\nMSG: "
_DEFINITION = _SECTION.join(
    (
        "std_msgs/Header header\nnav_msgs/MapMetaData info\nint8[] data",
        "std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id",
        "nav_msgs/MapMetaData\ntime map_load_time\nfloat32 resolution\nuint32 width\n"
        "uint32 height\ngeometry_msgs/Pose origin",
        "geometry_msgs/Pose\ngeometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
        "geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z",
        "geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    )
)


@dataclass(frozen=True, eq=False)
class OccupancyMap:
    """A map of the plane.

    Attributes:
        cells: (height, width) of int8: probability that the cell is occupied, 0 to 100 %; -1 =
            unknown. Row 0 has the smallest y, as in the message.
        resolution: Length of a cell, metres.
        x, y, yaw: Pose of the corner of cell (0, 0) in the frame: metres, radians.
        frame: Name of the frame, without a slash in front.
        stamp: Time of the newest measurement, ns since 1970.
    """

    cells: NDArray[np.int8]
    resolution: float
    x: float
    y: float
    yaw: float
    frame: str
    stamp: int

    @classmethod
    def of_grid(cls, grid: LogOddsGrid, frame: str, stamp: int) -> OccupancyMap:
        """Return the map of a grid of log-odds."""
        odds, (x, y) = grid.trimmed()
        percent = np.rint(100 / (1 + np.exp(-odds)))
        cells = np.where(odds == 0, UNKNOWN, percent).astype(np.int8)
        return cls(cells, grid.resolution, x, y, 0.0, frame, stamp)

    @classmethod
    def of_message(cls, message: Any) -> OccupancyMap:
        """Return the map of a nav_msgs/OccupancyGrid.

        Raises:
            CorruptMessage: The number of cells differs from width x height, or the resolution is
                invalid.
        """
        info = message.info
        cells = np.asarray(message.data, np.int8)
        if len(cells) != info.width * info.height or not 0 < info.resolution < math.inf:
            raise CorruptMessage(
                f"a map of {info.width} x {info.height} cells of {info.resolution:g} m has "
                f"{len(cells)} of them"
            )
        at, turned = info.origin.position, info.origin.orientation
        yaw = math.atan2(
            2 * (turned.w * turned.z + turned.x * turned.y),
            1 - 2 * (turned.y * turned.y + turned.z * turned.z),
        )
        frame, stamp = message.header.frame_id.lstrip("/"), message.header.stamp.to_nsec()
        cells = cells.reshape(info.height, info.width)
        return cls(cells, float(info.resolution), at.x, at.y, yaw, frame, stamp)

    @property
    def width(self) -> int:
        """Number of columns."""
        return int(self.cells.shape[1])

    @property
    def height(self) -> int:
        """Rows."""
        return int(self.cells.shape[0])

    def message(self) -> Any:
        """Return it as a nav_msgs/OccupancyGrid: of the installed class, where there is one."""
        made = message_class(parse_definition(OCCUPANCY_GRID, _DEFINITION))()
        made.header.frame_id = self.frame
        secs, nsecs = divmod(self.stamp, SECOND_NS)
        for stamp in (made.header.stamp, made.info.map_load_time):
            stamp.secs, stamp.nsecs = secs, nsecs
        made.info.resolution = self.resolution
        made.info.width, made.info.height = self.width, self.height
        made.info.origin.position.x, made.info.origin.position.y = self.x, self.y
        made.info.origin.orientation.z = math.sin(self.yaw / 2)
        made.info.origin.orientation.w = math.cos(self.yaw / 2)
        made.data = self.cells.ravel().tolist()
        return made
