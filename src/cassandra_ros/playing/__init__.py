# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Choice, order and names of the messages that are played; nothing is published here.

``play_selection`` says what is played. ``play_stream`` puts it in one order, window by window,
several robots as if at once; it reads one keyspace (``played_store``) or a fleet
(``played_fleet``). ``read_ahead`` reads before the time, ``playback`` waits for it, ``pace`` knows
when it is. ``history/`` joins the stored past of a topic and its live messages to one sequence.

In: a keyspace or a fleet, options. Out: messages in order, each with the time at which it is due.
This room imports recording/ (for history/), stores/fleet/, topics/ and what topics/ imports.
"""
