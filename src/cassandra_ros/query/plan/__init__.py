# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Work that the store can do for a statement: bounds of keys, filters of rows and blocks."""
