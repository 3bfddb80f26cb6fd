#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The Python listing of the paper on a recorded Husky: who, when, where, and what was sensed."""

from __future__ import annotations

import argparse
import os

from cassandra_ros import RosCassandra


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
    parser.add_argument(
        "--notes", default="listing", help="keyspace that a note is written into (%(default)s)"
    )
    args = parser.parse_args()

    login = {"cqlshrc": args.cqlshrc, "credentials": args.credentials}
    rosCas = RosCassandra(args.host, args.port, **login)
    rosCas.connectToKeyspace(args.keyspace, make=False)

    # Which topics come from a GPS receiver, and which robot recorded them?
    for topic in rosCas.getAllTopics():
        if topic.getMeta["msg_class"] in ["NavSatFix", "TimeReference"]:
            print(f"{topic.name}: {topic.getMeta['msg_type']} of node {topic.getMeta['nodeID']!r}")

    # A time range: from 3 to 4 s after the first fix.
    casTopic = rosCas.getTopic("fix")
    t1, t2 = casTopic.first() + 3, casTopic.first() + 4
    fixes = casTopic.getData(key=t1, to_key=t2)
    print(f"{len(fixes)} fixes from {t1} to {t2}, of type {type(fixes[0]).__name__}")

    # The working area of a wheel in that time +- 5 s; values are bound or pasted as you like.
    frame = "/front_left_wheel"
    stmt = (
        "select transforms.transform.translation.x from tf where transforms.child_frame_id='"
        + frame
        + "' and KEY > "
        + str(t1 - 5)
        + " and KEY < "
        + str(t2 + 5)
    )
    x_list = rosCas.executeCQL(stmt)
    x_min = min(x_list)[0]
    x_max = max(x_list)[0]
    print(f"{frame} in {len(x_list)} transforms: x from {x_min} to {x_max} m")

    # A type that is installed nowhere, from the definition that was stored with it.
    key, encoders = next(rosCas.getTopic("/husky/data/encoders").items(key=t1))
    travels = [encoder.travel for encoder in encoders.encoders]
    print(f"{type(encoders)._type} at {key}: travel {travels}")

    # A message added by hand, beside what was recorded, found again by its exact key.
    rosCas.connectToKeyspace(args.notes)
    rosCas.addTopic("/operator/notes", format="ros")
    notes = rosCas.getTopic("/operator/notes")
    from std_msgs.msg import String

    key = notes.addData(String(data="left turn at the gate"), key=t1)
    print(f"note at {key}: {notes.getData(key).data!r}")
    rosCas.close()


if __name__ == "__main__":
    main()
