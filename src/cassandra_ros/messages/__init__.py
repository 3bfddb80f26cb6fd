# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""ROS message types and serialised messages, without a database.

``spec`` parses one message type, ``shape`` limits its size, ``definition`` checks the full text of
a type and of the types that it uses. ``key_part`` and ``index_field`` read one field of a message,
by which messages are found. ``wire/`` converts messages to columns and back, ``tree/`` converts
them to plain values for the text formats.
"""
