# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Blocks of messages as rows (format ``packed``): packed, stored, found, read. No ROS."""
