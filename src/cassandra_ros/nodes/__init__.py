# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The ROS nodes: they unpack, call the library, pack. Only here is rospy imported.

``recorder`` subscribes and hands bytes on, through ``subscription``, which loses nothing that
rospy would lose; ``query_server`` answers services with what ``services`` and ``stored_messages``
make of the store; ``node_name`` and ``rosout`` are for both.
"""
