# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What records: sources, a buffer bounded in bytes, counts by topic. No rospy, no bags."""
