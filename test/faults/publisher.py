# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A publisher of numbered messages that writes what it has published into its own log.

It is a process of its own and uses rospy only. It begins when each of its topics has a subscriber.
With --until it goes on after its last number until a file exists. It prints "published" at the end,
and then waits until it is stopped.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import rospy
from diagnostic_msgs.msg import KeyValue
from std_msgs.msg import String

from faults.numbered import LOG_LINE, text_of, topic_of

TICK_SEC = 0.005
KINDS = {"String": String, "KeyValue": lambda text: KeyValue("", text)}
CLASSES = {"String": String, "KeyValue": KeyValue}


def main() -> None:
    """Publish what the arguments say."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--log", required=True)
    parser.add_argument("--topic", default="/numbered")
    parser.add_argument("--topics", type=int, default=1, help="publish on so many, in turn")
    parser.add_argument("--step", type=int, default=0, help="begin a topic after so many messages")
    parser.add_argument("--kind", choices=sorted(KINDS), default="String")
    parser.add_argument("--first", type=int, default=0, help="the first number")
    parser.add_argument("--count", type=int, required=True)
    parser.add_argument("--rate", type=float, required=True, help="messages a second")
    parser.add_argument("--subscribers", type=int, default=1, help="wait for so many")
    parser.add_argument("--until", type=Path, help="go on until this file exists")
    options = parser.parse_args()
    rospy.init_node("numbered", anonymous=True, disable_rostime=True)
    names = [topic_of(options.topic, number, options.topics) for number in range(options.topics)]
    # Without a queue publish returns when the bytes are with the kernel: nothing is dropped here.
    cls = CLASSES[options.kind]
    outlets = {
        name: rospy.Publisher(name, cls, queue_size=None, tcp_nodelay=True) for name in names
    }
    while any(each.get_num_connections() < options.subscribers for each in outlets.values()):
        time.sleep(0.01)
    with open(options.log, "w", encoding="ascii") as log:
        publish_all(outlets, options, log)
    print("published", flush=True)
    while not rospy.is_shutdown():
        time.sleep(0.1)


def publish_all(outlets, options, log) -> None:
    """Publish all numbers at the rate."""
    make, began, done = KINDS[options.kind], time.monotonic(), 0
    while not rospy.is_shutdown():
        due = int((time.monotonic() - began) * options.rate) + 1
        if options.until is None or options.until.exists():
            due = min(due, max(done, options.count))
            if done == due >= options.count:
                break
        for position in range(done, due):
            number = options.first + position
            outlet = outlets[topic_of(options.topic, number, options.topics, options.step)]
            connections, now = outlet.get_num_connections(), time.time_ns()
            outlet.publish(make(text_of(number)))
            line = LOG_LINE.format(number=number, time_ns=now, connections=connections)
            log.write(line)
        log.flush()
        done = due
        time.sleep(TICK_SEC)


if __name__ == "__main__":
    main()
