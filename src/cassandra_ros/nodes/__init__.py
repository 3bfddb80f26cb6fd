# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The ROS nodes: they unpack requests, call the library and pack answers. Only they import rospy.

``recorder`` subscribes through ``subscription``, which avoids the losses of rospy, and hands the
bytes to a recording; ``recorder_node`` is the node around it. ``player`` publishes bytes as they
are stored, through ``publication``; ``query_node`` answers services. All nodes use ``ros_node`` for
their name, log, time and services. ``registration`` registers again with a master that was started
anew. ``history_subscriber`` receives what is stored first, then what is live.

In: messages and requests of ROS. Out: messages and answers of ROS.
This room imports recording/, playing/, stores/, client/ and what client/ imports.
"""
