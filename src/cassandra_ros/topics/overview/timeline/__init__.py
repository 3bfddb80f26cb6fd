# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Timelines of stored messages, as counts in equal cells of time, for pictures."""
