# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Cassandra: connection, schema, directory of buckets, rows in and out. No ROS in here.

This is the only folder that imports the driver; its errors are translated here, once.
"""
