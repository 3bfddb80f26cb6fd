# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The ROS nodes: they unpack, call the library, pack. Only here is rospy imported.

``recorder`` subscribes and hands bytes on, through ``subscription``, which loses nothing that rospy
would lose; ``recorder_node`` is the node around it; ``query_node`` answers services with what the
library makes of the store. The module ``node`` is for both: name, log and time.
"""
