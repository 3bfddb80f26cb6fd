# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the rosbag module says of a bag: the measure that our reader and writer are held to."""

from __future__ import annotations

from typing import NamedTuple

import rosbag
from compiled import compiled

from cassandra_ros.messages.connection_header import Connection, live_connection


class Read(NamedTuple):
    """One message as rosbag hands it out."""

    topic: str
    t_ns: int
    type: str
    md5sum: str
    data: bytes
    header: dict


def read_with_rosbag(path):
    """Return the connections [(id, topic, header)] and the messages in the order of rosbag."""
    with rosbag.Bag(str(path)) as bag:
        if bag.get_compression_info().compression == rosbag.Compression.LZ4:
            compiled("roslz4")
        messages = [
            Read(topic, t.to_nsec(), raw[0], raw[2], raw[1], header)
            for topic, raw, t, header in bag.read_messages(raw=True, return_connection_header=True)
        ]
        connections = [(c.id, c.topic, c.header) for c in bag._get_connections()]
    return connections, messages


STRING_MD5 = "992ce8a1687cec8c8bd883ec73ca41d1"


def string_connection(topic="/chatter", number=-1, **fields):
    """Return a connection of std_msgs/String; further fields of its header by keyword."""
    header = {
        "topic": topic,
        "type": "std_msgs/String",
        "md5sum": STRING_MD5,
        "message_definition": "string data\n",
        **fields,
    }
    return Connection(topic, live_connection(topic, header).header, number)


def string_wire(text):
    """Serialise a std_msgs/String."""
    data = text.encode() if isinstance(text, str) else text
    return len(data).to_bytes(4, "little") + data
