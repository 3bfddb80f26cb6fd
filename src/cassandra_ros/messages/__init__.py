# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""ROS message types and serialised messages, without a database.

``spec`` parses one message type, ``shape`` limits its size, ``definition`` checks the full text of
a type and of the types that it uses. ``key_part`` and ``index_field`` read one field of a message,
by which messages are found. ``stamps`` is time. Folders:

- ``wire/`` converts serialised messages to columns and back.
- ``tree/`` converts them to plain values, for texts.
- ``formats/`` has the six formats in which a row keeps a message, a file each.

In: bytes, a type's name and its definition. Out: columns, values, objects of generated classes.
This room imports no other. genpy, genmsg, roslib and rosgraph come in here.
"""
