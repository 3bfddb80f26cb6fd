# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What of a statement the store can answer or leave out: bounds of keys, filters, blocks."""
