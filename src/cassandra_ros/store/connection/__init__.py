# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The connection to a cluster: login, sessions, requests, errors of the driver. No ROS."""
