# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The query language: parse, check against the definitions, run.

``cql.lark`` is the grammar and ``syntax`` the tree that ``parse`` makes of a statement; ``fields``
finds the fields that it names, ``literals`` fits its values to their types, ``evaluate`` says what
it means, ``bounds``, ``terms`` and ``pushdown`` what the store may leave out, ``extract`` takes
values out of messages, ``plan`` makes rows of them, ``run`` joins all, and ``explain`` tells how.
``statements`` runs what changes the store. ``arrays`` and ``frames`` give the fields of many
messages at once, of which ``table_values`` and ``table_columns`` gather those of one table. No
driver, no rospy.
"""
