# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""SQL over all topics by DuckDB: statements are checked, and their topics read as far as needed."""
