# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Runs that store messages at given times, and what NEAR finds of them."""

from __future__ import annotations

import math

from nav_msgs.msg import Odometry

from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.store.tables.registry import Run

SEC = 10**9
T0 = 1_700_000_000 * SEC
GAP = 10 * SEC
EARTH_RADIUS_M = 6_371_008.8


def header_of(message):
    kind = type(message)
    return {
        "type": kind._type,
        "md5sum": kind._md5sum,
        "message_definition": kind._full_text,
        "callerid": "/test",
    }


def odometry(x, y, frame="odom"):
    made = Odometry()
    made.header.frame_id = frame
    made.pose.pose.position.x, made.pose.pose.position.y = x, y
    made.pose.pose.orientation.w = 1
    return made


class Writer:
    """One run that stores messages at given times."""

    def __init__(self, store, node="", name="run", number=None, kind="recording"):
        self.store, self.node = store, node
        self.number = number or Writer.next()
        run = Run(node, self.number, kind, name=name)
        self.writer = store.messageWriter(writer_id=self.number, nodeID=node, run=run)
        self.handles, self.count = {}, 0

    @classmethod
    def next(cls):
        cls.last = getattr(cls, "last", 0) + 1
        return cls.last

    def put(self, topic, t, message):
        if topic not in self.handles:
            self.handles[topic] = self.writer.connect(live_connection(topic, header_of(message)))
        self.writer.write(self.handles[topic], t, self.count, serialize(message))
        self.count += 1

    def __enter__(self):
        return self

    def __exit__(self, *exc_info):
        self.writer.close()


def times_of(rows):
    return sorted(row.t for row in rows)


def asked(store, condition, params=(), **options):
    rows = store.executeCQL(f"select KEY from /n where {condition}", params, **options)
    return sorted(key.to_nsec() for (key,) in rows)


def noted_of(store, name="/odom"):
    """What the index says of the poses of a topic: from when to when."""
    tables = [table.name for table in store.getTopic(name).tables]
    return [(each.low, each.high) for each in store.catalog.keyspace.place_index.placed(tables)]


class Clock:
    def __init__(self):
        self.now = T0

    def __call__(self):
        return self.now


def haversine(one, other):
    """Metres between two (latitude, longitude), by the haversine formula."""
    (lat1, lon1), (lat2, lon2) = ([math.radians(n) for n in place] for place in (one, other))
    square = math.sin((lat2 - lat1) / 2) ** 2
    square += math.cos(lat1) * math.cos(lat2) * math.sin((lon2 - lon1) / 2) ** 2
    return 2 * EARTH_RADIUS_M * math.asin(math.sqrt(min(1.0, square)))
