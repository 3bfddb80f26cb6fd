# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rows into Cassandra and out: writer, reader, counts, rows found by their keys. No ROS."""
