# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Poses of robots over time, and the coarse cells of the ground by which they are found.

This room lies below topics/, whose statements and ``near`` use it. Like transforms/, it knows a
topic as a ``query.source.Source``, and gets topics from a function that raises TopicNotFound.
"""
