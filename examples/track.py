#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Draw the track of a recorded robot, from two CQL queries, to a PNG."""

from __future__ import annotations

import argparse
import math
import os

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from cassandra_ros import RosCassandra

METRES_PER_DEGREE = 111_320.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--host", help="default: CASSANDRA_ROS_HOST, or as your cqlshrc says")
    parser.add_argument(
        "--port", type=int, help="default: CASSANDRA_ROS_PORT, or as your cqlshrc says"
    )
    parser.add_argument("--cqlshrc", help="file like cqlsh's; default: ~/.cassandra/cqlshrc")
    parser.add_argument(
        "--credentials", help="file like cqlsh's; default: ~/.cassandra/credentials"
    )
    parser.add_argument(
        "--keyspace",
        default=os.environ.get("CASSANDRA_ROS_KEYSPACE") or "ros",
        help="what was recorded, only read (%(default)s)",
    )
    parser.add_argument("--out", default="track.png", help="the picture (%(default)s)")
    args = parser.parse_args()

    login = {"cqlshrc": args.cqlshrc, "credentials": args.credentials}
    with RosCassandra(args.host, args.port, **login) as rosCas:
        rosCas.connectToKeyspace(args.keyspace, make=False)
        wheels = rosCas.executeCQL(
            "select KEY, pose.pose.position.x, pose.pose.position.y from /encoder"
        )
        fixes = rosCas.executeCQL(
            "select KEY, latitude, longitude from /fix where status.status >= 0"
        )

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 5))
    start = wheels[0][0]
    seconds = [(key - start).to_sec() for key, _, _ in wheels]
    points = left.scatter([x for _, x, _ in wheels], [y for _, _, y in wheels], c=seconds, s=8)
    left.set(title=f"/encoder: {len(wheels)} poses", xlabel="x [m]", ylabel="y [m]", aspect="equal")
    figure.colorbar(points, ax=left, label="time [s]")

    _, lat0, lon0 = fixes[0]
    east = [(lon - lon0) * METRES_PER_DEGREE * math.cos(math.radians(lat0)) for _, _, lon in fixes]
    north = [(lat - lat0) * METRES_PER_DEGREE for _, lat, _ in fixes]
    seconds = [(key - start).to_sec() for key, _, _ in fixes]
    points = right.scatter(east, north, c=seconds, s=14)
    right.set(title=f"/fix: {len(fixes)} GPS fixes", xlabel="east [m]", ylabel="north [m]")
    right.axis("equal")
    figure.colorbar(points, ax=right, label="time [s]")
    figure.suptitle("Clearpath Husky, from two CQL queries")
    figure.tight_layout()
    figure.savefig(args.out, dpi=100)
    print(f"{args.out}: {len(wheels)} encoder poses, {len(fixes)} fixes")


if __name__ == "__main__":
    main()
