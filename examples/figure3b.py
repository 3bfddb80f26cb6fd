#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The paper's figure 3b: a stored scan, replayed over a map, in the viewer.

A bag with scans is imported. The map is one that was recorded, else it is made of the scans, with
the robot's poses out of recorded tf or of a topic of Odometry, and stored under a name beside them.
Then the viewer shows both from above: as a picture (--picture), or to be replayed (--view).
"""

from __future__ import annotations

import argparse
import base64
import json
import os
import subprocess
import sys
import zlib
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from geometry_msgs.msg import TransformStamped
from tf2_msgs.msg import TFMessage

from cassandra_ros import RosCassandra
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.viewing.mapping.map_builder import makeMap
from cassandra_ros.viewing.mapping.pose_offers import Measurements
from cassandra_ros.viewing.mapping.sensor_poses import PoseChoice, SensorPoses

VIEWER = Path(__file__).resolve().parents[1] / "scripts" / "viewer"
BAGS = os.environ.get("CASSANDRA_ROS_BAGS")
SCAN, MAP = "sensor_msgs/LaserScan", "nav_msgs/OccupancyGrid"
ABOVE_M = 0.1  # so far above the map a scan is drawn of which nobody knows the height
SIZE = (1280, 800)
POINTS = {"colorMode": "flat", "pointSize": 5}
DRAWN = """
const frame = document.querySelector('iframe#studio');
const page = frame && frame.contentDocument.body;
return page && page.dataset.presence === 'PRESENT' && Number(page.dataset.messages) > 0;
"""


def topics_of(rosCas, msg_type):
    """The topics of a type, those with most messages first."""
    found = [t for t in rosCas.getAllTopics() if t.getMeta["msg_type"] == msg_type]
    return sorted(found, key=lambda topic: -topic.countTopicData())


def map_of(rosCas, scan):
    """The topic of the map: as it was recorded, else made of the scans and stored as /map."""
    recorded = topics_of(rosCas, MAP)
    if recorded:
        print(f"map:      {recorded[0].name}, as it was recorded")
        return recorded[0]
    made = makeMap(rosCas, scan.name)
    topic = rosCas.addTopic("/map", key_format="manual", comment="made of " + scan.name)
    topic.addData(made.map.message(), key="figure3b")
    print(f"map:      {made.map.width} x {made.map.height} cells of {made.used} scans")
    print(f"poses:    {', '.join(made.sources)}")
    if not any(source.startswith("tf ") for source in made.sources):
        add_transforms(rosCas, scan, made.map.frame)
    return topic


def add_transforms(rosCas, scan, frame):
    """Store as /tf where the sensor was at each scan, for it was recorded by a topic only."""
    tf = rosCas.addTopic("/tf", msg_type="tf2_msgs/TFMessage")
    scans = [(row.key, row.message().header) for row in scan.rows()]
    times = np.array([[key.ns, header.stamp.to_nsec()] for key, header in scans])
    sensor = scans[0][1].frame_id
    poses = SensorPoses(PoseChoice(), Measurements(rosCas.catalog, scan.name), times[:, 0].tolist())
    placed = poses.at(sensor, times[:, 0], times[:, 1])
    for (key, header), place, turn, known in zip(
        scans, placed.poses.moved, placed.poses.turned, placed.known
    ):
        if not known:
            continue
        moved = TransformStamped(child_frame_id=sensor)
        moved.header.frame_id, moved.header.stamp = frame, header.stamp
        to = moved.transform
        to.translation.x, to.translation.y = place[:2]
        to.translation.z = place[2] or ABOVE_M
        to.rotation.x, to.rotation.y, to.rotation.z, to.rotation.w = turn
        tf.addData(TFMessage([moved]), key=key)


def layout_of(grid, scan):
    """One panel of the Studio, from above, as wide as the map; as an address carries it."""
    message = grid.getData(grid.last())
    info = message.info
    width, height = info.width * info.resolution, info.height * info.resolution
    middle = info.origin.position.x + width / 2, info.origin.position.y + height / 2, 0
    config = {
        "cameraState": {
            **{"perspective": False, "phi": 0, "thetaOffset": 0, "targetOffset": middle},
            "distance": 1.2 * max(width * SIZE[1] / SIZE[0], height),
        },
        "followTf": message.header.frame_id,
        "topics": {
            grid.name: {"visible": True},
            scan.name: {"visible": True, "flatColor": "#e5322d", "colorField": "range", **POINTS},
        },
    }
    text = json.dumps({"layout": "3D!map", "configById": {"3D!map": config}})
    deflate = zlib.compressobj(wbits=-zlib.MAX_WBITS)
    data = deflate.compress(text.encode()) + deflate.flush()
    return base64.urlsafe_b64encode(data).decode().rstrip("=")


@contextmanager
def viewer(arguments):
    """Start the viewer; yield its address, and the token as the end of a query ('' = none)."""
    command = [sys.executable, str(VIEWER), "--port", "0", *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            line = process.stdout.readline()
            address, _, token = line.split(" is at ")[1].split()[0].partition("?")
            yield address.rstrip("/"), f"&{token}" if token else ""
        finally:
            process.terminate()


def shoot(url, picture):
    """Make a PNG of what the viewer shows."""
    from chromium import chromium

    with chromium(SIZE) as browser:
        browser.driver.get(url)
        browser.wait_for(DRAWN, timeout_sec=120)
        picture.write_bytes(browser.settled())
    print(f"picture:  {picture}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    default = Path(BAGS, "luminar_stage_lz4.bag") if BAGS else None
    text = "a bag with scans, of one robot"
    add("bag", nargs="?" if default else None, type=Path, default=default, help=text)
    add("--scan", metavar="TOPIC", help="default: the topic of scans that has most")
    add("--keyspace", default="figure3b", help="default: figure3b")
    add("--host", help="default: CASSANDRA_ROS_HOST, or as your cqlshrc says")
    add("--port", type=int, help="default: CASSANDRA_ROS_PORT, or as your cqlshrc says")
    add("--cqlshrc", help="file like cqlsh's; default: ~/.cassandra/cqlshrc")
    add("--credentials", help="file like cqlsh's; default: ~/.cassandra/credentials")
    add("--picture", type=Path, metavar="PNG", help="make a picture of it, with chromium")
    add("--view", action="store_true", help="leave the viewer running until Ctrl-C")
    args = parser.parse_args()

    login = {"cqlshrc": args.cqlshrc, "credentials": args.credentials}
    with RosCassandra(args.host, args.port, **login) as rosCas:
        rosCas.connectToKeyspace(args.keyspace)
        report = import_bag(rosCas, args.bag)
        print(f"stored:   {report.messages} messages of {args.bag.name}")
        scan = rosCas.getTopic(args.scan) if args.scan else topics_of(rosCas, SCAN)[0]
        grid = map_of(rosCas, scan)
        moment = scan.first() + (scan.last() - scan.first()).to_sec() / 2
        tf = [name for name in ("/tf", "/tf_static") if rosCas.existTopic(name)]
        store = ["--keyspace", args.keyspace]
        store += [] if args.host is None else ["--store-host", args.host]
        store += [] if args.port is None else ["--store-port", str(args.port)]
        for name, file in login.items():
            store += [] if file is None else [f"--{name}", file]
        topics = ",".join([grid.name, scan.name, *tf])
        page = f"/look.html?layout={layout_of(grid, scan)}&topics={topics}"
        page += f"&start={scan.first()}&end={scan.last()}&time={moment}"
    with viewer(store) as (address, token):
        page += token
        print(f"look at:  {address}{page}", flush=True)
        if args.picture:
            shoot(address + page, args.picture)
        if args.view:
            print("Ctrl-C ends it", flush=True)
            try:
                sys.stdin.read()
            except KeyboardInterrupt:
                print()


if __name__ == "__main__":
    main()
