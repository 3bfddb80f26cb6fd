# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The tables of a keyspace: schema, directory of buckets, side tables. No ROS."""
