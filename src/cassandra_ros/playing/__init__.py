# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Choice, order and names of the messages that are played; nothing is published here.

``play_selection`` says what, ``played_store`` and ``played_fleet`` read it ahead in windows,
several robots as if at once. ``history/`` joins the stored past of a topic and its live messages
to one sequence.

In: a keyspace or a fleet, options. Out: messages in order, each with the time at which it is due.
This room imports recording/ (for history/), stores/fleet/, topics/ and what lies below.
"""
