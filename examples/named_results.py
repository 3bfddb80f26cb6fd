#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Results under names (the paper's future work): maps, models, trajectories, and their versions.

Recorded topics are found by time. What a robot worked out is found by what it is: the map of the
kitchen, the model of the cup, the way to the dock.
"""

from __future__ import annotations

import argparse
import math

from geometry_msgs.msg import Point, PoseStamped
from nav_msgs.msg import OccupancyGrid, Path
from shape_msgs.msg import Mesh, MeshTriangle
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import Marker

from cassandra_ros import RosCassandra


def room(width, height):
    """A room with walls, 5 cm a cell."""
    grid = OccupancyGrid()
    grid.header.frame_id = "map"
    grid.info.resolution = 0.05
    grid.info.width, grid.info.height = width, height
    wall, free = [100] * width, [100] + [0] * (width - 2) + [100]
    grid.data = wall + free * (height - 2) + wall
    return grid


def cylinder(radius, height, corners=32):
    """The side of a cup: 2 triangles a corner."""
    ring = [2 * math.pi * corner / corners for corner in range(corners)]
    mesh = Mesh()
    for angle in ring:
        x, y = radius * math.cos(angle), radius * math.sin(angle)
        mesh.vertices += [Point(x, y, 0.0), Point(x, y, height)]
    for low in range(0, 2 * corners, 2):
        following = (low + 2) % (2 * corners)
        mesh.triangles.append(MeshTriangle([low, following, low + 1]))
        mesh.triangles.append(MeshTriangle([following, following + 1, low + 1]))
    return mesh


def wave(joints, points):
    """A trajectory of an arm: each joint a sine, 10 points a second."""
    trajectory = JointTrajectory(joint_names=[f"joint_{number}" for number in range(joints)])
    for number in range(points):
        point = JointTrajectoryPoint()
        point.positions = [math.sin(0.1 * number + joint) for joint in range(joints)]
        point.time_from_start.nsecs = number % 10 * 10**8
        point.time_from_start.secs = number // 10
        trajectory.points.append(point)
    return trajectory


def way(*corners):
    """A path through corners, in the frame map."""
    path = Path()
    path.header.frame_id = "map"
    for x, y in corners:
        pose = PoseStamped()
        pose.header.frame_id = "map"
        pose.pose.position.x, pose.pose.position.y = x, y
        pose.pose.orientation.w = 1.0
        path.poses.append(pose)
    return path


def maps(rosCas):
    topic = rosCas.addTopic("maps", key_format="manual", metadata={"site": "house 3"})
    first = topic.addData(room(80, 60), key="kitchen")
    topic.addData(room(81, 60), key="kitchen")  # mapped again: the older one stays
    topic.addData(room(2000, 2000), key="hall")  # 4 MB
    newest = topic.getData("kitchen")
    print(f"kitchen: {newest.info.width} x {newest.info.height} cells, newest of "
          f"{topic.countTopicData('kitchen')} versions")  # fmt: skip
    print(f"         the first was {topic.getData(first).info.width} cells wide")
    print(f"hall:    {len(topic.getData('hall').data)} cells")
    print(f"names:   {sorted({str(name) for name, _ in topic.items()})}")


def models(rosCas):
    topic = rosCas.addTopic("models", key_format="manual")
    topic.addData(cylinder(0.04, 0.1), key="cup")
    print(f"cup:     {len(topic.getData('cup').triangles)} triangles")
    markers = rosCas.addTopic("markers", key_format="manual")
    marker = Marker(type=Marker.MESH_RESOURCE, mesh_resource="package://kitchen/cup.dae")
    markers.addData(marker, key="cup")
    print(f"         drawn as {markers.getData('cup').mesh_resource}")


def trajectories(rosCas):
    topic = rosCas.addTopic("trajectories", key_format="manual")
    topic.addData(wave(joints=6, points=50), key="wave")
    print(f"wave:    {len(topic.getData('wave').points)} points")
    paths = rosCas.addTopic("paths", key_format="manual")
    paths.addData(way((0, 0), (2, 0), (2, 3)), key="to the dock")
    paths.addData(way((0, 0), (5, 5)), key="to the door")
    stmt = "select KEY, poses.pose.position.x from paths where poses.pose.position.y >= 5"
    print(f"beyond 5 m: {[(str(key), x) for key, x in rosCas.executeCQL(stmt)]}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--host", help="default: CASSANDRA_ROS_HOST, or as your cqlshrc says")
    parser.add_argument(
        "--port", type=int, help="default: CASSANDRA_ROS_PORT, or as your cqlshrc says"
    )
    parser.add_argument("--cqlshrc", help="file like cqlsh's; default: ~/.cassandra/cqlshrc")
    parser.add_argument(
        "--credentials", help="file like cqlsh's; default: ~/.cassandra/credentials"
    )
    parser.add_argument("--keyspace", default="named_results", help="default: %(default)s")
    args = parser.parse_args()
    login = {"cqlshrc": args.cqlshrc, "credentials": args.credentials}
    with RosCassandra(args.host, args.port, keyspace=args.keyspace, **login) as rosCas:
        maps(rosCas)
        models(rosCas)
        trajectories(rosCas)


if __name__ == "__main__":
    main()
