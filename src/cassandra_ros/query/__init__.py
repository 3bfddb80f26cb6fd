# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The query language: parse a statement, check it against the definitions, run it.

``tree`` parses a statement (by the grammar ``cql.lark``) and holds it; ``plan`` finds what
of it the store can answer or leave out; ``rows`` takes values out of messages, checks conditions
and makes the rows of the result. ``run`` joins them; ``explain`` tells how a statement was
answered. ``protocols`` and ``source`` say what is needed of the caller that has the rows. No
driver, no rospy.
"""
