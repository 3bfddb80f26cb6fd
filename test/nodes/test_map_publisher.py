# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A map that is published, as a node that comes later gets it."""

from __future__ import annotations

from mapping.room import Drive
from nav_msgs.msg import OccupancyGrid
from nodes.children import start_node
from nodes.raw_subscriber import RawSubscriber


def test_a_late_subscriber_gets_the_map(roscore, cassandra, rosCas, keyspace):
    Drive().store(rosCas, ("/odom", "/scan"))
    where = ("--host", cassandra.host, "--port", cassandra.port, "--keyspace", keyspace)
    words = ("map", "/scan", "--publish", "/office", "--resolution", "0.1", "--limit", "8")
    with start_node(roscore, "cassandra_bag", *words, *where) as publisher:
        publisher.await_line("the map is latched on /office until Ctrl-C")
        for _ in range(2):  # each is a new subscriber
            with RawSubscriber(roscore.uri, "/office") as subscriber:
                assert subscriber.header["type"] == b"nav_msgs/OccupancyGrid"
                assert subscriber.header["latching"] == b"1"
                assert subscriber.header["md5sum"].decode() == OccupancyGrid._md5sum
                grid = OccupancyGrid().deserialize(subscriber.read())
            assert (grid.header.frame_id, round(grid.info.resolution, 6)) == ("odom", 0.1)
            assert sum(cell >= 65 for cell in grid.data) > 50
        assert "map of 8 messages of /scan" in publisher.output
        assert publisher.end() == 0, publisher.output
