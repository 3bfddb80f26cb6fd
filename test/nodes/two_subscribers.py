# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A node with two subscribers of a topic: ours leaves after the first message."""

from __future__ import annotations

import sys
import threading

import rospy
from std_msgs.msg import String

from cassandra_ros.messages.classes import deserialize
from cassandra_ros.nodes.subscription import subscribe

heard = {"ours": threading.Event(), "other": threading.Event()}


def take(who, msg):
    sys.stdout.write(f"{who}: {msg.data}\n")
    sys.stdout.flush()
    heard[who].set()


rospy.init_node("listener", anonymous=True)
ours = subscribe("/a", lambda topic, header, wire: take("ours", deserialize(String, wire)))
other = rospy.Subscriber("/a", rospy.AnyMsg, lambda m: take("other", deserialize(String, m._buff)))
print("both listen", flush=True)
for event in heard.values():
    event.wait()
ours.unregister()
print("one left", flush=True)
rospy.spin()
