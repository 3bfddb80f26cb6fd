# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A message as a tree of plain values, by the field names of its definition.

The text formats use it: ``read`` makes the tree from wire bytes and ``build`` the inverse.
``string`` prints the tree with ``echo``; ``json`` and ``yaml`` write it as their text.
"""
