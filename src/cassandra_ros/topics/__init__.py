# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The topic management of the paper: RosCassandra and CassandraTopic, and what they write with."""
