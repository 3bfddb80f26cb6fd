#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The paper's figure 4: occupancy grids out of stored LaserScan and PointCloud2.

A bag is imported, and of each of its topics of scans and clouds a map is made, with the poses that
were recorded: by tf, else by a topic of Odometry or of poses. All maps come into one picture; where
no pose is known it is drawn as if the sensor had stood still, and that is told.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from cassandra_ros import CassandraRosError, MapOptions, PoseChoice, RosCassandra, makeMap
from cassandra_ros.errors import TransformException
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.places.rigid import Rigid

BAGS = os.environ.get("CASSANDRA_ROS_BAGS")
KINDS = ("sensor_msgs/LaserScan", "sensor_msgs/MultiEchoLaserScan", "sensor_msgs/PointCloud2")


def sensors(rosCas):
    """The topics of which a map can be made, scans first."""
    found = [topic for topic in rosCas.getAllTopics() if topic.getMeta["msg_type"] in KINDS]
    return sorted(found, key=lambda topic: (KINDS.index(topic.getMeta["msg_type"]), topic.name))


def mapped(rosCas, topic, options, poses):
    """Make a map; of a sensor that stood still where nothing that was recorded knows its place."""
    try:
        return makeMap(rosCas, topic.name, options=options, poses=poses)
    except TransformException as exc:
        print(f"{topic.name}: as if it stood still, for {exc}")
        frame = topic.getData(topic.first()).header.frame_id
        return makeMap(rosCas, topic.name, options=options, poses=PoseChoice(frame=frame))


def draw(axes, topic, made):
    """Draw a map into one part of the picture."""
    grid = made.map
    right, top = grid.x + grid.width * grid.resolution, grid.y + grid.height * grid.resolution
    cells = np.ma.masked_less(grid.cells, 0)
    axes.imshow(
        cells, "gray_r", origin="lower", vmin=0, vmax=100, extent=(grid.x, right, grid.y, top)
    )
    axes.set_facecolor("0.8")
    kind = topic.getMeta["msg_class"]
    axes.set(title=f"{topic.name}: {made.used} {kind}", xlabel=f"x in {grid.frame} [m]")
    axes.set(ylabel="y [m]")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    default = Path(BAGS, "luminar_stage_lz4.bag") if BAGS else None
    text = "a bag with scans or clouds, of a robot"
    add("bag", nargs="?" if default else None, type=Path, default=default, help=text)
    add("--resolution", type=float, metavar="M", help="length of a cell (0.05, of clouds 0.2)")
    add("--max-range", type=float, metavar="M", help="what is further away is left out")
    add("--heights", nargs=2, type=float, metavar=("LOW", "HIGH"), help="of obstacles in clouds")
    add("--frame", help="the maps' frame; default: map, odom, or the topmost one")
    add("--odom", metavar="TOPIC", help="tells poses; default: tf, else the best topic")
    add("--sensor-offset", nargs=3, type=float, metavar=("X", "Y", "YAW"), help="on the robot")
    add("--keyspace", default="figure4", help="default: figure4")
    add("--host", help="default: CASSANDRA_ROS_HOST, or as your cqlshrc says")
    add("--port", type=int, help="default: CASSANDRA_ROS_PORT, or as your cqlshrc says")
    add("--cqlshrc", help="file like cqlsh's; default: ~/.cassandra/cqlshrc")
    add("--credentials", help="file like cqlsh's; default: ~/.cassandra/credentials")
    add("--out", default="figure4.png", help="the picture (%(default)s)")
    args = parser.parse_args()

    offset = args.sensor_offset and Rigid.planar(*([number] for number in args.sensor_offset))
    poses = PoseChoice(frame=args.frame, odom=args.odom, sensor_offset=offset)
    low, high = args.heights or (None, None)
    login = {"cqlshrc": args.cqlshrc, "credentials": args.credentials}
    with RosCassandra(args.host, args.port, **login) as rosCas:
        rosCas.connectToKeyspace(args.keyspace)
        report = import_bag(rosCas, args.bag)
        print(f"stored:   {report.messages} messages of {args.bag.name}")
        drawn = []
        for topic in sensors(rosCas):
            cloud = topic.getMeta["msg_class"] == "PointCloud2"
            options = MapOptions(
                resolution=args.resolution or (0.2 if cloud else 0.05),
                max_range=args.max_range or (100 if cloud else None),
                min_height=low if cloud else None,
                max_height=high if cloud else None,
            )
            try:
                made = mapped(rosCas, topic, options, poses)
            except CassandraRosError as exc:
                print(f"{topic.name}: no map: {exc}")
                continue
            drawn.append((topic, made))
            size = f"{made.map.width} x {made.map.height} cells"
            lost = f", {made.without_pose} without a pose" if made.without_pose else ""
            print(f"{topic.name}: {size} of {made.used} messages{lost}; {'; '.join(made.sources)}")
        if not drawn:
            parser.exit(1, f"{args.bag} gives no map\n")
        figure, parts = plt.subplots(1, len(drawn), figsize=(6.5 * len(drawn), 6), squeeze=False)
        for axes, (topic, made) in zip(parts[0], drawn):
            draw(axes, topic, made)
    figure.tight_layout()
    figure.savefig(args.out, dpi=110)
    print(f"picture:  {args.out}")


if __name__ == "__main__":
    main()
