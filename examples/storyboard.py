#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The storyboard of the paper (4.1.2): who saw it, when, where, and who else was there?

Two turtles of turtlesim share a keyspace. The camera of each is its colour sensor, one pixel that
looks down; what is searched is the bare floor between the lines that the turtles paint.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from cassandra_ros import RosCassandra
from cassandra_ros.files.bag.importer import import_bag

BAG = Path(__file__).resolve().parent / "data" / "turtlesim_tf.bag"
CAMERAS = ["Image", "CompressedImage", "LaserScan", "Color"]
FLOOR = "r = 69 and g = 86 and b = 255"
GAP_SEC = 0.5  # unseen for longer: a sighting of its own


def record(rosCas):
    """What each robot recorded, under its nodeID: the name of its frame in tf."""
    for robot in ("turtle1", "turtle2"):
        topics = [f"/{robot}/{name}" for name in ("color_sensor", "pose", "cmd_vel")]
        report = import_bag(rosCas, BAG, topics=topics, nodeID=robot)
        print(f"stored:   {report.messages} messages of {robot}")
    report = import_bag(rosCas, BAG, topics=["/tf", "/tf_static"])
    print(f"          {report.messages} messages of tf")


def cameras(rosCas):
    """The topics that may have seen it, by their metadata."""
    for topic in rosCas.getAllTopics():
        if topic.getMeta["msg_class"] in CAMERAS:
            yield topic


def sightings(rosCas, topic):
    """When the camera saw it: a list of [first seen, last seen]."""
    found = []
    for (key,) in rosCas.executeCQL(f"select KEY from {topic.name} where {FLOOR}"):
        if found and key <= found[-1][1] + GAP_SEC:
            found[-1][1] = key
        else:
            found.append([key, key])
    return found


def longest_look(rosCas):
    """Who saw it for the longest time, and when: nodeID, t1, t2."""
    looks = []
    for topic in cameras(rosCas):
        nodeID = topic.getMeta["nodeID"]
        found = sightings(rosCas, topic)
        looks += [(t2 - t1, nodeID, t1, t2) for t1, t2 in found]
        print(f"camera:   {topic.name}, a {topic.getMeta['msg_type']}, saw it {len(found)} times")
    lasted, nodeID, t1, t2 = max(looks)
    print(f"who:      {nodeID}\nwhen:     {t1} to {t2}, {lasted.to_sec():.2f} s")
    return nodeID, t1, t2


def area(rosCas, nodeID, t1, t2):
    """Where the robot was then, 5 s before and after included: the statement of the paper."""
    stmt = (
        "select transforms.transform.translation.x, transforms.transform.translation.y from tf"
        " where transforms.child_frame_id='"
        + nodeID
        + "' and KEY > "
        + str(t1 - 5)
        + " and KEY < "
        + str(t2 + 5)
    )
    xy_list = rosCas.executeCQL(stmt)
    (x_min, y_min), (x_max, y_max) = map(min, zip(*xy_list)), map(max, zip(*xy_list))
    return x_min, x_max, y_min, y_max


def others(rosCas, nodeID, t1, t2, bounds):
    """Who else was in this area at this time; here the values are bound."""
    stmt = (
        "select transforms.child_frame_id, KEY from tf where transforms.child_frame_id != ?"
        " and transforms.transform.translation.x between ? and ?"
        " and transforms.transform.translation.y between ? and ?"
        " and KEY between ? and ?"
    )
    seen = {}
    for frame, key in rosCas.executeCQL(stmt, [nodeID, *bounds, t1 - 5, t2 + 5]):
        seen.setdefault(frame, []).append(key)
    return {frame: (len(keys), keys[-1] - keys[0]) for frame, keys in seen.items()}


def mounted(rosCas, nodeID):
    """The frames that the robot carries: its sensors, as the paper finds them."""
    stmt = "select transforms.child_frame_id from tf_static where transforms.header.frame_id = ?"
    return [frame for (frame,) in rosCas.executeCQL(stmt, [nodeID])]


def readings(rosCas, nodeID, t1, t2):
    """What the robot sensed in this time: the messages of its topics, as they were sent."""
    for topic in rosCas.getAllTopics():
        if topic.getMeta["nodeID"] == nodeID:
            yield topic.name, topic.getData(key=t1 - 5, to_key=t2 + 5)


def replay(rosCas, topics, t1, t2):
    """Publish the window again, as fast as it was."""
    import rospy

    rospy.init_node("storyboard", anonymous=True)
    rows = list(rosCas.readMessages(topics, t1 - 5, t2 + 5))
    classes = {row.topic: row.message_class() for row in rows}
    publishers = {name: rospy.Publisher(name, classes[name], queue_size=1000) for name in classes}
    print(f"waiting for subscribers of {' '.join(classes)}", flush=True)
    while not all(publisher.get_num_connections() for publisher in publishers.values()):
        rospy.sleep(0.1)
    began = time.monotonic()
    for row in rows:
        due = began + (row.key - rows[0].key).to_sec()
        time.sleep(max(0.0, due - time.monotonic()))
        publishers[row.topic].publish(row.message())
    time.sleep(1.0)  # rospy sends from a thread of its own
    print(f"replayed: {len(rows)} messages in {time.monotonic() - began:.1f} s")


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
    parser.add_argument("--keyspace", default="storyboard", help="default: %(default)s")
    parser.add_argument("--replay", action="store_true", help="publish the messages again")
    args = parser.parse_args()

    login = {"cqlshrc": args.cqlshrc, "credentials": args.credentials}
    with RosCassandra(args.host, args.port, keyspace=args.keyspace, **login) as rosCas:
        record(rosCas)
        nodeID, t1, t2 = longest_look(rosCas)
        x_min, x_max, y_min, y_max = bounds = area(rosCas, nodeID, t1, t2)
        print(f"where:    x {x_min:.2f} to {x_max:.2f} m, y {y_min:.2f} to {y_max:.2f} m")
        for frame, (count, stay) in others(rosCas, nodeID, t1, t2, bounds).items():
            print(f"who else: {frame}, {count} transforms in {stay.to_sec():.2f} s")
        for frame in mounted(rosCas, nodeID):
            at = rosCas.lookupTransform("world", frame, t1).transform.translation
            print(f"carried:  {frame}, then at x {at.x:.2f} m, y {at.y:.2f} m")
        topics = []
        for name, messages in readings(rosCas, nodeID, t1, t2):
            print(f"sensed:   {name}, {len(messages)} messages {type(messages[0])._type}")
            topics.append(name)
        if args.replay:
            replay(rosCas, topics, t1, t2)
        else:
            store = f"--port {rosCas.cassandra.port} --keyspace {args.keyspace}"
            window = f"--start {t1 - 5} --end {t2 + 5} --topics {' '.join(topics)}"
            print("replay:   examples/storyboard.py --replay, or")
            print(f"          cassandra_bag export seen.bag {store} \\")
            print(f"            {window}")
            print("          rosbag play seen.bag")


if __name__ == "__main__":
    main()
