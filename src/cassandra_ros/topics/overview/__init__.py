# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is shown over time: timelines, series, envelopes, latest and latched messages."""
