# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""ROS types and their messages without a database: what a definition says, and what bytes mean.

``spec`` parses one message type, ``shape`` bounds it, ``definition`` checks the full text of one
with all that it uses. ``key_part`` and ``index_field`` take one field out of messages, by which
they are found; ``wire/`` turns messages into columns and back, ``tree/`` into values for texts.
"""
