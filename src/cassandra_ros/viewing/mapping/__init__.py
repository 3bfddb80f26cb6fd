# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Occupancy grids made from stored scans and clouds, and the poses of the sensors."""
