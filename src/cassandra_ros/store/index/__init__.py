# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Indexes of topic tables: made, built, back-filled, dropped."""
