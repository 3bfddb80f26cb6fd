# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Formats: how a message becomes the columns of a row, and a row a message again."""
