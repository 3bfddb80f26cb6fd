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
from cassandra_ros.nodes.ros_node import forward_logging
from cassandra_ros.playing.history import stored_past, topic_history

# What is recorded comes into the store: a machine that stands still for a while lets it be late.
topic_history.PATIENCE_SEC = topic_history.DOUBT_SEC = 150.0
topic_history.MOST_SEC = 300.0
stored_past.RUNNING_REPORT_SEC = 150.0
wanted = json.loads(sys.argv[1])
rospy.init_node("listener", anonymous=True, disable_signals=True)
forward_logging()
threads = set()
got = []
printing = threading.Lock()


def say(text):
    with printing:  # two threads do: a line of each, not a line of both
        # At once: print writes the end of a line by itself, behind what others log meanwhile.
        sys.stdout.write(f"{text}\n")
        sys.stdout.flush()


def take(msg, words):
    threads.add(threading.get_ident())
    wire = serialize(msg)
    shown = wire.hex() if len(wire) < 64 else hashlib.md5(wire).hexdigest()
    got.append((msg._connection_header.get("callerid"), shown))
    time.sleep(words["slow"])


def announce():
    while not subscriber.isLive:
        time.sleep(0.01)
    say("live")


name = wanted.pop("type", None)
data_class = roslib.message.get_message_class(name) if name else rospy.AnyMsg
words = {"slow": wanted.pop("slow", 0.0)}
subscriber = HistorySubscriber(wanted.pop("topic"), data_class, take, words, **wanted)
say("subscribed")
threading.Thread(target=announce, daemon=True).start()
for line in sys.stdin:
    command = line.strip()
    if command == "count":
        say(json.dumps(len(got)))
    if command == "unregister":
        subscriber.unregister()
        say("unregistered")
    if command == "got":
        one = len(threads) <= 1
        answer = {"got": got, "lost": subscriber.lost, "failed": subscriber.failed, "one": one}
        say(json.dumps(answer))
rospy.signal_shutdown("done")
