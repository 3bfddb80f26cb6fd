# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A user's own node that plays: it has a publisher of a played topic, and no signal handlers."""

from __future__ import annotations

import sys

import rospy
from std_msgs.msg import Int32

from cassandra_ros import Player, PlayerOptions, PlaySelection, RosCassandra
from cassandra_ros.playing import playback

playback.COMMAND_SEC = 180.0  # a busy machine is waited for


def main():
    host, port, keyspace = sys.argv[1:]
    rospy.init_node("own", disable_signals=True)
    own = rospy.Publisher("/own", Int32, queue_size=100)
    options = PlayerOptions(paused=True, keep_alive=True, wait_for_subscribers=True, rate=1000.0)
    with RosCassandra(host, int(port), keyspace=keyspace) as rosCas:
        with Player(rosCas, PlaySelection(remap={"/n": "/own"}), options) as player:
            while not own.get_num_connections():
                player.wait(0.02)
            print("stepped", player.step(2) - player.stream.start_ns)
            print("sought", player.seek(5.0) - player.stream.start_ns, player.resume())
            while player.status().state != "ended":
                player.wait(0.02)
            (topic,) = player.status().topics
            print("published", topic.topic, topic.published)
        print("ended", player.wait())
    own.publish(Int32(99))  # it is still ours
    sys.stdin.readline()
    rospy.signal_shutdown("done")


main()
