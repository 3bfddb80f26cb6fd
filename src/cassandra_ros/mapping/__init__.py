# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Occupancy grids out of stored scans and clouds, and the poses from which they were taken."""
