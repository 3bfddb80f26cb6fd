# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A message as a tree of plain values, by the field names of its definition.

The text formats use it: ``string`` prints the tree that ``read`` makes by ``echo``, ``json`` and
``yaml`` turn it into their text, and ``build`` makes the message of it again.
"""
