# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Make an occupancy grid of a topic of LaserScan or PointCloud2, or show a stored OccupancyGrid.

  cassandra_bag map /scan -o office.png
  cassandra_bag map /scan -o office.pgm --store /maps --as office
  cassandra_bag map /velodyne_points --odom /odom --sensor-offset 0.3 0 0 --sensor-height 0.6
  cassandra_bag map /scan --publish /map
  cassandra_bag map /maps --as office -o again.pgm

The poses of the sensor come from recorded tf, interpolated at the header stamps. The frame of the
map is map if tf connects it to the sensor, else odom, else the topmost frame. If no tf was
recorded, or with --odom, the poses come from a topic of type Odometry, PoseStamped or
PoseWithCovarianceStamped, and the pose of the sensor on the robot from --sensor-offset, else from
tf. If there are several such topics, the one whose poses cover most of the messages is used; the
others are printed. Messages without a known pose are left out and counted.

In a scan +Inf (or range_max itself) means that there is no obstacle up to range_max; NaN and other
values outside the range are ignored. In a cloud the points from --min-height to --max-height in the
map's frame are obstacles, and lower points are floor.

In a .png darker cells are more likely occupied. If OUT ends with .pgm or .yaml, both files are
written, for map_server. --store stores the map under a name; getData(name) returns its newest
version.
"""

from __future__ import annotations

import argparse
import os
import sys
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cassandra_ros.cli.json_answer import add_json_option, tell
from cassandra_ros.cli.options import (
    add_event_options,
    add_origin_options,
    add_store_options,
    add_time_options,
    open_store,
    read_event,
    read_times,
)
from cassandra_ros.cli.parsers import Rare
from cassandra_ros.cli.terminal_text import MessageBar, counted
from cassandra_ros.errors import InvalidName, InvalidOption, TopicNotFound, cannot_write
from cassandra_ros.own_files import whole_file
from cassandra_ros.printable import shown
from cassandra_ros.quantities import factor, whole_number

if TYPE_CHECKING:
    from cassandra_ros.client.ros_cassandra import RosCassandra
    from cassandra_ros.viewing.mapping.map_builder import MadeMap
    from cassandra_ros.viewing.mapping.occupancy import OccupancyMap
    from cassandra_ros.viewing.mapping.sensor_poses import PoseChoice

_PICTURE = ".png"
_FILES = (_PICTURE, ".pgm", ".yaml")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the topic, the outputs, the options for beams and poses, and the store."""
    parser.add_argument("topic", metavar="TOPIC", help="scans, clouds, or stored maps")
    _add_outputs(parser.add_argument_group("what becomes of the map"))
    _add_beams(parser.add_argument_group("what comes into it"))
    _add_poses(parser.add_argument_group("where the sensor was"))
    add_time_options(parser)
    add_event_options(parser)
    add_origin_options(parser)
    parser.add_argument("-q", "--quiet", action="store_true", help="print errors only")
    add_json_option(parser)
    add_store_options(parser)


def _add_outputs(group: argparse._ArgumentGroup) -> None:
    add = group.add_argument
    text = "file to write: .png, or .pgm or .yaml for map_server (default: map.png if neither "
    add("-o", "--output", metavar="OUT", help=text + "--store nor --publish is given)")
    add("-f", "--force", action="store_true", help="replace the files if they exist")
    text = "store the map on this topic, under the name of --as (default: do not store it)"
    add("--store", metavar="MAPS", help=text)
    text = "name under which the map is stored, or of the stored map to show (default: TOPIC)"
    add("--as", dest="map_name", metavar="NAME", help=text)
    text = "publish the map on this topic, latched, until Ctrl-C (default: do not publish it)"
    add("--publish", metavar="MAP", help=text)


def _add_beams(group: argparse._ArgumentGroup) -> None:
    add = group.add_argument
    text = "length of a cell, metres (default: 0.05)"
    add("--resolution", metavar="M", type=factor, help=text)
    text = "maximum distance of points, metres (default: range_max for scans, 30 for clouds)"
    add("--max-range", metavar="M", type=factor, help=text)
    text = "minimum height of obstacles; lower points are floor, metres (default: no minimum for "
    add("--min-height", metavar="M", type=float, help=Rare(text + "scans, 0.1 for clouds)"))
    text = "maximum height of points, metres (default: no maximum for scans, 2 for clouds)"
    add("--max-height", metavar="M", type=float, help=Rare(text))
    text = "maximum number of messages to use, evenly spread (default: all)"
    add("--limit", metavar="COUNT", type=whole_number, help=Rare(text))


def _add_poses(group: argparse._ArgumentGroup) -> None:
    add = group.add_argument
    add("--frame", metavar="F", help="the map's frame (default: map, odom, or the topmost one)")
    text = "topic with the robot's poses (default: tf, else the topic that covers most messages)"
    add("--odom", metavar="ODOM", help=text)
    text = "pose of the sensor on the robot, metres and radians (default: from tf, else 0 0 0)"
    add("--sensor-offset", nargs=3, type=float, metavar=("X", "Y", "YAW"), help=text)
    text = "height of the sensor above the robot's origin, metres (default: 0)"
    add("--sensor-height", metavar="M", type=float, help=text)
    # The library has the defaults. Importing it here would slow down every verb.
    add("--tf", metavar="TF", help=Rare("moving transforms (default: /tf)"))
    add("--tf-static", metavar="TF", help=Rare("fixed transforms (default: /tf_static)"))
    text = "maximum time between two poses for interpolation, seconds (default: 10)"
    add("--longest-gap", metavar="SEC", type=factor, help=Rare(text))


def run(options: argparse.Namespace) -> int:
    """Make the map, and write, store and publish it."""
    from cassandra_ros.viewing.mapping.map_builder import MapOptions, makeMap

    output = _output(options)
    (start, end), choice = read_times(options), _pose_choice(options)
    event = read_event(options)
    map_options = MapOptions(
        **_given_values(
            resolution=options.resolution,
            max_range=options.max_range,
            min_height=options.min_height,
            max_height=options.max_height,
            most=options.limit,
        )
    )
    with open_store(options) as ros_cas, MessageBar(f"mapping {options.topic}") as bar:
        made = makeMap(
            ros_cas,
            options.topic,
            start,
            end,
            nodeID=options.node_id,
            run=options.run,
            name=None if options.store else options.map_name,
            options=map_options,
            poses=choice,
            event=event,
            progress=bar.reach,
        )
        files = [] if output is None else _save(made.map, output)
        if options.store:
            _store(ros_cas, made.map, options)
    _tell(made, files, options)
    if options.publish:
        from cassandra_ros.nodes.map_publisher import publish_map

        publish_map(made.map.message(), options.publish, sys.argv, partial(_say, options))
    return 0


def _say(options: argparse.Namespace, line: str) -> None:
    """Print a line of the publisher, unless -q is given."""
    if not options.quiet:
        # Standard output may be read by another program.
        print(line, file=sys.stderr if options.json else sys.stdout, flush=True)


def _output(options: argparse.Namespace) -> Path | None:
    """Return the file to write; None = none. Refuse an invalid name before the map is made.

    Raises:
        InvalidName: The name has another ending.
        InvalidOption: The file exists, or its folder cannot be written.
    """
    from cassandra_ros.viewing.mapping.map_files import map_paths

    if not (options.output or options.store or options.publish):
        options.output = f"map{_PICTURE}"
    if options.output is None:
        return None
    output = Path(options.output)
    if output.suffix not in _FILES:
        raise InvalidName(f"-o {options.output}: give a name that ends in {', '.join(_FILES)}")
    for file in [output] if output.suffix == _PICTURE else map_paths(output):
        if os.path.exists(file) and not options.force:
            text = f"{file} exists; choose another name, or replace it with --force"
            raise InvalidOption(text)
    if not os.access(output.parent, os.W_OK):
        text = f"{output} cannot be written: {output.parent} is not a folder in which you may write"
        raise InvalidOption(text)
    return output


def _pose_choice(options: argparse.Namespace) -> PoseChoice:
    """Return where the poses of the sensor come from."""
    from cassandra_ros.places.rigid import Rigid
    from cassandra_ros.viewing.mapping.sensor_poses import PoseChoice

    offset = None
    if options.sensor_offset is not None or options.sensor_height is not None:
        x, y, yaw = options.sensor_offset or (0.0, 0.0, 0.0)
        offset = Rigid.planar([x], [y], [yaw])
        offset.moved[:, 2] = options.sensor_height or 0.0
    return PoseChoice(
        **_given_values(
            frame=options.frame,
            odom=options.odom,
            sensor_offset=offset,
            tf=options.tf,
            tf_static=options.tf_static,
            longest_gap_sec=options.longest_gap,
        )
    )


def _given_values(**values: Any) -> dict[str, Any]:
    """Return the values that are not None; the library has defaults for the others."""
    return {name: value for name, value in values.items() if value is not None}


def _save(made: OccupancyMap, output: Path) -> list[str]:
    """Write the files of a map; return their names."""
    from cassandra_ros.viewing.mapping.map_files import map_png, save_map

    try:
        if output.suffix != _PICTURE:
            return [str(path) for path in save_map(made, output)]
        with whole_file(output) as file:
            file.write(map_png(made))
        return [str(output)]
    except OSError as exc:
        raise InvalidOption(cannot_write(output, exc)) from exc


def _store(ros_cas: RosCassandra, made: OccupancyMap, options: argparse.Namespace) -> None:
    """Store a map under a name."""
    message = made.message()
    with suppress(TopicNotFound):  # then it is made
        ros_cas.getTopic(options.store).addData(message, _name(options), options.node_id)
        return
    topic = ros_cas.addTopic(options.store, key_format="manual")
    topic.addData(message, _name(options), options.node_id)


def _name(options: argparse.Namespace) -> str:
    """Return the name under which the map is stored."""
    return str(options.map_name or options.topic.strip("/"))


def _tell(made: MadeMap, files: list[str], options: argparse.Namespace) -> None:
    grid = made.map
    answer = {
        "frame": grid.frame,
        "resolution": grid.resolution,
        "origin": [grid.x, grid.y, grid.yaw],
        "width": grid.width,
        "height": grid.height,
        "stamp_ns": grid.stamp,
        "used": made.used,
        "without_pose": made.without_pose,
        "unreadable": made.unreadable,
        "placed_by_reception": made.received,
        "poses": list(made.sources),
        "pose_topics": [offer._asdict() for offer in made.offers],
        "files": files,
        "stored": {"topic": options.store, "name": _name(options)} if options.store else None,
    }
    tell(options, answer, _text(made, files, options))


def _text(made: MadeMap, files: list[str], options: argparse.Namespace) -> str:
    grid = made.map
    across, up = grid.width * grid.resolution, grid.height * grid.resolution
    lines = [
        f"map of {counted(made.used, 'message')} of {shown(options.topic)}, "
        f"{across:.1f} x {up:.1f} m in frame {shown(grid.frame)}, "
        f"{grid.width} x {grid.height} cells of {grid.resolution:g} m",
        f"poses: {shown('; '.join(made.sources), None)}",
    ]
    other_offers = [offer for offer in made.offers if not offer.taken]
    if other_offers:
        topics = ", ".join(
            f"{shown(o.topic)} ({_percent(o.share)} of the messages)" for o in other_offers
        )
        lines.append(f"--odom takes another topic of poses: {topics}")
    without = counted(made.without_pose, "message")
    if made.without_pose:
        lines.append(f"left out: {without}: no pose is known at their times")
    if made.unreadable:
        lines.append(f"left out: {counted(made.unreadable, 'message')} that cannot be read")
    if made.received:
        text = "by their reception: nothing that was recorded has the stamps of their headers"
        lines.append(f"placed {text}: {counted(made.received, 'message')}")
    if files:
        lines.append(f"written: {', '.join(files)}")
    if options.store:
        lines.append(f"stored on {shown(options.store)} as {shown(_name(options))}")
    return "\n".join(lines)


def _percent(share: float) -> str:
    """Return a share as a percentage; only exactly 0 is '0 %' and only exactly 1 is '100 %'."""
    percent = round(100 * share)
    if 0 < share < 1:
        percent = min(99, max(1, percent))
    return f"{percent} %"
