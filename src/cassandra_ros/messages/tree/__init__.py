# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A message as a tree of plain values, by the field names of its definition.

``read`` makes the tree of wire bytes, within a budget of characters; ``build`` makes wire bytes of
a tree and refuses what is no message; ``echo`` prints a tree as ``rostopic echo`` prints the
message. The text formats use them: ``formats/string.py`` prints, ``json.py`` and ``yaml.py`` turn
the tree into their text and build the message of it again.
"""
