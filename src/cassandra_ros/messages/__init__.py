# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""ROS types and their messages without a database: what a definition says, and what bytes mean.

``spec`` parses one message type, ``shape`` bounds its depth and size and computes its md5, and
``definition`` checks the full text that a connection or bag brings; ``installed`` finds the types
of this machine and ``classes`` makes message objects. ``connection`` keeps connection headers,
``stamps`` are the times that rows lie by, ``graph`` asks a ROS master for a topic's type.
``key_part`` and ``index_field`` take one field out of messages, by which they are found.
``wire/`` turns serialised messages into columns and back, ``tree/`` into plain values for texts.
"""
