# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The query language: parse, check against the definitions, run.

``cql.lark`` is the grammar, ``syntax`` the tree that ``parse`` makes of a statement by ``builder``
and ``binding``; ``settle`` and ``resolve`` find what it names (by ``names``), ``literals``
fits its values to their types, ``computed`` makes values of others, ``evaluate`` says what a
condition means, ``extract`` takes values out of messages, and ``projection`` makes of all this the
plan for one table. ``run`` and ``pushdown`` say what the store may leave out, ``run``, ``gathered``
and ``aggregates`` give the rows, ``explain`` tells how. ``protocols`` is what is needed of whoever
has the rows. No driver, no rospy.
"""
