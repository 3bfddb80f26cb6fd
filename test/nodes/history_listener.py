# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A node with a HistorySubscriber: its arguments are JSON; a line on stdin asks what it got."""

from __future__ import annotations

import hashlib
import json
import sys
import threading
import time

import roslib.message
import rospy

from cassandra_ros import HistorySubscriber
from cassandra_ros.messages.classes import serialize
from cassandra_ros.nodes.node import forward_logging

wanted = json.loads(sys.argv[1])
rospy.init_node("listener", anonymous=True, disable_signals=True)
forward_logging()
threads = set()
got = []


def take(msg, words):
    threads.add(threading.get_ident())
    wire = serialize(msg)
    shown = wire.hex() if len(wire) < 64 else hashlib.md5(wire).hexdigest()
    got.append((msg._connection_header.get("callerid"), shown))
    time.sleep(words["slow"])


def announce():
    while not subscriber.isLive:
        time.sleep(0.01)
    print("live", flush=True)


name = wanted.pop("type", None)
data_class = roslib.message.get_message_class(name) if name else rospy.AnyMsg
words = {"slow": wanted.pop("slow", 0.0)}
subscriber = HistorySubscriber(wanted.pop("topic"), data_class, take, words, **wanted)
print("subscribed", flush=True)
threading.Thread(target=announce, daemon=True).start()
for line in sys.stdin:
    command = line.strip()
    if command == "count":
        print(json.dumps(len(got)), flush=True)
    if command == "unregister":
        subscriber.unregister()
        print("unregistered", flush=True)
    if command == "got":
        one = len(threads) <= 1
        print(
            json.dumps(
                {"got": got, "lost": subscriber.lost, "failed": subscriber.failed, "one": one}
            ),
            flush=True,
        )
rospy.signal_shutdown("done")
