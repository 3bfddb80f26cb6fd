# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The query language: parse a statement, check it against the definitions, run it.

``tree`` parses a statement (by the grammar ``cql.lark``) to a tree. ``plan`` determines which part
of it the store can answer or filter. ``rows`` reads field values from messages, checks conditions
and makes the rows of the result. ``run`` joins them; ``explain`` reports how a statement was
answered. ``protocols`` and ``source`` are the interfaces to the caller, which has the stored rows.
No driver, no rospy.
"""
