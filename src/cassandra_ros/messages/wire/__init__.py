# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The wire layout of a message type: walked, skipped, built, without message objects."""
