# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The stored past of a topic and its live messages as one sequence, without rospy.

nodes/history_subscriber.py subscribes first, then reads. Meanwhile live messages wait in
``live_queue``, within a bound in bytes. ``stored_past`` reads the stored messages by receive time,
also while a recorder writes them. ``alignment`` finds by their bytes, for each publisher, the live
message after the last stored one. ``topic_history`` yields the past, then what was stored
meanwhile, then the live messages, each message once.
"""
